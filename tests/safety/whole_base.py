"""Search model of controllers, base robot and link.

The model uses `Permit` and `OdometryLink` of the host, and `VirtualBase` and `BaseLogic` of the
base robot. A move is one call of the base robot, which is also one cycle of the host. The base
robot's side is the product's code, from the received sample to the obedience token. The host makes
the calls of `ZenohBase` in their order. The host has no quality monitor and no limits. Instead, a
reason to stop may occur at any time. The guarantee does not need the monitor or the limits.

Assumptions:
- A link keeps the order of the samples of one publisher (TCP).
- The base robot reads the newest sample (RingChannel(1)).
- An ordinary delay is shorter than the watchdog of the base robot.
- If the base robot is not active, samples that were delayed for longer arrive together. `playback`
  drops this assumption: the link then delivers delayed samples at their original rate, or again.
- A base robot that is switched off stays off for longer than its watchdog.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from search import shift_permit, without_hold_ups

from freeflyer_adapters.base import ros_messages
from freeflyer_adapters.base.link import Counts, OdometryLink
from freeflyer_adapters.base.peer_clock import PeerClock
from freeflyer_adapters.base.rmw_zenoh import GID_BYTES, NO_PUBLISHER, Attachment
from freeflyer_adapters.device.device import LifeCycle
from freeflyer_adapters.device.permit import Permit
from freeflyer_adapters.facility.base_logic import MOST_USED, BaseLogic
from freeflyer_adapters.facility.settings import FacilitySettings
from freeflyer_adapters.facility.virtual_base import VirtualBase

CYCLE, PERIOD, NOW = 7_812_500, 2.0**-7, 26
"""Period of a call [ns, s], and the number of the present call.

The period is a power of two in seconds, to exclude rounding errors."""
WATCHDOG, PROOF, SILENCE = 2, 2, 4
"""Times in calls; the defaults of the first two are 20 ms.

A set point older than WATCHDOG is rejected. An activation needs set points for PROOF. A session
ends after SILENCE."""
RAMP = 2
"""Cycles of the graded stop."""
OLDEST = 5
"""Largest age of a sample [calls], more than two watchdogs.

