"""The hardware in the loop: the scenario's controllers, with devices in the place of its device models.

Devices are configured while the system is assembled, activated together, and stopped together, whatever ended the loop: a damped
ramp-down under the arm's own clock, then brakes. The arm's state frame is the clock; without an arm, absolute deadlines are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from freeflyer import metrics
from freeflyer.assemble import assembled, make
from freeflyer.clock import seconds
from freeflyer.component import Array
from freeflyer.errors import CosimError, StepFailed
from freeflyer.experiment import Result, origin
from freeflyer.graph import Connection, split
from freeflyer.interrupts import interrupts
from freeflyer.master import Master, Outcome, told
from freeflyer.parameters import Values, current
from freeflyer.scenario import ComponentSpec, Measure, Scenario
from freeflyer_adapters import outside, pacing
from freeflyer_adapters.device import SIMULATED, Device, DeviceError, LifeCycle, SafeStop
from freeflyer_adapters.device_component import DeviceComponent
from freeflyer_adapters.histogram import Histogram
from freeflyer_adapters.live_view import STATE, LiveValues
from freeflyer_adapters.pacing import Pacer
from freeflyer_adapters.recording.tap import Recording, Tap

INTERRUPTED = "interrupted by the user"
LONGEST_STOP = 5.0
"""After so long [s] the graded stop is given up, and the devices are left to their own watchdogs."""
VIEW_EVERY = 100
"""Instants between two sets of numbers for the live view."""


@dataclass(frozen=True, kw_only=True)
class LoopReport:
    """What a run in real time adds to a result."""

    granted: Sequence[str]
    times: Mapping[str, Mapping[str, float]]
    devices: Mapping[str, Mapping[str, float]]
    stop: str
    """Why the loop ended, and how the devices were left."""
    recording: Mapping[str, Any] | None = None
    """Where it was recorded, and what is missing there."""

    def summary(self) -> dict[str, Any]:
        return {
            "granted": list(self.granted),
            "times": {name: dict(times) for name, times in self.times.items()},
            "devices": {name: dict(counts) for name, counts in self.devices.items()},
            "stop": self.stop,
            "recording": self.recording,
        }


def with_devices(scenario: Scenario, *, simulated: bool = False, fmi: int | None = None) -> Scenario:
    """Devices in the place of the components of the same names; what joined two of them is physics, which is theirs.

    `simulated`: every device is its own model in this process, and the wall clock paces the loop.
    """
    if not scenario.devices:
        raise DeviceError(f"scenario {scenario.name} has no [devices.NAME]: there is nothing to put into the loop")
    if scenario.exchange != "sequential":
        raise DeviceError(
            f"scenario {scenario.name}: exchange is '{scenario.exchange}', but a device answers at its instant; 'sequential' is expected"
        )
    models = {spec.name: spec for spec in scenario.components}
    if simulated:
        specs = [replace(models[spec.name], kind=SIMULATED, parameters=spec.parameters) for spec in scenario.devices]
    else:
        specs = list(scenario.devices)
    # A simulated device has its model's parameters and, beside them, a device's settings.
    specs = [_with_model(spec, models[spec.name], fmi) if spec.kind == SIMULATED else spec for spec in specs]
    devices = {spec.name: spec for spec in specs}
    others = tuple(spec for spec in scenario.components if spec.name not in devices)

    ports = _ports(specs, scenario.directory)

    def stays(connection: Connection) -> bool:
        """What joins two devices stays in this process only where a model here is the target, and the other end is measured."""
        (source, variable), (target, _) = split(connection.source), split(connection.target)
        if source not in devices or target not in devices:
            return True
        return devices[target].kind == SIMULATED and variable in ports[source]

    connections = tuple(connection for connection in scenario.connections if stays(connection))
    return replace(scenario, components=(*devices.values(), *others), connections=connections)


def _with_model(spec: ComponentSpec, model: ComponentSpec, fmi: int | None) -> ComponentSpec:
    version = {} if fmi is None else {"fmi": fmi}
    return replace(
        spec, parameters={**model.parameters, **spec.parameters}, options={**model.options, **spec.options, **version}
    )


def _ports(specs: Sequence[ComponentSpec], directory: Path) -> dict[str, frozenset[str]]:
    """Which variables each device has; nothing is opened for that."""
    found = {}
    for spec in specs:
        component = make(spec, directory, None)
        found[spec.name] = frozenset(component.ports)
        with suppress(Exception):
            component.close()
    return found


def _guarded(device: Device, call: Callable[[], object]) -> None:
    """A driver fails in its own ways; what was recorded is kept all the same."""
    try:
        call()
    except (StepFailed, CosimError):
        raise
    except Exception as error:
        raise SafeStop(device.name, told(error)) from error


class _Pace:
    """The loop's own times, and its picture."""

    def __init__(
        self,
        devices: Sequence[Device],
        watched: Master,
        energies: Sequence[str],
        errors: Mapping[str, Callable[[], float]],
        asked_to_stop: Callable[[], bool],
    ) -> None:
        clocks = [device for device in devices if device.is_clock]
        self.period = watched.schedule.tick
        self.pacer = None if clocks else Pacer(self.period)
        self.compute = Histogram()
        self.devices = devices
        self._in_order = sorted(devices, key=lambda device: not device.is_clock)
        self.view: LiveValues | None = None
        self.tap: Tap | None = None
        self._clock = clocks[0] if clocks else None
        self._woken = 0
        self._master, self._energies, self._errors = watched, energies, errors
        self._times = {name: h for device in devices for name, h in device.histograms().items()}
        if self.pacer is not None:
            self._times["loop: wake-up"] = self.pacer.lateness
        self._pictured = 0.0
        self._asked_to_stop = asked_to_stop
        self._outside = outside.present()

    def begin(self, k: int) -> str | None:
        if k == 0:
            # As late as can be, and the arm last: from then on it waits for its commands.
            for device in self._in_order:
                _guarded(device, device.check_start)
            for device in reversed(self._in_order):
                if self._asked_to_stop():
                    return INTERRUPTED
                _guarded(device, lambda device=device: device.activate(self._meanwhile))  # type: ignore[misc]
        if self.pacer is not None:
            self._woken = self.pacer.wait()
        return None

    def end(self, k: int) -> None:
        # The arm's answer first: it is waited for.
        for device in self._in_order:
            self._master.hand_over(device.name)
            _guarded(device, device.write)
        woken = self._clock.woken if self._clock is not None else self._woken
        if self.tap is not None:
            self.tap.write(k)
        self.compute.add(self._outside.monotonic_ns() - woken)
        if self.view is not None and k % VIEW_EVERY == 0:
            self.view.write(self.numbers(k))

    def _meanwhile(self) -> bool:
        for device in self.devices:
            device.stay()
        return self._asked_to_stop()

    @property
    def times(self) -> Mapping[str, Histogram]:
        return {"loop: compute": self.compute, **self._times}

    @property
    def names(self) -> list[str]:
        times = ["time [s]", "rate [Hz]", "longest compute [us]", *(f"longest: {name} [us]" for name in self._times)]
        states = [f"{device.name}{STATE}" for device in self.devices]
        errors = [f"{name} error [{'m' if name.endswith('position') else 'deg'}]" for name in self._errors]
        counts = [f"{device.name}: {name.replace('_', ' ')}" for device in self.devices for name in device.report()]
        return [*times, *states, *errors, *(f"least {name} [J]" for name in self._energies), *counts]

    def numbers(self, k: int) -> list[float]:
        """In the order of `names`; times since the last picture, all else as it is."""
        now = self._outside.monotonic()
        rate = VIEW_EVERY / max(now - self._pictured, 1e-9)
        self._pictured = now
        return [
            seconds(k * self.period), rate, self.compute.take_recent(), *(h.take_recent() for h in self._times.values()),
            *(float(device.state.now) for device in self.devices),
            *(error() for error in self._errors.values()),
            *(float(self._master.value(name).min()) for name in self._energies),
            *(value for device in self.devices for value in device.report().values()),
        ]  # fmt: skip


