"""Controllers, arm and the link between them: the host's `ArmSession` and `Permit`, the arm's `ArmLogic`, and a link that does what links do.

A move is one of the arm's cycles. What the loop does in it is the calls that `CanArm` makes, in its order. Times are cycles; numbers that
count on are kept relative, and delays are told apart only as far as a limit tells them apart.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from device_alone import CYCLES, IGNORED, OLDEST, STILL, arm, shift
from search import shift_permit

from freeflyer_adapters.arm.frames import Mode
from freeflyer_adapters.arm.session import STOPPED, ArmSession, Phase
from freeflyer_adapters.device.device import LifeCycle
from freeflyer_adapters.device.permit import Permit
from freeflyer_adapters.device.quality import QualityMonitor
from freeflyer_adapters.facility.arm_logic import Command

NOW, CYCLE, MIDDLE = 20, 1_000_000, CYCLES // 2
LOST, RAMP, QUEUE = 2, 1, 1
"""Lost cycles that stop the loop; cycles of its ramp-down; frames that a link or a socket holds."""
HOST_IGNORED = IGNORED | {"_count", "_recent", "longest_row", "lost_reason", "_claims"}
POWER = (Mode.reset, Mode.activate, Mode.torque)
Frame = tuple[int, Mode, int]
"""Session number, mode, cycle number that is answered."""
Report = tuple[LifeCycle, int, int, int | None]
"""State, obeyed number, cycle number, echoed cycle number."""


@dataclass
class Numbers:
    number: int

    def __call__(self) -> int:
        return self.number


class Host:
    """One run of the controllers."""

    def __init__(self, number: int, *, watchdog: int, implicit: bool, reports_state: bool) -> None:
        permit = Permit("arm", watchdog=watchdog * CYCLE, reports_state=reports_state)
        self.session = ArmSession(permit, Numbers(number), implicit=implicit)
        self.monitor = QualityMonitor("frames", consecutive=LOST, cycle=1e-3)
        self.stage = "preparing"
        self.stopping = 0
        self.answered = MIDDLE
        self.inbox: list[Report] = []
        self.held: Mode | None = None
        """A frame that was ready to be sent when the process was stopped."""
        self.is_held_up = False
        self.has_asked = False
        self.session.claim()

    def revoke(self) -> None:
        """See `CanArm.revoke` and `graded_stop.stop`."""
        self.session.permit.lose("a reason to stop")
        self.stage = "stopping"

    @property
    def knows_active(self) -> bool:
        """Whether the newest report says that the arm was active no longer ago than its watchdog."""
        permit = self.session.permit
        return (
            permit._active_at is not None and (NOW * CYCLE - permit._active_at) <= permit.watchdog
        )

    def receive(self) -> bool:
        """See `StateFrames.wait` and `CanArm._take`."""
        came = bool(self.inbox)
        for state, obeyed, cycle, echoed in self.inbox:
            self.answered = cycle
            self.session.report(
                state if self.session.permit.reports_state else None,
                obeyed,
                (NOW - 1) * CYCLE,
                echoed,
            )
        self.inbox.clear()
        return came

    def answer(self) -> Mode | None:
        """What the loop sends in this cycle; None: nothing."""
        if self.stage == "over":
            return None
        came, session, now = self.receive(), self.session, NOW * CYCLE
        if self.stage == "preparing" and session.is_claimed:
            session.activate(now)
            self.stage, self.has_asked = "activating", True
        reason = self.monitor.observe(lost=not came) if self.has_asked else None
        if self.stage == "activating":
            if reason or session.permit.lost or session.is_obeyed_elsewhere:
                self.revoke()
            elif session.phase is Phase.commanding:
                self.stage = "running"
        elif self.stage == "running" and (
            reason or session.is_obeyed_elsewhere or not session.permit.allows(now)
        ):
            self.revoke()
        if self.stage != "stopping":
            return session.answer(now)
        self.stopping += 1
        if self.stopping > RAMP + 1:
            self.stage = "over"
            return None
        if session.permit.reports_state and session.state in STOPPED:
            return None
        return session.answer(now, brake=self.stopping > RAMP)

    def send(self, mode: Mode) -> Frame | None:
        """See `CanArm._send`: the last look before the frame goes out."""
        if not self.session.permits(mode, NOW * CYCLE):
            return None
        self.session.wrote(self.answered, NOW * CYCLE)
        return self.session.number, mode, self.answered


@dataclass
class Whole:
    """`any_delay`: the link holds frames up and repeats old ones, as often as it likes; else it loses and doubles them only."""

    watchdog: int = 2
    silence: int = 3
    implicit: bool = False
    reports_state: bool = True
    any_delay: bool = True
    ages: bool = True
    """Whether commands say which cycle they answer, so that the arm can tell how old they are."""
    arm_faults: bool = True
    """Whether the arm fails and restarts."""
    echoes: bool = True
    """Whether state frames echo the cycle number of the answer that was used."""
    loses: bool = True
    """Whether the link loses frames."""
    starts: int = 1
    arm: Any = None
    hosts: list[Host] = field(default_factory=list)
    last: list[Frame] = field(default_factory=list)
    """The frames of the cycle before."""
    to_host: list[Report] = field(default_factory=list)
    sent: set[tuple[int, Mode]] = field(default_factory=set)
    """What was ever sent, and may come again at any time."""
    elapsed: int = 0
    """Cycles since times were brought within their limits."""
    off: int = 0
    """Cycles until the arm, switched off and on, is there again: longer than the loop goes on without state frames."""
    sending: list[Frame] = field(default_factory=list)
    asked: set[int] = field(default_factory=set)
    activated: set[int] = field(default_factory=set)
    bad: str | None = None

    def __post_init__(self) -> None:
        self.arm = arm(self.implicit, self.watchdog, self.silence)

    def moves(self) -> Iterator[tuple[str, Callable[[Any], None]]]:
        for name in (
            ("nothing", "commands lost", "states lost", "both lost") if self.loses else ("nothing",)
        ):
            yield name, lambda world, name=name: world.cycle(name)
        if self.any_delay:
            yield "states held up", lambda world: world.cycle("states held up")
            for frame in self.last:
                yield (
                    "a command of the cycle before",
                    lambda world, f=frame: world.cycle("nothing", late=f),
                )
                yield (
                    "a command held up",
                    lambda world, f=frame: world.cycle("commands lost", late=f),
                )
            for number, mode in sorted(self.sent):
                frame = (number, mode, MIDDLE - OLDEST)
                yield (
                    f"late {mode.name} of run {number}",
                    lambda world, f=frame: world.cycle("nothing", late=f),
                )
        else:
            yield "commands doubled", lambda world: world.cycle("commands doubled")
        if self.arm_faults and not self.off:
            yield (
                "the arm fails",
                lambda world: (world.arm.fail("it fails"), world.cycle("nothing")),
            )
            yield "the arm restarts", lambda world: (world.restart_arm(), world.cycle("nothing"))
        if self.starts:
            yield "a run starts", lambda world: (world.start(), world.cycle("nothing"))
        for i, host in enumerate(self.hosts):
            if host.is_held_up:
                yield "the loop goes on", lambda world, i=i: world.go_on(i)
            else:
                yield "the loop is held up", lambda world, i=i: world.hold_up(i, after_answer=False)
                yield (
                    "the loop is held up after its answer",
                    lambda world, i=i: world.hold_up(i, after_answer=True),
                )
                if host.stage != "stopping":
                    yield (
                        "a reason to stop",
                        lambda world, i=i: (world.hosts[i].revoke(), world.cycle("nothing")),
                    )
            yield (
                "the loop is killed",
                lambda world, i=i: (world.hosts.pop(i), world.cycle("nothing")),
            )

    def start(self) -> None:
        self.starts -= 1
        self.hosts.append(
            Host(
                2 - self.starts,
                watchdog=self.watchdog,
                implicit=self.implicit,
                reports_state=self.reports_state,
            )
        )

    def restart_arm(self) -> None:
        """Power off and on: nothing is remembered, and cycle numbers are others."""
        self.arm = arm(self.implicit, self.watchdog, self.silence)
        old = (MIDDLE - OLDEST) % CYCLES
        self.last = [(number, mode, old) for number, mode, _ in self.last]
        self.off = LOST + 1
        # A run that has not seen its arm active is still in its one activation.
        self.activated -= {
            host.session.number for host in self.hosts if host.stage in ("preparing", "activating")
        }
        for host in self.hosts:
            host.session._answered_at.clear()

    def hold_up(self, i: int, *, after_answer: bool) -> None:
        """Stop the process between two of its instants, or when a frame is ready to go out."""
        host = self.hosts[i]
        if after_answer:
            host.held = host.answer()
        host.is_held_up = True
        self.cycle("nothing")

    def go_on(self, i: int) -> None:
        host = self.hosts[i]
        if host.held is None:
            host.is_held_up = False
            self.cycle("nothing")
            return
        self._put(host, host.held)
        host.held = None
        self.cycle("nothing")
        host.is_held_up = False

    def _put(self, host: Host, mode: Mode) -> None:
        frame = host.send(mode)
        if host.has_asked:
            self.asked.add(host.session.number)
        if frame is None:
            return
        if mode is Mode.activate and not host.session.permit.is_held:
            self.bad = "an activation was sent without a permit"
        if host.stage == "stopping" and (
            mode is Mode.activate or (mode is Mode.torque and not host.knows_active)
        ):
            self.bad = f"{mode.name} was sent after a reason to stop, to an arm that was not known to be active"
        self.sending.append(frame)
        if mode in POWER:
            self.sent.add(frame[:2])

    def cycle(self, link: str, late: Frame | None = None) -> None:
        self.elapsed += 1
        for host in self.hosts:
            if not host.is_held_up:
                mode = host.answer()
                if mode is not None:
                    self._put(host, mode)
        self.hosts = [host for host in self.hosts if host.stage != "over"]
        arriving, self.sending = self.sending, []
        self.last = [frame for frame in arriving if frame[1] in POWER] if self.any_delay else []
        if link in ("commands lost", "both lost"):
            arriving = []
        if link == "commands doubled":
            arriving = [frame for frame in arriving for _ in range(2)]
        if late is not None:
            arriving.append(late)
        if self.off:
            self.off -= 1
            for host in self.hosts:
                host.inbox = host.inbox[-QUEUE:]
            return
        self._arm_cycle(arriving)
        logic = self.arm
        self.to_host.append(
            (logic.life.now, logic.controller, logic.cycle, logic.echoed if self.echoes else None)
        )
        if link in ("states lost", "both lost"):
            self.to_host.pop()
        elif link == "states held up":
            self.to_host = self.to_host[-QUEUE:]
            return
        for host in self.hosts:
            host.inbox = [*host.inbox, *self.to_host][-QUEUE:]
        self.to_host = []

    def _arm_cycle(self, frames: list[Frame]) -> None:
        logic = self.arm
        for frame in frames or [None]:
            # One at a time, so that it is seen which one did it; only the last begins a cycle.
            before, braked = logic.life.now, logic.braked
            if frame is not None:
                number, mode, answered = frame if self.ages else (*frame[:2], logic.cycle)
                logic._obey(Command(controller=number, mode=mode, answered=answered, torque=STILL))
            if logic.life.now is LifeCycle.active and before is not LifeCycle.active:
                self._activated(number)
            elif braked and not logic.braked:
                self.bad = "brakes were released outside an activation"
        logic.begin([], STILL)
        if logic.session_is_over:
            self.arm = logic.again()

    def _activated(self, number: int) -> None:
        if number in self.activated:
            self.bad = f"run {number} has activated the arm twice"
        if number not in self.asked:
            self.bad = f"run {number} has activated the arm, and had not come to its activation"
        self.activated.add(number)

    def normalise(self) -> None:

        def relative(number: int | None, most: int = self.watchdog) -> Any:
            """What is older than the limit is old."""
            if number is None:
                return None
            age = (self.arm.cycle - number) % CYCLES
            return MIDDLE - (age if age < most else OLDEST)

        self.last = [(number, mode, relative(answered)) for number, mode, answered in self.last]
        self.sending = [
            (number, mode, relative(answered)) for number, mode, answered in self.sending
        ]
        # How old the last used answer is matters only where nothing else shows that the arm is active.
        echo = self.watchdog if self.reports_state else OLDEST
        self.to_host = [(s, o, relative(c), relative(e, echo)) for s, o, c, e in self.to_host]
        for host in self.hosts:
            session, permit = host.session, host.session.permit
            host.answered = relative(host.answered)
            host.inbox = [(s, o, relative(c), relative(e, echo)) for s, o, c, e in host.inbox]
            back = self.elapsed * CYCLE
            oldest = (NOW - self.watchdog - 1) * CYCLE
            answers = {
                relative(c, echo): max(at - back, oldest) for c, at in session._answered_at.items()
            }
            session._answered_at = {c: at for c, at in answers.items() if c > MIDDLE - OLDEST}
            shift_permit(permit, back, oldest)
            session._claims = 0
            host.monitor._row = min(host.monitor._row, LOST)
            host.monitor._recent.clear()
        shift(self.arm, echo)
        self.elapsed = 0

    def violation(self) -> str | None:
        return self.bad
