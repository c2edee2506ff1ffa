"""Energy audit of a recorded run: energy sources and sinks at the ports B and M.

Port B is at the base, port M at the end-effector. A held law is a control law whose output is
constant between two samples. The true wrench is the wrench that acts on the robot at a port. The
audit contains the power and the work at both ports and the kinetic energy of the robot. It also
contains three other energies: the energy that the held laws generate, the energy that the passivity
controllers remove, and the energy that the passivity observers computed. docs/energy_audit.md has
all equations. The work at each port is
    work = feed_forward + reference + stale + virtual - stored - dissipated - taken.
The class `Port` explains these terms. The change of the robot's kinetic energy is
    kinetic = work at B + work at M + others + residual.
The class `Balance` explains these terms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freeflyer.analysis.audit import energy
from freeflyer.analysis.audit.notes import notes
from freeflyer.analysis.audit.recorded_loop import Law, Motion, RecordedLoop
from freeflyer.fmi.component import Array


@dataclass(frozen=True, kw_only=True)
class Port:
    """Energies [J] of one port since the first row. The shape is (n) unless stated otherwise.

    The law is the control law of this port. Positive energy flows into the robot. For `stored`,
    `dissipated` and `taken`, positive energy flows out of the robot.
    """

    power: Array
    """Power [W] of the true wrench."""
    work: Array
    feed_forward: Array
    """Work of the sampled and held feed-forward F* of the law."""
    reference: Array
    """Work of the held law on the desired motion.

    The spring of the law acts between the robot and the desired pose. The desired motion moves one
    end of this spring. With the tracking observer, the work of the passivity controller on the
    desired motion is included.
    """
    stale: Array
    """Multi-rate energy: work of the true wrench at B minus work of the held wrench at B.

    The held wrench is the wrench that the base controller assumes. The multi-rate energy of port M
    is zero.
    """
    virtual: Array
    """Virtual energy: the energy that sampling the law generates.

    It is the work of the held law minus the work of a continuous spring-damper. Both works are for
    the same motion.
    """
    stored: Array
    """Change of the spring's potential energy."""
    dissipated: Array
    """Energy that a continuous damper K_D dissipates on the same motion."""
    taken: Array
    """Energy that the passivity controller removes."""
    observed: Array
    """Energy (n, 6) that the passivity observer computed, including E(0)."""
    absorbed: Array
    """E(0) minus the true work (n, 6) at the last sample of the manipulator controller.

    An ideal observer of this port would compute this energy: the observers of both ports are in
    the manipulator controller.
    """


@dataclass(frozen=True, kw_only=True)
class Balance:
    """Energy balance of the robot: energies [J] since the first row (n).

    `kinetic` is the change of the kinetic energy. `base_wrench` and `joint_torque` are the work of
    the base wrench F_b and of the joint torques tau that the robot received.
    """

    kinetic: Array
    base_wrench: Array
    joint_torque: Array
    others: Array
    """Work of wrenches and torques that do not come from the controllers.

    These wrenches and torques come from components between the controllers and the robot. An
    example is a disturbance that a user adds.
    """
    residual_of_held: Array
    """`kinetic` minus the work of the held commands F_b and tau."""
    residual_of_ports: Array
    """`kinetic` minus the work of the wrenches F_B and F_m at the ports, minus `others`."""
    moved: float
    """Sum of |work| of F_b and tau over all intervals [J]. It is the scale for the residuals."""


@dataclass(frozen=True, kw_only=True)
class Ledger:
    """All energies of a recorded loop."""

    loop: RecordedLoop
    base: Port
    manipulator: Port
    tracking_power: Array
    """Power of the tracking error [W] (n): (F'_m - F_m*) (x_m' - x_md').

    F'_m is the wrench at port M, and F_m* is its feed-forward. x_m' is the velocity of the
    end-effector, and x_md' is its desired velocity.
    """
    balance: Balance | None
    notes: tuple[str, ...]
    """Limitations of this audit."""

    @property
    def time(self) -> Array:
        return self.loop.time


