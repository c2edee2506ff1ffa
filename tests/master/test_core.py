"""The native core and the Python master make the same calls and give bit-identical records."""

from __future__ import annotations

import shutil
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import freeflyer
from freeflyer.fmi.component import Port, PythonComponent
from freeflyer.foundation.errors import ComponentError
from freeflyer.master import graph, native, schedule
from freeflyer.master.connection import Connection
from freeflyer.master.divergence import Limit
from freeflyer.master.master import Master, Outcome
from freeflyer.scenario import experiment, scenario
from freeflyer.scenario.assemble import assembled
from freeflyer.scenario.experiment import Engine

MS = 1_000_000
CORE = Path(freeflyer.__path__[0]) / "master" / "core"


def outcome(name: str, engine: Engine, *overrides: str, fmi: int = 2) -> Outcome:
    return experiment.run(scenario.load(name, overrides), fmi=fmi, engine=engine).outcome


def assert_equal(one: Outcome, other: Outcome) -> None:
    assert one.record.rows == other.record.rows
    assert np.array_equal(one.record.time, other.record.time)
    for signal in one.record.signals:
        assert one.record[signal].tobytes() == other.record[signal].tobytes(), signal
    ends = [
        (o.simulated, o.steps, o.diverged, o.failed, o.cause, o.interrupted) for o in (one, other)
    ]
    assert ends[0] == ends[1]


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("multirate_passive", ("stop_s=2.0",)),
        ("multirate_passive", ("stop_s=1.0", "exchange=parallel")),
        ("multirate_passive", ("stop_s=1.0", "record.every_s=0.001")),
        (
            "multirate_passive",
            ("stop_s=1.0", "base_controller.step_s=0.001", "record.every_s=0.25"),
        ),
        ("multirate_passive", ("stop_s=1.0", 'record.signals=["*_controller.*damping"]')),
        (
            "multirate_unstable",
            ("base_controller.period=0.5", "base_controller.damping=400"),
        ),  # diverges by a limit
        (
            "multirate_unstable",
            ("manipulator_controller.singularity_threshold=0.1866",),
        ),  # stops by a failed step
        ("facility", ("stop_s=0.5",)),
        ("continuous", ("stop_s=0.3",)),  # one component is not a co-simulation FMU
    ],
)
def test_both_masters_give_bit_identical_records(
    name: str, overrides: tuple[str, ...], fmi: int
) -> None:
    assert_equal(*(outcome(name, engine, *overrides, fmi=fmi) for engine in ("core", "python")))


@pytest.mark.parametrize("component", ["base_controller", "free_flyer"])
def test_both_masters_agree_with_an_in_process_block_among_fmus(
    tmp_path: Path, component: str
) -> None:
    path = tmp_path / "mixed.toml"
    path.write_text(
        f'extends = "multirate_passive"\nstop_s = 0.7\n[components.{component}]\nkind = "twin"\n'
    )
    assert_equal(*(outcome(str(path), engine) for engine in ("core", "python")))


class Noisy(PythonComponent):
    """A component whose outputs depend on all earlier inputs and their times.

    The component counts the calls of `advance` and fails at call number `fails_at`.
    """

    def __init__(self, name: str, size: int, sampled: bool, fails_at: int) -> None:
        def port(name: str, causality: str) -> Port:
            return Port(
                name=name,
                size=size,
                causality=causality,
                units=("m",) * size,
                start=(0.5,) * size,
                sampled=sampled and name == "y",
            )

        super().__init__(
            name, [port("u", "input"), port("v", "input"), port("y", "output"), port("z", "output")]
        )
        self.fails_at, self.calls = fails_at, 0

    def advance(self, time: float, size: float) -> None:
        self.calls += 1
        if self.calls == self.fails_at:
            raise ValueError("out of order")
        y, u, v = self.values["y"], self.values["u"], self.values["v"]
        y[:] = np.sin(3.0 * y + u - 0.5 * v[::-1] + time + 7.0 * size)
        self.values["z"][:] = y**2


@st.composite
def systems(
    draw: st.DrawFn,
) -> tuple[
    list[tuple[int, bool, int, int]], list[tuple[int, int, str, bool]], int, int, float, int
]:
    """Draw a system of components.

    The tuple contains the components (size, sampled, fails at, step), the connections (from, to,
    input, delayed), the stop time, the recording interval, and the bound and the duration of the
    limits.
    """
    size = draw(st.integers(1, 3))
    count = draw(st.integers(1, 5))
    steps = [draw(st.sampled_from((1, 2, 3, 5, 7))) for _ in range(count)]
    steps[draw(st.integers(0, count - 1))] = 1
    fails = st.sampled_from((0, 0, 0, 0, 2, 9))
    components = [(size, draw(st.booleans()), draw(fails), step) for step in steps]
    wires = []
    for target in range(count):
        for variable in "uv":
            source = draw(st.integers(-1, count - 1))
            if source >= 0:
                # A connection from a component to itself or to an earlier one is delayed. Therefore
                # there are no algebraic loops.
                wires.append((source, target, variable, source >= target or draw(st.booleans())))
    return (
        components,
        wires,
        draw(st.integers(1, 60)),
        draw(st.sampled_from((1, 3, 10))),
        draw(st.floats(0.9, 1.1)),
        draw(st.integers(0, 3)),
    )


