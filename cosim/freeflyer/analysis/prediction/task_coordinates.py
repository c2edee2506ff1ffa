"""Linear loop in the paper's coordinates [x_b; x_m]: inertia, stiffness, damping per axis.

x_b: position of B and small rotation of the base; x_m: the same for the end-effector; both in I.
The wrenches are those of the ports, [F_B; F_m], which do work on [x_b'; x_m'].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freeflyer.analysis.prediction.lifting import Indices, Instants, Loop
from freeflyer.analysis.prediction.linearisation import LoopModel, Point
from freeflyer.fmi.component import Array
from freeflyer.foundation.errors import ScenarioError

POSE = ("base_position", "base_orientation", "end_effector_position", "end_effector_orientation")
VELOCITY = ("base_velocity", "end_effector_velocity")
WRENCHES = {"base_velocity": "base_wrench", "joint_velocity": "joint_torque"}
"""Velocities (states) of the plant, and the inputs that do work on them."""
DEGREES = tuple(
    f"{body} {motion} {axis}"
    for body in ("base", "end-effector")
    for motion in ("translation along", "rotation about")
    for axis in ("x", "y", "z")
)
"""Names of the twelve coordinates, in order."""


@dataclass(frozen=True, kw_only=True)
class TaskCoordinates:
    """Task coordinates of the plant's states (n) and diagonals (12) of the loop's matrices.

    `pose`, `velocity` (12, n): coordinates and their rates from the states. `inertia`: M~
    [kg, kg m2] at each port without a wrench at the other. `stiffness` [N/m, N m/rad] and `damping`
    [N s/m, N m s/rad] of the sampled laws. For a redundant manipulator those of the end-effector
    are estimates, because it shares the joints with the null space.
    """

    pose: Array
    velocity: Array
    inertia: Array
    stiffness: Array
    damping: Array

    def energy(self, x: Array) -> Array:
        """Return 1/2 M~ |x'|^2 + 1/2 K_P |x|^2 (12) or (12, k) [J] of states (n) or (n, k).

        States may be complex. The energy makes metres, radians and velocities comparable. No term
        is negative, because the coupling terms of M are omitted.
        """
        kinetic = self.inertia * np.abs(self.velocity @ x).T ** 2
        return np.asarray(
            0.5 * (kinetic + np.maximum(self.stiffness, 0.0) * np.abs(self.pose @ x).T ** 2).T
        )


def task_coordinates(model: LoopModel, loop: Loop, point: Point) -> TaskCoordinates:
    """Return the task coordinates at the last linearisation point of the plant.

    Raises ScenarioError if the plant lacks a variable of a free-flyer.
    """
    name = model.roles.plant
    fmu = model.fmus[name]
    variables = {}
    for role in (*POSE, *VELOCITY, *WRENCHES, *WRENCHES.values()):
        variables[role] = model.scenario.roles.variable(role, name)
        if variables[role] not in fmu.ports:
            raise ScenarioError(
                f"component {name} has no variable {variables[role]!r}; the prediction describes free-flying robots "
                f'by the variables of free_flyer, or by those of [roles]: {role} = "{name}.VARIABLE"'
            )
    poses, velocities = ([variables[role] for role in roles] for roles in (POSE, VELOCITY))
    full = {**point, **{f"{name}.{v}": model.plant_value(v) for v in (*poses, *velocities)}}
    pose, velocity = model.outputs_of_plant(poses, full), model.outputs_of_plant(velocities, full)
    speeds = model.states_of_plant([variables[role] for role in WRENCHES], point)
    inputs = model.inputs_of_plant([variables[role] for role in WRENCHES.values()])
    # x' = J v, so that the generalised forces are J^T F and M^-1 = J H^-1 J^T.
    J = velocity[:, speeds]
    acceleration = J @ loop.plant.B[np.ix_(speeds, inputs)]  # x'' by generalised forces
    inverse = acceleration @ J.T
    inertia = np.concatenate(
        [np.diag(np.linalg.inv(inverse[part, part])) for part in (slice(0, 6), slice(6, 12))]
    )
    # F = -K_P x - K_D x': the port wrench with the same port acceleration as the laws' forces. In a
    # redundant manipulator the other forces act in the null space.
    F = (
        np.linalg.solve(inverse, acceleration)
        @ Instants(loop).feedback()[inputs]
        @ np.linalg.pinv(np.vstack([pose, velocity]))
    )
    stiffness, damping = -np.diag(F[:, :12]), -np.diag(F[:, 12:])
    # The base's own law without the compensation of the end-effector wrench.
    own = _own_law(loop, inputs[:6])
    stiffness[:6] = -np.diag(own @ np.linalg.pinv(pose[:6]))
    damping[:6] = -np.diag(own[:, model.states_of_plant([variables["base_velocity"]], point)])
    return TaskCoordinates(
        pose=pose, velocity=velocity, inertia=inertia, stiffness=stiffness, damping=damping
    )


def _own_law(loop: Loop, inputs: Indices) -> Array:
    """Return the base wrench (6, n) by the plant's states that the base controller measures itself.

    The compensation J_b^T F_m of the end-effector wrench is omitted: it is no spring of the base.
    """
    sources = loop.plant.inputs.sources[inputs]
    law = next(
        (law for law in loop.laws if law.first <= sources[0] and sources[-1] < law.last), None
    )
    if law is None:
        return np.zeros((6, loop.plant.A.shape[0]))
    measured = law.inputs.sources < loop.plant.C.shape[0]
    return np.asarray(
        law.gain[np.ix_(sources - law.first, measured)] @ loop.plant.C[law.inputs.sources[measured]]
    )
