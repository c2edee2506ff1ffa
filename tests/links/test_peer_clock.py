"""A peer's stamps: what is late is late, and what is a clock that was set is counted and harms nothing."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from freeflyer_adapters.base.peer_clock import DRIFT, SMALLEST_STEP, PeerClock

MS = 1_000_000
CYCLE = 4 * MS
SECOND = 1000 * MS
offsets = st.integers(-(10**18), 10**18)
"""[ns] Between two clocks that were never set alike."""


class Peer:
    """Sends each cycle; `offset` is its clock less ours."""

    def __init__(self, offset: int = 0) -> None:
        self.clock, self.offset, self.now = PeerClock(), offset, 1000 * SECOND

    def send(self, late: int = 0) -> int:
        """The delay that is told of the next sample, which comes `late`."""
        self.now += CYCLE
        return self.clock.delay(self.now + self.offset, self.now + late)

    def run(self, samples: int = 10) -> None:
        for _ in range(samples):
            self.send()


@given(offsets, st.lists(st.integers(0, 20 * MS), min_size=1, max_size=50))
def test_a_delay_is_that_beside_the_quickest_whatever_the_clocks_say(
    offset: int, late: list[int]
) -> None:
    peer = Peer(offset)
    quickest = late[0]
    for k, way in enumerate(late):
        quickest = min(quickest, way)
        # What is quick is forgotten at DRIFT, cycle by cycle.
        forgotten = DRIFT * (k * CYCLE + 20 * MS)
        assert way - quickest - forgotten <= peer.send(way) <= way - quickest
    assert peer.clock.steps == 0


@given(offsets, st.integers(CYCLE + 1, 3600 * SECOND), st.integers(0, 20 * MS))
def test_a_clock_that_is_set_back_is_counted_and_makes_nothing_late(
    offset: int, by: int, late: int
) -> None:
    peer = Peer(offset)
    peer.run()
    peer.send(late)
    peer.offset -= by
    # As late as the one before, but for what is forgotten at DRIFT.
    assert late - 2.0 * DRIFT * (CYCLE + late) <= peer.send(late) <= late
    assert peer.clock.steps == 1
    assert peer.clock.step == -by
    assert peer.send() == 0
    assert peer.clock.steps == 1


@given(offsets, st.integers(1, CYCLE))
def test_a_clock_that_is_set_back_by_less_than_a_cycle_shows_as_a_delay_of_as_much(
    offset: int, by: int
) -> None:
    peer = Peer(offset)
    peer.run()
    peer.offset -= by
    assert peer.send() == pytest.approx(by, abs=2.0 * DRIFT * CYCLE)
    assert peer.clock.steps == 0


@given(offsets, st.integers(SMALLEST_STEP + 1, 3600 * SECOND))
def test_a_clock_that_is_set_forward_is_counted_and_what_follows_is_measured_anew(
    offset: int, by: int
) -> None:
    peer = Peer(offset)
    peer.run()
    peer.offset += by
    assert peer.send() == 0
    assert (peer.clock.steps, peer.clock.step) == (1, by)
    peer.run()
    assert peer.send(30 * MS) == pytest.approx(30 * MS, abs=MS)
    assert peer.clock.steps == 1


@given(offsets, st.integers(1, SMALLEST_STEP))
def test_a_small_step_forward_is_taken_for_a_quicker_way(offset: int, by: int) -> None:
    peer = Peer(offset)
    peer.run()
    peer.offset += by
    assert peer.send() == 0
    assert peer.clock.steps == 0


def test_a_clock_that_is_set_while_samples_are_late_hides_no_lateness() -> None:
    peer = Peer()
    peer.run()
    peer.send(100 * MS)
    peer.offset += 10 * SECOND
    assert peer.send(100 * MS) == pytest.approx(100 * MS, abs=MS)
    assert peer.clock.steps == 1


@given(offsets, st.integers(1, 5))
def test_a_stamp_that_stands_still_ages(offset: int, seconds: int) -> None:
    """The publisher hangs, and something sends its last stamp again and again."""
    peer = Peer(offset)
    peer.run()
    stamp = peer.now + offset
    for k in range(1, seconds * 250 + 1):
        delay = peer.clock.delay(stamp, peer.now + k * CYCLE)
        assert delay >= (1.0 - 2.0 * DRIFT) * k * CYCLE
    assert peer.clock.steps == 0


@given(offsets, st.integers(2, 300))
def test_a_batch_that_was_held_up_is_late_and_no_step(offset: int, samples: int) -> None:
    peer = Peer(offset)
    peer.run()
    last = peer.now
    sent = [last + k * CYCLE for k in range(1, samples + 1)]
    arrived = last + 800 * MS
    for stamp in (stamp for stamp in sent if stamp <= arrived):
        delay = peer.clock.delay(stamp + offset, arrived)
        assert delay == pytest.approx(arrived - stamp, abs=2 * MS)
    assert peer.clock.steps == 0
    peer.now = max(arrived, sent[-1])
    assert peer.send() == 0
    assert peer.clock.steps == 0


def test_of_a_batch_that_was_held_up_for_800_ms_the_first_is_800_ms_late() -> None:
    peer = Peer(5 * SECOND)
    peer.run()
    first = peer.now + CYCLE
    assert peer.clock.delay(first + peer.offset, first + 800 * MS) == pytest.approx(
        800 * MS, abs=MS
    )
    assert peer.clock.steps == 0


def test_clocks_that_drift_apart_make_nothing_late() -> None:
    """100 ppm for a minute: 6 ms, which would be late for a base robot."""
    clock, now, stamp = PeerClock(), 1000 * SECOND, 10**18
    for _ in range(15_000):
        now, stamp = now + CYCLE, stamp + CYCLE - CYCLE // 10_000
        assert clock.delay(stamp, now) < MS


def test_another_publisher_begins_anew() -> None:
    peer = Peer()
    peer.run()
    peer.clock.forget()
    peer.offset = -3600 * SECOND
    assert peer.send() == 0
    assert peer.clock.steps == 0
