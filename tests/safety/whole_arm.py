"""Search model of controllers, arm and link.

The model uses `ArmSession` and `Permit` of the host and `ArmLogic` of the arm. The link loses,
repeats and delays frames. A move is one cycle of the arm. The loop calls the session in the order
of `CanArm`. Times are in cycles. Counters are relative, and delays are distinguished only up to the
next limit.
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
"""Number of lost cycles that stop the loop, cycles of the ramp-down, frames in a socket buffer."""
HOST_IGNORED = IGNORED | {"_count", "_recent", "longest_row", "lost_reason", "_claims"}
POWER = (Mode.reset, Mode.activate, Mode.torque)
Frame = tuple[int, Mode, int]
"""Session number, mode, answered cycle number."""
Report = tuple[LifeCycle, int, int, int | None]
"""State, echoed session number, cycle number, echoed cycle number."""


@dataclass
class Numbers:
    """Source of session numbers that always returns the same number."""

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
        """Mode of a frame that was ready for transmission when the process was suspended."""
        self.is_held_up = False
        self.has_activated = False
        """Whether the run has started its activation."""
        self.session.claim()

    def revoke(self) -> None:
        """Corresponds to `CanArm.revoke` and `graded_stop.stop`."""
        self.session.permit.lose("a reason to stop")
        self.stage = "stopping"

    @property
    def has_recent_report(self) -> bool:
        """Whether a report of active is not older than the watchdog."""
        permit = self.session.permit
        return (
            permit._active_at is not None and (NOW * CYCLE - permit._active_at) <= permit.watchdog
        )

    def receive(self) -> bool:
        """Corresponds to `StateFrames.wait` and `CanArm._take`."""
        has_received = bool(self.inbox)
        for state, number, cycle, echoed in self.inbox:
            self.answered = cycle
            self.session.report(
                state if self.session.permit.reports_state else None,
                number,
                (NOW - 1) * CYCLE,
                echoed,
            )
        self.inbox.clear()
        return has_received

    def answer(self) -> Mode | None:
        """Return the mode of the loop's frame in this cycle; None: no frame."""
        if self.stage == "over":
            return None
        received, session, now = self.receive(), self.session, NOW * CYCLE
        if self.stage == "preparing" and session.is_claimed:
            session.activate(now)
            self.stage, self.has_activated = "activating", True
        reason = self.monitor.observe(lost=not received) if self.has_activated else None
        if self.stage == "activating":
            if reason or session.permit.lost or session.has_other_controller:
                self.revoke()
            elif session.phase is Phase.commanding:
                self.stage = "running"
        elif self.stage == "running" and (
            reason or session.has_other_controller or not session.permit.allows(now)
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
        """Corresponds to `CanArm._send`, with the last check before transmission."""
        if not self.session.permits(mode, NOW * CYCLE):
            return None
        self.session.wrote(self.answered, NOW * CYCLE)
        return self.session.number, mode, self.answered


@dataclass
class Whole:
    """Complete model. `any_delay`: the link delays frames, and repeats old ones at any time.

    Without `any_delay`, the link only loses and doubles frames.
    """

    watchdog: int = 2
    silence: int = 3
    implicit: bool = False
    reports_state: bool = True
    any_delay: bool = True
    ages: bool = True
    """Whether commands contain the answered cycle, from which the arm derives their age."""
    arm_faults: bool = True
    """Whether the arm fails and restarts."""
    echoes: bool = True
    """Whether state frames echo the cycle number of the last accepted command."""
    loses: bool = True
    """Whether the link loses frames."""
    starts: int = 1
    arm: Any = None
    hosts: list[Host] = field(default_factory=list)
    last: list[Frame] = field(default_factory=list)
    """Frames of the previous cycle."""
    to_host: list[Report] = field(default_factory=list)
    sent: set[tuple[int, Mode]] = field(default_factory=set)
    """All sent frames, which the link may repeat at any time."""
    elapsed: int = 0
    """Cycles since the last call of `normalise`."""
    off: int = 0
    """Cycles until the end of a restart.

    A restart takes longer than the loop runs without frames.
    """
    sending: list[Frame] = field(default_factory=list)
    requested: set[int] = field(default_factory=set)
    """Runs that have started their activation."""
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
            yield "states delayed", lambda world: world.cycle("states delayed")
            for frame in self.last:
                yield (
                    "a command of the previous cycle",
                    lambda world, f=frame: world.cycle("nothing", late=f),
                )
                yield (
                    "a command delayed",
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
                yield "the loop resumes", lambda world, i=i: world.go_on(i)
            else:
                yield (
                    "the loop is suspended",
                    lambda world, i=i: world.hold_up(i, after_answer=False),
                )
                yield (
                    "the loop is suspended after its answer",
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
        """Switch the arm off and on: its memory is empty, and its cycle numbers are different."""
        self.arm = arm(self.implicit, self.watchdog, self.silence)
        old = (MIDDLE - OLDEST) % CYCLES
        self.last = [(number, mode, old) for number, mode, _ in self.last]
        self.off = LOST + 1
        # A run without a report of active is still in its first activation.
        self.activated -= {
            host.session.number for host in self.hosts if host.stage in ("preparing", "activating")
        }
        for host in self.hosts:
            host.session._answered_at.clear()

    def hold_up(self, i: int, *, after_answer: bool) -> None:
        """Suspend the process between two instants, or with a frame ready for transmission."""
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
        if host.has_activated:
            self.requested.add(host.session.number)
        if frame is None:
            return
        if mode is Mode.activate and not host.session.permit.is_held:
            self.bad = "an activation was sent without a permit"
        if host.stage == "stopping" and (
            mode is Mode.activate or (mode is Mode.torque and not host.has_recent_report)
        ):
            self.bad = (
                f"{mode.name} was sent after a reason to stop, without a recent report of active"
            )
        self.sending.append(frame)
        if mode in POWER:
            self.sent.add(frame[:2])

    def cycle(self, link: str, late: Frame | None = None) -> None:
        """Execute one cycle. `link`: behaviour of the link; `late`: old frame that arrives now."""
        # The hosts send.
        self.elapsed += 1
        for host in self.hosts:
            if not host.is_held_up:
                mode = host.answer()
                if mode is not None:
                    self._put(host, mode)
        self.hosts = [host for host in self.hosts if host.stage != "over"]
        # The link loses, doubles or delays the commands.
        arriving, self.sending = self.sending, []
        self.last = [frame for frame in arriving if frame[1] in POWER] if self.any_delay else []
        if link in ("commands lost", "both lost"):
            arriving = []
        if link == "commands doubled":
            arriving = [frame for frame in arriving for _ in range(2)]
        if late is not None:
            arriving.append(late)
        # The arm executes its cycle, and sends its state.
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
        elif link == "states delayed":
            self.to_host = self.to_host[-QUEUE:]
            return
        for host in self.hosts:
            host.inbox = [*host.inbox, *self.to_host][-QUEUE:]
        self.to_host = []

    def _arm_cycle(self, frames: list[Frame]) -> None:
        logic = self.arm
        for frame in frames or [None]:
            # Pass the frames one by one, to find the one that activates the arm.
            before, braked = logic.life.now, logic.braked
            if frame is not None:
                number, mode, answered = frame if self.ages else (*frame[:2], logic.cycle)
                logic._handle(
                    Command(controller=number, mode=mode, answered=answered, torque=STILL)
                )
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
        if number not in self.requested:
            self.bad = f"run {number} has activated the arm before its activation has started"
        self.activated.add(number)

    def normalise(self) -> None:

        def relative(number: int | None, most: int = self.watchdog) -> Any:
            """Return the number relative to the middle; OLDEST for ages beyond the limit."""
            if number is None:
                return None
            age = (self.arm.cycle - number) % CYCLES
            return MIDDLE - (age if age < most else OLDEST)

        self.last = [(number, mode, relative(answered)) for number, mode, answered in self.last]
        self.sending = [
            (number, mode, relative(answered)) for number, mode, answered in self.sending
        ]
        # The age of the last answer matters only for an arm that does not report its state.
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