def _present_errors(scenario: Scenario, master: Master, values: Values) -> dict[str, Callable[[], float]]:
    """The scenario's errors as functions of the present instant."""

    def made(measure: Measure, is_position: bool) -> Callable[[], float]:
        ends = []
        for signal in (measure.actual, measure.desired):
            component, variable = split(signal)
            is_output = master.graph.components[component].ports[variable].causality == "output"
            ends.append(master.value(signal) if is_output else current(master.graph.components, values, component, variable))
        actual, desired = (end.reshape(1, -1) for end in ends)
        error = metrics.position_error if is_position else metrics.orientation_error
        return lambda: float(error(actual, desired)[0])

    return {name: made(measure, name.endswith("position")) for name, measure in scenario.errors.items()}


def run(
    scenario: Scenario,
    *,
    real_time: bool = True,
    simulated: bool = False,
    view: bool = False,
    fmi: int | None = None,
    recording: Recording | None = None,
    say: Any = print,
) -> tuple[Result, LoopReport]:
    """Configure, activate, run, stop. Raises CosimError before anything moves; afterwards everything is in the result."""
    scenario = with_devices(scenario, simulated=simulated, fmi=fmi)
    pacing.prepare_links(real_time)
    try:
        # Until something is active, Ctrl-C is an ordinary exception, which closes what was opened.
        with assembled(scenario, fmi) as (master, values), interrupts() as asked:
            return _run(scenario, master, values, real_time, view, recording, asked, say)
    finally:
        pacing.leave_real_time()


@dataclass(frozen=True, kw_only=True)
class Looked:
    """What a device measures before anything is activated; `refusal`: why it could not be activated now, or None."""

    measured: Mapping[str, Array]
    units: Mapping[str, tuple[str | None, ...]]
    refusal: str | None


