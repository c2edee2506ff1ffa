"""The closed loop in continuous time, (1) with (7) and (8): plant, reference and both control laws.

Nothing is sampled. The results of the sampled loops are compared with the results of this block. It
also computes the Lyapunov function V of (10) and its derivative by (15).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from freeflyer_fmus.blocks.block import TWIST, Block
from freeflyer_fmus.blocks.gains import BASE, MANIPULATOR, gains, null_space_damping
from freeflyer_fmus.blocks.reference_trajectory import reference_motion
from freeflyer_fmus.blocks.robot_parameters import (
    IDENTITY,
    SINGULARITY_THRESHOLD,
    joint_units,
    mass_parameters,
    require_full_jacobian,
    require_quaternions,
    require_regular_jacobian,
)
from freeflyer_fmus.equations import dynamics, rotation
from freeflyer_fmus.equations.kinematics import (
    base_jacobian_transposed_times,
    end_effector_pose,
    end_effector_velocity,
)
from freeflyer_fmus.equations.mechanism import State
from freeflyer_fmus.equations.tracking_control import (
    feed_forward,
    joint_torque,
    null_space_torque,
    pose_error,
    spring_damper,
    spring_energy,
)
from freeflyer_fmus.robot.robot import Robot

SX = ca.SX


def continuous_loop(robot: Robot) -> Block:
    require_full_jacobian(robot, "continuous_loop")
    n = robot.joint_count
    block = Block(
        "continuous_loop", "Free-flyer, reference and both control laws in continuous time"
    )
    # Parameters of plant, control laws and reference.
    # fmt: off
    mechanism = mass_parameters(block, robot)
    K_Pm, K_Dm = gains(block, MANIPULATOR, "manipulator_")
    K_Pb, K_Db = gains(block, BASE, "base_")
    p_bd = block.parameter("position_setpoint", np.zeros(3), "m", "x_bd: base position to hold, in I", tunable=True)
    R_bd = block.parameter(
        "orientation_setpoint", IDENTITY, "1", "Base orientation to hold, quaternion x, y, z, w", tunable=True
    )
    least_sigma = block.parameter(
        "singularity_threshold", SINGULARITY_THRESHOLD, "1", "Smallest allowed singular value of J_m", tunable=True, minimum=0.0
    )
    null_damping = null_space_damping(block, robot)
    desired = reference_motion(block, robot)

    # States of the plant.
    p_b = block.state("base_position", np.zeros(3), "m", "Position of B in I")
    R_b = block.state("base_orientation", IDENTITY, "1", "Orientation of B in I, quaternion x, y, z, w")
    v_b = block.state("base_velocity", np.zeros(6), TWIST, "x_b': velocity of B's origin and angular velocity, in I")
    q = block.state("joint_position", robot.posture, joint_units(robot, "rad", "m"), "q: joint positions")
    qd = block.state("joint_velocity", np.zeros(n), joint_units(robot, "rad/s", "m/s"), "q': joint velocities")
    block.initial("base_orientation", rotation.normalised(R_b))
    require_quaternions(block, {"base_orientation": R_b}, initially=True)
    require_quaternions(block, {"orientation_setpoint": R_bd})
    # fmt: on
    state = State(R_b, v_b[:3], v_b[3:], q, qd)

    # Errors and feed-forward.
    p_e, R_e = end_effector_pose(mechanism, p_b, R_b, q)
    star = feed_forward(mechanism, state, desired.velocity, desired.acceleration)
    v_m = end_effector_velocity(mechanism, state)
    dx_m = pose_error(p_e, R_e, desired.position, desired.orientation)
    dx_b = pose_error(p_b, R_b, p_bd, R_bd)
    # Eq. (7), (8).
    F_m = star.F_m + spring_damper(K_Pm, K_Dm, dx_m, v_m - desired.velocity)
    F_b = (
        star.F_b
        + spring_damper(K_Pb, K_Db, dx_b, v_b)
        + base_jacobian_transposed_times(star.p_be, F_m)
    )
    # Plant under both control laws; a redundant manipulator has a null-space damper too.
    torque, null_power = joint_torque(mechanism, state, F_m), SX(0)
    if star.null_space:
        torque += null_space_torque(star.null_space, state, null_damping, SX(n, 1), q)
        rate = star.null_space.at.velocity_in_null_space(qd)
        null_power = ca.dot(null_damping * rate, rate)
    base_acceleration, qdd = dynamics.forward_dynamics(mechanism, state, F_b, torque)
    block.derivative("base_position", state.v)
    block.derivative("base_orientation", rotation.derivative(R_b, state.w))
    block.derivative("base_velocity", base_acceleration)
    block.derivative("joint_position", qd)
    block.derivative("joint_velocity", qdd)

    # Eq. (10). The kinetic part is the kinetic energy of the robot at the error velocity
    # [x_b'; dx_m']. In generalised coordinates, the error velocity is [x_b'; q' - qd_r].
    kinetic = dynamics.kinetic_energy(mechanism, State(R_b, v_b[:3], v_b[3:], q, qd - star.qd_r))
    V = kinetic + spring_energy(K_Pm, dx_m) + spring_energy(K_Pb, dx_b)
    # Eq. (15), plus the power of the null-space damper.
    dissipated = (
        null_power
        + ca.dot(K_Db * v_b, v_b)
        + ca.dot(K_Dm * (v_m - desired.velocity), v_m - desired.velocity)
    )
    block.output("end_effector_position", p_e, "m", "Position of E in I")
    block.output(
        "end_effector_orientation", R_e, "1", "Orientation of E in I, quaternion x, y, z, w"
    )
    block.output("end_effector_velocity", v_m, TWIST, "x_m': velocity of E, in I")
    block.output("desired_position", desired.position, "m", "x_md: desired position of E in I")
    block.output(
        "desired_orientation",
        desired.orientation,
        "1",
        "Desired orientation of E in I, quaternion x, y, z, w",
    )
    block.output("lyapunov_function", V, "J", "V of (10)")
    block.output("dissipated_power", dissipated, "W", "-dV/dt by (15)")
    require_regular_jacobian(block, star.sigma_min, least_sigma)
    return block
