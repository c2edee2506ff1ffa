"""Designs: each grid point once, each Latin hypercube stratum once, equal draws for equal seeds."""

from __future__ import annotations

import itertools
import math
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from families import family
from hypothesis import given
from hypothesis import strategies as st

from freeflyer.analysis.sweep import file as sweep_file
from freeflyer.analysis.sweep.designs import Axis, Designs, Interval, Levels, Sample, Target
from freeflyer.analysis.sweep.plan import Plan
from freeflyer.foundation.clock import nanoseconds

numbers = st.floats(1e-3, 1e3)


def axis(name: str, source: Levels | Interval) -> Axis:
    return Axis(target=Target(name=name), source=source)


def unit_axes(count: int) -> tuple[Axis, ...]:
    return tuple(axis(f"c.p{k}", Interval(low=0.0, high=1.0)) for k in range(count))


@given(count=st.integers(1, 60), size=st.integers(1, 5), seed=st.integers(0, 2**31))
def test_a_latin_hypercube_has_one_draw_in_every_stratum_of_every_axis(
    count: int, size: int, seed: int
) -> None:
    sample = Sample(method="latin_hypercube", count=count, seed=seed, axes=unit_axes(size))
    strata = np.floor(np.array(sample.rows) * count).astype(int)
    for column in strata.T:
        assert sorted(column) == list(range(count))


@given(low=numbers, ratio=st.floats(1.1, 1e4), count=st.integers(2, 40))
def test_a_logarithmic_latin_hypercube_is_stratified_by_ratio(
    low: float, ratio: float, count: int
) -> None:
    source = Interval(low=low, high=low * ratio, logarithmic=True)
    sample = Sample(method="latin_hypercube", count=count, seed=7, axes=(axis("c.p", source),))
    places = np.sort(
        [math.log(row[0] / low) / math.log(source.high / low) * count for row in sample.rows]
    )
    assert (places >= np.arange(count) - 1e-6).all()
    assert (places <= np.arange(count) + 1 + 1e-6).all()


@given(method=st.sampled_from(["latin_hypercube", "random"]), seed=st.integers(0, 2**31))
def test_the_draws_depend_only_on_the_seed(method: str, seed: int) -> None:
    def drawn(seed: int) -> list[tuple[float, ...]]:
        return Sample(method=method, count=5, seed=seed, axes=unit_axes(3)).rows  # type: ignore[arg-type]

    assert drawn(seed) == drawn(seed)
    assert drawn(seed) != drawn(seed + 1)


@given(low=numbers, span=st.floats(1e-3, 1e3), share=st.floats(0.0, 1.0), logarithmic=st.booleans())
def test_values_stay_inside_the_interval(
    low: float, span: float, share: float, logarithmic: bool
) -> None:
    interval = Interval(low=low, high=low + span, logarithmic=logarithmic)
    assert interval.low <= interval.at(share) <= interval.high


@given(
    multiple=st.integers(1, 5000),
    exponent=st.integers(-9, -3),
    low=st.integers(1, 500),
    more=st.integers(1, 2000),
    share=st.floats(0.0, 1.0),
    logarithmic=st.booleans(),
)
def test_multiples_are_exact_decimal_numbers_inside_the_interval(
    multiple: int, exponent: int, low: int, more: int, share: float, logarithmic: bool
) -> None:
    unit = Decimal(multiple).scaleb(exponent)
    interval = Interval(
        low=float(unit * low),
        high=float(unit * (low + more)),
        logarithmic=logarithmic,
        multiple_of=float(unit),
    )
    value = interval.at(share)
    assert interval.low <= value <= interval.high
    assert (Fraction(repr(value)) / Fraction(unit)).denominator == 1
    assert nanoseconds(value, "period") % nanoseconds(float(unit), "unit") == 0


@given(
    st.lists(st.lists(st.integers(), min_size=1, max_size=4, unique=True), min_size=1, max_size=4),
    st.integers(0, 3),
)
def test_a_grid_is_the_product_of_its_axes_with_every_draw(
    levels: list[list[int]], draws: int
) -> None:
    grid = tuple(axis(f"c.g{k}", Levels(values=tuple(values))) for k, values in enumerate(levels))
    sample = Sample(method="random", count=draws, seed=1, axes=unit_axes(1)) if draws else None
    designs = Designs(grid=grid, sample=sample)
    tails = sample.rows if sample else [()]
    assert [designs[k] for k in range(len(designs))] == [
        (*point, *tail) for point in itertools.product(*levels) for tail in tails
    ]


@given(count=st.integers(2, 50), low=numbers, span=st.floats(1e-2, 1e3))
def test_an_axis_has_both_ends_and_equal_distances(count: int, low: float, span: float) -> None:
    values = np.array(Interval(low=low, high=low + span).spread(count).values)
    assert (values[0], values[-1]) == (low, low + span)
    assert np.ptp(np.diff(values)) <= 1e-9 * (low + span)


def test_duplicates_from_rounding_are_removed() -> None:
    assert Interval(low=0.001, high=0.003, multiple_of=0.001).spread(20).values == (
        0.001,
        0.002,
        0.003,
    )


@pytest.mark.parametrize(("first", "last"), [(1, 6), (1, 3), (4, 6), (2, 2)])
def test_elements_and_factors_do_not_change_the_rest_of_a_vector(
    tmp_path: Path, first: int, last: int
) -> None:
    (tmp_path / "parts.toml").write_text(
        f'scenario = "multirate_passive"\n[grid]\n"base_controller.stiffness[{first}:{last}]" = [7.0, 11.0]\n'
        '"base_controller.damping[1:3]" = { values = [0.5, 3.0], relative = true }\n"base_controller.damping[6]" = [5.0]\n'
    )
    plan = Plan(sweep_file.read(str(tmp_path / "parts.toml")))
    for number in range(len(plan)):
        stiffness, factor, damping = plan.design(number)[2]
        assignments = dict(plan.run(number).assignments)
        own = [150.0] * 3 + [40.0] * 3
        assert (
            assignments["base_controller.stiffness"]
            == own[: first - 1] + [stiffness] * (last - first + 1) + own[last:]
        )
        assert assignments["base_controller.damping"] == [10.0 * factor] * 3 + [2.0, 2.0, damping]


def test_units_of_elements_are_converted(tmp_path: Path) -> None:
    (tmp_path / "units.toml").write_text(
        'scenario = "multirate_passive"\n[grid]\n"base_controller.period" = { values = [150, 300], unit = "ms" }\n'
        '"base_controller.stiffness[4]" = { values = [2.0], unit = "N.m/deg" }\n'
    )
    plan = Plan(sweep_file.read(str(tmp_path / "units.toml")))
    assignments = dict(plan.run(0).assignments)
    assert assignments["base_controller.stiffness"] == pytest.approx(
        [150.0] * 3 + [2.0 * 180.0 / math.pi, 40.0, 40.0]
    )
    assert assignments["base_controller.period"] == {"value": 150, "unit": "ms"}
    assert plan.units == {"base_controller.period": "ms", "base_controller.stiffness[4]": "N.m/deg"}


@pytest.mark.parametrize("name", family(sweep_file.shipped(), 2))
def test_shipped_sweeps_can_be_planned(name: str) -> None:
    plan = Plan(sweep_file.read(name))
    assert len(plan) == len(plan.designs) * len(plan.sweep.cases) >= 400