Older samples add no case: the base robot measures only differences of delays."""
IGNORED = frozenset({
    "_environment", "options", "settings", "session", "_obedience", "_used", "counts", "_turns", "events", "refused", "steps", "step", "subject",
    "position", "orientation", "velocity", "jump", "_sequence",
})  # fmt: skip
"""Counters, constants, and `_used`, which is `logic.used`. All set points equal the pose."""
PUBLISHERS = (1, 2)
POSE = (np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
JUMP = (FacilitySettings().base_jump_m, FacilitySettings().base_jump_rad)
HOLDS_ONLY_WHEN_ACTIVE = True
"""Whether the graded stop sends set points only after a complete activation."""
REASON = "a reason to stop"
SCRATCH = {
    "position_setpoint": np.zeros(3),
    "orientation_setpoint": np.zeros(4),
    "velocity_setpoint": np.zeros(6),
}
PAYLOAD = bytes(ros_messages.OdometryWriter("I", "B").write(0, *POSE, np.zeros(6)))


Move = Callable[[Any], None]


def do(method: str, *arguments: Any, **keywords: Any) -> Move:
    """Return a move that calls one method of the model."""

    def move(world: Any) -> None:
        getattr(world, method)(*arguments, **keywords)

    return move


def then(*moves: Move) -> Move:
    """Return a move that executes several moves in order."""

    def move(world: Any) -> None:
        for one in moves:
            one(world)

    return move


class Options:
    """Used part of `LinkOptions`."""

    frame, child_frame, domain, setpoint_topic = "I", "B", 0, "setpoint"


class Clock:
    """Clock of the base robot at the present call."""

    @staticmethod
    def monotonic_ns() -> int:
        return NOW * CYCLE


@dataclass
class Token:
    """Liveliness token that records its withdrawal."""

    news: list[tuple[str, bool]]
    whom: str

    def undeclare(self) -> None:
        self.news.append((self.whom, False))


@dataclass
class Air:
    """Test double of a Zenoh session with liveliness tokens."""

    news: list[tuple[str, bool]] = field(default_factory=list)
    """Obedience tokens by publisher since the last call: declared (True) or withdrawn."""

    def liveliness(self) -> Air:
        return self

    def declare_token(self, key: str) -> Token:
        whom = key.rsplit("/", 1)[1]
        self.news.append((whom, True))
        return Token(self.news, whom)


def gid(publisher: int) -> bytes:
    return bytes([publisher]) * GID_BYTES


class BaseEnd(OdometryLink):
    """Base robot's end of the link, without Zenoh. `heard`: sample since the last call."""

    def __post_init__(self) -> None:
        self._environment: Any = Clock
        self._reported, self._obedience = "", None
        self.clock = PeerClock()
        self._source = self._last = None
        self._other_source, self._turns, self._is_sealed = b"", deque(maxlen=3), False
        self.heard: Attachment | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {
            name: value
            for name, value in vars(self).items()
            if name not in ("counts", "options", "session", "_turns", "_obedience")
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(
            state, counts=Counts(), options=Options, session=Air(), _turns=deque(maxlen=3)
        )
        told = self._reported
        self._obedience = self.session.declare_token("/" + told) if told else None
        self.session.news.clear()

    def take(self) -> tuple[bytes, bytes] | None:
        heard, self.heard = self.heard, None
        return None if heard is None else (PAYLOAD, heard.pack())


class StillLogic(BaseLogic):
    """BaseLogic whose copies omit constant attributes: all set points equal the pose."""

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name not in IGNORED}

    def __setstate__(self, state: dict[str, Any]) -> None:
        position, orientation = POSE
        constant = {
            "position": position,
            "orientation": orientation,
            "velocity": np.zeros(6),
            "jump": JUMP,
        }
        vars(self).update(state, **constant, events=[], refused=1)


class Base(VirtualBase):
    """Virtual base robot without dynamics and without faults."""

    def __init__(self, watchdog: int, proof: int) -> None:
        self.watchdog, self.proof = watchdog, proof
        self.period, self.options = PERIOD, Options  # type: ignore[assignment]
        self._used: deque[bytes] = deque(maxlen=MOST_USED)
        self._link: Any = BaseEnd(Air(), Options, "", "")  # type: ignore[arg-type]
        self.begin_session({})

    @property
    def settings(self) -> FacilitySettings:  # type: ignore[override]
        return FacilitySettings(
            base_watchdog_s=self.watchdog * PERIOD,
            forget_after_s=(self.watchdog + SILENCE) * PERIOD,
        )

    def _new_logic(self) -> BaseLogic:
        logic = super()._new_logic()
        logic.__class__ = StillLogic
        logic.proof = self.proof
        return logic

    def begin_faults(self, faults: Any, end: Any) -> None: ...

    def begin_session(self, parameters: Any) -> None:
        self.faults: Any = None
        super().begin_session({"true_position": POSE[0], "true_orientation": POSE[1]})

    def begin_cycle(self) -> bool:
        return True

    @property
    def _pose(self) -> Any:
        return POSE

    @_pose.setter
    def _pose(self, pose: Any) -> None: ...

    def call(self, sample: Attachment | None) -> None:
        """Execute one call with a sample. As in `Facility`, a new session follows an ended one."""
        self._link.heard = sample
        self.receive(SCRATCH)
        if self.logic.session_is_over:
            self.begin_session({})

    def shift(self, watchdog: int) -> None:
        """Move all times back by one call, and limit their age."""
        # Set points of the candidate for the next activation.
        logic, link, clock = self.logic, self._link, self._link.clock
        candidate, first, call, *came = tuple[Any, ...](logic._candidate)
        if candidate == logic.publisher:
            candidate = b""  # a new activation would start with new set points
        gaps = [NOW - min(logic._calls - last, watchdog + 1) for last in came]
        if candidate == b"":
            found: tuple[Any, ...] = (b"", 0.0, NOW, *([NOW] * len(came)))
        else:
            # Only the delay of the first stamp and the elapsed time up to PROOF matter.
            late = round(first / PERIOD) - call
            passed = min(logic._calls - call, logic.proof)
            found = (candidate, (NOW - passed + late) * PERIOD, NOW - passed, *gaps)
        logic._candidate = found
        # Times of the logic, of the link and of its clock.
        logic._accepted_at = NOW - min(logic._calls - logic._accepted_at, watchdog + SILENCE)
        if not logic.was_active:
            logic._accepted_at = NOW
        logic._calls = NOW
        logic.events.clear()
        if link._last is not None:
            last = max(link._last.sequence - 1, NOW - OLDEST - 1)
            stamp = max(link._last.stamp - CYCLE, (NOW - OLDEST - 1) * CYCLE)
            link._last = Attachment(last, stamp, link._last.gid)
        if clock._fastest is None:
            clock.reset()
        else:
            # The smallest delay decays too slowly to matter here.
            clock._fastest = round(clock._fastest / CYCLE) * CYCLE
            clock._delay = round(clock._delay / CYCLE) * CYCLE
            arrived = max(clock._arrived - CYCLE, (NOW - OLDEST - 1) * CYCLE)
            clock._stamp, clock._arrived = clock._stamp - clock._arrived + arrived, arrived


