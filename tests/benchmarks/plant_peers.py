"""The plant's step in MuJoCo and Pinocchio, looped in C or C++ with RK4 steps of 1 ms.

The robot is the same, without gravity, contacts and joint limits.
"""

from __future__ import annotations

import shutil
import subprocess
import time
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from freeflyer_fmus.robot.robot import Array, Inertial, Robot

BASE_VELOCITY = (0.1, -0.2, 0.3, 0.05, 0.1, -0.1)
JOINT_VELOCITY = 0.1


def merged_bodies(robot: Robot) -> list[Inertial]:
    """Return the base with its fixed bodies, then the moving bodies; the last contains the tool."""
    tool = robot.tool.seen_from(robot.end_effector_rotation, robot.end_effector_translation)
    return [
        robot.base.merged_with(robot.base_attachment),
        *robot.bodies[:-1],
        robot.bodies[-1].merged_with(tool),
    ]


class MuJoCo:
    def __init__(self, robot: Robot) -> None:
        self.mujoco: Any = pytest.importorskip(
            "mujoco", reason="the benchmark extra is not installed"
        )
        spec = self.mujoco.MjSpec()
        spec.option.timestep = 1e-3
        spec.option.gravity = [0, 0, 0]
        spec.option.integrator = self.mujoco.mjtIntegrator.mjINT_RK4
        bodies = merged_bodies(robot)
        body = spec.worldbody.add_body(name="base")
        self._give(body, bodies[0])
        body.add_freejoint()
        for joint, inertial in zip(robot.joints, bodies[1:], strict=True):
            orientation = np.zeros(4)
            self.mujoco.mju_mat2Quat(orientation, np.ascontiguousarray(joint.rotation).ravel())
            body = body.add_body(name=joint.name, pos=joint.translation, quat=orientation)
            self._give(body, inertial)
            kind = (
                self.mujoco.mjtJoint.mjJNT_HINGE
                if joint.kind == "revolute"
                else self.mujoco.mjtJoint.mjJNT_SLIDE
            )
            body.add_joint(type=kind, axis=[0, 0, 1])
        self.model = spec.compile()
        self.data = self.mujoco.MjData(self.model)
        self.data.qpos[7:] = robot.posture
        self.data.qvel[:6] = BASE_VELOCITY  # identity orientation: body axes = axes of I
        self.data.qvel[6:] = JOINT_VELOCITY
        self.mujoco.mj_forward(self.model, self.data)
        self.acceleration = np.array(self.data.qacc)
        """Accelerations at the start: x_b'' (6) in frame I, q'' (n)."""

    @staticmethod
    def _give(body: Any, inertial: Inertial) -> None:
        m = inertial.inertia
        body.mass, body.ipos = inertial.mass, inertial.centre_of_mass
        body.fullinertia = [m[0, 0], m[1, 1], m[2, 2], m[0, 1], m[0, 2], m[1, 2]]
        body.explicitinertial = True

    def step_time(self) -> float:
        """Microseconds, the best of some runs."""
        best = np.inf
        for _ in range(7):
            start = time.perf_counter()
            self.mujoco.mj_step(self.model, self.data, nstep=5_000)
            best = min(best, (time.perf_counter() - start) / 5_000 * 1e6)
        return float(best)


class Pinocchio:
    """pinocchio_steps.cpp, compiled with `flags`, which takes 90 s."""

    def __init__(self, robot: Robot, directory: Path, *flags: str) -> None:
        # Pinocchio, Eigen and the compiler are optional.
        pin = pytest.importorskip("pinocchio")
        try:
            eigen = Path(
                str(distribution("cmeel-eigen").locate_file("cmeel.prefix/include/eigen3"))
            )
        except PackageNotFoundError:
            pytest.skip("the benchmark extra is not installed")
        compiler = shutil.which("g++") or pytest.skip("there is no g++ on this machine")
        prefix = Path(pin.__file__).parents[4]
        self.program = directory / "pinocchio_steps"
        # Pinocchio has more joint types than Boost's default limit of a list.
        defined = [
            "-DNDEBUG",
            "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
            "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
        ]
        included = ["-isystem", str(prefix / "include"), "-isystem", str(eigen)]
        linked = [
            f"-L{prefix / 'lib'}",
            "-lpinocchio_default",
            f"-Wl,-rpath,{prefix / 'lib'}",
            "-o",
            str(self.program),
        ]
        source = Path(__file__).parent / "pinocchio_steps.cpp"
        subprocess.run(
            [compiler, "-std=c++17", *flags, *defined, *included, str(source), *linked], check=True
        )
        # The program reads the robot and its start state as numbers.
        bodies = [[b.mass, *b.centre_of_mass, *b.inertia.ravel()] for b in merged_bodies(robot)]
        numbers = [robot.joint_count, *bodies[0]]
        for joint, body in zip(robot.joints, bodies[1:], strict=True):
            numbers += [
                joint.kind == "revolute",
                *joint.rotation.ravel(),
                *joint.translation,
                *body,
            ]
        numbers += [
            0,
            0,
            0,
            0,
            0,
            0,
            1,
            *robot.posture,
            *BASE_VELOCITY,
            *[JOINT_VELOCITY] * robot.joint_count,
        ]
        self.numbers = " ".join(repr(float(number)) for number in numbers)
        a = np.array(self._run(1)[:-2])
        # From the spatial acceleration to that of the origin; the base's axes are those of I here.
        linear = a[:3] + np.cross(BASE_VELOCITY[3:], BASE_VELOCITY[:3])
        self.acceleration: Array = np.concatenate([linear, a[3:]])

    def _run(self, count: int) -> list[float]:
        done = subprocess.run(
            [str(self.program), str(count)],
            input=self.numbers,
            capture_output=True,
            text=True,
            check=True,
        )
        return [float(word) for word in done.stdout.split()]

    def step_time(self) -> float:
        """Microseconds, the best of some runs."""
        return self._run(5_000)[-2]
