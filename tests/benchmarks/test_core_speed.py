"""Cost of the master, compared with the FMUs and with other masters in one run.

Run with: pytest -m benchmark -n 0 -s
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from test_speed import step_times

import freeflyer
from freeflyer.scenario import experiment, scenario
from freeflyer.scenario.experiment import Engine
from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.robot.robot import Robot

pytestmark = pytest.mark.benchmark
HERE = Path(__file__).parent
CORE = Path(freeflyer.__path__[0]) / "master" / "core"


def wall(engine: Engine, *changes: str, fmi: int = 2) -> float:
    """Return the wall time [s] of 100 s of multirate_passive with all outputs every 10 ms."""
    return experiment.run(
        scenario.load("multirate_passive", changes), engine=engine, fmi=fmi
    ).outcome.wall


def best(measure: Callable[[], float], times: int = 5) -> float:
    return min(measure() for _ in range(times))


def test_cost_of_the_native_core_with_trivial_slaves(tmp_path: Path) -> None:
    program = tmp_path / "core_alone"
    sources = [str(HERE.parent / "master" / "core_alone.c"), *map(str, sorted(CORE.glob("*.c")))]
    subprocess.run(
        ["gcc", "-std=c99", "-O2", "-I", str(CORE), *sources, "-lm", "-o", str(program)], check=True
    )
    done = subprocess.run([str(program), "200000"], capture_output=True, text=True, check=True)
    without, tenth, every = map(float, done.stdout.split())
    print(
        f"\ncore, step of a trivial slave with 8 inputs and 8 outputs: {without:.0f} ns; with all outputs recorded at every tenth "
        f"instant: {tenth:.0f} ns, at every instant: {every:.0f} ns"
    )


def test_cost_of_multirate_passive_relative_to_its_fmus_and_to_the_python_master(
    fmus: Path, robot: Robot, tmp_path: Path
) -> None:
    each = [
        step_times(fmus, tmp_path, BLOCKS[name](robot), 1e-3)
        for name in ("free_flyer", "reference_trajectory", "manipulator_controller")
    ]
    # The base controller's step every 300 ms is neglected.
    alone, _, cycle = (0.1 * sum(times) for times in zip(*each, strict=True))
    core, core3, python = (
        best(lambda: wall("core")),
        best(lambda: wall("core", fmi=3)),
        best(lambda: wall("python"), 2),
    )
    print(
        f"\nmultirate_passive, 100 s, all outputs every 10 ms: {core:.3f} s, {100 / core:.0f} times real time"
    )
    print(
        f"  {core / alone:.2f} times the sum of the FMUs' doStep, {alone:.3f} s, measured separately; FMI 3.0: {core3:.3f} s"
    )
    print(
        f"  {core / cycle:.2f} times the sum of: set connected inputs, doStep, get connected outputs, {cycle:.3f} s"
    )
    print(f"  --master python: {python:.2f} s, {python / core:.1f} times as long")
    assert core < python


def per_second(run: Callable[[float], object]) -> float:
    """Return the wall time per simulated second, without loading and initialisation."""

    def spent(stop: float) -> float:
        start = time.perf_counter()
        run(stop)
        return time.perf_counter() - start

    return (best(lambda: spent(12.0), 3) - best(lambda: spent(2.0), 3)) / 10.0


def container_per_second(sequential: bool) -> float:
    """Return the wall time per simulated second of an FMU container in steps of 100 ms."""
    import container_peer
    from masters import PEERS, arguments
    from slaves import Slave

    peer = PEERS["container, sequential" if sequential else "container, parallel"]
    connections, values, steps, *_ = arguments(0.001, 1.0, moving=False)
    with tempfile.TemporaryDirectory() as folder:
        path, first = container_peer.build(
            Path(folder), peer.fmus(2, 0.001), connections, values, steps, (), sequential=sequential
        )
        container = Slave("loop", path, validate=False)
        container.enter_initialization(first)
        container.exit_initialization()
        start = time.perf_counter()
        for k in range(100):
            container.step(k * 0.1, 0.1)
        spent = time.perf_counter() - start
        container.close()
    return spent / 10.0


def test_the_native_core_is_faster_than_other_masters(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every slave has a step of 1 ms, which all masters support. The others record nothing."""
    for name in ("libcosimpy", "ecospy", "fmu_manipulation_toolbox"):
        pytest.importorskip(name, reason="the peers extra is not installed")
    monkeypatch.syspath_prepend(str(HERE.parent / "peers"))
    from masters import PEERS, arguments

    every = ("base_controller.step_s=0.001",)
    walls = {"ours, core": best(lambda: wall("core", *every), 3) / 100.0}
    for sequential in (False, True):
        name = f"container, {'sequential' if sequential else 'parallel'}"
        walls[name] = best(lambda sequential=sequential: container_per_second(sequential), 3)  # type: ignore[misc]
    for name in ("ecos", "libcosim"):
        peer = PEERS[name]

        def run(stop: float, peer=peer) -> object:  # type: ignore[no-untyped-def]
            connections, values, steps, stop, _ = arguments(0.001, stop, moving=False)
            return peer.run(peer.fmus(2, 0.001), connections, values, steps, stop, ())

        walls[name] = per_second(run)
    walls["ours, python"] = best(lambda: wall("python", *every), 2) / 100.0
    print("\n| master | us per simulated ms | times ours |\n|---|---|---|")
    for name, value in walls.items():
        print(f"| {name} | {value * 1e3:.2f} | {value / walls['ours, core']:.1f} |")
    sys.stdout.flush()
    assert walls["ours, core"] < min(walls[name] for name in walls if name != "ours, core")
