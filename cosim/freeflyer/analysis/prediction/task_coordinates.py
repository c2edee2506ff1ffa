"""Inertia, stiffness and damping of the linearised loop in the paper's coordinates [x_b; x_m].

x_b contains the position of the base frame B and the small rotation of the base. x_m contains the
position and the small rotation of the end-effector. x_b and x_m are expressed in the inertial frame
I. The ports are the base and the end-effector. F_B is the wrench at the base, and F_m is the wrench
at the end-effector. Their power is [F_B; F_m]^T [x_b'; x_m'].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freeflyer.analysis.prediction.held_axis import CoupledDamper, coupled_damper
from freeflyer.analysis.prediction.lifting import Instants, Loop, without_slow_laws
from freeflyer.analysis.prediction.linearisation import LoopModel, Point
from freeflyer.fmi.component import Array
from freeflyer.foundation.errors import ScenarioError

POSE = ("base_position", "base_orientation", "end_effector_position", "end_effector_orientation")
VELOCITY = ("base_velocity", "end_effector_velocity")
WRENCHES = {"base_velocity": "base_wrench", "joint_velocity": "joint_torque"}
"""Roles of the velocities that are states of the plant, each with the role of its input.

The input is the wrench or torque that drives this velocity.
"""
DEGREES = tuple(
    f"{body} {motion} {axis}"
    for body in ("base", "end-effector")
    for motion in ("translation along", "rotation about")
    for axis in ("x", "y", "z")
)
"""Names of the twelve coordinates, in order."""


@dataclass(frozen=True, kw_only=True)
class TaskCoordinates:
    """Matrices and diagonals that describe the linearised loop in task coordinates.

    `pose` (12, n) maps the plant's states (n) to the coordinates. `velocity` (12, n) maps the
    plant's states to the rates of the coordinates. The other members are the diagonals (12) of
    three matrices. `inertia` is the inertia M~ [kg, kg m2] at each port, if no wrench acts at the
    other port. `stiffness` [N/m, N m/rad] and `damping` [N s/m, N m s/rad] describe the sampled
    control laws. The joints of a redundant manipulator can also move without a motion of the
    end-effector (null space). Therefore the states are not determined by the coordinates, and the
    stiffness and the damping of the end-effector are estimates. `fast_damper` is the sampled damper
    of the end-effector's own loop with the period T_m, while the slow laws hold their outputs.
    """

    pose: Array
    velocity: Array
    inertia: Array
    stiffness: Array
    damping: Array
    fast_damper: CoupledDamper

    def energy(self, x: Array) -> Array:
        """Return the energy [J] of each coordinate: 1/2 M~ |x'|^2 + 1/2 K_P |x|^2.

        In this formula, x is one coordinate. The argument `x` contains states of the plant, (n) or
        (n, k). They may be complex. The result is (12) or (12, k). Energies are used because
        metres, radians and velocities cannot be compared directly. No energy is negative, because
        the coupling between coordinates is omitted.
        """
        kinetic = self.inertia * np.abs(self.velocity @ x).T ** 2
        return np.asarray(
            0.5 * (kinetic + np.maximum(self.stiffness, 0.0) * np.abs(self.pose @ x).T ** 2).T
        )


def task_coordinates(model: LoopModel, loop: Loop, point: Point) -> TaskCoordinates:
    """Return the task coordinates at `point`.

    Before the call, `LoopModel.plant_at` must have linearised the plant at the same point. No other
    point may be linearised in between.

    Raises ScenarioError if the plant does not have all variables of a free-flyer.
    """
    name = model.roles.plant
    fmu = model.fmus[name]
    variables = {}
    for role in (*POSE, *VELOCITY, *WRENCHES, *WRENCHES.values()):
        variables[role] = model.scenario.roles.variable(role, name)
        if variables[role] not in fmu.ports:
            raise ScenarioError(
                f"component {name} has no variable {variables[role]!r}; the prediction needs this variable of a free-flying robot; "
                f'if the variable has another name, declare this name in [roles]: {role} = "{name}.VARIABLE"'
            )
    poses, velocities = ([variables[role] for role in roles] for roles in (POSE, VELOCITY))
    full = {**point, **{f"{name}.{v}": model.plant_value(v) for v in (*poses, *velocities)}}
    pose, velocity = model.outputs_of_plant(poses, full), model.outputs_of_plant(velocities, full)
    speeds = model.states_of_plant([variables[role] for role in WRENCHES], point)
    inputs = model.inputs_of_plant([variables[role] for role in WRENCHES.values()])
    # The rates of the coordinates are x' = J v. Therefore a wrench F at the ports acts on v as the
    # generalised force J^T F, and M^-1 is J H^-1 J^T. H is the mass matrix of the plant for v.
    # `acceleration` is J H^-1: x'' for a generalised force of 1 at each element of v.
    J = velocity[:, speeds]
    acceleration = J @ loop.plant.B[np.ix_(speeds, inputs)]
    inverse = acceleration @ J.T
    inertia = np.concatenate(
        [np.diag(np.linalg.inv(inverse[part, part])) for part in (slice(0, 6), slice(6, 12))]
    )
    # Describe the laws by a wrench F = -K_P x - K_D x' at the ports. F causes the same acceleration
    # x'' as the wrenches and torques of the laws. In a redundant manipulator, a part of the torques
    # acts only in the null space. F does not contain this part.
    back = np.linalg.pinv(np.vstack([pose, velocity]))
    feedback = Instants(loop).feedback()[inputs] @ back
    F = np.linalg.solve(inverse, acceleration) @ feedback
    # For the base, use the base wrench itself: its part J_b^T F_m does not depend on x_b.
    F[:6] = feedback[:6]
    stiffness, damping = -np.diag(F[:, :12]), -np.diag(F[:, 12:])
    # x_m'' that the fast laws cause, for the velocities of the end-effector.
    fast = acceleration[6:] @ Instants(without_slow_laws(loop)).feedback()[inputs] @ back[:, 18:]
    return TaskCoordinates(
        pose=pose,
        velocity=velocity,
        inertia=inertia,
        stiffness=stiffness,
        damping=damping,
        fast_damper=coupled_damper(-fast, damping[6:], loop.tick, late=loop.parallel),
    )
