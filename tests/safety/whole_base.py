"""Controllers, base robot and the link between them: the host's `Permit`, the base robot's `VirtualBase` and `BaseLogic`, and its `OdometryLink`.

A move is one call of the base robot, which is a cycle of the host, too. The base robot's end is the product's own from the sample to
the word whom it obeys. What the host does in a cycle is the calls that `ZenohBase` makes, in their order. It has no quality monitor and
no limits: a reason to stop may come at any time, and is not needed for the promise.

Premises. A link keeps one publisher's samples in their order (TCP), and the base robot looks at the freshest (RingChannel(1)). An
ordinary delay is shorter than the base robot's watchdog. What is held up for longer comes at once, but where the base robot is active
already; `playback` drops this premise: the link then gives back what it held up as slowly as it was sent, or once more. A base robot that is switched off is away for longer than its watchdog.
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
from freeflyer_adapters.base.rmw_zenoh import GID_BYTES, NOBODY, Attachment
from freeflyer_adapters.device.device import LifeCycle
from freeflyer_adapters.device.permit import Permit
from freeflyer_adapters.facility.base_logic import MOST_USED, BaseLogic
from freeflyer_adapters.facility.settings import FacilitySettings
from freeflyer_adapters.facility.virtual_base import VirtualBase

CYCLE, PERIOD, NOW = 7_812_500, 2.0**-7, 26
"""[ns, s] of a call: a number of nanoseconds that is a power of two in seconds, so that nothing is decided by rounding. The call now."""
WATCHDOG, PROOF, SILENCE = 2, 2, 4
"""Calls. By default both are 20 ms: a set point that is late by the watchdog is refused, and set points must have come for so long."""
RAMP = 2
"""Cycles of the graded stop."""
OLDEST = 5
"""Calls, more than two watchdogs. Older samples are left out: a base robot knows delays by their differences only, and these are all there."""
IGNORED = frozenset({
    "_environment", "options", "settings", "session", "_obedience", "_used", "counts", "_turns", "events", "refused", "steps", "step", "subject",
    "position", "orientation", "velocity", "jump", "_sequence",
})  # fmt: skip
"""Counters, constants, and `_used`, which is `logic.used`; set points are where the robot is in all samples."""
PUBLISHERS = (1, 2)
POSE = (np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
JUMP = (FacilitySettings().base_jump_m, FacilitySettings().base_jump_rad)
HOLDS_ONLY_WHEN_ACTIVE = True
"""Whether the graded stop's set points are for an activation that was through (`ZenohBase.ramp_down`)."""
REASON = "a reason to stop"
SCRATCH = {
    "position_setpoint": np.zeros(3),
    "orientation_setpoint": np.zeros(4),
    "velocity_setpoint": np.zeros(6),
}
PAYLOAD = bytes(ros_messages.OdometryWriter("I", "B").write(0, *POSE, np.zeros(6)))


Move = Callable[[Any], None]


def do(method: str, *arguments: Any, **keywords: Any) -> Move:
    """A move that is one call."""

    def move(world: Any) -> None:
        getattr(world, method)(*arguments, **keywords)

    return move


def then(*moves: Move) -> Move:
    def move(world: Any) -> None:
        for one in moves:
            one(world)

    return move


class Options:
    """What of `LinkOptions` is read."""

    frame, child_frame, domain, setpoint_topic = "I", "B", 0, "setpoint"


class Clock:
    """The base robot's clock stands at the call now."""

    @staticmethod
    def monotonic_ns() -> int:
        return NOW * CYCLE


@dataclass
class Token:
    news: list[tuple[str, bool]]
    whom: str

    def undeclare(self) -> None:
        self.news.append((self.whom, False))


