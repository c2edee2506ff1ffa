"""The hardware in the loop: the scenario's controllers, with devices in the place of its device models.

Devices are configured while the system is assembled, activated together, and stopped together, whatever ended the loop: a damped
ramp-down under the arm's own clock, then brakes. The arm's state frame is the clock; without an arm, absolute deadlines are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, replace
from typing import Any

from freeflyer.fmi.component import Array
from freeflyer.foundation.clock import seconds
from freeflyer.foundation.errors import StepFailed
from freeflyer.foundation.interrupts import interrupts, no_interrupts
from freeflyer.foundation.signal_name import split
from freeflyer.master.graph import Connection
from freeflyer.master.master import InstantHook, Master, Outcome
from freeflyer.scenario import metrics
from freeflyer.scenario.assemble import assembled
from freeflyer.scenario.experiment import Result, provenance
from freeflyer.scenario.parameters import Values, current
from freeflyer.scenario.scenario import ComponentSpec, Measure, Scenario
from freeflyer_adapters.device.component import DeviceComponent
from freeflyer_adapters.device.device import SIMULATED, Device, DeviceError
from freeflyer_adapters.foundation import pacing
from freeflyer_adapters.loop import activation
from freeflyer_adapters.loop.graded_stop import NOTHING_ACTIVE, stop
from freeflyer_adapters.loop.instant_hooks import CommandWriting, Observation, Pacing
from freeflyer_adapters.loop.live_view import LiveValues
from freeflyer_adapters.loop.stop_notice import StopNotice
from freeflyer_adapters.recording.client import Recording, Tap

INTERRUPTED, FINISHED = "interrupted by the user", "the scenario is over"


@dataclass(frozen=True, kw_only=True)
class LoopReport:
    """What a run in real time adds to a result."""

    granted: Sequence[str]
    times: Mapping[str, Mapping[str, float]]
    devices: Mapping[str, Mapping[str, float]]
    stop: str
    """Why the loop ended, and how the devices were left."""
    remarks: Sequence[str] = ()
    """What else the operator should know, a sentence for each."""
    recording: Mapping[str, Any] | None = None
    """Where it was recorded, and what is missing there."""

    def summary(self) -> dict[str, Any]:
        return {
            "granted": list(self.granted),
            "times": {name: dict(times) for name, times in self.times.items()},
            "devices": {name: dict(counts) for name, counts in self.devices.items()},
            "stop": self.stop,
            "remarks": list(self.remarks),
            "recording": self.recording,
        }


def with_devices(
    scenario: Scenario, *, simulated: bool = False, fmi: int | None = None
) -> Scenario:
    """Devices in the place of the components of the same names; what joined two of them is physics, which is theirs.

    `simulated`: every device is its own model in this process, and the wall clock paces the loop.
    """
    if not scenario.devices:
        raise DeviceError(
            f"scenario {scenario.name} has no [devices.NAME]: there is nothing to put into the loop"
        )
    if scenario.exchange != "sequential":
        raise DeviceError(
            f"scenario {scenario.name}: exchange is '{scenario.exchange}', but a device answers at its instant; 'sequential' is expected"
        )
    models = {spec.name: spec for spec in scenario.components}
    if simulated:
        specs = [
            replace(models[spec.name], kind=SIMULATED, parameters=spec.parameters)
            for spec in scenario.devices
        ]
    else:
        specs = list(scenario.devices)
    # A simulated device has its model's parameters and, beside them, a device's settings.
    specs = [
        _with_model(spec, models[spec.name], fmi) if spec.kind == SIMULATED else spec
        for spec in specs
    ]
    devices = {spec.name: spec for spec in specs}
    others = tuple(spec for spec in scenario.components if spec.name not in devices)

    def adapted(connection: Connection) -> Connection | None:
        """What joins two devices stays in this process only where a model here is the target and
        the other end measures it."""
        source, target = split(connection.source)[0], split(connection.target)[0]
        if source not in devices or target not in devices:
            return connection
        return replace(connection, optional=True) if devices[target].kind == SIMULATED else None

    connections = tuple(filter(None, map(adapted, scenario.connections)))
    return replace(scenario, components=(*devices.values(), *others), connections=connections)


def _with_model(spec: ComponentSpec, model: ComponentSpec, fmi: int | None) -> ComponentSpec:
    version = {} if fmi is None else {"fmi": fmi}
    return replace(
        spec,
        parameters={**model.parameters, **spec.parameters},
        options={**model.options, **spec.options, **version},
    )


def _present_errors(
    scenario: Scenario, master: Master, values: Values
) -> dict[str, Callable[[], float]]:
    """Return the scenario's errors at the present instant, by their names with units."""

    def made(measure: Measure) -> Callable[[], float]:
        ends = []
        for signal in (measure.actual, measure.desired):
            component, variable = split(signal)
            is_output = master.graph.components[component].ports[variable].causality == "output"
            ends.append(
                master.value(signal)
                if is_output
                else current(master.graph.components, values, component, variable)
            )
        actual, desired = (end.reshape(1, -1) for end in ends)
        error = metrics.ERRORS[measure.kind]
        return lambda: float(error(actual, desired)[0])

    return {f"{name} error [{m.unit}]": made(m) for name, m in scenario.errors.items()}


