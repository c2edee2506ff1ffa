"""No power after a stop: search of all states of loop, arm and link with the product's functions.

There are two locks: the permit of the host and the session number of the arm. The searches cover
each lock alone, and both locks together. Every guard is necessary: without this guard, the search
finds a path to power.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from device_alone import IGNORED, DeviceAlone
from search import Searched, World, explore, without_hold_ups
from whole_arm import HOST_IGNORED, Whole

from freeflyer_adapters.arm.frames import Mode
from freeflyer_adapters.arm.session import STOPPED, ArmSession
from freeflyer_adapters.device.device import LifeCycle
from freeflyer_adapters.device.permit import Permit
from freeflyer_adapters.device.quality import QualityMonitor
from freeflyer_adapters.facility.arm_logic import ArmLogic, Command

HOST_ALONE: dict[str, Any] = {"watchdog": 1, "silence": 4, "implicit": True, "any_delay": False}
"""An arm that cannot reject an activation, on a link that loses and repeats frames without delay.

Such an arm must keep its session for longer than the loop runs without state frames. The defaults
are 1 s and 20 ms; this model uses 4 and 2 cycles."""
WORLDS: dict[str, tuple[Callable[[], World], frozenset[str]]] = {
    "the arm's lock alone, any frames": (DeviceAlone, IGNORED),
    "both locks, any delay": (lambda: Whole(arm_faults=False), HOST_IGNORED),
    "both locks, an arm that fails and restarts": (lambda: Whole(any_delay=False), HOST_IGNORED),
    "the host's lock alone": (
        lambda: Whole(**HOST_ALONE, ages=False, arm_faults=False),
        HOST_IGNORED,
    ),
    # The loop cannot detect that such an arm has stopped because no command arrived. Therefore no
    # frame may be lost in this model.
    "the host's lock alone, neither life cycle nor echo": (
        lambda: Whole(
            **HOST_ALONE,
            ages=False,
            echoes=False,
            loses=False,
            reports_state=False,
            arm_faults=False,
        ),
        HOST_IGNORED,
    ),
    "the host's lock alone, no life cycle": (
        lambda: Whole(**HOST_ALONE, reports_state=False, arm_faults=False),
        HOST_IGNORED,
    ),
    "the host's lock alone, an arm that fails and restarts": (
        lambda: Whole(**HOST_ALONE),
        HOST_IGNORED,
    ),
    "both locks, any delay, an arm that fails and restarts": (Whole, HOST_IGNORED),
}
LONG = ("the host's lock alone, no life cycle", "both locks, an arm that fails and restarts", "the host's lock alone, an arm that fails and restarts",
        "both locks, any delay, an arm that fails and restarts")  # fmt: skip
MUST_BE_REACHED = {
    "Whole": {
        "a run starts",
        "a reason to stop",
        "the loop is suspended after its answer",
        "the loop resumes",
        "the loop is killed",
    },
    "DeviceAlone": {"a new session", "frame 2 activate 0", "frame 1 torque 3"},
}


def searched(name: str) -> Searched:
    made, ignored = WORLDS[name]
    return explore(made(), ignored)


def _marked(name: str) -> object:
    """Mark the long searches. The largest takes more than a minute: run it with `-m benchmark`."""
    marks = (
        [pytest.mark.benchmark] if name == LONG[-1] else [pytest.mark.slow] if name in LONG else []
    )
    return pytest.param(name, marks=marks)


@pytest.mark.parametrize("name", [_marked(name) for name in WORLDS])
def test_only_a_requested_activation_leads_to_power(name: str) -> None:
    found = searched(name)
    print(f"\n{name}: {found.states} states, {found.transitions} transitions")
    assert found.violation is None, f"{found.violation}: {' > '.join(found.path)}"
    assert MUST_BE_REACHED[type(WORLDS[name][0]()).__name__] <= found.reached


Patch = Callable[[pytest.MonkeyPatch], None]
GUARDS: dict[str, tuple[str, Patch]] = {}
"""Guard -> model that needs it, and a patch that removes it."""


def guard(world: str, what: str) -> Callable[[Patch], Patch]:
    def added(patch: Patch) -> Patch:
        GUARDS[what] = (world, patch)
        return patch

    return added


ALONE, HOST = "the arm's lock alone, any frames", "the host's lock alone"
SILENT, MUTE = (
    "the host's lock alone, no life cycle",
    "the host's lock alone, neither life cycle nor echo",
)


@guard(ALONE, "only mode 4 activates")
def _(patch: pytest.MonkeyPatch) -> None:
    is_activation = ArmLogic._is_activation

    def any_torque(self: ArmLogic, command: Command) -> bool:
        return is_activation(
            self, replace(command, mode=Mode.activate) if command.mode is Mode.torque else command
        )

    patch.setattr(ArmLogic, "_is_activation", any_torque)


@guard(ALONE, "only frames of the accepted session count")
def _(patch: pytest.MonkeyPatch) -> None:
    is_from_session = ArmLogic._is_from_session
    patch.setattr(
        ArmLogic,
        "_is_from_session",
        lambda self, command: is_from_session(self, command) or bool(self.controller),
    )


@guard(ALONE, "the activation answers a frame with the session number")
def _(patch: pytest.MonkeyPatch) -> None:
    begin = ArmLogic.begin

    def begun(self: ArmLogic, *arguments: Any) -> None:
        begin(self, *arguments)
        self._echoes = self.watchdog

    patch.setattr(ArmLogic, "begin", begun)


@guard(ALONE, "the activation answers a frame younger than the watchdog")
def _(patch: pytest.MonkeyPatch) -> None:
    begin = ArmLogic.begin

    def begun(self: ArmLogic, *arguments: Any) -> None:
        before = self._echoes
        begin(self, *arguments)
        self._echoes = (
            min(before + 1, self.watchdog + 1) if self.controller and before else self._echoes
        )

    patch.setattr(ArmLogic, "begin", begun)


@guard(ALONE, "active is entered from inactive only")
def _(patch: pytest.MonkeyPatch) -> None:
    is_activation = ArmLogic._is_activation

    def from_any(self: ArmLogic, command: Command) -> bool:
        state, self.life.now = self.life.now, LifeCycle.inactive
        activated = is_activation(self, command)
        self.life.now = state if not activated else LifeCycle.inactive
        return activated

    patch.setattr(ArmLogic, "_is_activation", from_any)


@guard(ALONE, "a number expires when the arm leaves active")
def _(patch: pytest.MonkeyPatch) -> None:
    use_up = ArmLogic._use_up
    patch.setattr(
        ArmLogic,
        "_use_up",
        lambda self: None if self.life.now is LifeCycle.active else use_up(self),
    )


@guard(ALONE, "a number expires at a brake command")
def _(patch: pytest.MonkeyPatch) -> None:
    use_up = ArmLogic._use_up
    patch.setattr(
        ArmLogic,
        "_use_up",
        lambda self: use_up(self) if self.life.now is LifeCycle.active else None,
    )


@guard(ALONE, "an expired number activates nothing")
def _(patch: pytest.MonkeyPatch) -> None:
    is_activation = ArmLogic._is_activation

    def without_used(self: ArmLogic, command: Command) -> bool:
        used, self.used = self.used, deque()
        try:
            return is_activation(self, command)
        finally:
            self.used = used

    patch.setattr(ArmLogic, "_is_activation", without_used)


@guard(ALONE, "an expired number claims nothing")
def _(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(
        ArmLogic, "_may_begin_session", lambda self, c: c.mode is Mode.reset and not self.controller
    )


@guard(ALONE, "expired numbers stay expired in the next session")
def _(patch: pytest.MonkeyPatch) -> None:
    again = ArmLogic.again

    def without_used(self: ArmLogic) -> ArmLogic:
        made = again(self)
        made.used = deque()
        return made

    patch.setattr(ArmLogic, "again", without_used)


@guard(ALONE, "an expired number ends no stop")
def _(patch: pytest.MonkeyPatch) -> None:
    obey = ArmLogic._handle

    def without_used(self: ArmLogic, command: Command) -> None:
        if command.mode is Mode.reset and command.controller == self.controller:
            used, self.used = self.used, deque()
            obey(self, command)
            self.used = used
        else:
            obey(self, command)

    patch.setattr(ArmLogic, "_handle", without_used)


@guard(ALONE, "a claim does not replace another session")
def _(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(
        ArmLogic,
        "_may_begin_session",
        lambda self, c: c.mode is Mode.reset and c.controller not in self.used,
    )


@guard(ALONE, "a stop ends only with the brakes engaged")
def _(patch: pytest.MonkeyPatch) -> None:
    obey = ArmLogic._handle

    def with_brakes(self: ArmLogic, command: Command) -> None:
        if (
            command.mode is Mode.reset
            and command.controller == self.controller
            and command.controller not in self.used
        ):
            braked, self.braked = self.braked, True
            obey(self, command)
            self.braked = braked
        else:
            obey(self, command)

    patch.setattr(ArmLogic, "_handle", with_brakes)
    patch.setattr(ArmLogic, "_use_up", lambda self: None)


@guard(ALONE, "torque counts in active only")
def _(patch: pytest.MonkeyPatch) -> None:
    command_ = ArmLogic._apply_torque

    def in_any_state(self: ArmLogic, command: Command) -> None:
        state, self.life.now = self.life.now, LifeCycle.active
        command_(self, command)
        self.life.now = state

    patch.setattr(ArmLogic, "_apply_torque", in_any_state)


@guard(ALONE, "torque as old as the watchdog, or older than the last, is not used")
def _(patch: pytest.MonkeyPatch) -> None:
    def any_age(self: ArmLogic, command: Command) -> None:
        if self.life.now is LifeCycle.active:
            self._answered = self.echoed = command.answered

    patch.setattr(ArmLogic, "_apply_torque", any_age)


@guard(ALONE, "the watchdog of the arm")
def _(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(ArmLogic, "_stop", lambda self, reason: None)


@guard(HOST, "a reason to stop ends the permit")
def _(patch: pytest.MonkeyPatch) -> None:
    lose = Permit.lose
    patch.setattr(
        Permit,
        "lose",
        lambda self, reason: None if reason == "a reason to stop" else lose(self, reason),
    )


guard(HOST, "a delay of the loop ends the permit")(without_hold_ups)


@guard(HOST, "a report of another state ends the permit")
def _(patch: pytest.MonkeyPatch) -> None:
    lose = Permit.lose
    patch.setattr(
        Permit,
        "lose",
        lambda self, reason: None if "another state" in reason else lose(self, reason),
    )


@guard(HOST, "the ramp-down needs a recent report")
def _(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Permit, "may_ramp_down", lambda self, now: self._is_taken)


@guard(HOST, "the last check before transmission")
def _(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(ArmSession, "permits", lambda self, mode, now: True)


@guard(HOST, "a stop during the activation ends the activation")
def _(patch: pytest.MonkeyPatch) -> None:
    lose = Permit.lose
    patch.setattr(
        Permit,
        "lose",
        lambda self, reason: None if "during its activation" in reason else lose(self, reason),
    )


@guard(HOST, "no reset after the first frame that may activate")
def _(patch: pytest.MonkeyPatch) -> None:
    request_activation = ArmSession._request_activation
    lose = Permit.lose

    def again(self: ArmSession) -> Mode:
        return Mode.reset if self.state in STOPPED else request_activation(self)

    patch.setattr(ArmSession, "_request_activation", again)
    patch.setattr(
        Permit,
        "lose",
        lambda self, reason: None if "during its activation" in reason else lose(self, reason),
    )


@guard(HOST, "lost state frames stop the loop")
def _(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(QualityMonitor, "observe", lambda self, lost: None)


@guard(SILENT, "an arm that does not report its state must echo this activation's answers")
def _(patch: pytest.MonkeyPatch) -> None:
    report = ArmSession.report
    patch.setattr(
        ArmSession,
        "report",
        lambda self, state, number, at, echoed: report(
            self, LifeCycle.active if state is None else state, number, at, echoed
        ),
    )


@guard(MUTE, "after a delay of the loop, an arm without reports is not ramped down")
def _(patch: pytest.MonkeyPatch) -> None:
    def without_delay_check(self: Permit, now: int) -> bool:
        self.allows(now)
        return (
            self._is_taken
            and self._active_at is not None
            and now - self._active_at <= self.watchdog
        )

    patch.setattr(Permit, "may_ramp_down", without_delay_check)


@pytest.mark.parametrize("what", GUARDS)
def test_without_this_guard_the_search_finds_a_path_to_power(
    what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    world, patch = GUARDS[what]
    patch(monkeypatch)
    found = searched(world)
    assert found.violation is not None, f"{found.states} states without a violation"
