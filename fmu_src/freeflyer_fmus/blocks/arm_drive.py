"""The facility's arm with its drives and sensors: a rigid-body arm on a moving base, under gravity.

The model includes friction, torque ripple, imperfect gravity compensation, noise and quantisation.
The block is sampled. Its period is the cycle of the arm. The outputs describe the state at the
present cycle. This state results from the torque that was applied since the last cycle, not from
the torque that is commanded at the present cycle. Therefore the torque command is a delayed input:
it gets the value that its source had before the present cycle. A real arm has the same delay.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from freeflyer_fmus.blocks.block import ACCELERATION, TWIST, Block
from freeflyer_fmus.blocks.facility_parameters import gravity_model, gravity_parameters
from freeflyer_fmus.blocks.robot_parameters import (
    IDENTITY,
    joint_limits,
    joint_units,
    mass_parameters,
    require_quaternions,
)
from freeflyer_fmus.equations import noise
from freeflyer_fmus.equations.dynamics import arm_on_moving_base
from freeflyer_fmus.equations.mechanism import State
from freeflyer_fmus.robot.robot import Robot

SX = ca.SX
SMOOTHING = 1e-2
"""Speed scale [rad/s]: near zero speed, Coulomb friction is proportional to tanh(speed / scale)."""


def arm_drive(robot: Robot) -> Block:
    n = robot.joint_count
    rad, rad_s, torque_unit = (
        joint_units(robot, "rad", "m"),
        joint_units(robot, "rad/s", "m/s"),
        joint_units(robot, "N.m", "N"),
    )
    block = Block(
        "arm_drive",
        "Torque-controlled arm on a moving base under gravity, with friction, ripple, noise and quantisation",
    )
    # Model parameters. The paper gives no data of the drives. Their defaults are assumptions.
    # fmt: off
    T = block.sampled_every("period", 1e-3, "Cycle of the arm")
    block.robot = robot
    mechanism = mass_parameters(block, robot)
    gravity, compensation = gravity_parameters(block)
    coulomb = block.parameter(
        "coulomb_friction", [0.1] * n, torque_unit, "Coulomb friction that the drive does not compensate (assumed)", minimum=0.0
    )
    viscous = block.parameter(
        "viscous_friction", [0.2] * n, "1", "Viscous friction that the drive does not compensate [SI] (assumed)", minimum=0.0
    )
    ripple = block.parameter("torque_ripple", [0.05] * n, torque_unit, "Amplitude of the torque ripple (assumed)", minimum=0.0)
    waves = block.parameter("ripple_periods", 160.0, "1", "Ripple periods per revolution of the joint (assumed; the gear ratio)", minimum=0.0)
    step = block.parameter("encoder_step", 1e-5, "rad", "Resolution of the position sensors (assumed; 0: no quantisation)", minimum=0.0)
    speed_noise = block.parameter(
        "velocity_noise", 1e-4, "rad/s", "Standard deviation of measured speeds (assumed)", minimum=0.0
    )
    torque_noise = block.parameter("torque_noise", 0.02, "N.m", "Standard deviation of measured torques (assumed)", minimum=0.0)
    seed = block.parameter("seed", 1.0, "1", "Seed of the noise")
    limits = joint_limits(block, robot)

    # Delayed inputs: torque command, brake and base motion since the last cycle.
    command = block.input("joint_torque_command", np.zeros(n), torque_unit, "Commanded torque since the last cycle (delayed)")
    brake = block.input("brake", 0.0, "1", "Brakes since the last cycle: 0 released, 1 holding every joint (delayed)")
    R_b = block.input("base_orientation", IDENTITY, "1", "Orientation of the base robot at the last cycle (delayed)")
    v_b = block.input("base_velocity", np.zeros(6), TWIST, "Velocity of the base robot at the last cycle, in I (delayed)")
    a_b = block.input(
        "base_acceleration", np.zeros(6), ACCELERATION, "Acceleration of the base robot since the last cycle, in I (delayed)"
    )
    q = block.state("true_joint_position", robot.posture, rad, "True joint positions")
    qd = block.state("true_joint_velocity", np.zeros(n), rad_s, "True joint velocities")
    random = block.state("random", 1.0, "1", "State of the noise generator", local=True)
    begun = block.state("begun", 0.0, "1", "1 after the first cycle", local=True)
    block.initial("random", noise.first_state(seed))
    # fmt: on

    drive = ca.fmin(ca.fmax(command, -limits.effort), limits.effort)

    def link_torque(position: SX, speed: SX) -> SX:
        """Return the torque at the sensor behind the gear (n).

        The torque is the command, plus the modelled gravity torque, plus ripple, minus friction.
        `position` and `speed` are those of the joints.
        """
        friction = coulomb * ca.tanh(speed / SMOOTHING) + viscous * speed
        model = compensation * gravity_model(mechanism, R_b, position, gravity)
        return drive + model + ripple * ca.sin(waves * position) - friction

    def rates(time: SX, position: SX, speed: SX) -> tuple[SX, SX]:
        state = State(R_b, v_b[:3] + time * a_b[:3], v_b[3:] + time * a_b[3:], position, speed)
        return speed, arm_on_moving_base(
            mechanism, state, a_b, link_torque(position, speed), gravity
        )

    # One classical Runge-Kutta step over the last cycle. At the first cycle, its size is 0.
    h = T * begun
    k1 = rates(SX(0), q, qd)
    k2 = rates(h / 2, q + h / 2 * k1[0], qd + h / 2 * k1[1])
    k3 = rates(h / 2, q + h / 2 * k2[0], qd + h / 2 * k2[1])
    k4 = rates(h, q + h * k3[0], qd + h * k3[1])
    free = (
        x + h / 6 * (a + 2 * b + 2 * c + d)
        for x, a, b, c, d in zip((q, qd), k1, k2, k3, k4, strict=True)
    )
    # If the brakes hold, the joints keep their positions and have zero speed.
    q, qd = (
        ca.if_else(brake > 0.5, held, moved)
        for held, moved in zip((q, SX(n, 1)), free, strict=True)
    )

    # New states, and measurements with noise and quantisation.
    next_random, normal = noise.normal(random, 2 * n)
    block.update("true_joint_position", q)
    block.update("true_joint_velocity", qd)
    block.update("random", next_random)
    block.update("begun", SX(1))
    safe_step = ca.fmax(step, 1e-15)
    quantised = ca.if_else(step > 0, ca.floor(q / safe_step + 0.5) * safe_step, q)
    block.output("joint_position", quantised, rad, "Measured joint positions")
    block.output(
        "joint_velocity", qd + speed_noise * normal[:n], rad_s, "Measured joint velocities"
    )
    torque = link_torque(q, qd) + torque_noise * normal[n:]
    block.output(
        "joint_torque",
        torque,
        torque_unit,
        "Joint torques measured behind the gear; they include the gravity torque",
    )
    require_quaternions(block, {"base_orientation": R_b})
    block.terminal("arm", "joint_position", "joint_velocity", measured_joint_torque="joint_torque")
    return block
