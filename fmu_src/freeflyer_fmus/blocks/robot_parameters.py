"""Declarations for the blocks that contain a robot model: masses, measured state, joint limits."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from freeflyer_fmus.blocks.block import ACCELERATION, TWIST, Block, Units
from freeflyer_fmus.equations.kinematics import axes, end_effector_pose, manipulator_jacobian
from freeflyer_fmus.equations.mechanism import (
    Mechanism,
    State,
    constant_mechanism,
    inertia_entries,
    mechanism,
    symmetric_matrix,
)
from freeflyer_fmus.errors import RobotError
from freeflyer_fmus.robot.robot import Array, Robot

SX = ca.SX
IDENTITY = (0.0, 0.0, 0.0, 1.0)
SINGULARITY_THRESHOLD = 0.02
"""Default of the smallest singular value of J_m that the controllers accept."""
NO_LIMIT = 1e6
"""Limit value of a joint without limits [SI]."""


def joint_units(robot: Robot, revolute: str, prismatic: str) -> Units:
    """Return one unit per joint: `revolute` or `prismatic`, according to the kind of the joint."""
    return tuple(revolute if joint.kind == "revolute" else prismatic for joint in robot.joints)


def start_pose(robot: Robot) -> tuple[Array, Array]:
    """Return position (3) [m] and quaternion (4) of E in I at the start posture.

    The frame B coincides with I.
    """
    position, orientation = end_effector_pose(
        constant_mechanism(robot), SX(3, 1), SX(list(IDENTITY)), SX(ca.DM(robot.posture))
    )
    values = [np.array(ca.evalf(part)).ravel() for part in (position, orientation)]
    return values[0], values[1]


def mass_parameters(block: Block, robot: Robot) -> Mechanism:
    """Declare mass and inertia of base and tool. Return the mechanism with these symbols."""
    base_mass = block.parameter(
        "base_mass", robot.base.mass, "kg", "Mass of the base body without the arm", above=0.0
    )
    base_inertia = block.parameter(
        "base_inertia",
        inertia_entries(robot.base.inertia),
        "kg.m2",
        "Inertia of the base body about its centre of mass, in B: xx, yy, zz, xy, xz, yz",
    )
    tool_mass = block.parameter("tool_mass", robot.tool.mass, "kg", "Mass of the tool", minimum=0.0)
    tool_centre = block.parameter(
        "tool_centre_of_mass", robot.tool.centre_of_mass, "m", "Centre of mass of the tool, in E"
    )
    tool_inertia = block.parameter(
        "tool_inertia",
        inertia_entries(robot.tool.inertia),
        "kg.m2",
        "Inertia of the tool about its centre of mass, in E: xx, yy, zz, xy, xz, yz",
    )
    arm_factor = block.parameter(
        "arm_mass_factor",
        1.0,
        "1",
        "Factor of all masses and inertias of the arm without tool",
        above=0.0,
    )
    _require_physical(block, "base_inertia", base_inertia, strict=True)
    _require_physical(block, "tool_inertia", tool_inertia, strict=False)
    return mechanism(
        robot, base_mass, base_inertia, tool_mass, tool_centre, tool_inertia, arm_factor
    )


def _require_physical(block: Block, name: str, entries: SX, *, strict: bool) -> None:
    """Require a positive (semi)definite inertia that satisfies the triangle inequality.

    `entries` are xx, yy, zz, xy, xz, yz. The triangle inequality holds if the covariance of the
    mass distribution is positive semidefinite. If `strict` is False, the inertia may be zero.
    """
    matrix = symmetric_matrix(entries)
    covariance = 0.5 * ca.trace(matrix) * SX.eye(3) - matrix
    scale = ca.trace(matrix)
    for condition, tested, exact in (
        ("matrix must be positive definite", matrix, strict),
        ("covariance must be positive (triangle inequality)", covariance, False),
    ):
        # Check all principal minors. The leading minors alone do not imply semidefiniteness.
        for rows in ([0], [1], [2], [0, 1], [0, 2], [1, 2], [0, 1, 2]):
            minor = ca.det(tested[rows, rows])
            # A minor of a valid body may be exactly zero. The slack covers its rounding error.
            slack = 0.0 if exact else -1e-12 * scale ** len(rows)
            label = "".join("xyz"[row] for row in rows)
            block.require(
                minor,
                slack,
                f"{name}: its {condition}, but principal minor {label}",
                "correct the inertia",
                strict=exact,
            )


def measured_state(block: Block, robot: Robot) -> State:
    """Declare base orientation, base velocity, joint positions and joint velocities as inputs."""
    n = robot.joint_count
    orientation = block.input(
        "base_orientation", IDENTITY, "1", "Orientation of B in I, quaternion x, y, z, w"
    )
    velocity = block.input(
        "base_velocity", np.zeros(6), TWIST, "Velocity of B's origin and angular velocity, in I"
    )
    return State(
        orientation,
        velocity[:3],
        velocity[3:],
        block.input(
            "joint_position", robot.posture, joint_units(robot, "rad", "m"), "Joint positions"
        ),
        block.input(
            "joint_velocity", np.zeros(n), joint_units(robot, "rad/s", "m/s"), "Joint velocities"
        ),
    )


@dataclass(frozen=True, kw_only=True)
class JointLimits:
    """Joint limits as parameters of the block. Each limit is a vector (n)."""

    lower: SX
    upper: SX
    velocity: SX
    effort: SX


def joint_limits(block: Block, robot: Robot) -> JointLimits:
    """Declare the joint limits of the robot as parameters.

    An arm adapter compares these parameters with the limits of the device.
    """

    def declared(name: str, values: list[float], units: Units, description: str) -> SX:
        return block.parameter(name, np.clip(values, -NO_LIMIT, NO_LIMIT), units, description)

    rad, joints = joint_units(robot, "rad", "m"), robot.joints
    return JointLimits(
        lower=declared(
            "joint_lower_limit", [j.lower for j in joints], rad, "Smallest joint positions"
        ),
        upper=declared(
            "joint_upper_limit", [j.upper for j in joints], rad, "Largest joint positions"
        ),
        velocity=declared(
            "joint_velocity_limit",
            [j.velocity_limit for j in joints],
            joint_units(robot, "rad/s", "m/s"),
            "Largest joint speeds",
        ),
        effort=declared(
            "joint_effort_limit",
            [j.effort_limit for j in joints],
            joint_units(robot, "N.m", "N"),
            "Largest joint torques",
        ),
    )


def desired_motion(block: Block, kind: str = "desired") -> tuple[SX, SX]:
    """Declare the reference velocity and acceleration as inputs.

    `kind` is the first part of their names: "desired", or "preview" for those of a later time.
    """
    later = ", preview_time ahead" if kind == "preview" else ""
    # fmt: off
    return (
        block.input(f"{kind}_velocity", np.zeros(6), TWIST, f"Desired end-effector velocity x_md', in I{later}"),
        block.input(f"{kind}_acceleration", np.zeros(6), ACCELERATION, f"Desired end-effector acceleration x_md'', in I{later}"),
    )
    # fmt: on


def require_quaternions(
    block: Block, quaternions: dict[str, SX], *, initially: bool = False
) -> None:
    """Require that no quaternion is zero. The error message contains the name of the quaternion."""
    for name, quaternion in quaternions.items():
        remedy = "give a quaternion x, y, z, w of norm one"
        block.require(
            ca.sumsqr(quaternion), 1e-12, f"squared norm of {name}", remedy, initially=initially
        )


def require_regular_jacobian(block: Block, sigma_min: SX, threshold: SX | float) -> None:
    """Require that the smallest singular value of J_m is at least `threshold`."""
    remedy = "keep the posture away from singularities, or lower singularity_threshold"
    block.require(sigma_min, threshold, "smallest singular value of J_m", remedy)


def require_full_jacobian(robot: Robot, subject: str) -> None:
    """Raise RobotError if J_m is singular at the start posture or has fewer than six columns.

    The start posture is checked, because every FMU must be valid at its start values. `subject` is
    the name of the block in the message.
    """
    if robot.joint_count < 6:
        raise RobotError(
            f"robot {robot.name}: {subject} needs at least six free joints so that the end-effector can move in all directions, got {robot.joint_count}"
        )
    mechanism = constant_mechanism(robot)
    Jm = np.array(
        ca.evalf(manipulator_jacobian(mechanism, axes(mechanism, SX(ca.DM(robot.posture)))))
    )
    smallest = float(np.linalg.svd(Jm, compute_uv=False)[-1])
    if smallest < SINGULARITY_THRESHOLD:
        raise RobotError(
            f"robot {robot.name}: at the start posture the smallest singular value of J_m is {smallest:.3g}; at least "
            f"{SINGULARITY_THRESHOLD} is expected: give another start posture with --posture"
        )
