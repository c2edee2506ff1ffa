"""Base controller, sampled at T_b: control law (17), and the damper of the passivity controller.

Equations (25) and (26) describe the damper.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from freeflyer_fmus.blocks.block import POSE_ERROR, TWIST, WRENCH, Block
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
from freeflyer_fmus.equations.passivity import Bookkeeping, DamperInertia
from freeflyer_fmus.equations.sampled_control import (
    Discretisation,
    mean_step,
    mean_wrench,
)
from freeflyer_fmus.equations.spatial import solve_positive_definite
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
    axis_inertia = block.choice("damper_inertia", DamperInertia, DamperInertia.diagonal, "M~ of each axis in the bound of the damper")
    least_sigma = block.parameter(
        "singularity_threshold", SINGULARITY_THRESHOLD, "1", "Smallest allowed singular value of J_m", tunable=True, minimum=0.0
    )
    theta = mean_weight(block)
    p_bd = block.parameter("position_setpoint", np.zeros(3), "m", "x_bd: base position to hold, in I", tunable=True)
    R_bd = block.parameter(
        "orientation_setpoint", IDENTITY, "1", "Base orientation to hold, quaternion x, y, z, w", tunable=True
    )
    preview = block.switch("preview", False, "Take the feed-forward from the preview inputs: the middle of the time in which the wrench acts")
    use_filtered = block.switch("filtered", False, "Use the filtered errors and velocities of the manipulator controller")
    T_m = block.parameter("manipulator_period", 1e-3, "s", "T_m: sampling time of the manipulator controller", above=0.0)
    delay = block.parameter("command_delay", 0.0, "s", "Known time from a sample until its wrench acts; errors are predicted over it", minimum=0.0)

    # Inputs: measurements, reference, and the values that the manipulator controller computes at
    # the same instant.
    p_b = block.input("base_position", np.zeros(3), "m", "Measured position of B in I")
    state = measured_state(block, robot)
    v_d, a_d = desired_motion(block)
    F_m = block.input("end_effector_wrench", np.zeros(6), WRENCH, "F'_m of the same instant, in I")
    beta_b = block.input("base_damping", np.zeros(6), DAMPING, "beta_b from the passivity observer")
    v_p, a_p = desired_motion(block, "preview")
    preview_time = block.input("preview_time", 0.0, "s", "Time by which the preview inputs are ahead")
    filter_time = block.input("filter_time_constant", 0.0, "s", "Time constant of the filtered inputs")
    e_bf = block.input("filtered_base_error", np.zeros(6), POSE_ERROR, "Filtered pose error of the base, in I")
    v_bf = block.input("filtered_base_velocity", np.zeros(6), TWIST, "Filtered x_b', in I")
    e_mf = block.input("filtered_end_effector_error", np.zeros(6), POSE_ERROR, "Filtered pose error of E, in I")
    dv_mf = block.input("filtered_end_effector_velocity_error", np.zeros(6), TWIST, "Filtered x_m' - x_md', in I")
    queued = block.state("queued_law", np.zeros(6), WRENCH, "Spring, damper and PC of the last sample: they act during command_delay", local=True)
    # fmt: on

    # M~ in I: the inertia at B if no wrench acts at the end-effector.
    M = (
        articulated_base_inertia(mechanism, state.q)
        .rotated(rotation.matrix(state.orientation))
        .matrix()
    )
    is_matched = discretisation == int(Discretisation.matched)

    # Feed-forward of this sample, and at the time of the preview inputs.
    star = feed_forward(mechanism, state, v_d, a_d)
    ahead = feed_forward(mechanism, state, v_p, a_p)
    F_m_star, F_b_star = (
        ca.if_else(preview, later, now)
        for later, now in ((ahead.F_m, star.F_m), (ahead.F_b, star.F_b))
    )
    # Errors and velocities of base and end-effector. `spring_m` is -K_Pm times the pose error.
    dx_b = ca.if_else(use_filtered, e_bf, pose_error(p_b, state.orientation, p_bd, R_bd))
    v_b = ca.if_else(use_filtered, v_bf, ca.vertcat(state.v, state.w))
    dv_m = end_effector_velocity(mechanism, state) - v_d
    spring_m = ca.if_else(use_filtered, -K_Pm * e_mf, F_m - star.F_m + K_Dm * dv_m)
    dv_m = ca.if_else(use_filtered, dv_mf, dv_m)
    # Prediction over the delay: the queued wrench acts on the base, and the mean law of the
    # manipulator controller acts on the end-effector.
    M_e = articulated_end_effector_inertia(mechanism, state)
    late = delay > 0
    v_later = v_b + delay * solve_positive_definite(M, queued)
    dx_later = dx_b + 0.5 * delay * (v_b + v_later)
    moved_m, faster_m = mean_step(M_e, ca.diag(K_Pm), ca.diag(K_Dm), delay, spring_m, dv_m)
    dx_b, v_b = ca.if_else(late, dx_later, dx_b), ca.if_else(late, v_later, v_b)
    spring_m -= ca.if_else(late, K_Pm * moved_m, 0)
    dv_m += ca.if_else(late, faster_m, 0)

    # Eq. (17) without its last term, J_b^T F'_m.
    held_law = mean_wrench(M, ca.diag(K_P), ca.diag(K_D), T_b, -K_P * dx_b, v_b, theta)
    law = ca.if_else(is_matched, held_law, spring_damper(K_P, K_D, dx_b, v_b))
    # Last term of (17), J_b^T F'_m. The matched law uses the wrench of the end-effector's spring
    # and damper, averaged over T_b.
    mean_m = mean_wrench(M_e, ca.diag(K_Pm), ca.diag(K_Dm), T_b, spring_m, dv_m)
    held_m = ca.if_else(preview, F_m_star + (F_m - star.F_m), F_m)
    Jb_F = base_jacobian_transposed_times(
        star.p_be, ca.if_else(is_matched, F_m_star + mean_m, held_m)
    )
    # Eqs. (25) and (26). The paper prints beta_m in (25). The code uses beta_b. The force of the
    # damper is constant between two samples. Therefore the damper generates energy if beta is too
    # large. With bookkeeping `applied`, beta has an upper bound for this reason. With bookkeeping
    # `as_printed`, the observer counts the energy of the damper with the unbounded beta_b.
    # Therefore this controller must apply the unbounded beta_b.
    is_bounded = ca.logic_and(passivity.is_applied(bookkeeping, "base"), share > 0)
    bound = passivity.bound_of_axes(axis_inertia, is_matched, M, K_P, K_D, T_b, theta)
    beta = ca.if_else(is_bounded, passivity.bounded(beta_b, share, *bound, T_b), beta_b)
    F_pcb = -beta * v_b
    wrench = F_b_star + law + F_pcb + Jb_F
    block.update("queued_law", law + F_pcb)

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
    block.require(
        ca.if_else(preview, preview_time, 1), 0, "preview_time with the switch preview [s]",
        "connect the preview outputs of the reference, or switch off preview", strict=True, connection=True,
    )
    block.require(
        ca.if_else(use_filtered, filter_time, 1), 0, "filter_time_constant with the switch filtered [s]",
        "connect the filtered outputs of the manipulator controller and set its filter_time, or switch off filtered",
        strict=True, connection=True,
    )
    block.require(
        ca.if_else(use_filtered, T_b - filter_time, 0), 0, "period minus filter_time_constant [s]",
        "choose a filter that is faster than the period of the base controller",
    )
    block.require(T_b - delay, -1e-9, "period minus command_delay [s]", "choose a command_delay of at most one period")
    whole = ca.fabs(delay - T_m * ca.floor(delay / T_m + 0.5))
    block.require(1e-9 - whole, 0, "1 ns minus the distance of command_delay from a multiple of T_m [s]", "choose a multiple of manipulator_period")
    block.terminal("base", "base_position", "base_orientation", "base_velocity", "base_wrench")
    block.terminal("arm", "joint_position", "joint_velocity")
    block.terminal("reference", velocity="desired_velocity", acceleration="desired_acceleration")
    block.terminal("ports", "end_effector_wrench", "base_damping")
    block.terminal("applied", "base_wrench", "port_wrench", base_passivity_wrench="passivity_wrench")
    # fmt: on
    return block
