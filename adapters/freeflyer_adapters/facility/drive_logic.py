"""Virtual CiA 402 drives: state machine, torque, brake and watchdogs of the drives of an arm.

The module reads no clock and sends no messages. One call of `advance` is one tick.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from freeflyer.fmi.component import Array
from freeflyer_adapters.cia402.objects import HEARTBEAT_LOST, RPDO_LOST, SYNC_LOST, error_text
from freeflyer_adapters.cia402.state_machine import DriveState, following
from freeflyer_adapters.device.ramp_down import AT_REST, RampDown

S = DriveState
STOPPING = (S.quick_stop_active, S.fault_reaction_active)


class DriveLogic:
    """Controller of one drive. `advance` is called every `tick` [s].

    `watchdog`: after this number of SYNC periods without a SYNC, or without a target torque, an
    enabled drive fails.
    `ramp`: torque of the ramp-down.
    `torque`: torque at the joint [N m]. In the state `Operation enabled` it is the target. In the
    states `Quick stop active` and `Fault reaction active` it is the torque of the ramp-down. In
    all other states it is zero.
    """

    def __init__(self, *, tick: float, watchdog: int, ramp: RampDown) -> None:
        self.tick, self.watchdog, self.ramp = tick, watchdog, ramp
        self.state = S.switch_on_disabled  # the self-test (transitions 0 and 1) is finished
        self.torque = 0.0
        self.error = 0
        self.new_error: int | None = None
        """Error code for the next EMCY message. 0: all errors are reset. None: send no message."""
        self.sync_period = 0.0
        """SYNC period [s]. 0: the host has not written the period, and SYNC is not monitored."""
        self.heartbeat_timeout = 0.0
        """Longest time [s] between two heartbeats of the host. 0: heartbeats are not monitored."""
        self.syncs = 0
        self._controlword = 0
        self._since_sync = 0
        self._syncs_since_target = 0
        self._since_host = -1
        """Number of ticks since the last heartbeat of the host.

        -1: no heartbeat has arrived yet, and heartbeats are not monitored (as in CiA 301)."""
        self._stopping = 0
        self._stopping_torque = 0.0

    @property
    def braked(self) -> bool:
        """Whether the brake is engaged. It is engaged whenever the drive function is disabled."""
        return self.state is not S.operation_enabled and self.state not in STOPPING

    def restart_host_watchdog(self) -> None:
        """Restart the watchdog that monitors the host. Call this after each host heartbeat."""
        self._since_host = 0

    def disarm_host_watchdog(self) -> None:
        """Disable the watchdog that monitors the host. The next heartbeat enables it again.

        Call this after a reset, and at the start of a session.
        """
        self._since_host = -1

    def synchronise(self, controlword: int | None, target: float) -> None:
        """Handle a SYNC: apply the last controlword and the last target.

        `controlword` is None if no RPDO was received since the last SYNC. `target` is the target
        torque at the joint [N m].
        """
        self.syncs += 1
        self._since_sync = 0
        self._syncs_since_target = 0 if controlword is not None else self._syncs_since_target + 1
        if controlword is not None:
            self.apply_controlword(controlword)
            if self.state is S.operation_enabled:
                self.torque = target if np.isfinite(target) else 0.0

    def apply_controlword(self, controlword: int) -> None:
        """Make the transition of CiA 402 for this state and controlword, if there is one."""
        before, self._controlword = self._controlword, controlword
        to = following(self.state, controlword, before)
        if to is self.state:
            return
        if self.state is S.fault:
            self.error, self.new_error = 0, 0
        if to is S.quick_stop_active:
            self._begin_stop()
        elif to is not S.operation_enabled:
            self.torque = 0.0
        else:
            self._since_sync = self._syncs_since_target = 0
        self.state = to

    def fail(self, code: int) -> None:
        """Go to the state `Fault` with the error code `code` (transition 13).

        An enabled drive first ramps its torque down in the state `Fault reaction active`.
        """
        if self.state in (S.fault, S.fault_reaction_active):
            return
        self.error = self.new_error = code
        if self.state is S.operation_enabled:
            self._begin_stop()
        self.state = S.fault if self.braked else S.fault_reaction_active

    def power_off(self) -> None:
        """Remove the power: zero torque, brake engaged."""
        self.torque, self.state = 0.0, S.switch_on_disabled

    def advance(self, velocity: float) -> None:
        """Advance by one tick. `velocity` is the velocity of the joint [rad/s]."""
        self._since_sync += 1
        if self._since_host >= 0:
            self._since_host += 1
        if self.state is S.operation_enabled:
            self._check_watchdogs()
        if self.state in STOPPING:
            speed = np.array([velocity])
            elapsed = self._stopping * self.tick
            self._stopping += 1
            self.torque = float(
                self.ramp.torque(np.array([self._stopping_torque]), speed, elapsed)[0]
            )
            has_stopped = self._stopping_torque == 0.0 and abs(velocity) < AT_REST
            if has_stopped or self.ramp.over(speed, elapsed):
                self.torque = 0.0
                self.state = (
                    S.fault if self.state is S.fault_reaction_active else S.switch_on_disabled
                )

    def _check_watchdogs(self) -> None:
        if self.sync_period and self._since_sync * self.tick > self.watchdog * self.sync_period:
            self.fail(SYNC_LOST)
        elif self._syncs_since_target >= self.watchdog:
            self.fail(RPDO_LOST)
        elif self.heartbeat_timeout and self._since_host * self.tick > self.heartbeat_timeout:
            self.fail(HEARTBEAT_LOST)

    def _begin_stop(self) -> None:
        self._stopping = 0
        self._stopping_torque = self.torque


class DriveGroup:
    """The drives of one arm. They share one brake circuit.

    The brakes are released only while the drive functions of all drives are enabled. `silence`
    [ticks]: after this time without a SYNC, the host is regarded as disconnected.
    """

    def __init__(self, drives: Sequence[DriveLogic], silence: int) -> None:
        self.drives, self.silence = drives, silence
        self.events: list[tuple[int, str]] = []
        self.was_active = False
        self.cycle = 0
        """Number of ticks."""
        self._states = [drive.state for drive in drives]
        self._syncs = 0
        self._quiet = 0
        self._has_host = False

    @property
    def braked(self) -> bool:
        """Whether the common brakes are engaged."""
        return any(drive.braked for drive in self.drives)

    @property
    def torque(self) -> Array:
        """Acting joint torques (n) [N m]."""
        return np.array([drive.torque for drive in self.drives])

    @property
    def session_is_over(self) -> bool:
        """Whether the arm was enabled in this session and now receives no SYNC."""
        return self.was_active and not self._has_host

    def advance(self, velocity: Array) -> None:
        """Advance every drive by one tick. `velocity` (n) [rad/s]: velocities of the joints."""
        for drive, speed in zip(self.drives, velocity.tolist(), strict=True):
            drive.advance(speed)
        self.cycle += 1
        self.was_active = self.was_active or not self.braked
        self._monitor_sync()
        self._note_changes()

    def _monitor_sync(self) -> None:
        syncs = sum(drive.syncs for drive in self.drives)
        self._quiet = 0 if syncs != self._syncs else self._quiet + 1
        if syncs != self._syncs and not self._has_host:
            self._has_host = True
            self._note("SYNC received")
        self._syncs = syncs
        if self._has_host and self._quiet > self.silence:
            self._has_host = False
            self._note("SYNC lost")

    def _note_changes(self) -> None:
        """Add one event for all drives that made the same transition in this tick."""
        steps: dict[str, list[int]] = {}
        for j, (drive, before) in enumerate(zip(self.drives, self._states, strict=True)):
            if drive.state is not before:
                why = f": {error_text(drive.error)}" if drive.error else ""
                steps.setdefault(f"{before.value} -> {drive.state.value}{why}", []).append(j + 1)
                self._states[j] = drive.state
        for step, joints in steps.items():
            subject = (
                "all joints"
                if len(joints) == len(self.drives)
                else f"joint {', '.join(map(str, joints))}"
            )
            self._note(f"{subject}: {step}")

    def _note(self, event: str) -> None:
        self.events.append((self.cycle, event))
