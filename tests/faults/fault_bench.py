"""Run of the host and the facility in virtual time with faults, and checks for all faults."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from dataclasses import replace as replaced
from itertools import pairwise
from typing import Any

import can
import numpy as np
import pytest
from e2e.p05 import e2e_p05_check

from freeflyer.fmi.component import Array
from freeflyer.scenario import scenario
from freeflyer.scenario.experiment import Result
from freeflyer.scenario.scenario import Scenario
from freeflyer_adapters.arm.frames import ArmFrames, FrameMapping, Mode
from freeflyer_adapters.base import ros_messages
from freeflyer_adapters.device.device import LifeCycle
from freeflyer_adapters.facility.accelerated import accelerated
from freeflyer_adapters.facility.faults import Fault
from freeflyer_adapters.facility.virtual_arm import VirtualArm
from freeflyer_adapters.facility.virtual_base import VirtualBase
from freeflyer_adapters.foundation.pose import distance, twist_rotated
from freeflyer_adapters.loop import hil
from freeflyer_adapters.loop.hil import LoopReport

JOINTS = 6
ARM, BASE = "arm_drive", "base_robot"
PROGRAM_ERROR = re.compile(r"\.py, line \d+\)")
"""Message of an unexpected exception (`freeflyer.master.master`)."""
PIECE = 0.03
"""Duration of one wait after the loop [s]; longer than any watchdog."""
AFTERWARDS = 0.9
"""Longest time [s] after the end of the controllers: watchdogs and ramp-downs of the devices."""


def shipped(stop: float, *overrides: str) -> Scenario:
    # Every instant is recorded, so that every used value can be compared.
    return replaced(
        scenario.load("facility", [f"stop_s={stop}", *overrides]), record_every=1_000_000
    )


def with_faults(base: Scenario, faults: Sequence[dict[str, Any]] = (), **facility: Any) -> Scenario:
    return replaced(base, facility={**base.facility, "faults": list(faults), **facility})


class _SetPoints:
    """A subscriber that keeps all samples."""

    def __init__(self, key: str) -> None:
        self.key, self.payloads = key, []

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "sample":
            self.payloads.append(value.payload.to_bytes())
        else:
            super().__setattr__(name, value)


@dataclass
class Observed:
    """Observations of a run; times in seconds of virtual time."""

    scenario: Scenario
    faults: tuple[Fault, ...] = ()
    result: Result | None = None
    report: LoopReport | None = None
    error: str = ""
    """Why the devices were not activated."""
    stopped_at: float = np.nan
    active_at: dict[str, float] = field(default_factory=dict)
    safe_at: dict[str, float] = field(default_factory=dict)
    """Time at which a device went to safe stop or fault."""
    true_states: list[bytes] = field(default_factory=list)
    true_samples: list[bytes] = field(default_factory=list)
    commands: list[can.Message] = field(default_factory=list)
    setpoints: list[bytes] = field(default_factory=list)
    applied: list[tuple[LifeCycle, bool, Array]] = field(default_factory=list)
    """State, brakes and torque of the arm in every cycle."""
    delivered: list[tuple[int, list[bytes]]] = field(default_factory=list)
    """Number of every cycle, and the frames that the arm received before it."""
    lives: dict[str, list[tuple[float, LifeCycle]]] = field(
        default_factory=lambda: {ARM: [], BASE: []}
    )
    """Time and state of each device in every cycle."""
    followed: list[tuple[Array, Array]] = field(default_factory=list)
    """Set point of the base robot in every cycle."""
    devices: dict[str, Any] = field(default_factory=dict)
    events: dict[str, list[str]] = field(default_factory=dict)
    acted: dict[str, int] = field(default_factory=dict)
    effort: Array = field(default_factory=lambda: np.zeros(JOINTS))
    """Joint effort limits of the arm (n) [N m]."""
    at_the_end: dict[str, LifeCycle] = field(default_factory=dict)
    braked_at_the_end: bool = False

    @property
    def stop(self) -> str:
        return self.error or (self.report.stop if self.report else "")

    @property
    def went_on(self) -> bool:
        return self.result is not None and self.result.as_expected

    def since(self, device: str, begin: float, moment: float) -> float:
        """Return the time [s] from the start of a fault to `moment`.

        `begin` [s] counts from the activation of the device.
        """
        return round(moment - (self.active_at[device] + begin), 9)  # the clock counts nanoseconds


def run(chosen: Scenario) -> Observed:
    """Run a scenario and return the observations.

    Exceptions that the loop or the facility should catch are not caught here.
    """
    seen = Observed(scenario=chosen)
    frames = ArmFrames(FrameMapping(), JOINTS)
    stop = hil.stop
    with accelerated(chosen) as both:
        clock = both.time
        facility, now = both.facility, clock.monotonic
        seen.faults = facility.settings.faults
        arm, base = facility.devices
        assert isinstance(arm, VirtualArm)
        assert isinstance(base, VirtualBase)
        # Record all frames, samples and states on both sides of the links.
        observer = clock.bus(channel=arm.options.channel)
        received: list[bytes] = []
        original_recv = arm._bus.recv

        def noted_frame(timeout: float = 0.0) -> can.Message | None:
            message = original_recv(timeout)
            if message is not None:
                received.append(bytes(message.data))
            return message

        arm._bus.recv = noted_frame  # type: ignore[method-assign]
        taken = _SetPoints(base._link._subscriber.key)
        clock._net.subscribers.append(taken)  # type: ignore[arg-type]

        def drained() -> None:
            while (message := observer.recv(0.0)) is not None:
                if message.arbitration_id == frames.command.identifier:
                    seen.commands.append(message)

        def note_arm(_: Any) -> None:
            drained()
            logic = arm.logic
            seen.applied.append((logic.life.now, logic.braked, logic.torque.copy()))
            seen.delivered.append((logic.cycle, received.copy()))
            received.clear()
            _note_state(seen, ARM, logic.life.now, now())

        def note_base(_: Any) -> None:
            seen.followed.append((base.logic.position.copy(), base.logic.orientation.copy()))
            _note_state(seen, BASE, base.logic.life.now, now())

        _spy(arm, "receive", after=note_arm)
        _spy(base, "receive", after=note_base)
        _spy(arm._bus, "send", before=lambda message: seen.true_states.append(bytes(message.data)))
        _spy(
            base._link, "put", before=lambda payload, attachment: seen.true_samples.append(payload)
        )

        def noted_stop(*arguments: Any, **keywords: Any) -> str:
            seen.stopped_at = now()
            return stop(*arguments, **keywords)

        # Run the loop, then the devices alone until both are safe.
        hil.stop = noted_stop
        try:
            seen.result, seen.report = hil.run(chosen, real_time=False, show=lambda text: None)
        except hil.CosimError as error:
            seen.error = str(error)
        finally:
            hil.stop = stop
        logics = arm.logic, base.logic
        seen.effort = np.array(arm._limits["joint_effort_limit"])
        for _ in range(round(AFTERWARDS / PIECE)):
            clock.sleep(PIECE)
            if (
                logics[0].braked
                and logics[1].life.now is not LifeCycle.active
                and _is_over(seen, clock.monotonic())
            ):
                break
        # Collect the results.
        drained()
        observer.shutdown()
        assert facility.outcome is None or not facility.outcome.failed, facility.outcome
        seen.setpoints = taken.payloads
        seen.devices = {name: dict(counts) for name, counts in facility.report()["devices"].items()}
        seen.events = {
            device.name: [
                event for session in facility.history for _, event in session["events"][device.name]
            ]
            + [event for _, event in device.events]
            for device in facility.devices
        }
        seen.acted = {
            kind: count
            for device in facility.devices
            for kind, count in device.faults.acted.items()
        }
        seen.at_the_end = {ARM: logics[0].life.now, BASE: logics[1].life.now}
        seen.braked_at_the_end = logics[0].braked
    return seen


def _is_over(seen: Observed, now: float) -> bool:
    """Whether every temporary fault has ended; a device that hung may continue its work."""
    return all(
        now > seen.active_at.get(f.device, now) + (f.begin_s or 0.0) + f.duration_s
        or f.duration_s > AFTERWARDS
        for f in seen.faults
    )


def _note_state(seen: Observed, name: str, state: LifeCycle, now: float) -> None:
    seen.lives[name].append((now, state))
    if state is LifeCycle.active:
        seen.active_at.setdefault(name, now)
    elif state in (LifeCycle.safe_stop, LifeCycle.fault):
        seen.safe_at.setdefault(name, now)


def _spy(
    subject: Any,
    name: str,
    *,
    before: Callable[..., None] | None = None,
    after: Callable[..., None] | None = None,
) -> None:
    original = getattr(subject, name)

    def spied(*arguments: Any) -> Any:
        if before:
            before(*arguments)
        result = original(*arguments)
        if after:
            after(*arguments)
        return result

    setattr(subject, name, spied)


def assert_safe(seen: Observed) -> None:
    """Check what must hold for all faults."""
    assert not PROGRAM_ERROR.search(seen.stop), seen.stop
    assert "not a transition" not in seen.stop
    frames = ArmFrames(FrameMapping(), JOINTS)
    _assert_nothing_corrupted_was_used(seen, frames)
    _assert_commands_within_limits(seen, frames)
    _assert_arm_without_commands_stops(seen, frames)
    _assert_one_activation(seen, frames)
    for name, state in seen.at_the_end.items():
        # A device that hangs until the end keeps its state.
        hangs = any(
            f.kind == "hung" and f.device == name and f.duration_s > AFTERWARDS for f in seen.faults
        )
        assert state is not LifeCycle.active or hangs, name
        assert name != ARM or seen.braked_at_the_end or hangs


def _assert_nothing_corrupted_was_used(seen: Observed, frames: ArmFrames) -> None:
    """Every value that one side used was sent by the other side."""
    states = [frames.state.unpack(data) for data in seen.true_states]
    commands = {
        tuple(frames.command.unpack(m.data)["joint_torque_command"]) for m in seen.commands
    } | {(0.0,) * JOINTS}
    for life, braked, torque in seen.applied:
        assert not (braked and torque.any())
        assert life is LifeCycle.active or life is LifeCycle.safe_stop or braked
        if life is LifeCycle.active:
            assert tuple(torque) in commands
    sent = [ros_messages.read(payload) for payload in seen.setpoints]
    places = {tuple(s.position) for s in sent} | {tuple(seen.followed[0][0])}
    # A base without power stays at its last measured pose.
    unpowered = any(fault.kind == "dead" and fault.device == BASE for fault in seen.faults)
    for position, _ in seen.followed:
        assert tuple(position) in places or (
            unpowered and position == pytest.approx(seen.followed[0][0], abs=0.01)
        )
    if seen.result is None:
        return
    record = seen.result.outcome.record
    for name in ("joint_position", "joint_velocity", "joint_torque"):
        known = {tuple(state[name]) for state in states}
        assert {tuple(row) for row in record[f"{ARM}.{name}"]} <= known, name
    samples = [ros_messages.read(payload) for payload in seen.true_samples]
    for name, values in {
        "base_position": {tuple(s.position) for s in samples},
        "base_orientation": {tuple(s.orientation) for s in samples},
        "base_velocity": {tuple(twist_rotated(s.orientation, s.velocity)) for s in samples},
    }.items():
        assert {tuple(row) for row in record[f"{BASE}.{name}"]} <= values, name


def _assert_arm_without_commands_stops(seen: Observed, frames: ArmFrames) -> None:
    """The arm is active only while it receives intact commands that answer its last cycles.

    A command with a correct CRC is intact, even if its sender numbered it wrongly.
    """
    watchdog, newest, data_id = 4, -1000, frames.command.data_id
    for (cycle, received), (life, _, _) in zip(seen.delivered, seen.applied, strict=True):
        for data in received:
            if len(data) == frames.command.size and e2e_p05_check(data, data_id):
                newest = max(newest, int(frames.command.unpack(data)["answered_cycle"][0]))
        # `cycle` is the number of the next state frame; the last one had the number before.
        hung = any(fault.kind == "hung" and fault.device == ARM for fault in seen.faults)
        assert life is not LifeCycle.active or cycle - 1 - newest < watchdog or hung


def _assert_one_activation(seen: Observed, frames: ArmFrames) -> None:
    """A device is activated at most once, never after the stop, and the arm only by mode 4."""
    for name, lives in seen.lives.items():
        activated = [
            now
            for (_, before), (now, state) in pairwise(lives)
            if state is not before and state is LifeCycle.active
        ]
        events = [event for event in seen.events[name] if event.split(":")[0].endswith("-> active")]
        assert len(activated) == len(events) <= 1, (name, activated, events)
        assert not activated or not activated[0] > seen.stopped_at, (
            name,
            activated,
            seen.stopped_at,
        )
    for (_, received), (before, _, _), (life, _, _) in zip(
        seen.delivered[1:], seen.applied, seen.applied[1:], strict=False
    ):
        if life is LifeCycle.active and before is not life:
            intact = [
                data
                for data in received
                if len(data) == frames.command.size and e2e_p05_check(data, frames.command.data_id)
            ]
            assert Mode.activate in [
                frames.mode(frames.command.unpack(data)["mode"][0]) for data in intact
            ]


def _assert_commands_within_limits(seen: Observed, frames: ArmFrames) -> None:
    resolution = frames.command.fields["joint_torque_command"][0].resolution
    change = 1000.0 * 0.001  # [N m] per cycle: torque_rate_limit times period
    before = np.zeros(JOINTS)
    for message in seen.commands:
        numbers = frames.command.unpack(message.data)
        torque = np.array(numbers["joint_torque_command"])
        assert np.isfinite(torque).all()
        assert (np.abs(torque) <= seen.effort + resolution).all()
        if frames.mode(numbers["mode"][0]) is Mode.torque:
            assert (np.abs(torque - before) <= change + 2 * resolution).all()
        else:
            assert not torque.any()
        before = torque
    last: ros_messages.Odometry | None = None
    for payload in seen.setpoints:
        s = ros_messages.read(payload)
        assert np.isfinite([*s.position, *s.orientation, *s.velocity]).all()
        assert (np.abs(s.position) <= 0.5).all()
        assert np.linalg.norm(s.velocity[:3]) <= 0.2
        assert np.linalg.norm(s.velocity[3:]) <= 0.5
        if last is not None:
            step = distance(s.position, s.orientation, last.position, last.orientation)
            assert step[0] <= 0.002
            assert step[1] <= 0.005
        last = s
