"""Conservation laws of the plant FMU: energy and momenta without inputs, work with inputs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from freeflyer.fmi.fmu import FmuComponent

STEP = 1e-3


def free_start(seed: int = 7, speed: float = 1.0) -> dict[str, np.ndarray]:
    """Return a start in which every axis moves: joints 0.1 rad/s rms, base 0.01 m/s, 0.01 rad/s.

    All velocities are multiplied by `speed`.
    """
    random = np.random.default_rng(seed)

    def of_norm(size: int, norm: float) -> np.ndarray:
        v = random.uniform(0.3, 1.0, size) * random.choice([-1.0, 1.0], size)
        return v / np.linalg.norm(v) * norm

    return {
        "base_position": np.array([0.3, -0.2, 0.1]),
        "base_orientation": Rotation.from_rotvec([0.2, -0.1, 0.3]).as_quat(),
        "base_velocity": speed * np.concatenate([of_norm(3, 0.01), of_norm(3, 0.01)]),
        "joint_velocity": speed * of_norm(6, 0.1 * np.sqrt(6)),
    }


def drift(
    path: Path,
    steps: int,
    every: int,
    *,
    seed: int = 7,
    speed: float = 1.0,
    integration_step: float = STEP,
    communication_step: float = STEP,
) -> dict[str, float]:
    """Return the largest change of each conserved quantity, relative to its initial value.

    The quantities are read after every `every` communication steps.
    """
    plant = FmuComponent("free_flyer", path)
    try:
        start = free_start(seed, speed) | {"integration_step": np.array([integration_step])}
        plant.enter_initialization(0.0, start)
        plant.exit_initialization()
        buffer = np.zeros(7)
        read = plant.bind_outputs(["kinetic_energy", "linear_momentum", "angular_momentum"], buffer)
        read()
        first = buffer.copy()
        assert (np.abs(first) > 1e-4).all(), "the relative drift of zero is undefined"
        worst = np.zeros(7)
        for k in range(steps):
            plant.step(k * communication_step, communication_step)
            if (k + 1) % every == 0:
                read()
                np.maximum(worst, np.abs(buffer - first), out=worst)
        return {
            "energy": worst[0] / first[0],
            "linear momentum": np.linalg.norm(worst[1:4]) / np.linalg.norm(first[1:4]),
            "angular momentum": np.linalg.norm(worst[4:]) / np.linalg.norm(first[4:]),
        }
    finally:
        plant.close()


def test_energy_and_momenta_are_conserved_for_100_s_without_inputs(fmus: Path) -> None:
    for seed in (7, 1, 2, 3, 4):
        found = drift(fmus / "fmi2" / "free_flyer.fmu", 100_000, 500, seed=seed)
        for quantity, change in found.items():
            assert change <= 2.5e-14, f"{quantity} drifts by {change:.1e} with seed {seed}"


def test_the_drift_depends_on_step_and_speed_only_by_their_product(fmus: Path) -> None:
    """drift(h, v, t) = f(h v, v t): without inputs, the motion has no time scale of its own."""
    path = fmus / "fmi2" / "free_flyer.fmu"
    slow = drift(path, 10_000, 100, speed=20.0)
    fast = drift(path, 10_000, 100, speed=40.0, integration_step=5e-4, communication_step=5e-4)
    assert slow["energy"] > 1e-11
    for quantity, change in slow.items():
        assert fast[quantity] == pytest.approx(change, rel=1e-2, abs=1e-14)


def test_a_shorter_integration_step_keeps_the_drift_of_fast_joints_below_1e_12(fmus: Path) -> None:
    """At 1 rad/s rms, 1 ms is too long; the longest seed of tests/benchmarks/drift.py."""
    path = fmus / "fmi3" / "free_flyer.fmu"
    coarse = drift(path, 100_000, 500, seed=1, speed=10.0)
    fine = drift(path, 100_000, 500, seed=1, speed=10.0, integration_step=1e-4)
    assert max(coarse.values()) > 1e-10
    assert max(fine.values()) < 1e-12


@pytest.mark.benchmark
def test_drift_over_1000_s_without_inputs(fmus: Path) -> None:
    """The base has moved 11 m, so 2e-14 of linear momentum become 4e-13 of angular momentum."""
    found = drift(fmus / "fmi2" / "free_flyer.fmu", 1_000_000, 1000)
    print(
        "drift over 1000 s:",
        ", ".join(f"{quantity} {change:.1e}" for quantity, change in found.items()),
    )
    assert found["energy"] <= 1e-13
    assert found["linear momentum"] <= 1e-13
    assert found["angular momentum"] <= 1e-12


def test_work_of_held_wrench_and_torques_is_the_change_of_kinetic_energy(fmus: Path) -> None:
    """The work of a held force is exactly F (x(k) - x(k-1)); for rotations, x' is w."""
    plant = FmuComponent("free_flyer", fmus / "fmi2" / "free_flyer.fmu")
    try:
        plant.enter_initialization(0.0, free_start())
        plant.exit_initialization()
        u, y = np.zeros(12), np.zeros(20)
        write = plant.bind_inputs(["base_wrench", "joint_torque"], u)
        read = plant.bind_outputs(
            [
                "base_position",
                "base_orientation",
                "joint_position",
                "base_velocity",
                "kinetic_energy",
            ],
            y,
        )
        read()
        before = y.copy()
        initial = y[-1]
        random = np.random.default_rng(11)
        work, moved = 0.0, 0.0
        for k in range(5000):
            if k % 10 == 0:
                u[:] = random.normal(size=12) * ([5.0] * 6 + [0.5] * 6)
            write()
            plant.step(k * STEP, STEP)
            read()
            # To third order, the rotation vector is the integral of w.
            rotation = Rotation.from_quat(y[3:7]) * Rotation.from_quat(before[3:7]).inv()
            change = np.concatenate(
                [y[:3] - before[:3], rotation.as_rotvec(), y[7:13] - before[7:13]]
            )
            work += u @ change
            moved += abs(u @ change)
            before[:] = y
        assert moved > 1.0
        assert abs(work - (y[-1] - initial)) <= 1e-9 * moved
    finally:
        plant.close()
