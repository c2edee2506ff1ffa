"""Search model of controllers, CiA 402 drives and bus.

The model uses `DriveSession` and `Permit` of the host, and one `DriveLogic` per drive. A move is
one SYNC period. The host makes the calls of `Cia402Arm` in their order. A node processes frames
like `VirtualDrive`. The watchdogs of both ends expire after two periods, and three lost cycles stop
the loop (the defaults are four and five).

CiA 402 has no session number, and an RPDO has no time stamp: a drive in NMT state operational
accepts every RPDO. The guarantee needs these assumptions:
- Another run starts only if no SYNC is received (`Cia402Arm.configure`).
- A restart of a drive takes longer than the loop runs without its TPDOs.
- The bus delays an RPDO by at most one SYNC. `any_delay` drops this assumption: an RPDO may be
  repeated at any time.
- The process is not suspended between its decision and the RPDO. `stops_at_send` drops this
  assumption.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

import pytest
from search import shift_permit, without_hold_ups
from whole_base import Move, do, then

from freeflyer_adapters.cia402.drive_session import DriveSession
from freeflyer_adapters.cia402.objects import SYNC_LOST
from freeflyer_adapters.cia402.state_machine import (
    FAULT_RESET,
    POWERED,
    TOWARDS_ENABLED,
    Command,
    DriveState,
)
from freeflyer_adapters.device.permit import Permit
from freeflyer_adapters.device.quality import QualityMonitor
from freeflyer_adapters.device.ramp_down import RampDown
from freeflyer_adapters.facility.drive_logic import STOPPING, DriveLogic

S = DriveState
NOW, CYCLE, PERIOD = 20, 4_000_000, 0.004
WATCHDOG, LOST, RAMP, BRAKE_TIMEOUT, OLDEST = 2, 3, 1, 2, 5
"""Times in periods.