@dataclass
class Air:
    """Of a Zenoh session: its liveliness tokens."""

    news: list[tuple[str, bool]] = field(default_factory=list)
    """Whom the base robot obeys (True), or ceased to obey, since the last call."""

    def liveliness(self) -> Air:
        return self

    def declare_token(self, key: str) -> Token:
        whom = key.rsplit("/", 1)[1]
        self.news.append((whom, True))
        return Token(self.news, whom)


def gid(publisher: int) -> bytes:
    return bytes([publisher]) * GID_BYTES


class Ear(OdometryLink):
    """The base robot's end of the link without Zenoh: `heard` is what came since the last call."""

    def __post_init__(self) -> None:
        self._environment: Any = Clock
        self._told, self._obedience = "", None
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
        told = self._told
        self._obedience = self.session.declare_token("/" + told) if told else None
        self.session.news.clear()

    def take(self) -> tuple[bytes, bytes] | None:
        heard, self.heard = self.heard, None
        return None if heard is None else (PAYLOAD, heard.pack())


class StillLogic(BaseLogic):
    """Copied without what never changes here: all set points are where the robot is."""

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
    """The virtual base robot without a model and without faults: `receive` is one of its calls."""

    def __init__(self, watchdog: int, proof: int) -> None:
        self.watchdog, self.proof = watchdog, proof
        self.period, self.options = PERIOD, Options  # type: ignore[assignment]
        self._used: deque[bytes] = deque(maxlen=MOST_USED)
        self._link: Any = Ear(Air(), Options, "", "")  # type: ignore[arg-type]
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
        """See `Facility`: a session that is over is followed by the next."""
        self._link.heard = sample
        self.receive(SCRATCH)
        if self.logic.session_is_over:
            self.begin_session({})

    def shift(self, watchdog: int) -> None:
        """The next call: all times are brought back by one, and those that are long ago to the limit."""
        logic, link, clock = self.logic, self._link, self._link.clock
        candidate, first, call, *came = tuple[Any, ...](logic._candidate)
        if candidate == logic.publisher:
            candidate = b""  # its set points begin anew if it is obeyed again
        gaps = [NOW - min(logic._calls - last, watchdog + 1) for last in came]
        if candidate == b"":
            found: tuple[Any, ...] = (b"", 0.0, NOW, *([NOW] * len(came)))
        else:
            # Only how far the stamp was behind the call matters, and whether it was long enough ago.
            late = round(first / PERIOD) - call
            passed = min(logic._calls - call, logic.proof)
            found = (candidate, (NOW - passed + late) * PERIOD, NOW - passed, *gaps)
        logic._candidate = found
        logic._heard = NOW - min(logic._calls - logic._heard, watchdog + SILENCE)
        if not logic.was_active:
            logic._heard = NOW
        logic._calls = NOW
        logic.events.clear()
        if link._last is not None:
            last = max(link._last.sequence - 1, NOW - OLDEST - 1)
            stamp = max(link._last.stamp - CYCLE, (NOW - OLDEST - 1) * CYCLE)
            link._last = Attachment(last, stamp, link._last.gid)
        if clock._quickest is None:
            clock.forget()
        else:
            # What is quick is forgotten so slowly that it plays no part here.
            clock._quickest = round(clock._quickest / CYCLE) * CYCLE
            clock._delay = round(clock._delay / CYCLE) * CYCLE
            arrived = max(clock._arrived - CYCLE, (NOW - OLDEST - 1) * CYCLE)
            clock._stamp, clock._arrived = clock._stamp - clock._arrived + arrived, arrived


@dataclass
class Proof:
    """One publisher's set points, as far as they prove that it is there."""

    chains: set[tuple[int, int, int]] = field(default_factory=set)
    """Set points that come as their stamps advance: how late the first was, how long ago it and the last one came [calls]."""

    def add(self, late: int, watchdog: int) -> None:
        self.chains |= {
            (first, ago, 0) for first, ago, _ in self.chains if abs(late - first) <= watchdog
        } | {(late, 0, 0)}

    def shift(self, watchdog: int, proof: int) -> None:
        """A call later; a chain is broken by a gap that is longer than the watchdog."""
        self.chains = {
            (first, min(ago + 1, proof), last + 1)
            for first, ago, last in self.chains
            if last < watchdog
        }