def ledger(loop: RecordedLoop) -> Ledger:
    """Compute the energy audit of a recorded loop."""
    # Compute the displacements of each motion. `moved` is the displacement in each interval.
    time, law_m, law_b = loop.time, loop.manipulator_law, loop.base_law
    moved_b, moved_m = (_moved(loop, motion) for motion in (loop.base, loop.end_effector))
    moved_d = energy.displacement(
        time, loop.desired.position, loop.desired.orientation, loop.desired.velocity
    )
    at_rest = np.zeros_like(moved_d)

    # The true wrench at B is F'_b(k_b) - J_b(k)^T F'_m(k). k_b is the last sample of the base
    # controller, and k is the present row. Until its next sample, the base controller assumes that
    # the wrench at B is F'_B(k_b).
    from_end_effector = energy.at_base(
        loop.end_effector_wrench, loop.end_effector.position - loop.base.position
    )
    F_B_true = loop.base_wrench - from_end_effector
    acting = loop.held(loop.base_wrench, law_b.period) - loop.held(from_end_effector, law_m.period)
    stale = acting - loop.held(loop.port_wrench, law_b.period)

    # With the tracking observer, the damper of the manipulator's passivity controller acts on the
    # velocity error. With the other observers, it acts on the velocity of the port.
    tracking = loop.observer == "tracking"
    # The set point of the base does not move (`at_rest`). The tracking power needs only the
    # feed-forward F* of port M.
    port_m, F_m_star = _port(
        loop,
        law_m,
        actual=loop.end_effector,
        desired=loop.desired,
        wrench=loop.end_effector_wrench,
        passivity_wrench=loop.manipulator_passivity_wrench,
        power=_power(loop.end_effector_wrench, loop.end_effector.velocity),
        stale=at_rest,
        moved=moved_m,
        moved_desired=moved_d,
        damped_motion=moved_m - moved_d if tracking else moved_m,
        observed=loop.manipulator_observed_energy,
    )
    port_b, _ = _port(
        loop,
        law_b,
        actual=loop.base,
        desired=loop.setpoint,
        wrench=loop.port_wrench,
        passivity_wrench=loop.base_passivity_wrench,
        power=_power(F_B_true, loop.base.velocity),
        stale=stale,
        moved=moved_b,
        moved_desired=at_rest,
        damped_motion=moved_b,
        observed=loop.base_observed_energy,
    )
    # The tracking power is the power of the spring and the damper on the tracking error.
    return Ledger(
        loop=loop,
        base=port_b,
        manipulator=port_m,
        tracking_power=_power(
            loop.end_effector_wrench - F_m_star, loop.end_effector.velocity - loop.desired.velocity
        ),
        balance=_balance(loop, port_b, port_m, moved_b),
        notes=tuple(notes(loop)),
    )


def _moved(loop: RecordedLoop, motion: Motion) -> Array:
    if loop.plant:
        return energy.displacement(loop.time, motion.position, motion.orientation, motion.velocity)
    return energy.displacement_of_twist(loop.time, motion.velocity)


def _power(wrench: Array, velocity: Array) -> Array:
    return np.asarray(np.sum(wrench * velocity, axis=1))