def build(system: tuple) -> tuple[Master, dict[str, Noisy]]:
    kinds, wires, stop, every, bound, patience = system
    components = {
        f"c{i}": Noisy(f"c{i}", size, sampled, fails)
        for i, (size, sampled, fails, _) in enumerate(kinds)
    }
    connections = [
        Connection(source=f"c{a}.y", target=f"c{b}.{v}", delayed=delayed)
        for a, b, v, delayed in wires
    ]
    samples = {name: kinds[i][1] for i, name in enumerate(components)}
    plan = schedule.build(
        {f"c{i}": kind[3] * MS for i, kind in enumerate(kinds)},
        stop * MS,
        every * MS,
        dict.fromkeys(components, True),
    )
    limits = [
        Limit(signal="c0.y", bound=bound, cause="far", lasting=patience * MS),
        Limit(signal="c0.z", bound=bound, cause="long", euclidean=True, lasting=MS),
        Limit(signal="c0.y", bound=-bound, cause="low", is_minimum=True, lasting=patience * MS),
    ]
    master = Master(graph.build(components, connections, samples), plan, limits)
    master.initialise({})
    return master, components


@given(systems())
@settings(max_examples=150)
def test_both_masters_agree_on_random_systems(system: tuple) -> None:
    (one, mine), (other, theirs) = build(system), build(system)
    ends: list[Outcome | str] = []
    for run in (one.run, lambda: native.run(other)):
        try:
            ends.append(run())
        except ComponentError as error:  # a failure at instant 0 has no outcome
            ends.append(str(error))
    if isinstance(ends[0], str) or isinstance(ends[1], str):
        assert ends[0] == ends[1]
    else:
        assert_equal(ends[0], ends[1])
    assert [c.calls for c in mine.values()] == [c.calls for c in theirs.values()]


@pytest.mark.parametrize("norm", ["maximum", "euclidean"])
@pytest.mark.parametrize("bound", ["1e200", "inf"])
def test_a_limit_whose_square_overflows_is_never_exceeded(
    tmp_path: Path, norm: str, bound: str
) -> None:
    path = tmp_path / "far.toml"
    limit = f"[[limits]]\nsignal = 'free_flyer.base_velocity'\nmaximum = {bound}\nnorm = '{norm}'\n"
    path.write_text(f"extends = 'multirate_passive'\nstop_s = 0.05\n{limit}")
    ends = [outcome(str(path), engine) for engine in ("core", "python")]
    assert_equal(*ends)
    assert ends[0].cause is None


def test_the_native_core_reports_progress_and_releases_the_gil() -> None:
    seen: list[float] = []
    counted = [0]
    done = threading.Event()

    def count() -> None:
        while not done.is_set():
            counted[0] += 1

    with assembled(scenario.load("multirate_passive", ["stop_s=20"])) as (master, _):
        other = threading.Thread(target=count)
        other.start()
        try:
            result = native.run(master, seen.append)
        finally:
            done.set()
            other.join()
    assert not result.diverged
    assert seen == sorted(seen)
    assert seen
    assert 0.0 < seen[0] < 20.0
    assert counted[0] > 1000


def test_another_thread_can_end_a_run() -> None:
    with assembled(scenario.load("multirate_passive", ["stop_s=2000", "record.every_s=0.1"])) as (
        master,
        _,
    ):
        run = native.Run(master)
        threading.Timer(0.3, run.cancel).start()
        start = time.perf_counter()
        ended = run.run(None)
    assert time.perf_counter() - start < 30.0
    assert ended.interrupted
    assert 0.0 < ended.simulated < 2000.0
    assert ended.record.time[-1] == ended.simulated


def test_a_run_too_long_for_exact_times_is_rejected() -> None:
    with (
        assembled(scenario.load("multirate_passive", ["stop_s=2e7", "record.every_s=1000"])) as (
            master,
            _,
        ),
        pytest.raises(ComponentError, match=r"too long for the native core.*--master python"),
    ):
        native.run(master)


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_the_native_core_passes_the_sanitizers_and_compiles_without_warnings(
    tmp_path: Path, compiler: str
) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    probe = [
        compiler,
        "-fsanitize=address,undefined",
        "-x",
        "c",
        "-",
        "-o",
        str(tmp_path / "probe"),
    ]
    if (
        subprocess.run(
            probe, input=b"int main(void) { return 0; }", capture_output=True, check=False
        ).returncode
        != 0
    ):
        pytest.skip(
            f"{compiler} has no sanitizers on this machine (Debian: libclang-rt-dev for clang)"
        )
    program = tmp_path / "core_alone"
    sources = [str(Path(__file__).parent / "core_alone.c"), *map(str, sorted(CORE.glob("*.c")))]
    flags = [
        "-std=c99",
        "-O1",
        "-g",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-pedantic",
        "-fsanitize=address,undefined",
    ]
    subprocess.run(
        [compiler, *flags, "-I", str(CORE), *sources, "-lm", "-o", str(program)], check=True
    )
    done = subprocess.run([str(program), "300"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_native_core_has_at_most_500_lines() -> None:
    assert sum(len(path.read_text().splitlines()) for path in CORE.glob("*.[ch]")) <= 500