class BaseAlone:
    """The base robot's own lock: in every call one sample of any publisher and stamp, or none."""

    def __init__(self, watchdog: int = WATCHDOG, proof: int = PROOF) -> None:
        self.watchdog, self.proof = watchdog, proof
        self.base = Base(watchdog, proof)
        self.was_active: set[int] = set()
        self.had_sent: set[int] = set()
        """Sent while another publisher was obeyed."""
        self.obeyed = 0
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
            self.obeyed = publisher
        elif is_active and sample is not None and logic._heard == NOW and publisher != self.obeyed:
            self.bad = "a set point of another publisher was followed"
        if is_active and sample is not None and publisher != self.obeyed:
            self.had_sent.add(publisher)
        if self.obeyed and not is_active:
            self.was_active.add(self.obeyed)
            self.obeyed = 0

    def _bad_activation(self, publisher: int) -> str | None:
        if publisher in self.was_active:
            return "active by a publisher that was used up"
        if publisher in self.had_sent:
            return "active by a publisher that had sent while another was obeyed"
        if not any(
            ago >= self.proof and last == 0 for _, ago, last in self.proofs[publisher].chains
        ):
            return "active by set points that had not come for long enough as their stamps advance"
        return None

    def normalise(self) -> None:
        self.base.shift(self.watchdog)
        is_active = self.base.logic.life.now is LifeCycle.active
        for publisher, proof in self.proofs.items():
            used = publisher in self.was_active | self.had_sent | {self.obeyed}
            if used or is_active:
                proof.chains.clear()
            proof.shift(self.watchdog, self.proof)

    def violation(self) -> str | None:
        return self.bad


class Host:
    """One run of the controllers, with a publisher of its own."""

    def __init__(self, run: int, base: int, *, watchdog: int, tells: bool) -> None:
        self.run, self.base, self.tells = run, base, tells
        """`base`: the base robot whose measurements it uses, the first that it receives."""
        self.permit = Permit("base", watchdog=watchdog * CYCLE, reports_state=False)
        self.stage = "preparing"
        self.publishes = self.is_active = self.was_obeyed = self.has_sent = False
        self.stopping = 0
        self.measured = False
        """A measurement waits in the ring of one."""
        self.news: list[bool] = []
        self.late_news: list[bool] = []
        """What the base robot has told, and is still on its way."""
        self.is_held_up = False
        self.held_up = 0
        """Calls that the process has been held up for."""
        self.stops_at_look = False
        self.looked: int | None = None
        """A set point was allowed so many calls ago, and has not gone out yet: the process was held up between."""

    def _take(self) -> bool:
        """See `ZenohBase._take`."""
        came, self.measured = self.measured, False
        if came:
            self.permit.report(True, NOW * CYCLE)
        return came

    def _obedience(self) -> bool | None:
        """See `OdometryLink.obedience`."""
        return self.news.pop(0) if self.news else None

    def _publish(self) -> bool:
        """See `ZenohBase._publish`; whether a set point goes out."""
        now = NOW * CYCLE
        if not (self.permit.allows(now) or self.permit.may_ramp_down(now)):
            return False
        if self.stops_at_look:
            self.stops_at_look, self.looked = False, 0
            return False
        self.permit.wrote(now)
        self.has_sent = True
        return self.publishes

    def stop(self) -> None:
        """See `graded_stop.stop` and `ZenohBase.revoke`."""
        self.permit.allows(NOW * CYCLE)
        self.permit.lose(REASON)
        if self.permit.was_held_up:
            self.publishes = False
        self.stage = "stopping" if self.has_sent else "over"  # see `ZenohBase.may_have_power`

    def cycle(self) -> bool:
        """What the loop does in one of its cycles; whether a set point goes out."""
        now, permit = NOW * CYCLE, self.permit
        if self.stage == "over":
            return False
        if self.stage == "preparing":  # see `ZenohBase.activate`
            if not self._take():
                return False
            self.publishes = True
            permit.take(now)
            self.stage = "asking"
        if self.stage == "asking":  # see `ZenohBase._be_obeyed`
            goes_out = self._publish()
            if not self.tells or self._obedience():
                self.stage, self.is_active, self.was_obeyed = "running", True, self.tells
                return self._publish() or goes_out
            if permit.lost:
                self.stop()
            self._take()
            return goes_out
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
        # See `ZenohBase.ramp_down`.
        self._take()
        self.stopping += 1
        if self.stopping > RAMP:
            self.stage = "over"
            return False
        return (self.is_active or not HOLDS_ONLY_WHEN_ACTIVE) and self._publish()

    def shift(self, watchdog: int) -> None:
        permit, oldest = self.permit, (NOW - watchdog - 1) * CYCLE
        shift_permit(permit, CYCLE, oldest)
        self.looked = None if self.looked is None else min(self.looked + 1, OLDEST + 1)
        self.held_up = (
            min(self.held_up + 1, 2 * watchdog + 1) if self.is_held_up and not permit.lost else 0
        )


