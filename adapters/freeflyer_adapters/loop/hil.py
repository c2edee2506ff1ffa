"""Hardware in the loop: the controllers of a scenario run with devices instead of models.

The devices are configured when the scenario is assembled. All devices are activated together and
stopped together. The stop is the same for every reason. First, the torques of the arm are ramped
down with joint damping. Then the brakes engage.

The loop runs in instants. At each instant, the loop reads the devices, evaluates the controllers
and writes the commands. The state frames of the arm are the clock of the loop: each state frame
starts an instant. If no device is the clock, each instant starts at an absolute deadline.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import asdict, dataclass, replace
from typing import Any

from freeflyer.fmi.component import Array
from freeflyer.foundation.clock import seconds
from freeflyer.foundation.errors import CosimError, StepFailed, one_line
from freeflyer.foundation.interrupts import interrupts, no_interrupts
from freeflyer.foundation.signal_name import split
from freeflyer.master.connection import Connection
from freeflyer.master.master import InstantHook, Master, Outcome
from freeflyer.scenario import metrics
from freeflyer.scenario.assemble import assembled
from freeflyer.scenario.description import described
from freeflyer.scenario.experiment import Result, provenance, result_of
from freeflyer.scenario.parameters import Values, current
from freeflyer.scenario.run_directory import RunDirectory
from freeflyer.scenario.scenario import ComponentSpec, Measure, Scenario
from freeflyer_adapters.device.component import DeviceComponent
from freeflyer_adapters.device.device import SIMULATED, Device
from freeflyer_adapters.foundation import pacing
from freeflyer_adapters.foundation.errors import DeviceError
from freeflyer_adapters.loop import activation
from freeflyer_adapters.loop.graded_stop import NOTHING_ACTIVE, stop
from freeflyer_adapters.loop.instant_hooks import CommandWriting, Observation, Pacing
from freeflyer_adapters.loop.live_view import LiveValues
from freeflyer_adapters.loop.stop_notice import StopNotice
from freeflyer_adapters.recording.client import Recording, RecordingClient

Times = Mapping[str, Mapping[str, float]]
INTERRUPTED, FINISHED = "interrupted by the user", "scenario finished"


@dataclass(frozen=True, kw_only=True)
class LoopReport:
    """The part of a result that only a run with devices has."""

    granted: Sequence[str]
    """Results of the requests for real-time scheduling (`pacing.enter_real_time`)."""
    times: Times
    """Summaries of the measured durations (`Histogram.summary`), by name."""
    devices: Times
    """Counters of each device (`Device.report`), by the name of the device."""
    stop: str
    """Reason of the stop, and the final state of the devices."""
    remarks: Sequence[str] = ()
    """Sentences with further information for the operator."""
    recording: Mapping[str, Any] | None = None
    """Files of the recording, and missing data. None if nothing was recorded."""

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
    """Replace components of the scenario by the devices with the same names.

    A connection between two devices exists in hardware if its target is not a simulated device. A
    connection that exists in hardware is removed from the scenario.

    `simulated`: instead of the devices, run the models of all devices in this process, in real
    time.
    `fmi`: FMI version of the models of simulated devices. None: the version in the scenario.

    Raises DeviceError if the scenario has no devices, or if `exchange` is not "sequential".
    """
    if not scenario.devices:
        raise DeviceError(
            f"scenario {scenario.name} has no [devices.NAME]; at least one device for the loop is expected"
        )
    if scenario.exchange != "sequential":
        raise DeviceError(
            f"scenario {scenario.name}: exchange is '{scenario.exchange}', but a device responds within the same instant; 'sequential' is expected"
        )
    # Select the devices. If `simulated`, select the models of the devices.
    models = {spec.name: spec for spec in scenario.components}
    if simulated:
        specs = [
            replace(models[spec.name], kind=SIMULATED, parameters=spec.parameters)
            for spec in scenario.devices
        ]
    else:
        specs = list(scenario.devices)
    # Merge the settings of the model into each simulated device. The device's own settings take
    # precedence.
    specs = [
        _with_model(spec, models[spec.name], fmi) if spec.kind == SIMULATED else spec
        for spec in specs
    ]
    devices = {spec.name: spec for spec in specs}
    others = tuple(spec for spec in scenario.components if spec.name not in devices)

    def adapted(connection: Connection) -> Connection | None:
        """Return the connection, or None if the connection exists in hardware.

        A connection between two devices exists in hardware if its target is not a simulated device.
        A connection from a device to a simulated device becomes optional, because the source may
        not measure this signal. All other connections are returned unchanged.
        """
        source, target = split(connection.source)[0], split(connection.target)[0]
        if source not in devices or target not in devices:
            return connection
        return replace(connection, optional=True) if devices[target].kind == SIMULATED else None

    # Keep the connections between the remaining components and the devices.
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
    """Return one function for each error in the table [errors] of the scenario.

    The function computes the error from the signal values at the time of the call. The keys of
    the returned mapping are the names of the errors with their units.
    """

    def error_now(measure: Measure) -> Callable[[], float]:
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

    return {f"{name} error [{m.unit}]": error_now(m) for name, m in scenario.errors.items()}


def run(
    scenario: Scenario,
    *,
    real_time: bool = True,
    simulated: bool = False,
    view: bool = False,
    fmi: int | None = None,
    directory: RunDirectory | None = None,
    recording: Recording | None = None,
    notice: StopNotice | None = None,
    show: Callable[[str], None] = print,
) -> tuple[Result, LoopReport]:
    """Configure, activate, run and stop the devices of a scenario.

    `real_time`: use real-time priorities. `simulated`, `fmi`: see `with_devices`. `view`: open the
    live view. `directory`: claimed directory of the run, or None. `recording`: settings of the
    recording, or None to record nothing. `notice` receives
    the reason of the stop before any other output. `show` prints a line.

    Raises CosimError for an error that occurs before anything moves. A later error does not raise
    an exception: it is the cause of the stop in the result.
    """
    scenario = with_devices(scenario, simulated=simulated, fmi=fmi)
    pacing.prepare_links(real_time)
    try:
        # Before the activation, Ctrl-C raises KeyboardInterrupt, which closes the links.
        with assembled(scenario, fmi) as (master, values):
            return _run(
                scenario, master, values, real_time, view, fmi, directory, recording, notice, show
            )
    finally:
        pacing.leave_real_time()


@dataclass(frozen=True, kw_only=True)
class Inspection:
    """Measurements of a device before the activation."""

    measured: Mapping[str, Array]
    units: Mapping[str, tuple[str | None, ...]]
    refusal: str | None
    """Reason why the device cannot be activated now. None if it can be activated."""
    cannot_refuse: Sequence[str] = ()
    """Sentences about unsafe commands that the device cannot reject by itself."""


def inspect(
    scenario: Scenario, *, simulated: bool = False, fmi: int | None = None
) -> dict[str, Inspection]:
    """Configure and read every device, and check whether the device can be activated.

    This function sends no message that changes the state of a device. Raises CosimError if a device
    cannot be configured.
    """
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
    """Return sentences for the operator about unsafe commands that devices cannot reject.

    `found`: the sentences of `Device.cannot_refuse`, by the name of the device.
    """
    return [
        f"{name} cannot reject every unsafe command: {sentence}"
        for name, sentences in found.items()
        for sentence in sentences
    ]


def _run(
    scenario: Scenario,
    master: Master,
    values: Values,
    real_time: bool,
    view: bool,
    fmi: int | None,
    directory: RunDirectory | None,
    recording: Recording | None,
    notice: StopNotice | None,
    show: Callable[[str], None],
) -> tuple[Result, LoopReport]:
    # A device is called once per communication step. So the step of the device must be equal to
    # the communication step.
    metrics.check(scenario, master.graph.components)
    origin = provenance(scenario, master, values)
    about = described(scenario, master.graph.components, origin, fmi=fmi, engine="devices")
    if directory is not None:
        directory.describe({"run": about, "provenance": asdict(origin)})
    devices = [c.device for c in master.graph.components.values() if isinstance(c, DeviceComponent)]
    period = master.schedule.tick
    for device in devices:
        step = seconds(master.schedule.ratios[device.name] * period)
        if abs(step - device.step) > 1e-9:
            raise DeviceError(
                f"device {device.name} works in steps of {device.step:g} s, but its step_s is {step:g} s; equal values are expected"
            )
    # The hook that writes the commands is called before the observation, because the observation
    # may take a long time.
    deadlines = Pacing(devices, period)
    observation = Observation(
        devices,
        master,
        deadlines,
        list(scenario.observed_energy.values()),
        _present_errors(scenario, master, values),
    )
    hooks: list[InstantHook] = [deadlines, CommandWriting(devices, master), observation]
    # The viewer and the recorder must not inherit the priority of the links.
    pacing.leave_real_time()
    outcome, end, recorded = master.outcome(), None, None
    stopping = _Stopping(devices, period, observation, notice, show)
    with ExitStack() as until_the_end:
        try:
            # Start the viewer and the recorder.
            if view:
                try:
                    observation.view = LiveValues(
                        f"{scenario.title} (Ctrl-C: orderly stop)", observation.names
                    )
                    observation.view.show()
                except (CosimError, OSError) as error:
                    reason = getattr(error, "strerror", None) or error
                    show(f"no live view: {reason}; the loop runs without it")
            if recording is not None:
                observation.recording = RecordingClient(
                    recording, scenario, master, values, devices
                )
            # Show the results of the real-time requests and the limitations of the devices. Then
            # run the loop.
            granted = pacing.enter_real_time(real_time)
            show("Real time: " + ", ".join(granted))
            for sentence in limitations({device.name: device.cannot_refuse for device in devices}):
                show(sentence)
            with pacing.no_collection() if real_time else nullcontext(), stopping:
                activation.prepare(devices)
                stop_requests = until_the_end.enter_context(interrupts())
                outcome = _loop(master, outcome, devices, hooks, stop_requests)
                stopping.reason = outcome.cause or FINISHED
                stopping.orderly = outcome.interrupted or outcome.cause is None
                end = round(outcome.simulated * 1e9 / period)
        finally:
            # The devices have been stopped. Close the viewer and the recorder.
            if observation.view is not None:
                observation.view.close()
            pacing.leave_real_time()
            if observation.recording is not None:
                recorded = observation.recording.close(stopping.sentence, end)
    report = LoopReport(
        granted=granted,
        times={name: histogram.summary() for name, histogram in observation.times.items()},
        devices={device.name: device.report() for device in devices},
        stop=stopping.sentence,
        remarks=[f"{device.name}: {sentence}" for device in devices for sentence in device.remarks],
        recording=recorded,
    )
    outcome.record.provenance = replace(origin, sampled_at_end=master.sampled_at_end)
    return result_of(scenario, outcome, about, real_time=report.summary()), report


def _loop(
    master: Master,
    outcome: Outcome,
    devices: Sequence[Device],
    hooks: Sequence[InstantHook],
    stop_requests: Sequence[float],
) -> Outcome:
    """Activate the devices, then run to the end. Return the outcome of the run.

    `stop_requests`: arrival times of the signals that `interrupts` collects, for example SIGINT.
    Such a signal is an interruption by the user.
    """
    try:
        if activation.activate(devices, lambda: bool(stop_requests)):
            outcome = master.run(hooks=hooks)
        else:
            outcome.interrupted, outcome.cause = True, INTERRUPTED
            master.finish(outcome, 0, whole=True)
    except StepFailed as error:  # a driver failed during the activation; keep the measurements
        outcome.stopped_by(error)
        master.finish(outcome, 0, whole=False)
    return outcome


def reason_of(error: BaseException) -> str:
    """Return the reason of a stop that `error` caused, in one line."""
    return INTERRUPTED if isinstance(error, KeyboardInterrupt) else one_line(error)


class _Stopping:
    """Context manager that stops the devices on every exit, and then reports the reason."""

    def __init__(
        self,
        devices: Sequence[Device],
        period: int,
        observation: Observation,
        notice: StopNotice | None,
        show: Callable[[str], None],
    ) -> None:
        self._devices, self._period, self._observation = devices, period, observation
        self._notice, self._show = notice, show
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
                self._observation.view.end()  # the view would overwrite the reason
            # If no device was active, the command line prints the error later.
            quiet = error is not None and self.left == NOTHING_ACTIVE
            if self._notice is not None:
                self._notice.give(self.reason, self.left, orderly=self.orderly, quiet=quiet)
            elif not quiet:
                self._show(f"Stop: {self.sentence}")