Watchdog of drives and permit, losses that stop the loop, ramp-down of the host, longest wait of the
host for the brakes, largest distinguished age of an RPDO."""
UPWARDS = {
    S.switch_on_disabled: (S.ready_to_switch_on,),
    S.ready_to_switch_on: (S.switched_on,),
    S.switched_on: (S.operation_enabled,),
}
CHECKS_BEFORE_SYNC = ("enabling", "running", "stopping")
"""Stages in which the loop checks its permit before it sends SYNC."""
SYNC_AFTER_HOLD_UP = False
"""Whether the end of the loop sends SYNC after a delay, which would apply old RPDOs."""
TARGET = 1.0
"""Target torque [N m]; not zero, so that the ramp of a stopping drive takes one period."""
IGNORED = frozenset({
    "subject", "_count", "_recent", "longest_row", "error", "new_error", "syncs", "ramp", "torque", "_controlword", "tick", "watchdog",
    "sync_period", "heartbeat_timeout", "_since_host",
})  # fmt: skip
"""Counters and constants."""


@dataclass(frozen=True)
class Rpdo:
    """RPDO of one run."""

    run: int
    command: Command
    answered: DriveState | None
    """Last state of the drive at the decision of the host."""
    age: int = 0
    """Periods since the decision."""


@dataclass
class Node:
    """Drive on the bus; corresponds to `VirtualDrive`."""

    logic: DriveLogic
    is_operational: bool = False
    was_operational: bool = False
    pending: Rpdo | None = None
    late: Rpdo | None = None
    """RPDO that is delayed on the bus until after the next SYNC."""
    off: int = 0
    """Periods until the end of a restart."""

    def on_sync(self) -> tuple[DriveState, Rpdo | None] | None:
        """Return the state in the TPDO and the applied RPDO; None: no response.

        Corresponds to `VirtualDrive.on_sync`.
        """
        if not self.is_operational or self.off:
            return None
        state, applied, self.pending = self.logic.state, self.pending, None
        self.logic.synchronise(None if applied is None else applied.command.value, TARGET)
        return state, applied

    def take(self, rpdo: Rpdo) -> None:
        """Corresponds to `VirtualDrive._take`."""
        if self.is_operational and not self.off:
            self.pending = rpdo

    def nmt(self, *, operational: bool) -> None:
        """Process an NMT command like `VirtualDrive.advance`."""
        self.is_operational = operational
        if operational == self.was_operational:
            return
        self.was_operational = operational
        if operational:
            self.pending = None
        elif not self.logic.braked:
            self.logic.fail(SYNC_LOST)


class Host:
    """One run of the controllers."""

    def __init__(self, run: int, drives: int) -> None:
        self.run = run
        self.permit = Permit("arm", watchdog=WATCHDOG * CYCLE)
        self.sessions = [DriveSession(self.permit, "drive") for _ in range(drives)]
        self.monitor = QualityMonitor("TPDOs", consecutive=LOST, cycle=PERIOD)
        self.stage = "preparing"
        self.was_active = False
        self.stopping = 0
        self.fresh = [False] * drives
        self.has_other_controller = False
        """Whether frames of another controller were received (`Cia402Arm._on_foreign_frame`)."""
        self.is_held_up = False
        self.held_up = 0
        self.held: list[Rpdo] | None = None
        """RPDOs that were ready for transmission when the process was suspended."""

    def stop(self) -> None:
        """Corresponds to `graded_stop.stop` and `Cia402Arm.revoke`."""
        self.permit.lose("a reason to stop")
        self.was_active = self.stage == "running"
        self.stage = "stopping"  # see `Cia402Arm.may_have_power`

    def may_exchange(self) -> bool:
        """Return whether the cycle starts with a SYNC.

        Corresponds to the start of `Cia402Arm.read` and to the loop in `Cia402Arm._enable`.
        """
        if self.stage in ("enabling", "running") and self.stage in CHECKS_BEFORE_SYNC:
            self.permit.allows(NOW * CYCLE)
            if self.permit.was_held_up:
                self.stop()
                return False
        return self.stage != "over"

    @property
    def only_measures(self) -> bool:
        """Whether the graded stop sends no SYNC (start of `Cia402Arm.ramp_down`)."""
        if self.stage in CHECKS_BEFORE_SYNC:
            self.permit.allows(NOW * CYCLE)
        return self.stage == "stopping" and self.permit.was_held_up and not SYNC_AFTER_HOLD_UP

    def measured(self, states: list[DriveState | None]) -> None:
        """Process statuswords that were read by SDO; None: no response, which ends the stop.

        Corresponds to `Cia402Arm.ramp_down` after a delay.
        """
        for j, state in enumerate(states):
            self.fresh[j] = state is not None
            self.sessions[j].report(state)
        self.stopping += 1
        if self._at_rest or not all(self.fresh) or self.stopping > RAMP + BRAKE_TIMEOUT:
            self.stage = "over"

    def exchanged(self, answers: list[DriveState | None]) -> None:
        """Process the TPDOs. Corresponds to `Cia402Arm._exchange` and `RemoteDrive._on_actual`."""
        for j, state in enumerate(answers):
            self.fresh[j] = state is not None
            if state is not None:
                self.sessions[j].report(state)
        if all(self.fresh):
            self.permit.report(
                all(s.state is S.operation_enabled for s in self.sessions), NOW * CYCLE
            )

    def write(self) -> list[Rpdo]:
        """Return the RPDOs of the cycle."""
        permit, now = self.permit, NOW * CYCLE
        are_enabled = all(session.state is S.operation_enabled for session in self.sessions)
        if self.stage == "preparing":  # see `Cia402Arm._first_measurement` and `activate`
            if self.has_other_controller:
                self.stage = "over"
            if self.has_other_controller or not all(self.fresh):
                return []
            permit.take(now)
            self.stage = "enabling"
            return self._send_targets()
        if self.stage == "enabling":  # see `Cia402Arm._enable`
            if permit.lost or self.has_other_controller:
                self.stop()
                return []
            self.stage = "running" if are_enabled else "enabling"
            return self._send_targets()
        if self.stage == "running":  # see `Cia402Arm.read` and `write`
            is_lost = self.monitor.observe(lost=not all(self.fresh))
            if is_lost or self.has_other_controller or not are_enabled or not permit.allows(now):
                self.stop()
                return []
            return self._send_targets()
        if self.stage == "over":
            return []
        # Stage "stopping": see `Cia402Arm.ramp_down`.
        self.stopping += 1
        brake = self.stopping > RAMP or not self.was_active
        sent = self._send_targets(brake=brake)
        if brake and (self._at_rest or self.stopping > RAMP + BRAKE_TIMEOUT):
            self.stage = "over"
        return sent

    @property
    def _at_rest(self) -> bool:
        return all(self.fresh) and all(session.state not in POWERED for session in self.sessions)

    def _send_targets(self, *, brake: bool = False) -> list[Rpdo]:
        """Corresponds to `Cia402Arm._send_targets`."""
        now = NOW * CYCLE
        sent = [
            Rpdo(self.run, session.answer(now, brake=brake), session.state)
            for session in self.sessions
        ]
        self.permit.wrote(now)
        return sent

    def brake(self) -> list[Rpdo]:
        """Corresponds to `Cia402Arm._stop_now`."""
        self.permit.allows(NOW * CYCLE)
        return self._send_targets(brake=True)

    def shift(self) -> None:
        permit, oldest = self.permit, (NOW - WATCHDOG - 1) * CYCLE
        shift_permit(permit, CYCLE, oldest)
        self.monitor._row, self.monitor.lost = min(self.monitor._row, LOST), 0
        self.monitor._recent.clear()
        self.held_up = min(self.held_up + 1, WATCHDOG + 1) if self.is_held_up else 0
        self.held = self.held and [older(rpdo) for rpdo in self.held]


def older(rpdo: Rpdo) -> Rpdo:
    return replace(rpdo, age=min(rpdo.age + 1, OLDEST))


def logic() -> DriveLogic:
    made = DriveLogic(tick=PERIOD, watchdog=WATCHDOG, ramp=RampDown(time=PERIOD, damping=0.0))
    made.sync_period = PERIOD
    return made


@dataclass
class Whole:
    """Complete model."""

    drives: int = 1
    starts: int = 1
    any_delay: bool = False
    stops_at_send: bool = False
    drive_faults: bool = True
    hold_ups: bool = True
    """Whether the host's process is suspended and resumed."""
    nodes: list[Node] = field(default_factory=list)
    hosts: list[Host] = field(default_factory=list)
    sent: set[Rpdo] = field(default_factory=set)
    """All sent RPDOs that would enable a drive, with the largest age."""
    stopped: dict[int, int | None] = field(default_factory=dict)
    """Periods since the first reason to stop, by run."""
    enabled: set[tuple[int, int]] = field(default_factory=set)
    """Pairs of a run and a drive that it has enabled."""
    bad: str | None = None

    def __post_init__(self) -> None:
        self.nodes = [Node(logic()) for _ in range(self.drives)]

    def moves(self) -> Iterator[tuple[str, Move]]:
        cycle = do("cycle", "nothing is lost")
        for link in (
            "nothing is lost",
            "SYNC lost",
            "RPDOs lost",
            "TPDOs lost",
            "all lost",
            "RPDOs late",
        ):
            yield link, do("cycle", link)
        for rpdo in sorted(self.sent, key=str):
            yield (
                f"late RPDO of run {rpdo.run}: {rpdo.command.name}",
                then(do("arrives_late", rpdo), cycle),
            )
        if self.drive_faults:
            yield "a drive fails", then(do("fail"), cycle)
            if not self.nodes[0].off:
                yield "a drive restarts", then(do("restart"), cycle)
        if self.starts and self._may_start():
            yield "a run starts", then(do("start"), cycle)
        for i, host in enumerate(self.hosts):
            if host.is_held_up:
                yield "the loop resumes", then(do("go_on", i), cycle)
                yield (
                    "the loop resumes, RPDOs lost",
                    then(do("go_on", i), do("cycle", "RPDOs lost")),
                )
            elif self.hold_ups:
                yield "the loop is suspended", then(do("hold_up", i), cycle)
                if self.stops_at_send:
                    yield (
                        "the loop is suspended before it sends",
                        do("cycle", "nothing is lost", hold_up=i),
                    )
            if not host.is_held_up and host.stage in ("enabling", "running"):
                yield "a reason to stop", then(do("stop", i), cycle)
            if self.hold_ups and not host.is_held_up and host.stage in ("enabling", "running"):
                yield (
                    "a reason to stop, and the loop is suspended",
                    then(do("stop", i), do("hold_up", i), cycle),
                )
            yield "the loop is killed", then(do("kill", i), cycle)

    def _may_start(self) -> bool:
        """Whether no SYNC is received and no drive is enabled. Corresponds to `configure`."""
        is_silent = all(host.is_held_up for host in self.hosts)
        return is_silent and not any(node.off or node.logic.state in POWERED for node in self.nodes)

    def start(self) -> None:
        """Corresponds to `Cia402Arm.prepare`."""
        self.starts -= 1
        run = len(self.stopped) + 1
        self.stopped[run] = None
        for node in self.nodes:
            node.nmt(operational=False)
            if node.logic.state is S.fault:
                for word in (0, FAULT_RESET, 0):
                    node.logic.apply_controlword(word)
            node.nmt(operational=True)
        self.hosts.append(Host(run, self.drives))

    def restart(self) -> None:
        """Restart a drive, which boots into NMT state pre-operational."""
        self.nodes[0] = Node(logic(), off=LOST + 1)

    def fail(self) -> None:
        self.nodes[0].logic.fail(SYNC_LOST)

    def arrives_late(self, rpdo: Rpdo) -> None:
        self.nodes[0].take(rpdo)

    def stop(self, i: int) -> None:
        self.hosts[i].stop()

    def hold_up(self, i: int) -> None:
        self.hosts[i].is_held_up = True

    def go_on(self, i: int) -> None:
        host = self.hosts[i]
        host.is_held_up = False
        if host.held is not None:
            self._put(host.held, is_late=False)
            host.held = None

    def kill(self, i: int) -> None:
        self._stopped(self.hosts.pop(i).run)

    def _stopped(self, run: int) -> None:
        if self.stopped[run] is None:
            self.stopped[run] = 0

    def _put(self, rpdos: list[Rpdo], *, is_late: bool) -> None:
        for node, rpdo in zip(self.nodes, rpdos, strict=True):
            if rpdo.command.value & FAULT_RESET:
                self.bad = "an RPDO would reset a fault"
            if rpdo.command in TOWARDS_ENABLED.values() and rpdo.command.value & 0x04:
                if rpdo.answered is None or TOWARDS_ENABLED.get(rpdo.answered) is not rpdo.command:
                    self.bad = f"{rpdo.command.name} was sent to a drive in {rpdo.answered}"
                if self.any_delay and rpdo.command is not Command.shutdown:
                    self.sent.add(replace(rpdo, age=OLDEST))
            if is_late:
                node.late = rpdo
            else:
                node.take(rpdo)

    def cycle(self, link: str, hold_up: int | None = None) -> None:
        """Execute one period. `hold_up`: host that is suspended before it sends its RPDOs."""
        waiting = [node.late for node in self.nodes]
        for node in self.nodes:
            node.late = None
        synced = False
        # Each host sends SYNC, receives the TPDOs and sends its RPDOs.
        for i, host in enumerate(self.hosts):
            if host.is_held_up:
                if host.held_up > WATCHDOG and host.stage != "preparing":
                    self._stopped(host.run)
                continue
            if host.only_measures:
                host.measured([None if node.off else node.logic.state for node in self.nodes])
            elif host.may_exchange():
                for other in self.hosts:
                    other.has_other_controller = other.has_other_controller or other is not host
                answers = self._sync(link)
                self._arrive(waiting if not synced else [])
                synced = True
                host.exchanged(
                    [None if link in ("TPDOs lost", "all lost") else answer for answer in answers]
                )
                rpdos = host.write()
                if host.permit.lost:
                    self._stopped(host.run)
                if rpdos and hold_up == i:
                    host.held, host.is_held_up = rpdos, True
                elif rpdos and link not in ("RPDOs lost", "all lost"):
                    self._put(rpdos, is_late=link == "RPDOs late")
            if host.permit.lost:
                self._stopped(host.run)
            if host.stage == "over" and not host.is_held_up:
                self._deactivate(host, link)
        # Without a SYNC, delayed RPDOs arrive at the end of the period.
        if not synced:
            self._arrive(waiting)
        self.hosts = [host for host in self.hosts if host.stage != "over" or host.is_held_up]
        for node in self.nodes:
            if node.off:
                node.off -= 1
            node.logic.advance(0.0)

    def _arrive(self, waiting: list[Rpdo | None]) -> None:
        for node, rpdo in zip(self.nodes, waiting, strict=False):
            if rpdo is not None:
                node.take(rpdo)

    def _deactivate(self, host: Host, link: str) -> None:
        """Corresponds to `Cia402Arm.deactivate`."""
        rpdos = host.brake()
        if link == "all lost":
            return
        if link != "RPDOs lost":
            self._put(rpdos, is_late=link == "RPDOs late")
        if SYNC_AFTER_HOLD_UP or not host.permit.was_held_up:
            self._sync(link)
        for node in self.nodes:
            node.nmt(operational=False)

    def _sync(self, link: str) -> list[DriveState | None]:
        """Send SYNC, and return the states in the TPDOs."""
        answers: list[DriveState | None] = []
        for j, node in enumerate(self.nodes):
            before = node.logic.state
            answered = None if link in ("SYNC lost", "all lost") else node.on_sync()
            answers.append(answered and answered[0])
            if answered and answered[1]:
                self._acted(j, before, node.logic.state, answered[1])
        return answers

    def _acted(self, j: int, before: DriveState, state: DriveState, rpdo: Rpdo) -> None:
        """Check the effect of an RPDO on drive `j`."""
        if state is before or state not in UPWARDS.get(before, ()):
            return
        if rpdo.answered is not before:
            self.bad = (
                f"{rpdo.command.name} acted in {before.value}, but was sent for another state"
            )
        if state is not S.operation_enabled:
            return
        if (rpdo.run, j) in self.enabled:
            self.bad = f"run {rpdo.run} has enabled drive {j + 1} twice"
        stopped = self.stopped[rpdo.run]
        if stopped is not None and rpdo.age <= stopped:
            self.bad = f"run {rpdo.run} has enabled a drive with an RPDO from after its stop"
        elif stopped is not None and rpdo.age > WATCHDOG:
            self.bad = f"run {rpdo.run} has enabled a drive after its stop, with an RPDO {rpdo.age} periods old"
        self.enabled.add((rpdo.run, j))

    def normalise(self) -> None:
        for node in self.nodes:
            made = node.logic
            if made.state not in STOPPING:
                made._stopping, made._stopping_torque = 0, 0.0
            is_enabled = made.state is S.operation_enabled
            made._since_sync = min(made._since_sync, WATCHDOG + 1) if is_enabled else 0
            made._syncs_since_target = min(made._syncs_since_target, WATCHDOG) if is_enabled else 0
            node.pending = node.pending and older(node.pending)
            node.late = node.late and older(node.late)
        for host in self.hosts:
            host.shift()
        for run, since in self.stopped.items():
            self.stopped[run] = None if since is None else min(since + 1, OLDEST)

    def violation(self) -> str | None:
        return self.bad