@dataclass
class Proof:
    """Set points of one publisher that may lead to an activation."""

    chains: set[tuple[int, int, int]] = field(default_factory=set)
    """Sequences of set points that arrive at the rate of their stamps.

    Delay of the first set point, time since the first and time since the last set point [calls]."""

    def add(self, late: int, watchdog: int) -> None:
        self.chains |= {
            (first, ago, 0) for first, ago, _ in self.chains if abs(late - first) <= watchdog
        } | {(late, 0, 0)}

    def shift(self, watchdog: int, proof: int) -> None:
        """Move the times back by one call. A gap longer than the watchdog ends a sequence."""
        self.chains = {
            (first, min(ago + 1, proof), last + 1)
            for first, ago, last in self.chains
            if last < watchdog
        }


class BaseAlone:
    """Base robot that receives a sample of any publisher and stamp, or none, in every call."""

    def __init__(self, watchdog: int = WATCHDOG, proof: int = PROOF) -> None:
        self.watchdog, self.proof = watchdog, proof
        self.base = Base(watchdog, proof)
        self.was_active: set[int] = set()
        self.had_sent: set[int] = set()
        """Publishers that have sent while another one was accepted."""
        self.accepted = 0
        self.proofs = {publisher: Proof() for publisher in PUBLISHERS}
        self.bad: str | None = None

    def moves(self) -> Iterator[tuple[str, Move]]:
        yield "no sample", do("call", None)
        for publisher, late in itertools.product(PUBLISHERS, range(self.watchdog + 2)):
            yield f"sample of {publisher}, {late} late", do("call", (publisher, late))
        yield "a sample again", do("call", (1, 0), again=True)

    def call(self, sample: tuple[int, int] | None, *, again: bool = False) -> None:
        base, logic = self.base, self.base.logic
        before = logic.life.now
        if sample is None:
            base.call(None)
        else:
            publisher, late = sample
            base.call(Attachment(NOW - again, (NOW - late) * CYCLE, gid(publisher)))
            if before is not LifeCycle.active:
                self.proofs[publisher].add(late, self.watchdog)
        is_active = logic.life.now is LifeCycle.active
        if is_active and before is not LifeCycle.active:
            self.bad = (
                "active without a sample" if sample is None else self._bad_activation(publisher)
            )
            self.accepted = publisher
        elif (
            is_active
            and sample is not None
            and logic._accepted_at == NOW
            and publisher != self.accepted
        ):
            self.bad = "a set point of another publisher was accepted"
        if is_active and sample is not None and publisher != self.accepted:
            self.had_sent.add(publisher)
        if self.accepted and not is_active:
            self.was_active.add(self.accepted)
            self.accepted = 0

    def _bad_activation(self, publisher: int) -> str | None:
        if publisher in self.was_active:
            return "active by an expired publisher"
        if publisher in self.had_sent:
            return "active by a publisher that had sent while another was accepted"
        if not any(
            ago >= self.proof and last == 0 for _, ago, last in self.proofs[publisher].chains
        ):
            return "active without set points for long enough at the rate of their stamps"
        return None

    def normalise(self) -> None:
        self.base.shift(self.watchdog)
        is_active = self.base.logic.life.now is LifeCycle.active
        for publisher, proof in self.proofs.items():
            used = publisher in self.was_active | self.had_sent | {self.accepted}
            if used or is_active:
                proof.chains.clear()
            proof.shift(self.watchdog, self.proof)

    def violation(self) -> str | None:
        return self.bad