def run(
    scenario: Scenario,
    *,
    real_time: bool = True,
    simulated: bool = False,
    view: bool = False,
    fmi: int | None = None,
    recording: Recording | None = None,
    notice: StopNotice | None = None,
    say: Callable[[str], None] = print,
) -> tuple[Result, LoopReport]:
    """Configure, activate, run, stop. Raises CosimError before anything moves; afterwards everything is in the result.

    `notice` gets the reason of the stop before anything else is written.
    """
    scenario = with_devices(scenario, simulated=simulated, fmi=fmi)
    pacing.prepare_links(real_time)
    try:
        # Until something is active, Ctrl-C is an ordinary exception, which closes what was opened.
        with assembled(scenario, fmi) as (master, values):
            return _run(scenario, master, values, real_time, view, recording, notice, say)
    finally:
        pacing.leave_real_time()


@dataclass(frozen=True, kw_only=True)
class Inspection:
    """What a device measures before anything is activated; `refusal`: why it could not be activated now, or None."""

    measured: Mapping[str, Array]
    units: Mapping[str, tuple[str | None, ...]]
    refusal: str | None
    cannot_refuse: Sequence[str] = ()
    """What the device itself cannot refuse, a sentence for each."""


def inspect(
    scenario: Scenario, *, simulated: bool = False, fmi: int | None = None
) -> dict[str, Inspection]:
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
            found[device.name] = Inspection(
                measured={port.name: device.values[port.name].copy() for port in outputs},
                units={port.name: port.units for port in outputs},
                refusal=refusal,
                cannot_refuse=tuple(device.cannot_refuse),
            )
    return found


def limitations(found: Mapping[str, Sequence[str]]) -> list[str]:
    """What devices cannot refuse by themselves, for the operator."""
    return [
        f"{name} cannot refuse everything by itself: {sentence}"
        for name, said in found.items()
        for sentence in said
    ]


