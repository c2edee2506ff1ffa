"""What a virtual CiA 402 drive decides: its state machine, torque, brake and watchdogs; and all drives of an arm together.

No clock is read and nothing is sent here: a tick is a call, at any speed.
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
    """`tick` [s] is how often `advance` is called; `watchdog`: SYNC periods without SYNC, or without a target, that are one too many.

    `torque` [N m] at the joint is what acts: the target in Operation enabled, its own ramp while it stops, else none.
    """

    def __init__(self, *, tick: float, watchdog: int, ramp: RampDown) -> None:
        self.tick, self.watchdog, self.ramp = tick, watchdog, ramp
        self.state = S.switch_on_disabled  # transitions 0 and 1: the self-test is passed
        self.torque = 0.0
        self.error = 0
        self.new_error: int | None = None
        """An error that nobody was told of yet; 0: all errors are reset."""
        self.sync_period = 0.0
        """[s]; 0 while the host has not written it, and then SYNC is not watched."""
        self.host_patience = 0.0
        """Longest time [s] between two heartbeats of the host; 0: not watched."""
        self.syncs = 0
        self._controlword = 0
        self._since_sync = 0
        self._syncs_since_target = 0
        self._since_host = -1
        """Ticks; -1 before the first heartbeat, as CiA 301 has it."""
        self._stopping = 0
        self._stopping_torque = 0.0

    @property
    def braked(self) -> bool:
        """The brake holds wherever the drive function is off."""
        return self.state is not S.operation_enabled and self.state not in STOPPING

    def host_is_there(self) -> None:
        self._since_host = 0

    def forget_host(self) -> None:
        """After a reset of communication, or with a new session."""
        self._since_host = -1

    def synchronise(self, controlword: int | None, target: float) -> None:
        """A SYNC: what came since the last one acts from now on; None: no RPDO came. `target` [N m] at the joint."""
        self.syncs += 1
        self._since_sync = 0
        self._syncs_since_target = 0 if controlword is not None else self._syncs_since_target + 1
        if controlword is not None:
            self.obey(controlword)
            if self.state is S.operation_enabled:
                self.torque = target if np.isfinite(target) else 0.0

    def obey(self, controlword: int) -> None:
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
        """Transition 13: a fault; if torque acts, the drive ramps it down by itself first."""
        if self.state in (S.fault, S.fault_reaction_active):
            return
        self.error = self.new_error = code
        if self.state is S.operation_enabled:
            self._begin_stop()
        self.state = S.fault if self.braked else S.fault_reaction_active

    def power_off(self) -> None:
        """Without power there is no torque, and the brake is engaged."""
        self.torque, self.state = 0.0, S.switch_on_disabled

    def advance(self, velocity: float) -> None:
        """One tick; `velocity` [rad/s] of the joint."""
        self._since_sync += 1
        if self._since_host >= 0:
            self._since_host += 1
        if self.state is S.operation_enabled:
            self._watch()
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

    def _watch(self) -> None:
        if self.sync_period and self._since_sync * self.tick > self.watchdog * self.sync_period:
            self.fail(SYNC_LOST)
        elif self._syncs_since_target >= self.watchdog:
            self.fail(RPDO_LOST)
        elif self.host_patience and self._since_host * self.tick > self.host_patience:
            self.fail(HEARTBEAT_LOST)

    def _begin_stop(self) -> None:
        self._stopping = 0
        self._stopping_torque = self.torque


class DriveGroup:
    """The drives of one arm, with one circuit for all brakes: they are released while every drive has its function on."""

    def __init__(self, drives: Sequence[DriveLogic], silence: int) -> None:
        self.drives, self.silence = drives, silence
        self.events: list[tuple[int, str]] = []
        self.was_active = False
        self.cycle = 0
        """Ticks."""
        self._states = [drive.state for drive in drives]
        self._syncs = 0
        self._quiet = 0
        self._has_host = False

    @property
    def braked(self) -> bool:
        return any(drive.braked for drive in self.drives)

    @property
    def torque(self) -> Array:
        return np.array([drive.torque for drive in self.drives])

    @property
    def session_is_over(self) -> bool:
        """An arm that was enabled, and whose SYNC has gone."""
        return self.was_active and not self._has_host

    def advance(self, velocity: Array) -> None:
        """One tick of every drive; `velocity` (n) [rad/s]."""
        for drive, speed in zip(self.drives, velocity.tolist(), strict=True):
            drive.advance(speed)
        self.cycle += 1
        self.was_active = self.was_active or not self.braked
        self._listen()
        self._note_changes()

    def _listen(self) -> None:
        syncs = sum(drive.syncs for drive in self.drives)
        self._quiet = 0 if syncs != self._syncs else self._quiet + 1
        if syncs != self._syncs and not self._has_host:
            self._has_host = True
            self._note("SYNC comes")
        self._syncs = syncs
        if self._has_host and self._quiet > self.silence:
            self._has_host = False
            self._note("no SYNC any more")

    def _note_changes(self) -> None:
        """One line for all drives that made the same step in the same tick."""
        steps: dict[str, list[int]] = {}
        for j, (drive, before) in enumerate(zip(self.drives, self._states, strict=True)):
            if drive.state is not before:
                why = f": {error_text(drive.error)}" if drive.error else ""
                steps.setdefault(f"{before.value} -> {drive.state.value}{why}", []).append(j + 1)
                self._states[j] = drive.state
        for step, joints in steps.items():
            who = (
                "all joints"
                if len(joints) == len(self.drives)
                else f"joint {', '.join(map(str, joints))}"
            )
            self._note(f"{who}: {step}")

    def _note(self, event: str) -> None:
        self.events.append((self.cycle, event))