class Host:
    """One run of the controllers, with its own publisher.

    `base`: number of the base robot whose measurements the run uses; `reports`: whether the base
    robot reports which publisher it accepts.
    """

    def __init__(self, run: int, base: int, *, watchdog: int, reports: bool) -> None:
        self.run, self.base, self.reports = run, base, reports
        self.permit = Permit("base", watchdog=watchdog * CYCLE, reports_state=False)
        self.stage = "preparing"
        self.publishes = self.is_active = self.was_accepted = self.has_sent = False
        self.stopping = 0
        self.measured = False
        """Whether a measurement is pending in the ring channel."""
        self.news: list[bool] = []
        self.late_news: list[bool] = []
        """Obedience tokens that are still in transit."""
        self.is_held_up = False
        self.held_up = 0
        """Calls since the process was suspended."""
        self.stops_after_check = False
        self.checked: int | None = None
        """Calls since the last check of a set point that is not yet sent (suspended process)."""

    def _take(self) -> bool:
        """Corresponds to `ZenohBase._take`."""
        has_received, self.measured = self.measured, False
        if has_received:
            self.permit.report(True, NOW * CYCLE)
        return has_received

    def _obedience(self) -> bool | None:
        """Corresponds to `OdometryLink.obedience`."""
        return self.news.pop(0) if self.news else None

    def _publish(self) -> bool:
        """Return whether a set point is sent. Corresponds to `ZenohBase._publish`."""
        now = NOW * CYCLE
        if not (self.permit.allows(now) or self.permit.may_ramp_down(now)):
            return False
        if self.stops_after_check:
            self.stops_after_check, self.checked = False, 0
            return False
        self.permit.wrote(now)
        self.has_sent = True
        return self.publishes

    def stop(self) -> None:
        """Corresponds to `graded_stop.stop` and `ZenohBase.revoke`."""
        self.permit.allows(NOW * CYCLE)
        self.permit.lose(REASON)
        if self.permit.was_held_up:
            self.publishes = False
        self.stage = "stopping" if self.has_sent else "over"  # see `ZenohBase.may_have_power`

    def cycle(self) -> bool:
        """Execute one cycle of the loop. Return whether a set point is sent."""
        now, permit = NOW * CYCLE, self.permit
        if self.stage == "over":
            return False
        if self.stage == "preparing":  # see `ZenohBase.activate`
            if not self._take():
                return False
            self.publishes = True
            permit.take(now)
            self.stage = "activating"
        if self.stage == "activating":  # see `ZenohBase._take_command`
            is_sent = self._publish()
            if not self.reports or self._obedience():
                self.stage, self.is_active, self.was_accepted = "running", True, self.reports
                return self._publish() or is_sent
            if permit.lost:
                self.stop()
            self._take()
            return is_sent
        if self.stage == "running":  # see `ZenohBase.read` and `write`
            permit.allows(now)
            if not permit.was_held_up:
                self._take()
                if self._obedience() is False:
                    permit.report(False, 0)
                elif permit.allows(now):
                    return self._publish()
            self.stop()
            return False
        # Stage "stopping": see `ZenohBase.ramp_down`.
        self._take()
        self.stopping += 1
        if self.stopping > RAMP:
            self.stage = "over"
            return False
        return (self.is_active or not HOLDS_ONLY_WHEN_ACTIVE) and self._publish()

    def shift(self, watchdog: int) -> None:
        permit, oldest = self.permit, (NOW - watchdog - 1) * CYCLE
        shift_permit(permit, CYCLE, oldest)
        self.checked = None if self.checked is None else min(self.checked + 1, OLDEST + 1)
        self.held_up = (
            min(self.held_up + 1, 2 * watchdog + 1) if self.is_held_up and not permit.lost else 0
        )