def _run(
    scenario: Scenario,
    master: Master,
    values: Values,
    real_time: bool,
    view: bool,
    recording: Recording | None,
    notice: StopNotice | None,
    say: Callable[[str], None],
) -> tuple[Result, LoopReport]:
    metrics.check(scenario, master.graph.components)
    devices = [c.device for c in master.graph.components.values() if isinstance(c, DeviceComponent)]
    period = master.schedule.tick
    for device in devices:
        step = seconds(master.schedule.ratios[device.name] * period)
        if abs(step - device.step) > 1e-9:
            raise DeviceError(
                f"device {device.name} works in steps of {device.step:g} s; its step_s is {step:g} s"
            )
    deadlines = Pacing(devices, period)
    observation = Observation(
        devices,
        master,
        deadlines,
        list(scenario.observed_energy.values()),
        _present_errors(scenario, master, values),
    )
    hooks: list[InstantHook] = [deadlines, CommandWriting(devices, master), observation]
    pacing.leave_real_time()  # or viewer and recorder would inherit the priority of the links
    outcome, end, recorded = master.outcome(), None, None
    stopping = _Stopping(devices, period, observation, notice, say)
    with ExitStack() as until_the_end:
        try:
            if view:
                try:
                    observation.view = LiveValues(
                        f"{scenario.title} (Ctrl-C stops it in order)", observation.names
                    )
                    observation.view.show()
                except OSError as error:
                    say(
                        f"there is no live view: {error.strerror or error}; the loop runs without it"
                    )
            if recording is not None:
                observation.tap = Tap(recording, scenario, master, values, devices)
            granted = pacing.enter_real_time(real_time)
            say("Real time: " + ", ".join(granted))
            for sentence in limitations({device.name: device.cannot_refuse for device in devices}):
                say(sentence)
            with pacing.no_collection() if real_time else nullcontext(), stopping:
                activation.prepare(devices)
                asked = until_the_end.enter_context(interrupts())
                outcome = _loop(master, outcome, devices, hooks, asked)
                stopping.reason = outcome.cause or FINISHED
                stopping.orderly = outcome.interrupted or outcome.cause is None
                end = round(outcome.simulated * 1e9 / period)
        finally:
            if observation.view is not None:
                observation.view.close()
            pacing.leave_real_time()
            if observation.tap is not None:
                recorded = observation.tap.close(stopping.sentence, end)
    report = LoopReport(
        granted=granted,
        times={name: histogram.summary() for name, histogram in observation.times.items()},
        devices={device.name: device.report() for device in devices},
        stop=stopping.sentence,
        remarks=[f"{device.name}: {sentence}" for device in devices for sentence in device.remarks],
        recording=recorded,
    )
    return _result(scenario, master, values, outcome, report), report


def _loop(
    master: Master,
    outcome: Outcome,
    devices: Sequence[Device],
    hooks: Sequence[InstantHook],
    asked: Sequence[float],
) -> Outcome:
    """Activate as late as can be, then run to the end."""
    try:
        if activation.activate(devices, lambda: bool(asked)):
            outcome = master.run(hooks=hooks)
        else:
            outcome.interrupted, outcome.cause = True, INTERRUPTED
            master.finish(outcome, 0, whole=True)
    except StepFailed as error:  # a driver that fails in its activation; what was measured is kept
        outcome.stopped_by(error)
        master.finish(outcome, 0, whole=False)
    return outcome


def reason_of(error: BaseException) -> str:
    """Why a run ended that an exception has ended."""
    return (
        INTERRUPTED
        if isinstance(error, KeyboardInterrupt)
        else " ".join(str(error).split()) or repr(error)
    )


class _Stopping:
    """Whatever ends its block: the devices are stopped, then the reason is given, before anything else is done."""

    def __init__(
        self,
        devices: Sequence[Device],
        period: int,
        observation: Observation,
        notice: StopNotice | None,
        say: Callable[[str], None],
    ) -> None:
        self._devices, self._period, self._observation = devices, period, observation
        self._notice, self._say = notice, say
        self.reason, self.left, self.orderly = "", "", False

    @property
    def sentence(self) -> str:
        return f"{self.reason}; {self.left}" if self.left else self.reason

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, place: object
    ) -> None:
        if error is not None:
            self.reason, self.orderly = reason_of(error), isinstance(error, KeyboardInterrupt)
        with no_interrupts():
            self.left = stop(self._devices, self._period, self.reason, orderly=self.orderly)
            if self._observation.view is not None:
                self._observation.view.end()  # or it would draw over the sentence
            # A refusal before anything was active is printed by the command, once.
            quiet = error is not None and self.left == NOTHING_ACTIVE
            if self._notice is not None:
                self._notice.give(self.reason, self.left, orderly=self.orderly, quiet=quiet)
            elif not quiet:
                self._say(f"Stop: {self.sentence}")


def _result(
    scenario: Scenario, master: Master, values: Values, outcome: Outcome, report: LoopReport
) -> Result:
    outcome.record.provenance = provenance(scenario, master, values)
    series = metrics.errors(scenario, outcome.record, master.graph.components, values)
    summary = {**metrics.summary(scenario, outcome, series), "real_time": report.summary()}
    return Result(scenario=scenario, outcome=outcome, errors=series, summary=summary)
