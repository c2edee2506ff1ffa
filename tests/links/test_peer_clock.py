"""Delays from a peer's time stamps: real delays are found, and clock steps are only counted."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from freeflyer_adapters.base.peer_clock import DRIFT, SMALLEST_STEP, PeerClock

MS = 1_000_000
CYCLE = 4 * MS
SECOND = 1000 * MS
offsets = st.integers(-(10**18), 10**18)
"""Offset between two clocks that are not synchronised [ns]."""


class Peer:
    """A peer that sends every cycle. `offset` [ns] is its clock minus the local clock."""

    def __init__(self, offset: int = 0) -> None:
        self.clock, self.offset, self.now = PeerClock(), offset, 1000 * SECOND

    def send(self, late: int = 0) -> int:
        """Return the computed delay of the next sample, which arrives `late` [ns]."""
        self.now += CYCLE
        return self.clock.delay(self.now + self.offset, self.now + late)

    def run(self, samples: int = 10) -> None:
        for _ in range(samples):
            self.send()


@given(offsets, st.lists(st.integers(0, 20 * MS), min_size=1, max_size=50))
def test_a_delay_is_relative_to_the_fastest_sample_for_any_clock_offset(
    offset: int, late: list[int]
) -> None:
    peer = Peer(offset)
    fastest = late[0]
    for k, way in enumerate(late):
        fastest = min(fastest, way)
        # The minimum grows by DRIFT.
        growth = DRIFT * (k * CYCLE + 20 * MS)
        assert way - fastest - growth <= peer.send(way) <= way - fastest
    assert peer.clock.steps == 0


@given(offsets, st.integers(CYCLE + 1, 3600 * SECOND), st.integers(0, 20 * MS))
def test_a_clock_that_is_set_back_is_counted_and_adds_no_delay(
    offset: int, by: int, late: int
) -> None:
    peer = Peer(offset)
    peer.run()
    peer.send(late)
    peer.offset -= by
    # The delay is equal to the previous one, except for the growth by DRIFT.
    assert late - 2.0 * DRIFT * (CYCLE + late) <= peer.send(late) <= late
    assert peer.clock.steps == 1
    assert peer.clock.step == -by
    assert peer.send() == 0
    assert peer.clock.steps == 1


@given(offsets, st.integers(1, CYCLE))
def test_a_clock_that_is_set_back_by_less_than_a_cycle_appears_as_a_delay(
    offset: int, by: int
) -> None:
    peer = Peer(offset)
    peer.run()
    peer.offset -= by
    assert peer.send() == pytest.approx(by, abs=2.0 * DRIFT * CYCLE)
    assert peer.clock.steps == 0


@given(offsets, st.integers(SMALLEST_STEP + 1, 3600 * SECOND))
def test_a_clock_that_is_set_forward_is_counted_and_later_delays_are_correct(
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
def test_a_small_step_forward_is_taken_as_a_shorter_delay(offset: int, by: int) -> None:
    peer = Peer(offset)
    peer.run()
    peer.offset += by
    assert peer.send() == 0
    assert peer.clock.steps == 0


def test_a_clock_step_does_not_hide_a_delay() -> None:
    peer = Peer()
    peer.run()
    peer.send(100 * MS)
    peer.offset += 10 * SECOND
    assert peer.send(100 * MS) == pytest.approx(100 * MS, abs=MS)
    assert peer.clock.steps == 1


@given(offsets, st.integers(1, 5))
def test_the_delay_of_a_frozen_stamp_grows(offset: int, seconds: int) -> None:
    """The publisher hangs and sends its last stamp repeatedly."""
    peer = Peer(offset)
    peer.run()
    stamp = peer.now + offset
    for k in range(1, seconds * 250 + 1):
        delay = peer.clock.delay(stamp, peer.now + k * CYCLE)
        assert delay >= (1.0 - 2.0 * DRIFT) * k * CYCLE
    assert peer.clock.steps == 0


@given(offsets, st.integers(2, 300))
def test_a_delayed_batch_is_late_and_not_a_clock_step(offset: int, samples: int) -> None:
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


def test_the_first_sample_of_a_batch_delayed_by_800_ms_is_800_ms_late() -> None:
    peer = Peer(5 * SECOND)
    peer.run()
    first = peer.now + CYCLE
    assert peer.clock.delay(first + peer.offset, first + 800 * MS) == pytest.approx(
        800 * MS, abs=MS
    )
    assert peer.clock.steps == 0


def test_clock_drift_adds_no_delay() -> None:
    """A drift of 100 ppm is 6 ms in a minute, which would be a significant delay."""
    clock, now, stamp = PeerClock(), 1000 * SECOND, 10**18
    for _ in range(15_000):
        now, stamp = now + CYCLE, stamp + CYCLE - CYCLE // 10_000
        assert clock.delay(stamp, now) < MS


def test_another_publisher_resets_the_clock() -> None:
    peer = Peer()
    peer.run()
    peer.clock.reset()
    peer.offset = -3600 * SECOND
    assert peer.send() == 0
    assert peer.clock.steps == 0