@dataclass
class Transit:
    """Samples of one publisher in transit: `queue` has their ages [calls], oldest first."""

    queue: list[int] = field(default_factory=list)
    arrived: int | None = None
    """Age of the last sample that arrived, which may be repeated."""
    stopped: int | None = None
    """Calls since the first reason to stop of the run."""
    is_over: bool = False


@dataclass
class Whole:
    """Complete model.

    `limit`: largest age [calls] of a set point that may activate the base robot after the stop of
    its run.
    """

    watchdog: int = WATCHDOG
    proof: int = PROOF
    limit: int = WATCHDOG
    reports: bool = True
    """Whether the base robot reports which publisher it accepts."""
    playback: bool = False
    """Whether the link delivers delayed samples one by one, or again, at any time."""
    base_restarts: bool = True
    hold_ups: bool = True
    """Whether the host's process is suspended and resumed."""
    stops_after_check: bool = False
    """Whether the host's process may be suspended between its last check and the sample."""
    queue: int = 2
    starts: int = 1
    base: Any = None
    bases: int = 1
    off: int = 0
    hosts: list[Host] = field(default_factory=list)
    transits: dict[int, Transit] = field(default_factory=dict)
    news: list[tuple[str, bool]] = field(default_factory=list)
    activated: set[int] = field(default_factory=set)
    quickest: int = OLDEST
    """Smallest age of an accepted set point in this activation."""
    bad: str | None = None

    def __post_init__(self) -> None:
        self.base = Base(self.watchdog, self.proof)

    def moves(self) -> Iterator[tuple[str, Move]]:
        for run, transit in sorted(self.transits.items()):
            yield f"samples of run {run} arrive", do("call", run)
            if len(transit.queue) > 1:
                yield f"the oldest sample of run {run} arrives", do("call", run, only_oldest=True)
            if transit.arrived is not None:
                yield f"a sample of run {run} is repeated", do("call", again=run)
        yield "samples are delayed", do("call")
        yield "samples are lost", do("call", lost=True)
        # A run that detects the publisher of another run does not start.
        if self.starts and not self.hosts:
            yield "a run starts", then(do("start"), do("call"))
        if self.base_restarts and not self.off and self.bases == 1:
            yield "the base restarts", then(do("restart"), do("call"))
        for i, host in enumerate(self.hosts):
            run, call = host.run, do("call", host.run)
            yield f"run {run} gets no measurement", do("call", run, measured=False, reported=False)
            yield f"run {run} gets a late report", do("call", run, reported=False)
            if host.is_held_up:
                yield f"run {run} resumes", do("go_on", i, stamped=False)
                if host.checked is not None:
                    yield (
                        f"run {run} resumes after its reading of the clock",
                        do("go_on", i, stamped=True),
                    )
            elif self.hold_ups:
                yield f"run {run} is suspended", then(do("hold_up", i), call)
                if self.stops_after_check:
                    yield (
                        f"run {run} is suspended after its check",
                        then(do("hold_up_after_check", i), call),
                    )
            if not host.is_held_up and host.stage in ("activating", "running"):
                yield f"run {run} has a reason to stop", then(do("stop", i), call)
            yield f"run {run} is killed", then(do("kill", i), call)

    def start(self) -> None:
        self.starts -= 1
        run = len(self.transits) + 1
        self.transits[run] = Transit()
        self.hosts.append(Host(run, self.bases, watchdog=self.watchdog, reports=self.reports))

    def stop(self, i: int) -> None:
        self.hosts[i].stop()

    def kill(self, i: int) -> None:
        self._stopped(self.hosts.pop(i).run)

    def hold_up(self, i: int) -> None:
        self.hosts[i].is_held_up = True

    def hold_up_after_check(self, i: int) -> None:
        host = self.hosts[i]
        host.stops_after_check = True
        if host.cycle():
            self.transits[host.run].queue.append(0)
        host.stops_after_check, host.is_held_up = False, True

    def go_on(self, i: int, *, stamped: bool) -> None:
        """Resume the process. `stamped`: the pending sample already has its time stamp."""
        host = self.hosts[i]
        if host.checked is not None:
            host.permit.wrote((NOW - host.checked) * CYCLE)
            if host.publishes:
                self._put(host, host.checked if stamped else 0)
            self.call(run=host.run)
            host.checked = None
            host.is_held_up = False
        else:
            host.is_held_up = False
            self.call(run=host.run)

    def restart(self) -> None:
        """Switch the base robot off and on.

        The base robot loses the expired publishers, and gets a new publisher.
        """
        whom = self.base._link._reported
        if whom not in ("", NO_PUBLISHER):
            self.news.append((whom, False))
        self.base = Base(self.watchdog, self.proof)
        self.bases += 1
        self.off = self.watchdog + 1
        # A run without a report of the base robot is still in its first activation.
        self.activated -= {
            host.run for host in self.hosts if host.stage in ("preparing", "activating")
        }

    def _stopped(self, run: int) -> None:
        transit = self.transits[run]
        transit.stopped = 0 if transit.stopped is None else transit.stopped

    def _put(self, host: Host, age: int) -> None:
        if self.reports and not (host.permit.is_held or host.was_accepted):
            self.bad = "a set point was sent without a permit and without a report of the base"
        queue = self.transits[host.run].queue
        if age == 0 and queue and queue[-1] == 0:
            return
        queue.append(age)
        del queue[1 : -self.queue + 1]

    def call(
        self,
        run: int | None = None,
        *,
        only_oldest: bool = False,
        again: int | None = None,
        lost: bool = False,
        measured: bool = True,
        reported: bool = True,
    ) -> None:
        """Execute one cycle of the hosts and one call of the base robot.

        `run`: run whose samples arrive; `only_oldest`: only its oldest sample arrives; `again`: run
        whose last sample is repeated; `lost`: new samples are lost; `measured`, `reported`: whether
        the hosts get the measurement and the obedience tokens.
        """
        # The hosts send.
        for host in self.hosts:
            if host.is_held_up:
                # A process that is suspended after its check sends its set point later. Within
                # twice the watchdog, the base robot cannot distinguish this from a delay.
                longest = self.watchdog * (1 if host.checked is None else 2)
                if host.held_up > longest and host.stage != "preparing":
                    self._stopped(host.run)
                continue
            is_sent = host.cycle()
            if host.permit.lost or host.stage in ("stopping", "over"):
                self._stopped(host.run)
            if is_sent:
                self._put(host, 0)
        for host in self.hosts:
            self.transits[host.run].is_over = host.stage == "over"
        self.hosts = [host for host in self.hosts if host.stage != "over"]
        # The base robot receives a sample, and reports.
        sample = self._sample(run, only_oldest, again, lost)
        if self.off:
            self.off -= 1
        else:
            self._base_called(sample)
        self._report(measured, reported)

    def _sample(
        self, run: int | None, only_oldest: bool, again: int | None, lost: bool
    ) -> tuple[int, int] | None:
        """Return run and age of the sample that the base robot receives, or None."""
        if lost:
            for transit in self.transits.values():
                transit.queue = [age for age in transit.queue if age]
            return None
        if again is not None:
            age = self.transits[again].arrived
            return None if age is None else (again, age)
        if run is None or self.off:
            return None
        transit = self.transits[run]
        if not transit.queue:
            return None
        arrived = transit.queue[:1] if only_oldest else transit.queue
        transit.queue = transit.queue[len(arrived) :]
        transit.arrived = arrived[-1]
        return run, transit.arrived

    def _base_called(self, sample: tuple[int, int] | None) -> None:
        """Call the base robot with a sample, and check the result."""
        base, logic = self.base, self.base.logic
        before, accepted = logic.life.now, logic.publisher
        attachment = None
        if sample is not None:
            run, age = sample
            attachment = Attachment(NOW - age, (NOW - age) * CYCLE, gid(run))
        base.call(attachment)
        is_active = logic.life.now is LifeCycle.active
        if is_active and sample is not None and logic._accepted_at == NOW:
            if before is not LifeCycle.active:
                self.bad = self._bad_activation(run, age)
                self.activated.add(run)
                self.quickest = age
            elif gid(run) != accepted:
                self.bad = "a set point of another publisher was accepted"
            else:
                self.quickest = min(self.quickest, age)
                if age > self.quickest + self.watchdog:
                    self.bad = "a set point older than the watchdog was accepted"
        elif is_active and before is not LifeCycle.active:
            self.bad = "active without a set point"

    def _bad_activation(self, run: int, age: int) -> str | None:
        stopped = self.transits[run].stopped
        if run in self.activated:
            return f"run {run} has activated the base robot twice"
        if stopped is None:
            return None
        if age <= stopped:
            return f"run {run} has activated the base robot with a set point from after its stop"
        if age > self.limit:
            return f"run {run} has activated the base robot after its stop, with a set point {age} calls old"
        return None

    def _report(self, measured: bool, reported: bool) -> None:
        """Deliver measurement and obedience tokens of the base robot to the hosts."""
        air = self.base._link.session.news
        self.news += air
        air.clear()
        for publisher, is_accepted in self.news:
            for host in self.hosts:
                if self.reports and publisher == gid(host.run).hex():
                    host.late_news = [*host.late_news, is_accepted]
        self.news = []
        for host in self.hosts:
            if not self.off and measured and host.base == self.bases:
                host.measured = True
            if reported:
                host.news, host.late_news = [*host.news, *host.late_news], []

    def normalise(self) -> None:
        self.base.shift(self.watchdog)
        if self.base.logic.life.now is not LifeCycle.active:
            self.quickest = OLDEST
        for host in self.hosts:
            host.shift(self.watchdog)
        for run, transit in self.transits.items():
            transit.queue = [age + 1 for age in transit.queue if age < OLDEST]
            # Samples that arrive together: the base robot reads the newest one only.
            arrive_together = not self.playback and gid(run) != self.base.logic.publisher
            if arrive_together and len(transit.queue) > 1 and transit.queue[0] >= self.watchdog:
                del transit.queue[0]
            if transit.arrived is not None:
                transit.arrived = (
                    transit.arrived + 1
                    if transit.arrived + 1 < (OLDEST if self.playback else self.watchdog)
                    else None
                )
            if transit.stopped is not None:
                transit.stopped = min(transit.stopped + 1, OLDEST)
                if transit.arrived is None and (
                    not transit.queue or transit.queue[0] <= transit.stopped
                ):
                    transit.stopped = OLDEST  # no sample from before the stop is in transit

    def violation(self) -> str | None:
        return self.bad


