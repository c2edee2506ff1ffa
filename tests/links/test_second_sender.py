"""Detection of two senders of one identifier. Faults of one link cause no detection."""

from __future__ import annotations

from itertools import product
from random import Random
from statistics import median
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from freeflyer_adapters.can.second_sender import LISTEN, SecondSender

Frame = tuple[int, bytes]
OFFSETS = (0, 1, 3, 8, 9, 13, 40, 128, 200, 248, 255)


def sent(name: str, start: int, frames: int, counters: int = 256) -> list[Frame]:
    return [((start + i) % counters, f"{name}{i}".encode()) for i in range(frames)]


def delivered(frames: list[Frame], places: list[int]) -> list[Frame]:
    """Delay each frame by a number of places; `places` is repeated cyclically."""
    order = sorted(range(len(frames)), key=lambda i: i + places[i % len(places)])
    return [frames[i] for i in order]


def duplicated(frames: list[Frame], copied: list[int | None]) -> list[Frame]:
    """Repeat frames a number of places later. `copied` is repeated cyclically; None: no copy."""
    copies = [(i, copied[i % len(copied)]) for i in range(len(frames))]
    order = [(i + 0.0, i) for i, _ in copies] + [
        (i + late + 0.5, i) for i, late in copies if late is not None
    ]
    return [frames[i] for _, i in sorted(order)]


def alternating(first: list[Frame], second: list[Frame], bursts: list[int]) -> list[Frame]:
    """Alternate bursts of both senders. At a negative length, the second sender sends first."""
    frames: list[Frame] = []
    at = turn = 0
    while at < len(first):
        burst = bursts[turn % len(bursts)]
        one, other = first[at : at + abs(burst)], second[at : at + abs(burst)]
        frames += one + other if burst > 0 else other + one
        at, turn = at + abs(burst), turn + 1
    return frames


def detected_after(frames: list[Frame], counters: int = 256) -> int | None:
    """Return the number of frames until two senders are detected, or None."""
    detector = SecondSender(counters)
    return next((n for n, frame in enumerate(frames, 1) if detector.observe(*frame)), None)


faults = st.fixed_dictionaries(
    {
        "start": st.integers(0, 255),
        "restart": st.none() | st.integers(0, 255),
        "before": st.integers(0, 120),
        "lost": st.lists(st.booleans(), min_size=1, max_size=40),
        "gap": st.tuples(st.integers(0, 200), st.sampled_from([0, 1, 7, 8, 9, 30, 128, 250, 256])),
        "copied": st.lists(st.none() | st.integers(0, 8), min_size=1, max_size=40),
        "places": st.lists(st.integers(0, 8), min_size=1, max_size=40),
    }
)


@settings(max_examples=400)
@given(faults)
def test_loss_duplication_reordering_and_one_restart_are_one_sender(faults: dict[str, Any]) -> None:
    frames = sent(
        "before", faults["start"], faults["before"] if faults["restart"] is not None else 300
    )
    if faults["restart"] is not None:
        frames += sent("after", faults["restart"], 200)
    at, length = faults["gap"]
    frames = [
        f
        for i, f in enumerate(frames)
        if not at <= i < at + length and not faults["lost"][i % len(faults["lost"])]
    ]
    late = delivered(frames, faults["places"])
    assert detected_after(late) is None
    assert detected_after(duplicated(late, faults["copied"])) is None


@pytest.mark.parametrize("counters", [32, 256])
@pytest.mark.parametrize("lost", [0.0, 0.2, 0.5, 0.9, 0.99])
def test_any_rate_of_loss_is_one_sender(lost: float, counters: int) -> None:
    random = Random(1)
    frames = [f for f in sent("a", 0, int(2000 / (1 - lost)), counters) if random.random() >= lost]
    assert detected_after(frames, counters) is None
    assert (
        detected_after(delivered(frames, [random.randint(0, 8) for _ in frames]), counters) is None
    )


@pytest.mark.parametrize("step", [1, 2, 3])
def test_permanent_reordering_is_one_sender(step: int) -> None:
    frames = sent("a", 0, 300 * step)[::step]
    for places in product([0, 8], repeat=8):
        assert detected_after(delivered(frames, list(places))) is None, places
    assert detected_after(delivered(frames, [2, 0])) is None
    assert detected_after(delivered(frames, list(range(8, 0, -1)))) is None


def test_frames_mixed_across_a_restart_are_one_sender() -> None:
    """A delay of up to eight places mixes at most sixteen frames."""
    for jump in range(256):
        before, after = sent("before", 0, 100), sent("after", 100 + jump, 100)
        frames = before[:-8] + alternating(before[-8:], after[:8], [1]) + after[8:]
        assert detected_after(frames) is None, jump


def test_a_restart_at_a_recent_counter_with_the_worst_reordering_is_one_sender() -> None:
    random = Random(4)
    for _ in range(1000):
        frames = sent("before", 0, 200) + sent("after", 200 - random.randint(0, 40), 100)
        places = random.choices([0, 8], k=random.randint(2, 8))
        assert detected_after(delivered(frames, places)) is None, places


def test_a_frozen_counter_is_one_sender() -> None:
    frozen = [(49, f"frozen{i}".encode()) for i in range(500)]
    assert detected_after(sent("a", 0, 50) + frozen) is None
    assert detected_after(sent("a", 0, 50) + frozen + sent("b", 50, 500)) is None, "and counts on"


