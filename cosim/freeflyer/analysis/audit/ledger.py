"""Where the energy of a recorded run came from and went: power and work at ports B and M, the true balance, what the held laws
made beyond the springs and dampers that they stand for, what the passivity controllers took, and what the observers believed.

At each port, with everything else as it is in docs/energy_audit.md:
    work = feed_forward + reference + stale + virtual - stored - dissipated - taken
and of the robot: kinetic = work at B + work at M + others + residual.
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
    """Energies [J] since the first row, (n) unless said otherwise; positive is given to the robot, but for `stored`, `dissipated`
    and `taken`, which are what has left it.
    """

    power: Array
    """[W], of the wrench that really acts."""
    work: Array
    feed_forward: Array
    """Of F* as it was sampled and held."""
    reference: Array
    """Of the law on the desired motion: what moving the spring's other end costs."""
    stale: Array
    """Of the wrench that really acts at B less the held one: where multi-rate energy enters."""
    virtual: Array
    """What the held law gave beyond a continuous spring-damper on the same motion."""
    stored: Array
    """Change of the spring's potential."""
    dissipated: Array
    """What a continuous damper K_D would have taken."""
    taken: Array
    """By the passivity controller."""
    believed: Array
    """(n, 6) observed energy, E(0) included."""
    absorbed: Array
    """(n, 6) E(0) less the true work: what an observer of the true port would say."""


@dataclass(frozen=True, kw_only=True)
class Balance:
    """Energies [J] since the first row (n); residuals are what is left of `kinetic`."""

    kinetic: Array
    base_wrench: Array
    joint_torque: Array
    others: Array
    """Work of what acted on the robot beside the controllers' outputs (a disturbance of the user's)."""
    residual_of_held: Array
    """Beside the held pair (F_b, tau)."""
    residual_of_ports: Array
    """Beside the ports' derived pair (F_B, F_m)."""
    moved: float
    """Sum of the magnitudes of all work of (F_b, tau): what residuals are measured by."""


@dataclass(frozen=True, kw_only=True)
class Audit:
    loop: RecordedLoop
    base: Port
    manipulator: Port
    tracking_power: Array
    """(F'_m - F_m*) (x_m' - x_md') [W] (n)."""
    balance: Balance | None
    notes: tuple[str, ...]
    """What has to be known to read the figures, one sentence each."""

    @property
    def time(self) -> Array:
        return self.loop.time


def audit(loop: RecordedLoop) -> Audit:
    time, law_m, law_b = loop.time, loop.manipulator_law, loop.base_law
    share_m, share_b = (_share(loop, law.period) for law in (law_m, law_b))
    moved_b, moved_m = (_moved(loop, motion) for motion in (loop.base, loop.hand))
    moved_d = energy.displacement(
        time, loop.desired.position, loop.desired.orientation, loop.desired.velocity
    )
    at_rest = np.zeros_like(moved_d)

    # The wrench that acts at B between the base's samples: F'_b(k_b) - J_b(k)^T F'_m(k), beside F'_B(k_b).
    from_hand = energy.at_base(loop.end_effector_wrench, loop.hand.position - loop.base.position)
    F_B_true = loop.base_wrench - from_hand
    acting = energy.held(loop.base_wrench, share_b) - energy.held(from_hand, share_m)
    stale = acting - energy.held(loop.port_wrench, share_b)

    tracking = loop.observer == "tracking"
    port_m, F_m_star = _port(
        loop,
        law_m,
        share_m,
        actual=loop.hand,
        desired=loop.desired,
        wrench=loop.end_effector_wrench,
        passivity_wrench=loop.manipulator_passivity_wrench,
        power=_power(loop.end_effector_wrench, loop.hand.velocity),
        stale=at_rest,
        moved=moved_m,
        moved_desired=moved_d,
        watched=moved_m - moved_d if tracking else moved_m,
        believed=loop.manipulator_observed_energy,
    )
    port_b, _ = _port(
        loop,
        law_b,
        share_b,
        actual=loop.base,
        desired=loop.setpoint,
        wrench=loop.port_wrench,
        passivity_wrench=loop.base_passivity_wrench,
        power=_power(F_B_true, loop.base.velocity),
        stale=stale,
        moved=moved_b,
        moved_desired=at_rest,
        watched=moved_b,
        believed=loop.base_observed_energy,
    )
    return Audit(
        loop=loop,
        base=port_b,
        manipulator=port_m,
        tracking_power=_power(
            loop.end_effector_wrench - F_m_star, loop.hand.velocity - loop.desired.velocity
        ),
        balance=_balance(loop, port_b, port_m, moved_b),
        notes=tuple(notes(loop)),
    )