NO_RESTART: dict[str, Any] = {"base_restarts": False}
WORLDS: dict[str, Callable[[], Any]] = {
    "the base robot's lock alone, any samples": BaseAlone,
    "one run, a base robot that restarts": Whole,
    "two runs": lambda: Whole(starts=2, **NO_RESTART),
    "one run, a link that becomes slow": lambda: Whole(queue=3, hold_ups=False, **NO_RESTART),
    "one run, a process that is suspended after its check": lambda: Whole(
        stops_after_check=True, **NO_RESTART
    ),
}
NOT_GUARANTEED: dict[str, Callable[[], Any]] = {
    "a link that plays delayed samples back": lambda: Whole(playback=True, **NO_RESTART),
    "a base robot that does not report which publisher it accepts": lambda: Whole(
        reports=False, **NO_RESTART
    ),
}
"""Models without one assumption, in which the search finds a violation."""
Patch = Callable[[pytest.MonkeyPatch], None]


def _expired_are_accepted(patch: pytest.MonkeyPatch) -> None:
    is_activated = BaseLogic._is_activated

    def without_used(self: BaseLogic, *arguments: Any) -> bool | None:
        used, self.used = self.used, deque()
        activated = is_activated(self, *arguments)
        used.extend(self.used)
        self.used = used
        return activated

    patch.setattr(BaseLogic, "_is_activated", without_used)