@pytest.mark.parametrize("every", [20, 40, 100, 256])
def test_occasional_restarts_are_one_sender(every: int) -> None:
    random = Random(2)
    assert detected_after([f for i in range(50) for f in sent(f"{i},", 0, every)]) is None, (
        "always from 0"
    )
    assert (
        detected_after([f for i in range(50) for f in sent(f"{i},", random.randrange(256), every)])
        is None
    )


@pytest.mark.parametrize("frames", [20, 40, 100])
def test_long_alternating_bursts_count_as_one_sender_at_a_time(frames: int) -> None:
    one, other = sent("a", 0, 1000), sent("b", 77, 1000)
    assert detected_after(alternating(one, other, [frames])) is None


@pytest.mark.parametrize("bursts", [[1], [-1], [1, -1], [2], [3], [4], [-4], [1, -2, 3, -4]])
def test_two_senders_are_detected_at_any_offset_of_their_counters(bursts: list[int]) -> None:
    needed = [
        detected_after(alternating(sent("a", 50, 200), sent("b", 50 + offset, 200), bursts))
        or 10**6
        for offset in range(256)
    ]
    assert min(needed) > 2 * 12, "an overlap of twelve frames is none yet"
    assert max(needed) <= 2 * (27 if max(map(abs, bursts)) == 1 else 39)


@given(st.integers(0, 255), st.lists(st.integers(1, 7), min_size=1, max_size=20))
def test_two_senders_are_detected_before_the_first_transmission(
    offset: int, bursts: list[int]
) -> None:
    needed = detected_after(alternating(sent("a", 0, LISTEN), sent("b", offset, LISTEN), bursts))
    assert needed is not None
    assert needed <= LISTEN


def test_two_senders_are_detected_with_a_fifth_lost() -> None:
    random, needed = Random(3), []
    for offset in list(range(256)) * 4:
        frames = alternating(sent("a", 0, 200), sent("b", offset, 200), [1, -1])
        needed.append(detected_after([f for f in frames if random.random() >= 0.2]) or 10**6)
    assert median(needed) <= 2 * 17
    assert max(needed) <= 2 * 40, "frames received of each"


@pytest.mark.parametrize("later", [4, 20, 40])
def test_duplicates_do_not_hide_two_senders(later: int) -> None:
    for offset in range(256):
        frames = alternating(sent("a", 0, 100), sent("b", offset, 100), [1])
        assert (detected_after(duplicated(frames, [later])) or 10**6) <= 4 * 30, offset


def test_earlier_losses_do_not_hide_a_second_sender() -> None:
    """Frames of the second sender must not fill old gaps in the first stream."""
    first = sent("a", 0, 2000)
    for offset in range(256):
        frames = first[:1000:4] + alternating(first[1000:], sent("b", 1000 + offset, 1000), [1])
        assert (detected_after(frames) or 10**6) <= 250 + 2 * 27, offset


def test_a_second_sender_is_detected_after_a_pause() -> None:
    first, second = sent("a", 0, 400), sent("b", 100, 400)
    for pause in (20, 50, 150, 250):
        frames = (
            alternating(first[:5], second[:5], [1])
            + first[5 : 5 + pause]
            + alternating(first[5 + pause :], second[5:], [1])
        )
        assert (detected_after(frames) or 10**6) <= 10 + pause + 2 * 20, pause


@given(
    st.sampled_from(OFFSETS) | st.integers(0, 255),
    st.lists(st.sampled_from([1, -1, 2, -2, 3, -3, 4, -4]), min_size=1, max_size=20),
    st.integers(0, 300),
    st.sampled_from([0.0, 0.1, 0.2]),
    st.integers(0, 2**32),
)
def test_two_senders_are_detected_in_any_order_with_loss_and_a_later_start(
    offset: int, bursts: list[int], earlier: int, lost: float, seed: int
) -> None:
    random = Random(seed)
    first = sent("a", 7, earlier + 300)
    frames = first[:earlier] + alternating(
        first[earlier:], sent("b", 7 + earlier + offset, 300), bursts
    )
    assert detected_after([f for f in frames if random.random() >= lost]) is not None


@pytest.mark.parametrize("counters", [32, 64, 2**24])
def test_any_cycle_number_serves_as_the_counter(counters: int) -> None:
    start = counters - 20
    for offset in (0, 1, 8, 9, 13, 16, counters // 2, counters - 1):
        two = alternating(
            sent("a", start, 100, counters), sent("b", start + offset, 100, counters), [1]
        )
        assert (detected_after(two, counters) or 10**6) <= 2 * 26
    assert detected_after(delivered(sent("a", start, 1000, counters), [0, 8, 3]), counters) is None
    with pytest.raises(ValueError, match="power of two"):
        SecondSender(counters - 2)


def test_a_slower_second_sender_is_detected() -> None:
    slow = iter(sent("b", 30, 100))
    assert (
        detected_after(
            [
                f
                for i, a in enumerate(sent("a", 0, 500))
                for f in ([a, next(slow)] if i % 10 == 0 else [a])
            ]
        )
        is not None
    )


def test_a_detection_lasts_until_the_reset() -> None:
    detector = SecondSender()
    assert detector.counters == (-1, -1)
    for frame in alternating(sent("a", 0, 30), sent("b", 100, 30), [1]):
        detector.observe(*frame)
    assert detector.found
    one, other = sorted(detector.counters)
    assert 8 < one < 30
    assert one + 98 < other < one + 102, "the last counters of both"
    assert detector.observe(5, b"another")
    detector.reset()
    assert not detector.found
    assert detector.counters == (-1, -1)
    assert not any(detector.observe(*frame) for frame in sent("a", 200, 300))
    assert detector.counters == (243, -1)
