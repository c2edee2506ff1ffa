"""Virtual facility: the device models of a scenario, reached through the devices' protocols.

The facility runs in a separate process. The scenario defines the models, their parameters and the
connections between the models. All connections to the controllers are links. Time is counted in
cycles. If the process is delayed, it skips no cycle: it runs the delayed cycles later. Therefore
data can be lost only on a link.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from freeflyer.fmi.component import Array, Component, PythonComponent
from freeflyer.foundation.clock import SECOND, seconds
from freeflyer.foundation.interrupts import interrupts
from freeflyer.foundation.plugins import load, plugins
from freeflyer.foundation.signal_name import split
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.master import graph, schedule
from freeflyer.master.connection import Connection
from freeflyer.master.master import Master, Outcome
from freeflyer.scenario import assemble, parameters
from freeflyer.scenario.scenario import Scenario
from freeflyer.scenario.steps import communication_steps
from freeflyer_adapters.device.device import SIMULATED
from freeflyer_adapters.facility import faults
from freeflyer_adapters.facility import settings as facility_settings
from freeflyer_adapters.facility.settings import FacilitySettings
from freeflyer_adapters.facility.virtual_device import VirtualDevice
from freeflyer_adapters.foundation.errors import DeviceError
from freeflyer_adapters.foundation.pacing import Pacer

LONGEST = 7 * 24 * 3600 * SECOND
"""Longest session [ns]."""


Factory = Callable[[str, Mapping[str, Any], Path, FacilitySettings, float], VirtualDevice[Any]]


class _Incoming(PythonComponent):
    def __init__(self, device: VirtualDevice[Any]) -> None:
        super().__init__(f"{device.name}_incoming", device.commands)
        self._device = device

    def step(self, time: float, size: float) -> None:
        self._device.receive(self.values)


class _Outgoing(PythonComponent):
    def __init__(self, device: VirtualDevice[Any]) -> None:
        super().__init__(f"{device.name}_outgoing", device.measurements)
        self._device = device

    def step(self, time: float, size: float) -> None:
        self._device.send(self.values)


class _SessionEnd:
    """A hook that the master calls at every instant. It reports events and ends a session."""

    def __init__(self, devices: list[VirtualDevice[Any]], log: Callable[[str], None]) -> None:
        self.devices, self.log = devices, log
        self._reported = [0] * len(devices)

    def before(self, k: int) -> str | None:
        if k % 10 == 0:
            self.report()
            # A session ends when every device that was active has lost its controller.
            moved = [device for device in self.devices if not device.is_idle]
            if moved and all(device.session_is_over for device in moved):
                return "session over"
        return None

    def after(self, k: int) -> None:
        pass

    def report(self) -> None:
        for i, device in enumerate(self.devices):
            events = device.events
            for cycle, event in events[self._reported[i] :]:
                self.log(f"{device.name}, cycle {cycle}: {event}")
            self._reported[i] = len(events)


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """The models for one session. `stack` closes the models."""

    stack: ExitStack
    master: Master
    values: dict[str, dict[str, Array]]


class Facility:
    """A facility with open links.

    `fmi`, if given, overrides the FMI version of the models. `run` serves one session after another
    until the user interrupts it. Call `close` at the end. The constructor raises DeviceError if the
    scenario, or the table [facility] in it, is not valid for a facility.
    """

    def __init__(self, scenario: Scenario, fmi: int | None = None) -> None:
        # The control loop itself simulates the devices of kind "simulated".
        played = [spec for spec in scenario.devices if spec.kind != SIMULATED]
        if not played:
            raise DeviceError(
                f"scenario {scenario.name} has no [devices.NAME] with a kind other than 'simulated'; a virtual facility needs at least one such device"
            )
        self.scenario, self.fmi = scenario, fmi
        self.settings = facility_settings.read(scenario.facility)
        self.period = _cycle(scenario)
        self.pacer = Pacer(self.period)
        self.devices: list[VirtualDevice[Any]] = []
        self.history: list[dict[str, Any]] = []
        self.outcome: Outcome | None = None
        """Outcome of the last session."""
        self._prepared: Prepared | None = None
        factories = {spec.name: _factory(spec.name, spec.kind) for spec in played}
        self.settings = _with_drawn_faults(self.settings, factories)
        try:
            for spec in played:
                make = factories[spec.name]
                self.devices.append(
                    make(
                        spec.name,
                        spec.options,
                        scenario.directory,
                        self.settings,
                        seconds(self.period),
                    )
                )
            # Build the models now, so that errors are raised before a controller connects.
            self._prepared = self._prepare()
        except BaseException:
            self.close()
            raise

    def run(self, log: Callable[[str], None]) -> Outcome:
        """Run in real time until Ctrl-C, SIGTERM or the failure of a model.

        Return the outcome of the last session. `log` receives one line per event.
        """
        with interrupts() as received:
            for _ in self.cycles(log, received):
                self.pacer.wait()
        assert self.outcome is not None
        return self.outcome

    def cycles(
        self, log: Callable[[str], None], interruptions: Sequence[float] = ()
    ) -> Generator[None, None, None]:
        """Run all sessions and yield after every cycle. The caller controls the time.

        `log` receives one line per event. The generator ends when `interruptions` is not empty, or
        when a model fails.
        """
        while True:
            outcome = self.outcome = yield from self._session(log, interruptions)
            if outcome.failed or outcome.diverged:
                log(f"the model failed: {outcome.cause}")
            if outcome.interrupted or outcome.failed or outcome.diverged:
                return
            log("the controller has disconnected; the robots return to their start poses")

    def _session(
        self, log: Callable[[str], None], interruptions: Sequence[float]
    ) -> Generator[None, None, Outcome]:
        prepared, self._prepared = self._prepared or self._prepare(), None
        with prepared.stack:
            master, values = prepared.master, prepared.values
            for device in self.devices:
                device.begin_session(values[device.name])
            end = _SessionEnd(self.devices, log)
            outcome = master.outcome()
            yield from master.instants(outcome, interruptions, hooks=[end])
            end.report()
            self.history.append({
                "ended": outcome.cause or "interrupted",
                "cycles": outcome.steps[f"{self.devices[0].name}_outgoing"],
                "events": {device.name: [list(event) for event in device.events] for device in self.devices},
            })  # fmt: skip
            return outcome

    def _prepare(self) -> Prepared:
        with ExitStack() as stack:
            master, values = stack.enter_context(self._models())
            return Prepared(stack=stack.pop_all(), master=master, values=values)

    @contextmanager
    def _models(self) -> Iterator[tuple[Master, dict[str, dict[str, Array]]]]:
        """Yield a master and the parameter values of each device model.

        The components of the master are the device models and the link ends. A link end is an
        `_Incoming` or an `_Outgoing`, which connects a model to the link of its device.
        """
        scenario, names = self.scenario, [device.name for device in self.devices]
        everything: dict[str, Component] = {}
        try:
            for spec in scenario.components:
                everything[spec.name] = assemble.make(spec, scenario.directory, self.fmi)
            values = parameters.resolve(scenario, everything)
            models = {name: everything[name] for name in names}
            # Order of a cycle: receive commands, step the models, send measurements.
            components: dict[str, Component] = {}
            for device in self.devices:
                components[f"{device.name}_incoming"] = _Incoming(device)
            components |= models
            for device in self.devices:
                components[f"{device.name}_outgoing"] = _Outgoing(device)
            # The step of a link end is the cycle of the facility.
            steps = communication_steps(scenario, everything, values)
            plan = schedule.build(
                {name: steps.get(name, self.period) for name in components},
                LONGEST,
                LONGEST,
                {name: component.variable_step for name, component in components.items()},
            )
            master = Master(graph.build(components, self._connections()), plan)
            master.initialise({name: values[name] for name in names})
            # A device needs all parameters of its model, including parameters with default values.
            full = {
                name: {
                    p.name: parameters.current(everything, values, name, p.name)
                    for p in models[name].ports.values()
                    if p.settable
                }
                for name in names
            }
            yield master, full
        finally:
            for component in everything.values():
                with suppress(Exception):
                    component.close()

    def _connections(self) -> list[Connection]:
        names = {device.name for device in self.devices}
        # A connection between two device models is physical. All other connections are links.
        joined = [
            c
            for c in self.scenario.connections
            if {split(c.source)[0], split(c.target)[0]} <= names
        ]
        for device in self.devices:
            joined += [
                Connection(
                    source=f"{device.name}_incoming.{p.name}", target=f"{device.name}.{p.name}"
                )
                for p in device.commands
            ]
            joined += [
                Connection(
                    source=f"{device.name}.{p.name}", target=f"{device.name}_outgoing.{p.name}"
                )
                for p in device.measurements
            ]
        return joined

    def report(self) -> dict[str, Any]:
        """Return faults, sessions, counters and times for the result file."""
        histograms = {
            name: h.summary() for device in self.devices for name, h in device.histograms().items()
        }
        return {
            "scenario": self.scenario.name,
            "faults": [fault.one_line() for fault in self.settings.faults],
            "sessions": self.history,
            "own_overruns": self.pacer.overruns,
            "devices": {device.name: dict(device.report()) for device in self.devices},
            "times": {"facility: wake-up": self.pacer.lateness.summary(), **histograms},
        }

    def close(self) -> None:
        """Close the models and all links."""
        if self._prepared is not None:
            self._prepared.stack.close()
        for device in self.devices:
            with suppress(Exception):
                device.close()


def _cycle(scenario: Scenario) -> int:
    """Return the cycle of the facility [ns]: the smallest step of its device models."""
    names = {spec.name for spec in scenario.devices}
    steps = [
        spec.step
        for spec in scenario.components
        if spec.name in names and isinstance(spec.step, int)
    ]
    if not steps:
        raise DeviceError(
            f"scenario {scenario.name}: the step of at least one device model must be a number; the smallest of these steps is the cycle of the facility"
        )
    return min(steps)


def _factory(name: str, kind: str) -> Factory:
    points = plugins("freeflyer.virtual_devices")
    if kind not in points:
        raise DeviceError(
            f"device {name}: no virtual device for the kind {kind!r}{did_you_mean(kind, points)}"
        )
    found: Factory = load(points[kind], f"device {name} of kind {kind!r}")
    return found


def _with_drawn_faults(
    settings: FacilitySettings, factories: Mapping[str, Factory]
) -> FacilitySettings:
    """Return the settings with the scheduled and the random faults. Check all these faults."""
    kinds: dict[str, tuple[str, ...]] = {
        name: getattr(factory, "fault_kinds", ()) for name, factory in factories.items()
    }
    drawn = () if settings.random_faults is None else faults.draw(settings.random_faults, kinds)
    everything = (*settings.faults, *drawn)
    faults.check(everything, kinds)
    return replace(settings, faults=everything)