def _expired_end_with_the_session(patch: pytest.MonkeyPatch) -> None:
    new_logic = Base._new_logic

    def without_used(self: Base) -> BaseLogic:
        logic = new_logic(self)
        logic.used = deque()
        return logic

    patch.setattr(Base, "_new_logic", without_used)


def _stamps_do_not_count(patch: pytest.MonkeyPatch) -> None:
    comes_in_time = BaseLogic._comes_in_time

    def ignores(self: BaseLogic, publisher: bytes, stamp: float) -> bool:
        candidate, first, call, *_ = self._candidate
        agrees = first + (self._calls - call) * self.period
        return comes_in_time(self, publisher, agrees if candidate == publisher else stamp)

    patch.setattr(BaseLogic, "_comes_in_time", ignores)


def _every_publisher_is_accepted(patch: pytest.MonkeyPatch) -> None:
    """Remove two guards: the link accepts one source, and the logic checks the publisher again."""
    receive, take = OdometryLink.receive, BaseLogic.take

    def receives(self: OdometryLink, judge: Any) -> Any:
        source, self._source = self._source, None
        received = receive(self, judge)
        self._source = self._source or source
        return received

    def takes(
        self: BaseLogic,
        position: Any,
        orientation: Any,
        velocity: Any,
        pose: Any,
        publisher: bytes,
        *others: Any,
    ) -> Any:
        accepted = self.publisher if self.life.now is LifeCycle.active else publisher
        return take(self, position, orientation, velocity, pose, accepted, *others)

    patch.setattr(OdometryLink, "receive", receives)
    patch.setattr(BaseLogic, "take", takes)