def look(scenario: Scenario, *, simulated: bool = False, fmi: int | None = None) -> dict[str, Looked]:
    """Configure every device, read it, ask whether it may be activated, and leave it as it was found. Raises CosimError."""
    scenario = with_devices(scenario, simulated=simulated, fmi=fmi)
    found = {}
    with assembled(scenario, fmi) as (master, _):
        for component in master.graph.components.values():
            if not isinstance(component, DeviceComponent):
                continue
            device, refusal = component.device, None
            try:
                device.check_start()
            except DeviceError as error:
                refusal = str(error)
            outputs = [port for port in device.ports.values() if port.causality == "output"]
            found[device.name] = Looked(
                measured={port.name: device.values[port.name].copy() for port in outputs},
                units={port.name: port.units for port in outputs},
                refusal=refusal,
            )
    return found


def _run(
    scenario: Scenario,
    master: Master,
    values: Values,
    real_time: bool,
    view: bool,
    recording: Recording | None,
    asked: list[float],
    say: Any,
) -> tuple[Result, LoopReport]:
    metrics.check(scenario, master.graph.components)
    devices = [c.device for c in master.graph.components.values() if isinstance(c, DeviceComponent)]
    for device in devices:
        step = seconds(master.schedule.ratios[device.name] * master.schedule.tick)
        if abs(step - device.step) > 1e-9:
            raise DeviceError(f"device {device.name} works in steps of {device.step:g} s; its step_s is {step:g} s")
    period = master.schedule.tick
    live = None
    errors = _present_errors(scenario, master, values)
    pace = _Pace(devices, master, list(scenario.observed_energy.values()), errors, lambda: bool(asked))
    pacing.leave_real_time()  # or viewer and recorder would inherit the priority of the links
    if view:
        live = pace.view = LiveValues(f"{scenario.title} (Ctrl-C stops it in order)", pace.names)
        live.show()
    reason, end, left, recorded = "the loop could not be activated", None, "", None
    try:
        if recording is not None:
            pace.tap = Tap(recording, scenario, master, values, devices)
        granted = pacing.enter_real_time(real_time)
        say("Real time: " + ", ".join(granted))
        orderly = False
        with pacing.no_collection() if real_time else nullcontext():
            try:
                outcome = master.run(pace=pace)
                outcome.interrupted = outcome.interrupted or outcome.cause == INTERRUPTED
                reason = outcome.cause or "the scenario is over"
                orderly = outcome.interrupted or outcome.cause is None
                end = round(outcome.simulated * 1e9 / period)
            finally:
                left = stop(devices, period, reason, orderly=orderly)
    finally:
        if live is not None:
            live.close()
        pacing.leave_real_time()
        if pace.tap is not None:
            recorded = pace.tap.close(f"{reason}; {left}", end)
    report = LoopReport(
        granted=granted,
        times={name: histogram.summary() for name, histogram in pace.times.items()},
        devices={device.name: device.report() for device in devices},
        stop=f"{reason}; {left}",
        recording=recorded,
    )
    return _result(scenario, master, values, outcome, report), report


def _result(scenario: Scenario, master: Master, values: Values, outcome: Outcome, report: LoopReport) -> Result:
    outcome.record.origin = origin(scenario, master, values)
    series = metrics.errors(scenario, outcome.record, master.graph.components, values)
    summary = {**metrics.summary(scenario, outcome, series), "real_time": report.summary()}
    return Result(scenario=scenario, outcome=outcome, errors=series, summary=summary)


def stop(devices: Sequence[Device], period: int, reason: str, *, orderly: bool) -> str:
    """The graded stop of every device that is active; says how they were left. `orderly`: nothing has failed."""
    active = [device for device in devices if device.state.now is LifeCycle.active]
    if not active:
        return "nothing was active"
    now = outside.present().monotonic
    begin = now()
    pacer = None if any(device.is_clock for device in active) else Pacer(period)
    going = list(active)
    broken: list[Device] = []
    while going and now() - begin < LONGEST_STOP:
        if pacer is not None:
            pacer.wait()
        elapsed = now() - begin
        # Who is done goes on holding until all are.
        done = [_ramped(device, elapsed, broken) for device in active]
        going = [device for device, is_done in zip(active, done, strict=True) if not is_done]
    took = now() - begin
    unsure = [device.name for device in active if device in broken or not device.at_rest]
    for device in active:
        with suppress(Exception):  # one that fails even now must not keep the others from their end
            if not orderly or device.name in unsure:
                device.on_error(reason)
            device.deactivate()
    if unsure:
        return f"after {took:.2f} s {', '.join(unsure)} had not confirmed to be at rest, and is left to its own watchdog"
    return f"all devices were brought to rest in {took:.2f} s"


def _ramped(device: Device, elapsed: float, broken: list[Device]) -> bool:
    """Whether the device is done; one whose driver fails is left alone from then on."""
    if device in broken:
        return True
    try:
        return device.ramp_down(elapsed)
    except Exception:
        broken.append(device)
        return True
