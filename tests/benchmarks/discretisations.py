"""Comparison of discretisations of the control law on the loop linearised at the start posture.

Usage: python tests/benchmarks/discretisations.py

Prints the table of docs/matched_gains.md: the share of 400 random gain sets (seed 1) that are
stable. The columns are factors between the base's true mass and inertia and those in the control
law. The inertia is from Pinocchio, not from this project's equations.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.linalg import expm

from freeflyer_fmus.equations.pinocchio_reference import pinocchio_model
from freeflyer_fmus.robot.urdf import load_robot_file

Array = NDArray[np.float64]
T_M = 1e-3
I6, Z6 = np.eye(6), np.zeros((6, 6))
FACTORS = (0.5, 0.67, 0.8, 1.0, 1.25, 1.5)


def loop_inertia(factor: float) -> tuple[Array, Array]:
    """Return M of (6), shape (12, 12), and J_b, shape (6, 6), at the start posture.

    The mass and inertia of the base body are multiplied by `factor`.
    """
    robot = load_robot_file()
    model = pinocchio_model(robot)
    base = model.inertias[1]
    own = pin.Inertia(
        robot.base.mass, np.array(robot.base.centre_of_mass), np.array(robot.base.inertia)
    )
    model.inertias[1] = pin.Inertia(
        base.mass + (factor - 1.0) * own.mass,
        base.lever,
        base.inertia + (factor - 1.0) * own.inertia,
    )
    data = model.createData()
    q = np.concatenate([np.zeros(3), [0.0, 0.0, 0.0, 1.0], robot.posture])
    H = pin.crba(model, data, q)
    H = np.triu(H) + np.triu(H, 1).T
    pin.computeJointJacobians(model, data, q)
    pin.framesForwardKinematics(model, data, q)
    J = pin.getFrameJacobian(model, data, model.getFrameId("end_effector"), pin.LOCAL_WORLD_ALIGNED)
    to_joints = np.block(
        [[I6, Z6], [-np.linalg.solve(J[:, 6:], J[:, :6]), np.linalg.inv(J[:, 6:])]]
    )
    return to_joints.T @ H @ to_joints, J[:, :6]


# Discretisations of the law for one mass matrix. Each returns gains G, shape (6, 12), of -G [x; v].


def emulated(M: Array, K: Array, D: Array, T: float) -> Array:
    return np.hstack([K, D])


def mean(M: Array, K: Array, D: Array, T: float) -> Array:
    """Evaluate the law at the mean state of the period, like the blocks."""
    v = np.linalg.solve(M + T / 2 * D + T * T / 4 * K, np.hstack([-T / 2 * K, M]))
    return K @ (np.hstack([I6, Z6]) + T / 2 * v) + D @ v


def matched_poles(M: Array, K: Array, D: Array, T: float) -> Array:
    """Match the poles and modes of the sampled loop to exp(S T) of the continuous, coupled loop."""
    S = np.block([[Z6, I6], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    step, top = expm(S * T), np.hstack([I6, Z6])
    G = 2.0 / T * (step - np.eye(12)) @ np.linalg.inv(step + np.eye(12))
    return -M / T @ top @ (step - np.eye(12)) @ G @ np.linalg.inv(np.vstack([top, top @ G]))


def matched_poles_per_axis(M: Array, K: Array, D: Array, T: float) -> Array:
    gains = np.zeros((6, 12))
    for i in range(6):
        m = M[i, i]
        z = np.exp(np.roots([m, D[i, i], K[i, i]]) * T)
        p, r = z.sum().real, z.prod().real
        gains[i, i], gains[i, 6 + i] = m * (1.0 + r - p) / T**2, m * (3.0 - p - r) / (2.0 * T)
    return gains


LAWS = {
    "emulated": emulated,
    "poles, per axis": matched_poles_per_axis,
    "poles, coupled": matched_poles,
    "mean": mean,
}


@dataclass(frozen=True)
class Gains:
    K_b: Array
    D_b: Array
    K_m: Array
    D_m: Array
    T_b: float


def gain_sets(count: int, seed: int) -> Iterator[Gains]:
    """Yield random gains in the ranges of the shipped sweep random_designs."""
    random = np.random.default_rng(seed)

    def draw(*ranges: tuple[float, float]) -> Array:
        return np.diag(np.repeat([np.exp(random.uniform(*np.log(pair))) for pair in ranges], 3))

    for _ in range(count):
        yield Gains(
            draw((20, 2000), (5, 500)),
            draw((5, 500), (1, 150)),
            draw((100, 2000), (10, 200)),
            draw((20, 200), (1, 10)),
            round(float(random.uniform(0.01, 1.0)), 3),
        )


def spectral_radius(
    M: Array, Jb: Array, base: Array, end_effector: Array, compensation: Array, T_b: float
) -> float:
    """Return the spectral radius of the map over one base period. Stable below 1.

    The state is [dx_b, dx_m, x_b', x_m']. `base` and `end_effector` are gains on their own states.
    `compensation` are gains on the end-effector's state; times J_b^T they are in the held base
    wrench.
    """
    # The plant over one manipulator period.
    A = np.zeros((24, 24))
    A[:12, 12:] = np.eye(12)
    B = np.zeros((24, 12))
    B[12:] = np.linalg.solve(M, np.block([[I6, -Jb.T], [Z6, I6]]))
    step = expm(T_M * np.block([[A, B], [np.zeros((12, 36))]]))
    A_d, B_d = step[:24, :24], step[:24, 24:]
    none = np.zeros((6, 6))
    on_end_effector = lambda gains: np.hstack([none, gains[:, :6], none, gains[:, 6:]])  # noqa: E731
    # The base wrench is held; the manipulator's controller closes its loop at every period.
    held = -np.hstack([base[:, :6], none, base[:, 6:], none]) - Jb.T @ on_end_effector(compensation)
    fast = np.block(
        [[A_d - B_d[:, 6:] @ on_end_effector(end_effector), B_d[:, :6]], [np.zeros((6, 24)), I6]]
    )
    lifted = np.linalg.matrix_power(fast, round(T_b / T_M))
    return float(abs(np.linalg.eigvals(lifted[:24, :24] + lifted[:24, 24:] @ held)).max())


def main() -> None:
    # The laws are designed with the nominal inertia and tested with the true ones.
    M, Jb = loop_inertia(1.0)
    inverse = np.linalg.inv(M)
    M_base, M_end_effector = np.linalg.inv(inverse[:6, :6]), np.linalg.inv(inverse[6:, 6:])
    true = {factor: loop_inertia(factor)[0] for factor in FACTORS}
    sets = list(gain_sets(400, 1))
    print(
        "| base law | end-effector law | J_b^T F_m in the held wrench | "
        + " | ".join(f"{f:g}" for f in FACTORS)
        + " |"
    )
    print("|---|---|---|" + "---|" * len(FACTORS))
    # One row per combination of discretisations.
    for base, end_effector, share in (
        ("emulated", "emulated", "of the sample"),
        ("poles, per axis", "emulated", "of the sample"),
        ("mean", "emulated", "of the sample"),
        ("mean", "mean", "of the sample"),
        ("poles, per axis", "mean", "mean"),
        ("poles, coupled", "mean", "mean"),
        ("mean", "mean", "mean"),
    ):
        stable = dict.fromkeys(FACTORS, 0)
        for g in sets:
            law = LAWS[base](M_base, g.K_b, g.D_b, g.T_b)
            fast = LAWS[end_effector](M_end_effector, g.K_m, g.D_m, T_M)
            slow = fast if share == "of the sample" else mean(M_end_effector, g.K_m, g.D_m, g.T_b)
            for factor, inertia in true.items():
                stable[factor] += spectral_radius(inertia, Jb, law, fast, slow, g.T_b) < 1.0
        print(
            f"| {base} | {end_effector} | {share} | "
            + " | ".join(f"{100 * n / len(sets):.1f} %" for n in stable.values())
            + " |"
        )


if __name__ == "__main__":
    main()
