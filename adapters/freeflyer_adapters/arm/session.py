"""The host's end of an arm's life cycle: which mode a command frame may have now.

One session is one activation, with a session number of its own. The dialogue of the interface control document: claim the number until
the arm echoes it, activate until the arm reports active, then command; after the first reason to stop only what lowers.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

from freeflyer_adapters.arm.frames import Mode
from freeflyer_adapters.device.device import LifeCycle
from freeflyer_adapters.device.permit import Permit

CLAIMS = 100
"""Claims without an echo after which another number is tried: the arm may have used this one up."""
REMEMBERED = 32
"""Answers whose time is remembered: half of the fewest cycle numbers that there are."""
STOPPED = (LifeCycle.safe_stop, LifeCycle.fault)


class Phase(Enum):
    listening = "listening"
    claiming = "claiming"
    activating = "activating"
    commanding = "commanding"


class ArmSession:
    """Decides only: no clock is read and nothing is sent. Times are [ns] of the monotonic clock.

    `numbers` gives a new session number. `implicit`: the arm knows no `activate`; torque frames activate it. `echoes`: the arm's
    state frames have the number of the controller that it obeys.
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
        self.obeyed = 0
        """The number that the arm echoes; 0: none."""
        self._answered_at: dict[int, int] = {}
        self._claims = 0
        self._was_claimed = False
        self._has_asked = False
        """Whether a frame went out that may have released the brakes."""

    @property
    def is_claimed(self) -> bool:
        """Whether the arm echoes this session's number, and can be activated."""
        echoed = self.obeyed == self.number or not self.echoes
        return echoed and (self.implicit or self.state is LifeCycle.inactive)

    @property
    def is_obeyed_elsewhere(self) -> bool:
        return self.obeyed not in (0, self.number)

    def wrote(self, answered: int, now: int) -> None:
        """A command frame went out, in answer to the state frame of this cycle number."""
        self.permit.wrote(now)
        self._answered_at[answered] = now
        if len(self._answered_at) > REMEMBERED:
            del self._answered_at[next(iter(self._answered_at))]

    def report(
        self, state: LifeCycle | None, obeyed: int, at: int, echoed: int | None = None
    ) -> None:
        """A state frame, which was received at `at` or later. `state`: None from an arm that does not report it; `echoed`: the cycle
        number whose answer it echoes.
        """
        if echoed is not None:
            # It was made after that answer went out, however long it was under way.
            at = self._answered_at.get(echoed, 0)
        if state is None:
            # It is taken to be active while it uses recent answers of this session; or, where it echoes none, while its frames come.
            uses_them = at > 0 and self.permit.last_write - at <= self.permit.watchdog
            state = LifeCycle.active if uses_them or echoed is None else LifeCycle.inactive
        self.state, self.obeyed = state, obeyed
        self.permit.report(state is LifeCycle.active and obeyed in (0, self.number), at)
        if self.phase is Phase.commanding:
            return
        if (
            not self.implicit
            and self._was_claimed
            and not self._has_asked
            and state is not LifeCycle.inactive
        ):
            # What was there before the claim is reset by it, once; this is new.
            self.permit.lose(f"{self.permit.subject} went to {state.name} before it was activated")
        self._was_claimed = self._was_claimed or (self.phase is Phase.claiming and self.is_claimed)
        if self.phase is Phase.activating:
            if state is LifeCycle.active and not self.is_obeyed_elsewhere:
                self.phase = Phase.commanding
            elif self._has_asked and state is not LifeCycle.inactive:
                self.permit.lose(
                    f"{self.permit.subject} went to {state.name} while it was activated"
                )

    def claim(self) -> None:
        self.phase = Phase.claiming

    def activate(self, now: int) -> None:
        """The operator's run begins: takes the permit."""
        self.permit.take(now)
        self._answered_at.clear()
        self.phase = Phase.commanding if self.state is LifeCycle.active else Phase.activating

    def answer(self, now: int, *, brake: bool = False) -> Mode:
        """The mode of the next command frame; `brake`: the graded stop has come to its brakes."""
        if self.phase in (Phase.listening, Phase.claiming):
            is_claiming = self.phase is Phase.claiming and self.permit.lost is None and not brake
            return self._claim() if is_claiming else Mode.brake if brake else Mode.idle
        if self.permit.allows(now) and not brake:
            return Mode.torque if self.phase is Phase.commanding else self._ask()
        # The graded stop: torque that falls, of an arm that is known to be active; without commands its own watchdog stops it.
        if self.phase is Phase.commanding and not brake:
            return Mode.torque if self.permit.may_ramp_down(now) else Mode.idle
        return Mode.brake

    def permits(self, mode: Mode, now: int) -> bool:
        """Whether a frame of this mode may still be sent; the last look before it goes out."""
        if mode is Mode.torque:
            return self.permit.allows(now) or self.permit.may_ramp_down(now)
        return mode is not Mode.activate or self.permit.allows(now)

    def _claim(self) -> Mode:
        if self.is_claimed or self.implicit:
            return Mode.idle
        self._claims += 1
        if self._claims % CLAIMS == 0 and self.obeyed == 0:
            self.number = self._numbers()
        return Mode.reset

    def _ask(self) -> Mode:
        if not self._has_asked:
            if self.implicit and self.state in STOPPED:
                return Mode.reset
            if not self.implicit and not self.is_claimed:
                return self._claim()
        self._has_asked = True
        return Mode.torque if self.implicit else Mode.activate