@dataclass
class Way:
    """One publisher's samples on their way, by their ages [calls], oldest first."""

    queue: list[int] = field(default_factory=list)
    came: int | None = None
    """The last one that came, which may come again."""
    stopped: int | None = None
    """Calls since the run's first reason to stop."""
    is_over: bool = False


@dataclass
class Whole:
    """`limit`: how old [calls] a set point may be that activates the base robot after its run's stop."""

    watchdog: int = WATCHDOG
    proof: int = PROOF
    limit: int = WATCHDOG
    tells: bool = True
    """Whether the base robot reports whom it obeys."""
    playback: bool = False
    """Whether a link gives back what it has held up, or sends it again, at any time."""
    base_restarts: bool = True
    hold_ups: bool = True
    """Whether the host's process is stopped and continued."""
    stops_at_look: bool = False
    """Whether the host's process may be stopped between its last look and the sample."""
    queue: int = 2
    starts: int = 1
    base: Any = None
    bases: int = 1
    off: int = 0
    hosts: list[Host] = field(default_factory=list)
    ways: dict[int, Way] = field(default_factory=dict)
    news: list[tuple[str, bool]] = field(default_factory=list)
    activated: set[int] = field(default_factory=set)
    quickest: int = OLDEST
    """The least age of a set point that was followed in this activation."""
    bad: str | None = None

    def __post_init__(self) -> None:
        self.base = Base(self.watchdog, self.proof)

    def moves(self) -> Iterator[tuple[str, Move]]:
        for run, way in sorted(self.ways.items()):
            yield f"samples of run {run} come", do("call", run)
            if len(way.queue) > 1:
                yield f"the oldest sample of run {run} comes", do("call", run, only_oldest=True)
            if way.came is not None:
                yield f"a sample of run {run} comes again", do("call", again=run)
        yield "samples are held up", do("call")
        yield "samples are lost", do("call", lost=True)
        if (
            self.starts and not self.hosts
        ):  # another one's publisher is announced, and the run refused
            yield "a run starts", then(do("start"), do("call"))
        if self.base_restarts and not self.off and self.bases == 1:
            yield "the base restarts", then(do("restart"), do("call"))
        for i, host in enumerate(self.hosts):
            run, call = host.run, do("call", host.run)
            yield f"run {run} gets no measurement", do("call", run, measured=False, told=False)
            yield f"run {run} is told late", do("call", run, told=False)
            if host.is_held_up:
                yield f"run {run} goes on", do("go_on", i, stamped=False)
                if host.looked is not None:
                    yield (
                        f"run {run} goes on after its look at the clock",
                        do("go_on", i, stamped=True),
                    )
            elif self.hold_ups:
                yield f"run {run} is held up", then(do("hold_up", i), call)
                if self.stops_at_look:
                    yield (
                        f"run {run} is held up after its look",
                        then(do("hold_up_at_look", i), call),
                    )
            if not host.is_held_up and host.stage in ("asking", "running"):
                yield f"run {run} has a reason to stop", then(do("stop", i), call)
            yield f"run {run} is killed", then(do("kill", i), call)

    def start(self) -> None:
        self.starts -= 1
        run = len(self.ways) + 1
        self.ways[run] = Way()
        self.hosts.append(Host(run, self.bases, watchdog=self.watchdog, tells=self.tells))

    def stop(self, i: int) -> None:
        self.hosts[i].stop()

    def kill(self, i: int) -> None:
        self._stopped(self.hosts.pop(i).run)

    def hold_up(self, i: int) -> None:
        self.hosts[i].is_held_up = True

    def hold_up_at_look(self, i: int) -> None:
        host = self.hosts[i]
        host.stops_at_look = True
        if host.cycle():
            self.ways[host.run].queue.append(0)
        host.stops_at_look, host.is_held_up = False, True

    def go_on(self, i: int, *, stamped: bool) -> None:
        """`stamped`: the sample that waits to go out had its stamp already."""
        host = self.hosts[i]
        if host.looked is not None:
            host.permit.wrote((NOW - host.looked) * CYCLE)
            if host.publishes:
                self._put(host, host.looked if stamped else 0)
            self.call(come=host.run)
            host.looked = None
            host.is_held_up = False
        else:
            host.is_held_up = False
            self.call(come=host.run)

    def restart(self) -> None:
        """Power off and on: what it knew of used publishers is lost, and its own publisher is another."""
        whom = self.base._link._told
        if whom not in ("", NOBODY):
            self.news.append((whom, False))
        self.base = Base(self.watchdog, self.proof)
        self.bases += 1
        self.off = self.watchdog + 1
        # A run whose base robot was not yet seen to obey is still in its one activation.
        self.activated -= {host.run for host in self.hosts if host.stage in ("preparing", "asking")}

    def _stopped(self, run: int) -> None:
        way = self.ways[run]
        way.stopped = 0 if way.stopped is None else way.stopped

    def _put(self, host: Host, age: int) -> None:
        if self.tells and not (host.permit.is_held or host.was_obeyed):
            self.bad = (
                "a set point was sent without a permit to a base robot that was not known to obey"
            )
        queue = self.ways[host.run].queue
        if age == 0 and queue and queue[-1] == 0:
            return
        queue.append(age)
        del queue[1 : -self.queue + 1]

    def call(
        self,
        come: int | None = None,
        *,
        only_oldest: bool = False,
        again: int | None = None,
        lost: bool = False,
        measured: bool = True,
        told: bool = True,
    ) -> None:
        for host in self.hosts:
            if host.is_held_up:
                # Stopped at its look, it sends what it has decided: within twice the watchdog a base robot cannot tell that from a delay.
                longest = self.watchdog * (1 if host.looked is None else 2)
                if host.held_up > longest and host.stage != "preparing":
                    self._stopped(host.run)
                continue
            goes_out = host.cycle()
            if host.permit.lost or host.stage in ("stopping", "over"):
                self._stopped(host.run)
            if goes_out:
                self._put(host, 0)
        for host in self.hosts:
            self.ways[host.run].is_over = host.stage == "over"
        self.hosts = [host for host in self.hosts if host.stage != "over"]
        sample = self._sample(come, only_oldest, again, lost)
        if self.off:
            self.off -= 1
        else:
            self._base_called(sample)
        self._tell(measured, told)

    def _sample(
        self, come: int | None, only_oldest: bool, again: int | None, lost: bool
    ) -> tuple[int, int] | None:
        """Run and age of the sample that the base robot finds, if one comes."""
        if lost:
            for way in self.ways.values():
                way.queue = [age for age in way.queue if age]
            return None
        if again is not None:
            age = self.ways[again].came
            return None if age is None else (again, age)
        if come is None or self.off:
            return None
        way = self.ways[come]
        if not way.queue:
            return None
        arrived = way.queue[:1] if only_oldest else way.queue
        way.queue = way.queue[len(arrived) :]
        way.came = arrived[-1]
        return come, way.came

    def _base_called(self, sample: tuple[int, int] | None) -> None:
        base, logic = self.base, self.base.logic
        before, obeyed = logic.life.now, logic.publisher
        attachment = None
        if sample is not None:
            run, age = sample
            attachment = Attachment(NOW - age, (NOW - age) * CYCLE, gid(run))
        base.call(attachment)
        is_active = logic.life.now is LifeCycle.active
        if is_active and sample is not None and logic._heard == NOW:
            if before is not LifeCycle.active:
                self.bad = self._bad_activation(run, age)
                self.activated.add(run)
                self.quickest = age
            elif gid(run) != obeyed:
                self.bad = "a set point of another publisher was followed"
            else:
                self.quickest = min(self.quickest, age)
                if age > self.quickest + self.watchdog:
                    self.bad = "a set point was followed that was late by more than the watchdog"
        elif is_active and before is not LifeCycle.active:
            self.bad = "active without a set point"

    def _bad_activation(self, run: int, age: int) -> str | None:
        stopped = self.ways[run].stopped
        if run in self.activated:
            return f"run {run} has activated the base robot twice"
        if stopped is None:
            return None
        if age <= stopped:
            return f"run {run} has activated the base robot with a set point that it sent after its stop"
        if age > self.limit:
            return f"run {run} has activated the base robot after its stop, with a set point {age} calls old"
        return None

    def _tell(self, measured: bool, told: bool) -> None:
        """The base robot's measurement and its word to the hosts."""
        air = self.base._link.session.news
        self.news += air
        air.clear()
        for whom, obeys in self.news:
            for host in self.hosts:
                if self.tells and whom == gid(host.run).hex():
                    host.late_news = [*host.late_news, obeys]
        self.news = []
        for host in self.hosts:
            if not self.off and measured and host.base == self.bases:
                host.measured = True
            if told:
                host.news, host.late_news = [*host.news, *host.late_news], []

    def normalise(self) -> None:
        self.base.shift(self.watchdog)
        if self.base.logic.life.now is not LifeCycle.active:
            self.quickest = OLDEST
        for host in self.hosts:
            host.shift(self.watchdog)
        for run, way in self.ways.items():
            way.queue = [age + 1 for age in way.queue if age < OLDEST]
            comes_at_once = not self.playback and gid(run) != self.base.logic.publisher
            if comes_at_once and len(way.queue) > 1 and way.queue[0] >= self.watchdog:
                del way.queue[0]  # they come at once, and the freshest is looked at
            if way.came is not None:
                way.came = (
                    way.came + 1
                    if way.came + 1 < (OLDEST if self.playback else self.watchdog)
                    else None
                )
            if way.stopped is not None:
                way.stopped = min(way.stopped + 1, OLDEST)
                if way.came is None and (not way.queue or way.queue[0] <= way.stopped):
                    way.stopped = OLDEST  # nothing is on its way from before

    def violation(self) -> str | None:
        return self.bad