WORLDS: dict[str, Callable[[], Whole]] = {
    "one drive": Whole,
    "one drive, a process that is suspended before it sends": lambda: Whole(
        stops_at_send=True, drive_faults=False
    ),
    "two drives": lambda: Whole(drives=2, drive_faults=False),
    "two runs": lambda: Whole(starts=2, drive_faults=False, hold_ups=False),
}
NOT_GUARANTEED: dict[str, Callable[[], Whole]] = {
    "a late RPDO in the same run": lambda: Whole(
        any_delay=True, drive_faults=False, hold_ups=False
    ),
    "a late RPDO of the previous run": lambda: Whole(
        starts=2, stops_at_send=True, drive_faults=False
    ),
}
"""Models without one assumption, in which the search finds a violation."""
Patch = Callable[[pytest.MonkeyPatch], None]


def _not_stepwise(patch: pytest.MonkeyPatch) -> None:
    answer = DriveSession.answer

    def enables(self: DriveSession, now: int, *, brake: bool = False) -> Command:
        return (
            Command.enable_operation
            if not brake and self.permit.allows(now)
            else answer(self, now, brake=brake)
        )

    patch.setattr(DriveSession, "answer", enables)


def _ramps_down_in_any_state(patch: pytest.MonkeyPatch) -> None:
    answer = DriveSession.answer

    def enables(self: DriveSession, now: int, *, brake: bool = False) -> Command:
        return (
            Command.enable_operation
            if not brake and self.permit.lost
            else answer(self, now, brake=brake)
        )

    patch.setattr(DriveSession, "answer", enables)