def _share(loop: RecordedLoop, period: int) -> float:
    """Of the interval between two rows, for which a sample is held."""
    return min(1.0, period / loop.interval)


def _moved(loop: RecordedLoop, motion: Motion) -> Array:
    if loop.plant:
        return energy.displacement(loop.time, motion.position, motion.orientation, motion.velocity)
    return energy.displacement_of_twist(loop.time, motion.velocity)


def _power(wrench: Array, velocity: Array) -> Array:
    return np.asarray(np.sum(wrench * velocity, axis=1))


def _port(
    loop: RecordedLoop,
    law: Law,
    share: float,
    *,
    actual: Motion,
    desired: Motion,
    wrench: Array,
    passivity_wrench: Array,
    power: Array,
    stale: Array,
    moved: Array,
    moved_desired: Array,
    watched: Array,
    believed: Array,
) -> tuple[Port, Array]:
    """One port, and F* (n, 6) of its law. `stale` (n - 1, 6) acts beside the law's own wrench; `watched` is the displacement
    that the passivity controller's damper acts on.
    """

    def errors(motion: Motion) -> tuple[Array, Array]:
        pose = energy.pose_error(
            motion.position, motion.orientation, desired.position, desired.orientation
        )
        return pose, motion.velocity - desired.velocity

    # -K_P Delta x - K_D Delta x' as it was sampled; F* is what the law adds to it. Sampled gains are not in a record: then the
    # whole law stands in its place.
    seen_pose, seen_velocity = (
        energy.last_samples(loop.time, values, law.period) for values in errors(law.measured)
    )
    spring_damper = -law.stiffness * seen_pose - law.damping * seen_velocity
    star = wrench - passivity_wrench - spring_damper if law.is_plain else np.zeros_like(wrench)
    held_star, held_law, held_pc = (
        energy.held(values, share)
        for values in (star, wrench - passivity_wrench - star, passivity_wrench)
    )

    def total(force: Array, displacement: Array) -> Array:
        return np.asarray(energy.work(force, displacement).sum(axis=1))

    pose, velocity = errors(actual)
    stored = energy.spring_energy(law.stiffness, pose).sum(axis=1)
    dissipated = energy.dissipation(loop.time, law.damping, velocity).sum(axis=1)
    worked = energy.work(held_star + held_law + held_pc + stale, moved)
    port = Port(
        power=power,
        work=worked.sum(axis=1),
        feed_forward=total(held_star, moved),
        reference=total(held_law, moved_desired) + total(held_pc, moved - watched),
        stale=total(stale, moved),
        virtual=energy.virtual_energy(total(held_law, moved - moved_desired), stored, dissipated),
        stored=stored - stored[0],
        dissipated=dissipated,
        taken=0.0 - total(held_pc, watched),  # never a negative zero
        believed=believed,
        absorbed=law.initial_energy - worked,
    )
    return port, star


def _balance(loop: RecordedLoop, port_b: Port, port_m: Port, moved_b: Array) -> Balance | None:
    plant = loop.plant
    if plant is None:
        return None
    moved_q = np.diff(plant.joint_position, axis=0)

    def held(values: Array, period: int) -> Array:
        return energy.held(values, _share(loop, period))

    by_base, by_joints = (
        held(plant.base_wrench, plant.base_wrench_period),
        held(plant.joint_torque, plant.joint_torque_period),
    )
    base_wrench, joint_torque = (
        energy.work(force, moved).sum(axis=1)
        for force, moved in ((by_base, moved_b), (by_joints, moved_q))
    )
    others = energy.work(by_base - held(loop.base_wrench, loop.base_law.period), moved_b).sum(
        axis=1
    ) + energy.work(by_joints - held(loop.joint_torque, loop.manipulator_law.period), moved_q).sum(
        axis=1
    )
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