NO_RESTART: dict[str, Any] = {"base_restarts": False}
WORLDS: dict[str, Callable[[], Any]] = {
    "the base robot's lock alone, any samples": BaseAlone,
    "one run, a base robot that restarts": Whole,
    "two runs": lambda: Whole(starts=2, **NO_RESTART),
    "one run, a link that becomes slow": lambda: Whole(queue=3, hold_ups=False, **NO_RESTART),
    "one run, a process that is stopped after its look": lambda: Whole(
        stops_at_look=True, **NO_RESTART
    ),
}
NOT_PROMISED: dict[str, Callable[[], Any]] = {
    "a link that plays back what it held up": lambda: Whole(playback=True, **NO_RESTART),
    "a base robot that does not tell whom it obeys": lambda: Whole(tells=False, **NO_RESTART),
}
"""A premise dropped, and the way is found: what a base robot cannot refuse."""
Patch = Callable[[pytest.MonkeyPatch], None]


def _used_are_obeyed(patch: pytest.MonkeyPatch) -> None:
    is_activated = BaseLogic._is_activated

    def forgets(self: BaseLogic, *arguments: Any) -> bool | None:
        used, self.used = self.used, deque()
        activated = is_activated(self, *arguments)
        used.extend(self.used)
        self.used = used
        return activated

    patch.setattr(BaseLogic, "_is_activated", forgets)


