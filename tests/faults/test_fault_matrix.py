"""Rows of the fault matrix, host and facility in virtual time, default settings."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest
from families import family
from fault_bench import ARM, Observed, assert_safe, run, shipped, with_faults
from fault_matrix import BEGIN, PROCESS_ROWS, ROWS, Row, stated

from freeflyer_adapters.arm.frames import Mode
from freeflyer_adapters.device.device import LifeCycle
from freeflyer_adapters.facility.arm_logic import ArmLogic, Command

FIRST_OF_ITS_KIND = [
    row for row in ROWS if row == next(other for other in ROWS if other.kind == row.kind)
]


def observed(row: Row) -> Observed:
    return run(with_faults(shipped(BEGIN + row.lasts), [row.fault], seed=row.seed))


def reaction_times(row: Row, seen: Observed) -> tuple[float, float]:
    """Return the reaction times of the controllers and the device [s], from the fault's start."""
    safe = seen.safe_at.get(row.device, float("nan"))
    return seen.since(row.device, BEGIN, seen.stopped_at), seen.since(row.device, BEGIN, safe)


@pytest.mark.parametrize("row", family(ROWS, FIRST_OF_ITS_KIND), ids=lambda row: row.name)
def test_a_fault_has_its_stated_reaction_within_its_stated_time(row: Row) -> None:
    seen = observed(row)
    assert_safe(seen)
    assert not seen.error
    whole = row.kind in ("bus_off", "hung", "dead", "device_fault")
    assert whole or seen.acted[row.kind] > 0, "the fault has changed no packet"
    if row.stop is None:
        assert seen.went_on, seen.stop
    else:
        assert re.search(row.stop, seen.stop), seen.stop
        assert row.within is not None
        decided, by_itself = reaction_times(row, seen)
        assert 0.0 <= decided <= row.within
        if row.device_within is not None:
            assert 0.0 <= by_itself <= row.device_within
    counts = Counter(seen.devices[row.device]) + Counter(
        seen.report.devices[row.device] if seen.report else {}
    )  # of host and facility
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


ROOT = Path(__file__).parents[2]


def test_every_process_row_names_an_existing_test() -> None:
    for row in PROCESS_ROWS:
        file, _, function = row.test.partition("::")
        assert f"def {function}(" in (ROOT / file).read_text(), row.test


def test_the_document_contains_every_row_with_its_reaction_and_its_time() -> None:
    """The measured times are not compared; they are those of the run that wrote the document."""
    document = (ROOT / "docs" / "fault_matrix.md").read_text()
    expected = [stated(row) for row in ROWS]
    found = [
        "|".join([*cells[1:6], cells[7]])
        for line in document.splitlines()
        if len(cells := [cell.strip() for cell in line.split("|")]) == 10
        and cells[1] not in ("fault", "---")
    ]
    assert found == expected, "run python tests/faults/fault_matrix.py > docs/fault_matrix.md"
    for process in PROCESS_ROWS:
        assert (
            f"| {process.what} | {process.reaction} | {process.within} | `{process.test}` |"
            in document
        )


def test_the_base_stays_active_while_the_arm_takes_half_a_second_to_become_active(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Brakes open slowly; meanwhile the active base continues to receive its set point."""
    handle = ArmLogic._handle
    requests: list[int] = []

    def slow(self: ArmLogic, command: Command) -> None:
        if command.mode is Mode.activate and self.life.now is LifeCycle.inactive:
            requests.append(self.cycle)
            if self.cycle < requests[0] + 500:
                return
        handle(self, command)

    monkeypatch.setattr(ArmLogic, "_handle", slow)
    seen = run(shipped(0.2))
    assert len(requests) > 400
    assert seen.went_on, seen.stop
    assert not [
        event
        for event in seen.events["base_robot"]
        if "safe_stop" in event and "no set point" in event
    ][1:]
    assert seen.active_at[ARM] - seen.active_at["base_robot"] > 0.45
    assert seen.safe_at["base_robot"] > seen.stopped_at
