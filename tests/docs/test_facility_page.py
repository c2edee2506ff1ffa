"""docs/facility.md and docs/operating_guide.md state what the program prints."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from freeflyer.scenario import scenario
from freeflyer_adapters.facility.accelerated import accelerated
from freeflyer_adapters.facility.faults import Fault
from freeflyer_adapters.loop import hil
from freeflyer_adapters.loop.hil import LoopReport

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "facility.md").read_text(encoding="utf-8")
GUIDE = (ROOT / "docs" / "operating_guide.md").read_text(encoding="utf-8")
ARM = "arm_drive"


def run_example(containing: str, folder: Path) -> tuple[tuple[Fault, ...], bool, LoopReport]:
    """Run the TOML example in virtual time; return its faults, whether it ended, and the report."""
    examples = re.findall(r"```toml\n(.*?)```", TEXT, re.DOTALL)
    file = folder / "example.toml"
    file.write_text(next(toml for toml in examples if containing in toml), encoding="utf-8")
    chosen = scenario.load(str(file))
    with accelerated(chosen) as both:
        result, report = hil.run(chosen, real_time=False)
        return both.facility.settings.faults, result.as_expected, report


@pytest.fixture(scope="module")
def scheduled(tmp_path_factory: pytest.TempPathFactory) -> tuple[bool, LoopReport]:
    _, reached_its_end, report = run_example(
        "[[facility.faults]]", tmp_path_factory.mktemp("scheduled")
    )
    return reached_its_end, report


def test_the_scheduled_loss_is_counted_as_stated_and_the_run_reaches_its_end(
    scheduled: tuple[bool, LoopReport],
) -> None:
    reached_its_end, report = scheduled
    assert reached_its_end, report.stop
    for count in ("cycles lost", "longest loss cycles"):
        value = int(report.devices[ARM][count.replace(" ", "_")])
        assert re.search(rf"{ARM}: {count} +│ +{value} │", TEXT), (count, value)


def test_times_in_virtual_time_are_within_the_stated_resolution(
    scheduled: tuple[bool, LoopReport],
) -> None:
    answers = next(times for name, times in scheduled[1].times.items() if "answer" in name)
    assert answers["p50_us"] <= 1.0, answers
    assert answers["p99_us"] <= 1.0, answers


def test_the_random_faults_are_those_that_the_page_lists(tmp_path: Path) -> None:
    faults, reached_its_end, report = run_example("random_faults", tmp_path)
    assert not reached_its_end
    assert "went to safe_stop by itself" in report.stop
    listed = re.findall(r"^fault: ([a-z ]+) of (\w+)[,:].* ([\d.]+) s after", TEXT, re.MULTILINE)
    assert [(f.kind.replace("_", " "), f.device, f"{f.begin_s:.4g}") for f in faults] == listed


def test_the_operating_guide_quotes_reasons_that_the_program_can_print() -> None:
    files = [*(ROOT / "adapters").rglob("*.py"), *(ROOT / "cosim").rglob("*.toml")]
    source = "\n".join(file.read_text(encoding="utf-8") for file in files)
    table = GUIDE.partition("| the reason contains |")[2].partition("\n\n")[0]
    cells = [row.split("|")[1] for row in table.splitlines()[2:]]
    quoted = [text for cell in cells for text in re.findall("`(.+?)`", cell)]
    # The program inserts numbers, names and states at these places.
    inserted = re.compile(r"\.{3}|[N()]|0\.2|safe_stop|fault")
    parts = [part for text in quoted for part in inserted.split(text)]
    missing = [part for part in parts if len(part.split()) > 2 and part.strip() not in source]
    assert len(quoted) > 20
    assert not missing