class _Reset(Enum):
    fault_reset = FAULT_RESET


def _resets(patch: pytest.MonkeyPatch) -> None:
    answer = DriveSession.answer

    def resets(self: DriveSession, now: int, *, brake: bool = False) -> Any:
        return _Reset.fault_reset if self.state is S.fault else answer(self, now, brake=brake)

    patch.setattr(DriveSession, "answer", resets)


def _keeps_pending(patch: pytest.MonkeyPatch) -> None:
    nmt = Node.nmt

    def keeps(self: Node, *, operational: bool) -> None:
        pending = self.pending
        nmt(self, operational=operational)
        self.pending = pending

    patch.setattr(Node, "nmt", keeps)


def _follows_in_any_nmt_state(patch: pytest.MonkeyPatch) -> None:
    on_sync = Node.on_sync

    def take(self: Node, rpdo: Rpdo) -> None:
        self.pending = rpdo

    def synced(self: Node) -> tuple[DriveState, Rpdo | None] | None:
        self.is_operational = True
        return on_sync(self)

    patch.setattr(Node, "take", take)
    patch.setattr(Node, "on_sync", synced)


def _two_at_a_time(patch: pytest.MonkeyPatch) -> None:
    """Remove two guards: the check of the bus before a run, and the stop at foreign frames."""
    patch.setattr(Whole, "_may_start", lambda world: True)
    never = property(lambda host: False, lambda host, value: None)
    patch.setattr(Host, "has_other_controller", never, raising=False)


