"""Speed of FMUs and builds, as ratios within one run. Run with: pytest -m benchmark -n 0 -s"""

from __future__ import annotations

import subprocess
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmpy import read_model_description
from plant_peers import BASE_VELOCITY, JOINT_VELOCITY, MuJoCo, Pinocchio

from freeflyer_fmus.blocks.block import Block, Variable
from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.export.archive import build_all
from freeflyer_fmus.export.compiler import compiler, fmi_headers, host_platform, run
from freeflyer_fmus.export.layout import layout
from freeflyer_fmus.robot.robot import Array, Robot

pytestmark = pytest.mark.benchmark


def step_times(fmus: Path, tmp_path: Path, block: Block, step: float) -> list[float]:
    """Return three times per step [us], measured by a C program.

    They are doStep; set inputs, step and get all outputs; the same with the outputs of terminals.
    """
    program = tmp_path / "time_steps"
    if not program.exists():
        source = Path(__file__).parent / "time_steps.c"
        zig = compiler(host_platform(), "-std=c99", "-O2", "-isystem", str(fmi_headers()))
        run([*zig, str(source), "-ldl", "-o", str(program)], "time_steps")
    path = fmus / "fmi2" / f"{block.name}.fmu"
    with zipfile.ZipFile(path) as archive:
        library = next(entry for entry in archive.namelist() if entry.startswith("binaries/"))
        archive.extract(library, tmp_path)
    token = read_model_description(str(path)).guid
    first = layout(block).reference

    def references(variables: list[Variable]) -> str:
        return ",".join(str(first[v.name] + i) for v in variables for i in range(v.size)) or "-"

    outputs = [variable for variable in block.having("output", "state") if not variable.local]
    members = {name for group in block.terminals.values() for name in group.values()}
    lists = [
        references(block.having("input")),
        references(outputs),
        references([v for v in outputs if v.name in members]),
    ]
    command = [str(program), str(tmp_path / library), token, str(step), "10000", *lists]
    return [
        float(part)
        for part in subprocess.run(
            command, capture_output=True, text=True, check=True
        ).stdout.split()
    ]


def ours_at_the_start(robot: Robot) -> Array:
    block = BLOCKS["free_flyer"](robot)
    x = dict(zip([v.name for v in block.having("state")], block.having("state"), strict=True))
    start = {name: np.array(variable.start) for name, variable in x.items()}
    start["base_velocity"] = np.array(BASE_VELOCITY)
    start["joint_velocity"] = np.full(robot.joint_count, JOINT_VELOCITY)
    given = [
        0.0,
        block.start_values("parameter"),
        block.start_values("input"),
        np.concatenate(list(start.values())),
    ]
    rates = np.array(block.functions["derivatives"](*given)).ravel()
    first = {name: block.offset(name) for name in start}
    return np.concatenate(
        [rates[first[name] :][: start[name].size] for name in ("base_velocity", "joint_velocity")]
    )


def test_step_times_of_the_fmus(fmus: Path, robot: Robot, tmp_path: Path) -> None:
    """Time doStep and a master's cycle: set inputs, step, get all outputs or those of terminals."""
    steps = {
        "free_flyer": 1e-3,
        "reference_trajectory": 1e-3,
        "manipulator_controller": 1e-3,
        "base_controller": 0.3,
    }
    times = {
        name: step_times(fmus, tmp_path, BLOCKS[name](robot), step) for name, step in steps.items()
    }
    print(f"\n{'us':24s} doStep  set, step, get all  set, step, get connected")
    for name, (alone, everything, connected) in times.items():
        print(f"{name:24s} {alone:6.2f} {everything:19.2f} {connected:25.2f}")
    cycle = np.sum([time for name, time in times.items() if name != "base_controller"], axis=0)
    print(f"{'each millisecond':24s} {cycle[0]:6.2f} {cycle[1]:19.2f} {cycle[2]:25.2f}")


def test_the_plant_is_faster_than_mujoco_and_pinocchio(
    fmus: Path, robot: Robot, tmp_path: Path
) -> None:
    peers = {"MuJoCo": MuJoCo(robot), "Pinocchio, C++ -O2": Pinocchio(robot, tmp_path, "-O2")}
    expected = ours_at_the_start(robot)
    for peer in peers.values():  # the robot is the same
        np.testing.assert_allclose(
            peer.acceleration, expected, rtol=0, atol=1e-9 * np.abs(expected).max()
        )
    times = {"ours": np.inf} | dict.fromkeys(peers, np.inf)
    for _ in range(3):  # alternately, because the speed of the machine varies
        times["ours"] = min(
            times["ours"], step_times(fmus, tmp_path, BLOCKS["free_flyer"](robot), 1e-3)[0]
        )
        for name, peer in peers.items():
            times[name] = min(times[name], peer.step_time())
    print("\nRK4 step of 1 ms, same robot")
    for name, value in times.items():
        print(f"{name:24s} {value:6.2f} us, {value / times['ours']:4.1f} times ours")
    assert min(times[name] for name in peers) > 3.0 * times["ours"]


def test_build_and_size_of_all_fmus(robot: Robot, tmp_path: Path) -> None:
    """Build all blocks for this machine on all cores, after the compiler's own libraries."""
    list(build_all([BLOCKS["reference_trajectory"](robot)], tmp_path / "before"))
    start = time.perf_counter()
    made = list(build_all([make(robot) for make in BLOCKS.values()], tmp_path / "fmus"))
    wall = time.perf_counter() - start
    largest = max((path.stat().st_size, path.name) for _, paths in made for path in paths.values())
    print(
        f"\n{len(made)} blocks, both FMI versions: {wall:.1f} s; the largest is {largest[1]} with {largest[0] / 1e3:.0f} kB"
    )