def _used_end_with_the_session(patch: pytest.MonkeyPatch) -> None:
    new_logic = Base._new_logic

    def forgets(self: Base) -> BaseLogic:
        logic = new_logic(self)
        logic.used = deque()
        return logic

    patch.setattr(Base, "_new_logic", forgets)


def _stamps_do_not_count(patch: pytest.MonkeyPatch) -> None:
    comes_in_time = BaseLogic._comes_in_time

    def ignores(self: BaseLogic, publisher: bytes, stamp: float) -> bool:
        candidate, first, call, *_ = self._candidate
        agrees = first + (self._calls - call) * self.period
        return comes_in_time(self, publisher, agrees if candidate == publisher else stamp)

    patch.setattr(BaseLogic, "_comes_in_time", ignores)


def _anybody_is_followed(patch: pytest.MonkeyPatch) -> None:
    """Two guards: the link listens to one source, and the logic looks at the publisher again."""
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
        obeyed = self.publisher if self.life.now is LifeCycle.active else publisher
        return take(self, position, orientation, velocity, pose, obeyed, *others)

    patch.setattr(OdometryLink, "receive", receives)
    patch.setattr(BaseLogic, "take", takes)


def _no_reason_to_stop(patch: pytest.MonkeyPatch) -> None:
    lose = Permit.lose
    patch.setattr(
        Permit, "lose", lambda permit, reason: None if reason == REASON else lose(permit, reason)
    )


