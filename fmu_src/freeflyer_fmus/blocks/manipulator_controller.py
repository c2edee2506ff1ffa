"""Manipulator controller, sampled at T_m: control law (16), passivity observers and dampers.

Equations (20) to (24) describe the observers and dampers of both ports, M and B. The base
controller applies the damper of port B.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from freeflyer_fmus.blocks.block import POSE_ERROR, TWIST, WRENCH, Block
from freeflyer_fmus.blocks.gains import (
    BASE,
    DAMPING,
    MANIPULATOR,
    gains,
    mean_weight,
    null_space_damping,
    null_space_spring,
)
from freeflyer_fmus.blocks.robot_parameters import (
    IDENTITY,
    SINGULARITY_THRESHOLD,
    desired_motion,
    joint_limits,
    joint_units,
    mass_parameters,
    measured_state,
    require_full_jacobian,
    require_quaternions,
    require_regular_jacobian,
    start_pose,
)
from freeflyer_fmus.blocks.terminals import END_EFFECTOR, REFERENCE
from freeflyer_fmus.equations import passivity
from freeflyer_fmus.equations.dynamics import articulated_end_effector_inertia
from freeflyer_fmus.equations.kinematics import base_jacobian_transposed_times
from freeflyer_fmus.equations.passivity import Bookkeeping, DamperInertia, Observer
from freeflyer_fmus.equations.sampled_control import Discretisation, mean_wrench
from freeflyer_fmus.equations.tracking_control import (
    feed_forward,
    joint_torque,
    null_space_torque,
    pose_error,
    spring_damper,
    spring_energies,
)
from freeflyer_fmus.robot.robot import Robot

SX = ca.SX


def manipulator_controller(robot: Robot) -> Block:
    require_full_jacobian(robot, "manipulator_controller")
    block = Block(
        "manipulator_controller",
        "Tracking control of the end-effector with both passivity observers",
    )
    # Parameters of the law, of the observers and of both passivity controllers.
    # fmt: off
    T_m = block.sampled_every("period", 1e-3, "T_m: sampling time of this controller")
    T_b = block.parameter("base_period", 0.3, "s", "T_b: sampling time of the base controller", above=0.0)
    mechanism = mass_parameters(block, robot)
    K_P, K_D = gains(block, MANIPULATOR)
    discretisation = block.choice("discretisation", Discretisation, Discretisation.emulated, "How the law is sampled")
    observer = block.choice("observer", Observer, Observer.port, "Power that the passivity observers integrate")
    bookkeeping = block.choice(
        "bookkeeping", Bookkeeping, Bookkeeping.applied, "How the observers count energy (must be the same as in the base controller)"
    )
    arm_on = block.switch("manipulator_passivity_control", True, "Switch on the passivity controller of port M")
    base_on = block.switch("base_passivity_control", True, "Switch on the passivity controller of port B")
    E_m0 = block.parameter("manipulator_initial_energy", [0.05] * 6, "J", "E_m(0) per degree of freedom (assumed)", minimum=0.0)
    E_b0 = block.parameter("base_initial_energy", [0.0] * 6, "J", "E_b(0) per degree of freedom (assumed)", minimum=0.0)
    floor = block.parameter("velocity_floor", 1e-8, "1", "Lower bound of v^2 T in beta of (24) [SI]", tunable=True, above=0.0)
    share = block.parameter(
        "damper_bound", 0.5, "1", "c in beta <= c M~ / T - K_D (0: no bound; used only with bookkeeping applied)", tunable=True, minimum=0.0
    )
    axis_inertia = block.choice("damper_inertia", DamperInertia, DamperInertia.diagonal, "M~ of each axis in the bound of the damper")
    least_sigma = block.parameter(
        "singularity_threshold", SINGULARITY_THRESHOLD, "1", "Smallest allowed singular value of J_m", tunable=True, minimum=0.0
    )
    theta = mean_weight(block)
    # The reference energy needs the base's spring-damper. The filter serves the base controller.
    K_Pb, K_Db = gains(block, BASE, "base_law_")
    p_bd = block.parameter("position_setpoint", np.zeros(3), "m", "x_bd: base position to hold, in I", tunable=True)
    R_bd = block.parameter("orientation_setpoint", IDENTITY, "1", "Base orientation to hold, quaternion x, y, z, w", tunable=True)
    weight = block.parameter(
        "angular_velocity_weight", 1.0, "m/rad", "Weight of w in the squared speed of observer `reference`", tunable=True, above=0.0
    )
    tau_f = block.parameter("filter_time", 0.0, "s", "Time constant of the filtered outputs (0: no filter)", minimum=0.0)
    without_lag = block.switch("filter_without_lag", False, "Use the velocities in the filter of the errors: the filtered errors then do not lag")
    null_damping = null_space_damping(block, robot)
    null_stiffness, null_posture = null_space_spring(block, robot)
    limits = joint_limits(block, robot)

    # Inputs: measurements and reference.
    p_b = block.input("base_position", np.zeros(3), "m", "Measured position of B in I (observer `reference` and filter)")
    state = measured_state(block, robot)
    # fmt: on
    p_start, R_start = start_pose(robot)
    # fmt: off
    p_e = block.input("end_effector_position", p_start, "m", "Measured position of E in I")
    R_e = block.input("end_effector_orientation", R_start, "1", "Measured orientation of E in I, quaternion x, y, z, w")
    v_m = block.input("end_effector_velocity", np.zeros(6), TWIST, "Measured x_m', in I")
    p_d = block.input("desired_position", p_start, "m", "Desired position of E in I")
    R_d = block.input("desired_orientation", R_start, "1", "Desired orientation of E in I, quaternion x, y, z, w")
    v_d, a_d = desired_motion(block)
    # Delayed inputs: they get the values that were valid before this sample, so they contain the
    # wrenches that acted since the previous sample. Therefore this controller can be stepped before
    # the base controller, which computes these wrenches.
    F_b_applied = block.input("applied_base_wrench", np.zeros(6), WRENCH, "F'_b that acted since the previous sample (delayed)")
    F_B_held = block.input("held_port_wrench", np.zeros(6), WRENCH, "F'_B(k_b): held since the last sample of the base controller (delayed)")
    F_pcb_held = block.input("base_passivity_wrench", np.zeros(6), WRENCH, "F_pcb: wrench of the base's passivity controller (delayed)")

    # States: observed energies, damping, and the previous sample's values.
    E_m = block.state("manipulator_observed_energy", np.zeros(6), "J", "E_obs,m + E_m(0): port M is passive while this is not negative")
    E_b = block.state("base_observed_energy", np.zeros(6), "J", "E_obs,b + E_b(0): port B is passive while this is not negative")
    block.initial("manipulator_observed_energy", E_m0)
    block.initial("base_observed_energy", E_b0)
    beta_m_1 = block.state("end_effector_damping", np.zeros(6), DAMPING, "beta_m: damper of port M")
    beta_b_1 = block.state(
        "base_damping", np.zeros(6), DAMPING, "beta_b: damping requested from the base's passivity controller"
    )
    # fmt: on

    def previous(name: str, unit: tuple[str, ...]) -> SX:
        return block.state(
            f"previous_{name}", np.zeros(6), unit, f"Value of {name} at sample k-1", local=True
        )

    u_m_1, u_b_1 = previous("manipulator_port_velocity", TWIST), previous("base_velocity", TWIST)
    S_m_1, S_b_1 = previous("manipulator_port_wrench", WRENCH), previous("base_port_share", WRENCH)

    # Energies of the springs at the last sample, for the observer `reference`.
    U_m_1, U_b_1 = (
        block.state(
            f"previous_{port}_spring_energy",
            np.zeros(6),
            "J",
            f"Energy of the spring at port {port[0].upper()} at sample k-1",
            local=True,
        )
        for port in ("manipulator", "base")
    )

    # No wrench is applied before the first sample. Therefore the observers ignore the delayed
    # inputs at the first sample.
    begun = block.state("begun", 0.0, "1", "1 after the first sample", local=True)

    # Eq. (16).
    star = feed_forward(mechanism, state, v_d, a_d)
    M_e = articulated_end_effector_inertia(mechanism, state)
    dx_m = pose_error(p_e, R_e, p_d, R_d)
    is_matched = discretisation == int(Discretisation.matched)
    held_law = mean_wrench(M_e, ca.diag(K_P), ca.diag(K_D), T_m, -K_P * dx_m, v_m - v_d, theta)
    F_m = star.F_m + ca.if_else(is_matched, held_law, spring_damper(K_P, K_D, dx_m, v_m - v_d))

    # Port M: `u_m` is the velocity that the observer uses. `excluded_m` is the part of F_m that the
    # observer does not count.
    tracking = passivity.excludes_feed_forward(observer)
    u_m = v_m - ca.if_else(tracking, v_d, 0)
    excluded_m = ca.if_else(tracking, star.F_m, 0)
    # Eq. (20) with corrected sign, with the selected bookkeeping.
    applied_m = passivity.is_applied(bookkeeping, "manipulator")
    E_m = ca.if_else(
        applied_m,
        passivity.observed_as_applied(E_m, S_m_1, u_m_1, u_m, T_m),
        passivity.observed_as_printed(E_m, F_m - excluded_m, u_m, beta_m_1, u_m_1, T_m),
    )
    # Observer `reference`: the energy beyond that of a continuous spring. The damper of the law is
    # not counted here: with it, the loop diverges.
    follows = observer == int(Observer.reference)
    U_m = spring_energies(K_P, dx_m)
    E_m -= ca.if_else(follows, begun * passivity.reference_energy(U_m, U_m_1, 0, u_m, T_m), 0)
    bound = passivity.bound_of_axes(axis_inertia, is_matched, M_e, K_P, K_D, T_m, theta)
    beta_m = ca.if_else(
        follows,
        passivity.common_damper(E_m, u_m, weight, T_m, floor),
        passivity.damper(E_m, u_m, T_m, floor),
    )
    beta_m = ca.if_else(
        ca.logic_and(applied_m, share > 0),
        passivity.bounded(beta_m, share, *bound, T_m),
        beta_m,
    )
    beta_m = ca.if_else(arm_on, beta_m, 0)
    # Eq. (21), (22).
    F_pcm = -beta_m * u_m
    F_m_total = F_m + F_pcm

    # Port B: `share_b` is the part of the port wrench that this controller computes. The part that
    # the base controller computes is in the delayed inputs.
    v_b = ca.vertcat(state.v, state.w)
    Jb_F = base_jacobian_transposed_times(star.p_be, F_m_total)
    share_b = passivity.choose(
        observer,
        {
            Observer.paper: SX(6, 1),
            Observer.port: -Jb_F,
            Observer.tracking: -Jb_F - star.F_b,
            Observer.reference: -Jb_F - star.F_b,
        },
    )
    held = begun * ca.if_else(observer == int(Observer.paper), F_B_held, F_b_applied)
    # Eq. (23) with corrected sign.
    applied_b = passivity.is_applied(bookkeeping, "base")
    E_b = ca.if_else(
        applied_b,
        passivity.observed_as_applied(E_b, held + S_b_1, u_b_1, v_b, T_m),
        passivity.observed_as_printed(
            E_b, held - begun * F_pcb_held + share_b, v_b, beta_b_1, u_b_1, T_m
        ),
    )
    # First-order filter of the errors and velocities, for the base controller and its damper. The
    # filter delays its input by tau_f. A spring with a delayed error loses the damping K_P tau_f.
    # With the input e + tau_f e', the filtered error does not lag: (1 + tau_f s) e is its input.
    dx_b = pose_error(p_b, state.orientation, p_bd, R_bd)
    share_f = ca.if_else(begun > 0, T_m / (tau_f + T_m), 1.0)
    filtered = {}
    lead = ca.if_else(ca.logic_and(without_lag, begun > 0), tau_f, 0.0)
    for name, value, unit in (
        ("base_error", dx_b + lead * v_b, POSE_ERROR),
        ("base_velocity", v_b, TWIST),
        ("end_effector_error", dx_m + lead * (v_m - v_d), POSE_ERROR),
        ("end_effector_velocity_error", v_m - v_d, TWIST),
    ):
        before = block.state(f"filtered_{name}", np.zeros(6), unit, f"Filtered {name}, in I")
        # In parallel exchange, the base controller samples these values at t = 0.
        block.initial(f"filtered_{name}", value)
        filtered[f"filtered_{name}"] = before + share_f * (value - before)
    v_bf = ca.if_else(tau_f > 0, filtered["filtered_base_velocity"], v_b)
    # Observer `reference`: the energy beyond that of a continuous spring-damper.
    U_b = spring_energies(K_Pb, dx_b)
    E_b -= ca.if_else(follows, begun * passivity.reference_energy(U_b, U_b_1, K_Db, v_bf, T_m), 0)
    # Eq. (24). The paper prints T_m. The bookkeeping `applied` uses T_b, because the force of the
    # damper is constant for T_b. During this time, the damper dissipates the missing energy.
    T_damper = ca.if_else(applied_b, T_b, T_m)
    beta_b = ca.if_else(
        follows,
        passivity.common_damper(E_b, v_bf, weight, T_damper, floor),
        passivity.damper(E_b, v_b, T_damper, floor),
    )
    beta_b = ca.if_else(base_on, beta_b, 0)

    # New states and outputs.
    for name, value in {
        "manipulator_observed_energy": E_m,
        "base_observed_energy": E_b,
        "end_effector_damping": beta_m,
        "base_damping": beta_b,
        "previous_manipulator_port_velocity": u_m,
        "previous_base_velocity": v_b,
        "previous_manipulator_port_wrench": F_m_total - excluded_m,
        "previous_base_port_share": share_b,
        "previous_manipulator_spring_energy": U_m,
        "previous_base_spring_energy": U_b,
        **filtered,
        "begun": SX(1),
    }.items():
        block.update(name, value)
    tau, meaning = joint_torque(mechanism, state, F_m_total), "tau = J_m^T F'_m"
    if star.null_space:
        tau += null_space_torque(star.null_space, state, null_damping, null_stiffness, null_posture)
        meaning += ", plus the null-space torque"
    # fmt: off
    block.output("joint_torque", tau, joint_units(robot, "N.m", "N"), meaning)
    block.output("end_effector_wrench", F_m_total, WRENCH, "F'_m: Cartesian wrench at the end-effector, (22), in I")
    block.output("passivity_wrench", F_pcm, WRENCH, "F_pcm: wrench of the passivity controller, (21), in I")
    block.output("filter_time_constant", tau_f, "s", "Time constant of the filtered outputs")
    block.output("jacobian_sigma_min", star.sigma_min, "1", "Lower bound of the smallest singular value of J_m")
    # fmt: on
    margin = ca.fmin(state.q - limits.lower, limits.upper - state.q)
    block.output(
        "joint_limit_margin",
        margin,
        joint_units(robot, "rad", "m"),
        "Distance of each joint from the nearer of its two limits",
    )
    quaternions = {
        "base_orientation": state.orientation,
        "end_effector_orientation": R_e,
        "desired_orientation": R_d,
        "orientation_setpoint": R_bd,
    }
    require_quaternions(block, quaternions)
    block.require(
        ca.if_else(ca.logic_and(follows, ca.logic_or(applied_m == 0, applied_b == 0)), -1, 0),
        0,
        "0 if observer and bookkeeping fit",
        "observer `reference` needs the bookkeeping `applied` at both ports",
    )
    require_regular_jacobian(block, star.sigma_min, least_sigma)
    block.terminal("base", "base_orientation", "base_velocity")
    block.terminal("arm", "joint_position", "joint_velocity", "joint_torque")
    block.terminal("hand", **END_EFFECTOR)
    block.terminal("reference", **{name: f"desired_{name}" for name in REFERENCE})
    block.terminal("ports", "end_effector_wrench", "base_damping")
    block.terminal(
        "applied",
        "base_passivity_wrench",
        base_wrench="applied_base_wrench",
        port_wrench="held_port_wrench",
    )
    return block
