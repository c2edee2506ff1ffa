"""Base controller, sampled at T_b: control law (17), and the damper of the passivity controller.

Equations (25) and (26) describe the damper.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from freeflyer_fmus.blocks.block import WRENCH, Block
from freeflyer_fmus.blocks.gains import BASE, DAMPING, MANIPULATOR, gains, mean_weight
from freeflyer_fmus.blocks.robot_parameters import (
    IDENTITY,
    SINGULARITY_THRESHOLD,
    desired_motion,
    mass_parameters,
    measured_state,
    require_full_jacobian,
    require_quaternions,
    require_regular_jacobian,
)
from freeflyer_fmus.equations import passivity, rotation
from freeflyer_fmus.equations.dynamics import (
    articulated_base_inertia,
    articulated_end_effector_inertia,
)
from freeflyer_fmus.equations.kinematics import (
    base_jacobian_transposed_times,
    end_effector_velocity,
)
from freeflyer_fmus.equations.passivity import Bookkeeping
from freeflyer_fmus.equations.sampled_control import Discretisation, mean_wrench, sampled_damping
from freeflyer_fmus.equations.tracking_control import feed_forward, pose_error, spring_damper
from freeflyer_fmus.robot.robot import Robot

SX = ca.SX


def base_controller(robot: Robot) -> Block:
    require_full_jacobian(robot, "base_controller")
    block = Block("base_controller", "Regulation of the base with its passivity controller")
    # Parameters. The manipulator gains are used only with discretisation `matched`, in J_b^T F'_m.
    # fmt: off
    T_b = block.sampled_every("period", 0.3, "T_b: sampling time of this controller")
    mechanism = mass_parameters(block, robot)
    K_P, K_D = gains(block, BASE)
    K_Pm, K_Dm = gains(block, MANIPULATOR, "manipulator_")
    discretisation = block.choice("discretisation", Discretisation, Discretisation.emulated, "How the law is sampled")
    bookkeeping = block.choice(
        "bookkeeping", Bookkeeping, Bookkeeping.applied, "How the observers count energy (must be the same as in the manipulator controller)"
    )
    share = block.parameter(
        "damper_bound", 0.5, "1", "c in beta <= c M~ / T_b - K_D (0: no bound; used only with bookkeeping applied)", tunable=True, minimum=0.0
    )
    least_sigma = block.parameter(
        "singularity_threshold", SINGULARITY_THRESHOLD, "1", "Smallest allowed singular value of J_m", tunable=True, minimum=0.0
    )
    theta = mean_weight(block)
    p_bd = block.parameter("position_setpoint", np.zeros(3), "m", "x_bd: base position to hold, in I", tunable=True)
    R_bd = block.parameter(
        "orientation_setpoint", IDENTITY, "1", "Base orientation to hold, quaternion x, y, z, w", tunable=True
    )

    # Inputs: measurements, reference, and the values that the manipulator controller computes at
    # the same instant.
    p_b = block.input("base_position", np.zeros(3), "m", "Measured position of B in I")
    state = measured_state(block, robot)
    v_d, a_d = desired_motion(block)
    F_m = block.input("end_effector_wrench", np.zeros(6), WRENCH, "F'_m of the same instant, in I")
    beta_b = block.input("base_damping", np.zeros(6), DAMPING, "beta_b from the passivity observer")
    # fmt: on

    # M~ in I: the inertia at B if no wrench acts at the end-effector.
    M = (
        articulated_base_inertia(mechanism, state.q)
        .rotated(rotation.matrix(state.orientation))
        .matrix()
    )
    is_matched = discretisation == int(Discretisation.matched)

    # Eq. (17) without its last term, J_b^T F'_m.
    star = feed_forward(mechanism, state, v_d, a_d)
    v_b = ca.vertcat(state.v, state.w)
    dx_b = pose_error(p_b, state.orientation, p_bd, R_bd)
    held_law = mean_wrench(M, ca.diag(K_P), ca.diag(K_D), T_b, -K_P * dx_b, v_b, theta)
    F_b = star.F_b + ca.if_else(is_matched, held_law, spring_damper(K_P, K_D, dx_b, v_b))
    # Last term of (17), J_b^T F'_m. The matched law uses the wrench of the end-effector's spring
    # and damper, averaged over T_b.
    dv_m = end_effector_velocity(mechanism, state) - v_d
    spring_m = F_m - star.F_m + K_Dm * dv_m
    M_e = articulated_end_effector_inertia(mechanism, state)
    mean_m = mean_wrench(M_e, ca.diag(K_Pm), ca.diag(K_Dm), T_b, spring_m, dv_m)
    Jb_F = base_jacobian_transposed_times(star.p_be, ca.if_else(is_matched, star.F_m + mean_m, F_m))
    # Eqs. (25) and (26). The paper prints beta_m in (25). The code uses beta_b. The force of the
    # damper is constant between two samples. Therefore the damper generates energy if beta is too
    # large. With bookkeeping `applied`, beta has an upper bound for this reason. With bookkeeping
    # `as_printed`, the observer counts the energy of the damper with the unbounded beta_b.
    # Therefore this controller must apply the unbounded beta_b.
    is_bounded = ca.logic_and(passivity.is_applied(bookkeeping, "base"), share > 0)
    own_damping = ca.if_else(is_matched, sampled_damping(ca.diag(M), K_P, K_D, T_b, theta), K_D)
    beta = ca.if_else(
        is_bounded, passivity.bounded(beta_b, share, ca.diag(M), own_damping, T_b), beta_b
    )
    F_pcb = -beta * v_b
    wrench = F_b + F_pcb + Jb_F

    block.output(
        "base_wrench",
        wrench,
        WRENCH,
        "F'_b: total wrench on the base, including the passivity controller, in I",
    )
    at_port = wrench - base_jacobian_transposed_times(star.p_be, F_m)
    # fmt: off
    block.output("port_wrench", at_port, WRENCH, "F'_B(k_b) = F'_b - J_b^T F'_m at this sample, in I")
    block.output("passivity_wrench", F_pcb, WRENCH, "F_pcb: wrench of the passivity controller, (25), in I")
    require_quaternions(block, {"base_orientation": state.orientation, "orientation_setpoint": R_bd})
    require_regular_jacobian(block, star.sigma_min, least_sigma)
    block.terminal("base", "base_position", "base_orientation", "base_velocity", "base_wrench")
    block.terminal("arm", "joint_position", "joint_velocity")
    block.terminal("reference", velocity="desired_velocity", acceleration="desired_acceleration")
    block.terminal("ports", "end_effector_wrench", "base_damping")
    block.terminal("applied", "base_wrench", "port_wrench", base_passivity_wrench="passivity_wrench")
    # fmt: on
    return block