def _port(
    loop: RecordedLoop,
    law: Law,
    *,
    actual: Motion,
    desired: Motion,
    wrench: Array,
    passivity_wrench: Array,
    power: Array,
    stale: Array,
    moved: Array,
    moved_desired: Array,
    damped_motion: Array,
    observed: Array,
) -> tuple[Port, Array]:
    """Return the energies of one port, and the feed-forward F* (n, 6) of the port's law.

    `wrench` (n, 6) is the commanded wrench at the
    port, and `passivity_wrench` (n, 6) is the part of it that comes from the passivity controller.
    `stale` (n - 1, 6) is a wrench that acts in addition to the commanded wrench. The displacements
    are (n - 1, 6): `moved` is the displacement of the port, and `moved_desired` is the displacement
    of the desired motion. The damper of the passivity controller acts on the displacement
    `damped_motion`.
    """

    def errors(motion: Motion) -> tuple[Array, Array]:
        pose = energy.pose_error(
            motion.position, motion.orientation, desired.position, desired.orientation
        )
        return pose, motion.velocity - desired.velocity

    # Split the law into the sampled spring-damper -K_P Delta x - K_D Delta x' and the feed-forward
    # F*, which is the rest. If `is_plain` is false, the controller computes discrete gains from K_P
    # and K_D. These gains are not recorded, and the law cannot be split. Therefore the whole law
    # counts as a spring-damper without feed-forward.
    sampled_pose, sampled_velocity = (
        loop.last_samples(values, law.period) for values in errors(law.measured)
    )
    spring_damper = -law.stiffness * sampled_pose - law.damping * sampled_velocity
    star = wrench - passivity_wrench - spring_damper if law.is_plain else np.zeros_like(wrench)
    held_star, held_law, held_pc = (
        loop.held(values, law.period)
        for values in (star, wrench - passivity_wrench - star, passivity_wrench)
    )

    def total(force: Array, displacement: Array) -> Array:
        return np.asarray(energy.work(force, displacement).sum(axis=1))

    # Compute the energies of the continuous spring-damper on the true motion, and the work of all
    # wrenches.
    pose, velocity = errors(actual)
    stored = energy.spring_energy(law.stiffness, pose).sum(axis=1)
    dissipated = energy.dissipation(loop.time, law.damping, velocity).sum(axis=1)
    worked = energy.work(held_star + held_law + held_pc + stale, moved)
    port = Port(
        power=power,
        work=worked.sum(axis=1),
        feed_forward=total(held_star, moved),
        reference=total(held_law, moved_desired) + total(held_pc, moved - damped_motion),
        stale=total(stale, moved),
        virtual=energy.virtual_energy(total(held_law, moved - moved_desired), stored, dissipated),
        stored=stored - stored[0],
        dissipated=dissipated,
        taken=0.0 - total(held_pc, damped_motion),  # `0.0 -` avoids a negative zero
        observed=observed,
        absorbed=loop.last_samples(law.initial_energy - worked, loop.manipulator_law.period),
    )
    return port, star


def _balance(loop: RecordedLoop, port_b: Port, port_m: Port, moved_b: Array) -> Balance | None:
    plant = loop.plant
    if plant is None:
        return None
    moved_q = np.diff(plant.joint_position, axis=0)

    # Compute the work of the wrenches and torques that the plant received.
    by_base, by_joints = (
        loop.held(plant.base_wrench, plant.base_wrench_period),
        loop.held(plant.joint_torque, plant.joint_torque_period),
    )
    base_wrench, joint_torque = (
        energy.work(force, moved).sum(axis=1)
        for force, moved in ((by_base, moved_b), (by_joints, moved_q))
    )
    # A component between controller and plant can change the values that the plant receives.
    # Compute the work of this change.
    other_wrench = by_base - loop.held(loop.base_wrench, loop.base_law.period)
    other_torque = by_joints - loop.held(loop.joint_torque, loop.manipulator_law.period)
    others = energy.work(other_wrench, moved_b).sum(axis=1) + energy.work(
        other_torque, moved_q
    ).sum(axis=1)
    kinetic = plant.kinetic_energy - plant.kinetic_energy[0]
    return Balance(
        kinetic=kinetic,
        base_wrench=base_wrench,
        joint_torque=joint_torque,
        others=others,
        residual_of_held=kinetic - base_wrench - joint_torque,
        residual_of_ports=kinetic - port_b.work - port_m.work - others,
        moved=float(np.abs(by_base * moved_b).sum() + np.abs(by_joints * moved_q).sum()),
    )