def _no_reason_to_stop(patch: pytest.MonkeyPatch) -> None:
    lose = Permit.lose
    patch.setattr(
        Permit, "lose", lambda permit, reason: None if reason == REASON else lose(permit, reason)
    )


ALONE, ONE, _, SLOW, CHECK = WORLDS.values()
GUARDS: dict[str, tuple[Callable[[], Any], Patch]] = {
    "an expired publisher is not accepted again": (ALONE, _expired_are_accepted),
    "expired publishers stay expired in the next session": (ALONE, _expired_end_with_the_session),
    "a publisher that sent while another was accepted is rejected": (
        ALONE,
        lambda patch: patch.setattr(BaseLogic, "refuse", lambda logic, publisher: None),
    ),
    "an activation needs set points for some time": (
        ALONE,
        lambda patch: patch.setattr(
            BaseLogic, "_comes_in_time", lambda logic, publisher, stamp: True
        ),
    ),
    "set points must arrive at the rate of their stamps": (ALONE, _stamps_do_not_count),
    "only one publisher is accepted": (ALONE, _every_publisher_is_accepted),
    "a late set point is not accepted": (
        SLOW,
        lambda patch: patch.setattr(PeerClock, "delay", lambda clock, stamp, arrived: 0),
    ),
    "a delay of the loop ends the permit": (CHECK, without_hold_ups),
    "the first reason to stop ends the permit": (ONE, _no_reason_to_stop),
    "the graded stop needs recent measurements": (
        ONE,
        lambda patch: patch.setattr(Permit, "may_ramp_down", lambda permit, now: True),
    ),
    "the graded stop sends set points only after a complete activation": (
        SLOW,
        lambda patch: patch.setattr(f"{__name__}.HOLDS_ONLY_WHEN_ACTIVE", False),
    ),
}
"""Guard -> model that needs it, and a patch that removes it."""