GUARDS: dict[str, tuple[Callable[[], Whole], Patch]] = {
    "a delay of the loop ends the permit": (WORLDS["two drives"], without_hold_ups),
    "the activation checks the permit before its SYNC": (
        WORLDS["two drives"],
        lambda patch: patch.setattr(f"{__name__}.CHECKS_BEFORE_SYNC", ("running", "stopping")),
    ),
    "the graded stop checks the permit before its SYNC": (
        WORLDS["two drives"],
        lambda patch: patch.setattr(f"{__name__}.CHECKS_BEFORE_SYNC", ("enabling", "running")),
    ),
    "no SYNC after a delay of the loop": (
        WORLDS["two drives"],
        lambda patch: patch.setattr(f"{__name__}.SYNC_AFTER_HOLD_UP", True),
    ),
    "every step responds to the previous statusword": (WORLDS["two drives"], _not_stepwise),
    "only enabled drives are ramped down": (WORLDS["two drives"], _ramps_down_in_any_state),
    "an RPDO never resets a fault": (WORLDS["two drives"], _resets),
    "NMT start discards earlier RPDOs": (WORLDS["two runs"], _keeps_pending),
    "PDOs act in NMT state operational only": (WORLDS["one drive"], _follows_in_any_nmt_state),
    "one controller at a time": (WORLDS["two runs"], _two_at_a_time),
}
"""Guard -> model that needs it, and a patch that removes it."""
