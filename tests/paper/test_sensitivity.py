"""The sweep `paper_sensitivity`: no change of 5 or 10 % of one assumption fails a statement."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from freeflyer.analysis.sweep import file as sweep_file
from freeflyer.cli import main as command
from freeflyer.paper import criteria, sensitivity, statements
from freeflyer.scenario.scenario import literal

SHIPPED = sweep_file.SHIPPED / "paper_sensitivity.toml"


def reduced(folder: Path, factors: tuple[float, ...]) -> Path:
    """Write the shipped sweep with only some of its factors."""
    raw = tomllib.loads(SHIPPED.read_text())
    lines = [f"{key} = {literal(raw[key])}" for key in ("title", "scenario", "evaluation")]
    for name, case in raw["cases"].items():
        lines += [f"[cases.{name}]", *(f'"{key}" = {literal(v)}' for key, v in case.items())]
    lines.append("[vary]")
    for target, axis in raw["vary"].items():
        values = [value for value in axis["values"] if value in factors]
        lines.append(f'"{target}" = {literal(axis | {"values": values})}')
    path = folder / "reduced.toml"
    path.write_text("\n".join(lines))
    return path


@pytest.mark.slow
def test_every_statement_holds_with_one_assumption_changed_by_5_or_10_per_cent(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = reduced(tmp_path, sensitivity.NEAR)
    assert command.call(["sweep", str(path), "--out", str(tmp_path / "out")]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "48 of 48 designs with one change of 5 or 10 % keep all statements." in shown
    assert "The smallest margin of these designs is 1.08: Fig. 9, manipulator minimum" in shown
    assert "48 of 48 designs" in statements.FIRMNESS
    assert "The smallest margin of these designs is 1.08." in statements.FIRMNESS
    table = (tmp_path / "out" / sensitivity.FILE).read_text()
    page = (Path(__file__).parents[2] / "docs" / "paper_statements.md").read_text()
    assert table.splitlines()[-1] in page


def row(case: str, factor: float | None, **changes: float) -> dict[str, Any]:
    """Return a row of a run in which all statements hold, with changed numbers."""
    numbers = dict.fromkeys(criteria.columns(), 1.0)
    for error in criteria.ERRORS:
        numbers |= {f"{error}_max": 5e-4, f"{error}_end": 1e-6}
    for port in criteria.PORTS:
        numbers[f"{port}_energy_sum_least"] = numbers[f"{port}_energy_sum_early_slope"] = -1.0
    if case == "unstable":
        numbers |= {"completed": 0.0, "end_effector_position_max": 1.0}
    return {"design": 0 if factor is None else round(100 * factor), "case": case, "a.b": factor} | (
        numbers | changes
    )


def test_the_table_names_the_figures_that_fail_for_each_factor() -> None:
    rows = [row(case, factor) for factor in (None, 0.9) for case in criteria.RUNS]
    rows += [
        row("continuous", 1.5),
        row("unstable", 1.5),
        row("passive", 1.5, base_correction_max=0.0),
    ]
    rows += [row("continuous", 2.0, end_effector_position_max=1.0), row("unstable", 2.0)]
    rows += [row("passive", 2.0, completed=None)]  # a failed run has no numbers
    designs = sensitivity.judged_designs(rows)
    header, lines = sensitivity.verdicts(designs, ["a.b"])
    assert header == ["assumption", "x 0.9", "x 1.5", "x 2"]
    assert lines == [["`a.b`", "-", "8", "3, 4, 10"]]
    assert sensitivity.summary(designs, ["a.b"]).startswith("1 of 1 designs")
