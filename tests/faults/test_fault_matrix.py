"""Every row of the fault matrix, both ends of the facility in virtual time, every rule at its default."""

from __future__ import annotations

import re

import pytest
from fault_bench import ARM, Observed, assert_safe, run, shipped, with_faults
from fault_matrix import BEGIN, ROWS, Row


def observed(row: Row) -> Observed:
    return run(with_faults(shipped(BEGIN + row.lasts), [row.fault], seed=row.seed))


def reaction_times(row: Row, seen: Observed) -> tuple[float, float]:
    """Of the controllers and of the device itself, from the fault's begin [s]."""
    safe = seen.safe_at.get(row.device, float("nan"))
    return seen.since(row.device, BEGIN, seen.stopped_at), seen.since(row.device, BEGIN, safe)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_a_fault_has_its_stated_reaction_within_its_stated_time(row: Row) -> None:
    seen = observed(row)
    assert_safe(seen)
    assert not seen.error
    whole = row.kind in ("bus_off", "hung", "dead", "device_fault")
    assert whole or seen.acted[row.kind] > 0, "the fault has met no packet"
    if row.stop is None:
        assert seen.went_on, seen.stop
    else:
        assert re.search(row.stop, seen.stop), seen.stop
        assert row.within is not None
        decided, by_itself = reaction_times(row, seen)
        assert 0.0 <= decided <= row.within
        if row.device_within is not None:
            assert 0.0 <= by_itself <= row.device_within
    counts = {**seen.devices[row.device], **(seen.report.devices[row.device] if seen.report else {})}
    if row.counted:
        assert any(counts[name] > 0 for name in row.counted), counts


def test_without_a_fault_nothing_is_counted() -> None:
    seen = run(shipped(0.5))
    assert_safe(seen)
    assert seen.went_on
    assert seen.report is not None
    assert seen.report.devices[ARM]["cycles_lost"] == 0
    assert seen.report.devices[ARM]["state_frames_rejected"] == 0
    assert seen.report.devices["base_robot"]["cycles_lost"] == 0
    assert seen.report.devices["base_robot"]["samples_refused"] == 0
    assert not seen.acted
