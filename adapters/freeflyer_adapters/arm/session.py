"""Session of the host with an arm. The session determines the mode of the next command frame.

A session is one activation of the arm, with its own session number. At first, a session is in the
phase listening: the host does not claim the session number yet. Then the session has these phases,
as in the interface control document:

1. Claiming: the host sends the session number until the arm echoes this number.
2. Activating: the host requests the activation until the arm reports the state active.
3. Commanding: the host sends torque commands.

After the first reason to stop, only frames of the graded stop are allowed. In a graded stop, the
torque decreases to zero, then the brakes engage.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

from freeflyer_adapters.arm.frames import Mode
from freeflyer_adapters.device.device import LifeCycle
from freeflyer_adapters.device.permit import Permit

CLAIMS = 100
"""Number of claims without an echo after which the host uses a new session number.

A session number expires when the arm leaves the state active. The arm neither accepts nor echoes an
expired number. The host draws its number at random. An earlier session may have used the same
number, and then the host needs a new one.
"""
REMEMBERED = 32
"""Number of command frames whose send times are stored.

This is half of `FEWEST_CYCLES`, the smallest accepted modulus of the cycle numbers.
"""
STOPPED = (LifeCycle.safe_stop, LifeCycle.fault)


class Phase(Enum):
    """Phase of a session."""

    listening = "listening"
    claiming = "claiming"
    activating = "activating"
    commanding = "commanding"


class ArmSession:
    """Decision logic of a session. This class reads no clock and sends nothing.

    Times are [ns] of the monotonic clock. `numbers` returns a new session number. `implicit`:
    whether the arm has no mode `activate`. Torque frames activate such an arm. `echoes`: whether
    the state frames of the arm echo the accepted session number.
    """

    def __init__(
        self,
        permit: Permit,
        numbers: Callable[[], int],
        *,
        implicit: bool = False,
        echoes: bool = True,
    ) -> None:
        self.permit, self._numbers = permit, numbers
        self.implicit, self.echoes = implicit, echoes
        self.phase = Phase.listening
        self.number = numbers()
        self.state = LifeCycle.unconfigured if permit.reports_state else LifeCycle.inactive
        self.echoed_number = 0
        """Session number that the arm echoes. 0: the arm has no session."""
        self._answered_at: dict[int, int] = {}
        self._claims = 0
        self._was_claimed = False
        self._activation_requested = False
        """Whether a frame was sent that may have released the brakes."""

    @property
    def is_claimed(self) -> bool:
        """Whether the arm has accepted this session and can be activated.

        An arm that echoes session numbers must echo the number of this session. If `implicit` is
        False, the arm must also be in the state inactive.
        """
        echoed = self.echoed_number == self.number or not self.echoes
        return echoed and (self.implicit or self.state is LifeCycle.inactive)

    @property
    def has_other_controller(self) -> bool:
        """Whether the arm echoes the number of another session."""
        return self.echoed_number not in (0, self.number)

    def wrote(self, answered: int, now: int) -> None:
        """Record that a command frame was sent at `now`.

        `answered`: cycle number of the state frame that the command frame answers.
        """
        self.permit.wrote(now)
        self._answered_at[answered] = now
        if len(self._answered_at) > REMEMBERED:
            del self._answered_at[next(iter(self._answered_at))]

    def report(
        self, state: LifeCycle | None, number: int, at: int, echoed_cycle: int | None = None
    ) -> None:
        """Process a state frame.

        `state`: reported state, or None if the arm does not report its state. `number`: echoed
        session number; 0: none. `at`: the state frame was not sent before this time.
        `echoed_cycle`: cycle number that the last accepted command frame answered. None: the arm
        does not report the last accepted command frame.
        """
        if echoed_cycle is not None:
            # The arm has sent this frame after it accepted the reported command. The frame may have
            # been delayed on the bus. Therefore use the send time of the command as the earliest
            # time of this frame.
            at = self._answered_at.get(echoed_cycle, 0)
        if state is None:
            # This arm does not report its state. If the arm reports the last accepted command, the
            # arm counts as active while this command is recent and from this session. If the arm
            # reports no command, the arm counts as active while its frames arrive.
            is_recent = at > 0 and self.permit.last_write - at <= self.permit.watchdog
            state = LifeCycle.active if is_recent or echoed_cycle is None else LifeCycle.inactive
        self.state, self.echoed_number = state, number
        self.permit.report(state is LifeCycle.active and number in (0, self.number), at)
        if self.phase is Phase.commanding:
            return
        if (
            not self.implicit
            and self._was_claimed
            and not self._activation_requested
            and state is not LifeCycle.inactive
        ):
            # The claim has already reset any earlier stop or fault. Therefore the reported stop or
            # fault is new.
            self.permit.lose(f"{self.permit.subject} went to {state.name} before its activation")
        self._was_claimed = self._was_claimed or (self.phase is Phase.claiming and self.is_claimed)
        if self.phase is Phase.activating:
            if state is LifeCycle.active and not self.has_other_controller:
                self.phase = Phase.commanding
            elif self._activation_requested and state is not LifeCycle.inactive:
                self.permit.lose(
                    f"{self.permit.subject} went to {state.name} during its activation"
                )

    def claim(self) -> None:
        """Start to claim the session number."""
        self.phase = Phase.claiming

    def activate(self, now: int) -> None:
        """Take the permit, and start the activation."""
        self.permit.take(now)
        self._answered_at.clear()
        self.phase = Phase.commanding if self.state is LifeCycle.active else Phase.activating

    def answer(self, now: int, *, brake: bool = False) -> Mode:
        """Return the mode of the next command frame. `brake`: whether the arm must brake now."""
        if self.phase in (Phase.listening, Phase.claiming):
            is_claiming = self.phase is Phase.claiming and self.permit.lost is None and not brake
            return self._claim() if is_claiming else Mode.brake if brake else Mode.idle
        if self.permit.allows(now) and not brake:
            if self.phase is Phase.commanding:
                return Mode.torque
            return self._request_activation()
        # Graded stop: send decreasing torques while recent state frames report the state active.
        # Otherwise send no torque. Then the watchdog of the arm stops the arm.
        if self.phase is Phase.commanding and not brake:
            return Mode.torque if self.permit.may_ramp_down(now) else Mode.idle
        return Mode.brake

    def permits(self, mode: Mode, now: int) -> bool:
        """Return whether a frame of this mode may still be sent.

        This is the last check before the transmission.
        """
        if mode is Mode.torque:
            return self.permit.allows(now) or self.permit.may_ramp_down(now)
        return mode is not Mode.activate or self.permit.allows(now)

    def _claim(self) -> Mode:
        if self.is_claimed or self.implicit:
            return Mode.idle
        self._claims += 1
        if self._claims % CLAIMS == 0 and self.echoed_number == 0:
            self.number = self._numbers()
        return Mode.reset

    def _request_activation(self) -> Mode:
        if not self._activation_requested:
            if self.implicit and self.state in STOPPED:
                return Mode.reset
            if not self.implicit and not self.is_claimed:
                return self._claim()
        self._activation_requested = True
        return Mode.torque if self.implicit else Mode.activate