ALONE, ONE, _, SLOW, LOOK = WORLDS.values()
GUARDS: dict[str, tuple[Callable[[], Any], Patch]] = {
    "a used publisher is not obeyed again": (ALONE, _used_are_obeyed),
    "used publishers outlive a session": (ALONE, _used_end_with_the_session),
    "a publisher that sent while another was obeyed is refused": (
        ALONE,
        lambda patch: patch.setattr(BaseLogic, "refuse", lambda logic, publisher: None),
    ),
    "set points must have come for a while": (
        ALONE,
        lambda patch: patch.setattr(
            BaseLogic, "_comes_in_time", lambda logic, publisher, stamp: True
        ),
    ),
    "as their stamps advance": (ALONE, _stamps_do_not_count),
    "one publisher is followed": (ALONE, _anybody_is_followed),
    "a late set point is not followed": (
        SLOW,
        lambda patch: patch.setattr(PeerClock, "delay", lambda clock, stamp, arrived: 0),
    ),
    "a permit is lost by a hold-up": (LOOK, without_hold_ups),
    "a permit is lost at the first reason to stop": (ONE, _no_reason_to_stop),
    "a set point is held while measurements come only": (
        ONE,
        lambda patch: patch.setattr(Permit, "may_ramp_down", lambda permit, now: True),
    ),
    "the graded stop holds only what was activated": (
        SLOW,
        lambda patch: patch.setattr(f"{__name__}.HOLDS_ONLY_WHEN_ACTIVE", False),
    ),
}
"""What is taken away, and the world that needs it."""
