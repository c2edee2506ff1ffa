"""Speed, printed as ratios taken in one run. Run with: pytest -m benchmark -n 0 -s"""

from __future__ import annotations

import subprocess
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmpy import read_model_description

from cosim import experiment, scenario
from fmu_src.export.archive import build_all
from fmu_src.export.compiler import compiler, fmi_headers, host_platform, run
from fmu_src.robot import Robot
from fmu_src.shipped import BLOCKS

pytestmark = pytest.mark.benchmark


def step_time(fmus: Path, tmp_path: Path, name: str, step: float) -> float:
    """Microseconds a doStep, measured by a C program."""
    program = tmp_path / "time_steps"
    if not program.exists():
        source = Path(__file__).parent / "time_steps.c"
        zig = compiler(host_platform(), "-std=c99", "-O2", "-isystem", str(fmi_headers()))
        run([*zig, str(source), "-ldl", "-o", str(program)], "time_steps")
    path = fmus / "fmi2" / f"{name}.fmu"
    with zipfile.ZipFile(path) as archive:
        library = next(entry for entry in archive.namelist() if entry.startswith("binaries/"))
        archive.extract(library, tmp_path)
    token = read_model_description(str(path)).guid
    done = subprocess.run(
        [str(program), str(tmp_path / library), token, str(step), "50000"], capture_output=True, text=True, check=True
    )
    return float(done.stdout)


def mujoco_step_time(robot: Robot) -> float:
    """Microseconds an RK4 step of 1 ms of the same robot, without gravity, contacts and joint limits, looped in C."""
    mujoco = pytest.importorskip("mujoco", reason="the benchmark extra is not installed")
    spec = mujoco.MjSpec()
    spec.option.timestep = 1e-3
    spec.option.gravity = [0, 0, 0]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4

    def give(body: object, inertial: object) -> None:
        body.mass = inertial.mass  # type: ignore[attr-defined]
        body.ipos = inertial.centre_of_mass  # type: ignore[attr-defined]
        m = inertial.inertia  # type: ignore[attr-defined]
        body.fullinertia = [m[0, 0], m[1, 1], m[2, 2], m[0, 1], m[0, 2], m[1, 2]]  # type: ignore[attr-defined]
        body.explicitinertial = True  # type: ignore[attr-defined]

    def quaternion(rotation: np.ndarray) -> np.ndarray:
        result = np.zeros(4)
        mujoco.mju_mat2Quat(result, np.ascontiguousarray(rotation).ravel())
        return result

    body = spec.worldbody.add_body(name="base")
    give(body, robot.base.merged_with(robot.base_attachment))
    body.add_freejoint()
    hand = (robot.end_effector_rotation, robot.end_effector_translation)
    for index, (joint, inertial) in enumerate(zip(robot.joints, robot.bodies, strict=True)):
        body = body.add_body(name=joint.name, pos=joint.translation, quat=quaternion(joint.rotation))
        last = index == robot.joint_count - 1
        give(body, inertial.merged_with(robot.tool.seen_from(*hand)) if last else inertial)
        kind = mujoco.mjtJoint.mjJNT_HINGE if joint.kind == "revolute" else mujoco.mjtJoint.mjJNT_SLIDE
        body.add_joint(type=kind, axis=[0, 0, 1])
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[7:] = robot.posture
    data.qvel[6:] = 0.1
    best = np.inf
    for _ in range(5):
        begin = time.perf_counter()
        mujoco.mj_step(model, data, nstep=20_000)
        best = min(best, (time.perf_counter() - begin) / 20_000 * 1e6)
    return float(best)


def test_step_times(fmus: Path, robot: Robot, tmp_path: Path) -> None:
    names = {"free_flyer": 1e-3, "reference_trajectory": 1e-3, "manipulator_controller": 1e-3, "base_controller": 0.3}
    times = {name: step_time(fmus, tmp_path, name, step) for name, step in names.items()}
    theirs = mujoco_step_time(robot)
    print()
    for name, value in times.items():
        print(f"{name:24s} {value:6.2f} us a doStep")
    print(
        f"{'MuJoCo RK4, same robot':24s} {theirs:6.2f} us a step: {theirs / times['free_flyer']:.1f} times the plant's doStep"
    )
    assert times["free_flyer"] < 3.5


def test_multirate_passive_through_fmpy(fmus: Path) -> None:
    result = experiment.run(scenario.load("multirate_passive"))
    print(
        f"\nmultirate_passive, 100 s, python master: {result.outcome.wall:.2f} s, {100.0 / result.outcome.wall:.0f} times real time"
    )
    assert result.outcome.wall < 15.0


def test_build_and_size_of_all_fmus(robot: Robot, tmp_path: Path) -> None:
    """All blocks for this machine, on all cores; the compiler's own parts are built before."""
    list(build_all([BLOCKS["reference_trajectory"](robot)], tmp_path / "before"))
    begin = time.perf_counter()
    made = list(build_all([make(robot) for make in BLOCKS.values()], tmp_path / "fmus"))
    wall = time.perf_counter() - begin
    largest = max((path.stat().st_size, path.name) for _, paths in made for path in paths.values())
    print(f"\n{len(made)} blocks, both FMI versions: {wall:.1f} s; the largest is {largest[1]} with {largest[0] / 1e3:.0f} kB")
    assert wall < 90.0
