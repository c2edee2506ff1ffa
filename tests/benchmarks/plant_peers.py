"""The plant's step by others: the same robot without gravity, contacts and joint limits, RK4 of 1 ms, looped in C or C++."""

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
    """The base with what is welded to it, then the bodies; the tool is part of the last."""
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
            turn = np.zeros(4)
            self.mujoco.mju_mat2Quat(turn, np.ascontiguousarray(joint.rotation).ravel())
            body = body.add_body(name=joint.name, pos=joint.translation, quat=turn)
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
        self.data.qvel[:6] = BASE_VELOCITY  # at the identity orientation body axes are I's
        self.data.qvel[6:] = JOINT_VELOCITY
        self.mujoco.mj_forward(self.model, self.data)
        self.acceleration = np.array(self.data.qacc)
        """x_b'' (6, in I), q'' (n) at the start."""

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
            begin = time.perf_counter()
            self.mujoco.mj_step(self.model, self.data, nstep=5_000)
            best = min(best, (time.perf_counter() - begin) / 5_000 * 1e6)
        return float(best)


class Pinocchio:
    """pinocchio_steps.cpp, compiled with `flags`: one and a half minutes of templates."""

    def __init__(self, robot: Robot, directory: Path, *flags: str) -> None:
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
        # Its joints are more than Boost's list has room for by default.
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
        # Of the origin, from the spatial one; the base's axes are I's here.
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
