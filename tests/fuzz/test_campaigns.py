"""Mutated untrusted inputs give a valid value or a documented exception."""

from __future__ import annotations

import pytest
from campaign import Hang, one, run, run_in_processes
from families import family
from target import Target
from targets import TARGETS

INPUTS = {
    "can": 20_000,
    "cdr": 50_000,
    "attachment": 50_000,
    "scenario": 20_000,
    "fmu": 400,
    "ssp": 600,
    "dbc": 400,
    "record": 400,
    "recover": 3000,
}
"""Number of inputs; less than a minute in total, with some milliseconds for an FMU or a DBC."""


@pytest.mark.parametrize("share", family([10, 1]), ids=lambda share: f"one in {share}")
@pytest.mark.parametrize("name", TARGETS)
def test_every_input_gives_a_value_or_a_documented_exception(name: str, share: int) -> None:
    inputs = INPUTS[name] // share
    found = run(TARGETS[name], 0, inputs)
    assert not found.faults, str(found)
    assert found.inputs == inputs
    rejected = {error.__name__ for error in TARGETS[name].allowed}
    assert (
        sum(count for outcome, count in found.outcomes.items() if outcome not in rejected)
        > 0.02 * found.inputs
    ), f"too few inputs pass the first check\n{found}"


@pytest.mark.benchmark
@pytest.mark.parametrize("name", ["can", "cdr", "attachment", "scenario", "recover"])
def test_a_million_inputs(name: str) -> None:
    found = run_in_processes(name, 0, 1_000_000, 2)
    print(f"\n{found}")
    assert not found.faults, str(found)
    assert found.inputs == 1_000_000


def test_the_same_seed_gives_the_same_input() -> None:
    for target in TARGETS.values():
        assert [target.input(seed) for seed in range(20)] == [
            target.input(seed) for seed in range(20)
        ]
        assert len({target.input(seed) for seed in range(200)}) > 100


def _faulty(data: bytes) -> str:
    """Show each kind of fault for one input in fifty."""
    kind = data[0] % 50
    if kind == 0:
        raise KeyError("not documented")
    if kind == 1:
        assert data[0] > 255, "an invalid value"
    if kind == 2:
        while True:
            pass
    if kind == 3:
        raise ValueError
    return "value"


def test_a_campaign_finds_wrong_exceptions_invalid_values_hangs_and_growth() -> None:
    faulty = Target(
        name="faulty",
        generate=lambda rng: rng.randbytes(4),
        call=_faulty,
        allowed=(ValueError,),
        time_limit=0.05,
        growth=64,
    )
    found = run(faulty, 0, 200)
    what = " ".join(fault.what for fault in found.faults)
    assert "KeyError: 'not documented'" in what
    assert "AssertionError: an invalid value" in what
    assert "no answer within 0.05 s" in what
    assert found.outcomes["ValueError"] > 0
    fault = next(fault for fault in found.faults if "KeyError" in fault.what)
    assert faulty.input(fault.seed) == fault.data
    with pytest.raises(KeyError):
        one(faulty, fault.data)
    grown = Target(
        name="grown", generate=lambda _: b"\x03", call=lambda _: _grow(), allowed=(), growth=64
    )
    try:
        assert "the process has grown" in run(grown, 0, 1000).faults[-1].what
    finally:
        _kept.clear()


_kept: list[bytes] = []


def _grow() -> str:
    _kept.append(b"x" * (1 << 20))
    return "value"


def test_a_hang_is_not_an_exception_that_the_code_under_test_can_catch() -> None:
    assert not issubclass(Hang, Exception)
