"""Stability map: one cell per pair of values in the colour of its verdict, with the boundary."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from matplotlib import colors
from matplotlib import pyplot as plt

from freeflyer.analysis.prediction.predict import predict
from freeflyer.analysis.sweep import boundary
from freeflyer.analysis.sweep import file as sweep_file
from freeflyer.analysis.sweep import map as stability_map
from freeflyer.analysis.sweep.plan import Plan
from freeflyer.fmi.component import Array
from freeflyer.scenario import scenario
from freeflyer.scenario.figure_style import save

UNITS = {"a.x": "s", "a.y": "1"}


def table(ys: Array, *, cases: tuple[str, ...] = ("one", "two")) -> pa.Table:
    """Return results: stable for x = 0.1, growing for 0.2, diverged at 10 y for 0.3."""
    rows = [
        {
            "case": case,
            "a.x": x,
            "a.y": float(y),
            "stable": x == 0.1,
            "diverged": x == 0.3,
            "failed": False,
            "diverged_at_s": 10.0 * float(y) if x == 0.3 else None,
            "simulated_s": 60.0,
        }
        for case in cases
        for x in (0.1, 0.2, 0.3)
        for y in ys
    ]
    return pa.Table.from_pylist(rows)


def test_cells_have_the_colour_of_their_verdict() -> None:
    figure = stability_map.draw(table(np.array([1.0, 2.0])), "a.x", "a.y", UNITS)
    for panel in figure.axes[:2]:
        cells = panel.collections[0].get_array()
        assert cells.shape == (2, 3, 4)
        assert np.allclose(cells[:, 0], colors.to_rgba(stability_map.STABLE))
        assert np.allclose(cells[:, 1], colors.to_rgba(stability_map.GROWING))
        brightness = cells[:, 2, :3].sum(axis=1)
        assert brightness[1] > brightness[0]  # later divergence is lighter
        assert panel.get_xlabel() == "a.x [s]"
    plt.close(figure)


def test_the_worst_run_of_a_cell_is_shown() -> None:
    rows = table(np.array([1.0]), cases=("one",)).to_pylist()
    also = rows[0] | {"stable": False, "diverged": True, "diverged_at_s": 5.0}
    for order in ([*rows, also], [also, *rows]):
        figure = stability_map.draw(pa.Table.from_pylist(order), "a.x", "a.y", UNITS)
        cell = figure.axes[0].collections[0].get_array()[0, 0]
        assert not np.allclose(cell, colors.to_rgba(stability_map.STABLE))
        plt.close(figure)


def test_a_boundary_is_drawn_only_on_the_panel_of_its_case(tmp_path: Path) -> None:
    line = (np.array([0.1, 0.2]), np.array([1.0, 2.0]))
    figure = stability_map.draw(table(np.array([1.0, 2.0])), "a.x", "a.y", UNITS, {"two": line})
    assert not figure.axes[0].lines
    assert np.array_equal(figure.axes[1].lines[0].get_xydata(), np.column_stack(line))
    save(figure, tmp_path / "map")
    assert {path.name for path in tmp_path.iterdir()} == {"map.png", "map.pdf"}


def test_the_boundary_is_the_predicted_one_with_a_gap_at_a_rejected_value(
    tmp_path: Path,
) -> None:
    path = tmp_path / "some.toml"
    path.write_text(
        'scenario = "multirate_unstable"\n'
        '[grid]\n"base_controller.period" = [0.05, 0.2]\n"free_flyer.base_mass" = [150, -1]\n'
        '[map]\nx = "base_controller.period"\ny = "free_flyer.base_mass"\npredict = true\n'
    )
    plan, done = Plan(sweep_file.read(str(path))), list[str | None]()
    figure = plan.sweep.map
    assert figure is not None
    boundary.check(plan)
    ((periods, masses),) = boundary.predicted(plan, figure, done.append).values()
    assert len(done) == boundary.points(plan, figure) == 2
    assert masses.tolist() == [150.0, -1.0]
    assert periods[0] == predict(scenario.load("multirate_unstable")).largest_stable_s
    assert np.isnan(periods[1])
    assert done[0] is None
    assert "no boundary for case scenario at free_flyer.base_mass = -1" in str(done[1])


@pytest.mark.parametrize(
    ("axis", "seconds"),
    [
        ('{ values = [50, 200], unit = "ms" }', 0.001),
        ("{ values = [0.2, 0.8], relative = true }", 0.3),
    ],
)
def test_the_boundary_is_in_the_unit_of_its_axis(tmp_path: Path, axis: str, seconds: float) -> None:
    path = tmp_path / "some.toml"
    path.write_text(
        f'scenario = "multirate_unstable"\n[grid]\n"base_controller.period" = {axis}\n'
        '"free_flyer.base_mass" = [150]\n'
        '[map]\nx = "base_controller.period"\ny = "free_flyer.base_mass"\npredict = true\n'
    )
    plan = Plan(sweep_file.read(str(path)))
    assert plan.sweep.map is not None
    ((periods, _),) = boundary.predicted(plan, plan.sweep.map, lambda _: None).values()
    expected = predict(scenario.load("multirate_unstable")).largest_stable_s
    assert periods[0] * seconds == pytest.approx(expected, abs=1e-12)


@example([1.0, 0.010000000000000002, 0.01])
@given(st.lists(st.floats(0.01, 100.0), min_size=1, max_size=12, unique=True))
def test_every_value_lies_inside_its_cell(values: list[float]) -> None:
    ordered = np.sort(np.array(values))
    edges = stability_map.edges(ordered)
    assert edges.size == ordered.size + 1
    assert (edges[:-1] <= ordered).all()
    assert (ordered <= edges[1:]).all()


@pytest.mark.parametrize(
    ("values", "expected"), [(np.geomspace(0.1, 10, 20), True), (np.linspace(0.02, 0.5, 25), False)]
)
def test_an_axis_with_geometric_values_is_logarithmic(values: Array, expected: bool) -> None:
    assert stability_map.is_logarithmic(values) is expected
