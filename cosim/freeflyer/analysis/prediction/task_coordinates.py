"""The linear loop in the paper's coordinates [x_b; x_m]: inertia, stiffness and damping per degree of freedom, from the matrices.

x_b: position of B and small rotation of the base; x_m: the same of the end-effector; all in I. Wrenches are those of the ports,
[F_B; F_m], which do work on [x_b'; x_m'].
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
"""A plant's velocities (states), and its inputs that do work on them."""
DEGREES = tuple(
    f"{body} {motion} {axis}"
    for body in ("base", "hand")
    for motion in ("translation along", "rotation about")
    for axis in ("x", "y", "z")
)
"""Names of the twelve coordinates, in order."""


@dataclass(frozen=True, kw_only=True)
class TaskCoordinates:
    """`pose` and `velocity`: (12, n) of the plant's states. Diagonals (12): `inertia` M~ [kg, kg m2], felt at each port while
    nothing acts at the other; `stiffness` [N/m, N m/rad] and `damping` [N s/m, N m s/rad] of the laws as they are sampled
    (of a redundant arm's hand an estimate, for null space and hand share its joints).
    """

    pose: Array
    velocity: Array
    inertia: Array
    stiffness: Array
    damping: Array

    def energy(self, x: Array) -> Array:
        """(12) per degree of freedom [J], of real or complex states (n), or (12, k) of k states: 1/2 M~ |x'|^2 + 1/2 K_P |x|^2.
        All terms are positive, and metres, radians and speeds compare; M's coupling terms are left out.
        """
        kinetic = self.inertia * np.abs(self.velocity @ x).T ** 2
        return np.asarray(
            0.5 * (kinetic + np.maximum(self.stiffness, 0.0) * np.abs(self.pose @ x).T ** 2).T
        )


def task_coordinates(model: LoopModel, loop: Loop, point: Point) -> TaskCoordinates:
    """At the point where the plant was last linearised. ScenarioError if the plant has not a free-flyer's variables."""
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
    moved = J @ loop.plant.B[np.ix_(speeds, inputs)]  # x'' by generalised forces
    inverse = moved @ J.T
    inertia = np.concatenate(
        [np.diag(np.linalg.inv(inverse[part, part])) for part in (slice(0, 6), slice(6, 12))]
    )
    # F = -K_P x - K_D x', the wrench that moves the ports as the laws' forces do: a redundant arm's null space takes the rest.
    F = (
        np.linalg.solve(inverse, moved)
        @ Instants(loop).feedback()[inputs]
        @ np.linalg.pinv(np.vstack([pose, velocity]))
    )
    stiffness, damping = -np.diag(F[:, :12]), -np.diag(F[:, 12:])
    own = _own_answer(loop, inputs[:6])
    stiffness[:6] = -np.diag(own @ np.linalg.pinv(pose[:6]))
    damping[:6] = -np.diag(own[:, model.states_of_plant([variables["base_velocity"]], point)])
    return TaskCoordinates(
        pose=pose, velocity=velocity, inertia=inertia, stiffness=stiffness, damping=damping
    )


def _own_answer(loop: Loop, inputs: Indices) -> Array:
    """(6, n): the base's wrench by the plant's state, as far as its controller sees that itself. What it adds for the hand's
    wrench, J_b^T F_m, is no spring of the base.
    """
    sources = loop.plant.inputs.sources[inputs]
    law = next(
        (law for law in loop.laws if law.first <= sources[0] and sources[-1] < law.last), None
    )
    if law is None:
        return np.zeros((6, loop.plant.A.shape[0]))
    seen = law.inputs.sources < loop.plant.C.shape[0]
    return np.asarray(
        law.gain[np.ix_(sources - law.first, seen)] @ loop.plant.C[law.inputs.sources[seen]]
    )
