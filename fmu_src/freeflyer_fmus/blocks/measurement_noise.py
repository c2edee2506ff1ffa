"""White noise on the measured motion. The end-effector is computed from the noisy measurements."""

from __future__ import annotations

import casadi as ca
import numpy as np

from freeflyer_fmus.blocks.block import TWIST, Block
from freeflyer_fmus.blocks.robot_parameters import IDENTITY, joint_units, require_quaternions
from freeflyer_fmus.blocks.terminals import END_EFFECTOR
from freeflyer_fmus.equations import noise, rotation
from freeflyer_fmus.equations.kinematics import end_effector_pose, end_effector_velocity
from freeflyer_fmus.equations.mechanism import State, constant_mechanism
from freeflyer_fmus.robot.robot import Robot

SX = ca.SX


def measurement_noise(robot: Robot) -> Block:
    n = robot.joint_count
    rad, rad_s = joint_units(robot, "rad", "m"), joint_units(robot, "rad/s", "m/s")
    block = Block(
        "measurement_noise",
        "Noise on pose and velocity of the base and on the joints; the end-effector is computed from them",
    )
    # fmt: off
    block.sampled_every("period", 1e-3, "Sampling time: that of the manipulator controller")
    seed = block.parameter("seed", 1.0, "1", "Seed of the noise")

    def deviation(name: str, unit: str, what: str) -> SX:
        return block.parameter(f"{name}_noise", 0.0, unit, f"Standard deviation of {what}", minimum=0.0)

    s_p = deviation("position", "m", "each element of the base position")
    s_R = deviation("orientation", "rad", "each element of a rotation vector that rotates the base orientation, in I")
    s_v = deviation("velocity", "m/s", "each element of the base velocity")
    s_w = deviation("angular_velocity", "rad/s", "each element of the angular velocity of the base")
    s_q = block.parameter("joint_position_noise", np.zeros(n), rad, "Standard deviation of the joint positions", minimum=0.0)
    s_qd = block.parameter("joint_velocity_noise", np.zeros(n), rad_s, "Standard deviation of the joint velocities", minimum=0.0)
    p = block.input("true_base_position", np.zeros(3), "m", "Position of B in I")
    R = block.input("true_base_orientation", IDENTITY, "1", "Orientation of B in I, quaternion x, y, z, w")
    v = block.input("true_base_velocity", np.zeros(6), TWIST, "x_b': velocity of B's origin and angular velocity, in I")
    q = block.input("true_joint_position", robot.posture, rad, "Joint positions")
    qd = block.input("true_joint_velocity", np.zeros(n), rad_s, "Joint velocities")
    # fmt: on

    def white(name: str, stream: int, size: int) -> SX:
        """Return `size` numbers of an own generator.

        With one generator for all numbers, its derivative by its state would overflow.
        """
        random = block.state(
            f"random_{name}", 1.0, "1", f"State of the noise generator of {name}", local=True
        )
        block.initial(f"random_{name}", noise.first_state(seed + 1_000_003.0 * stream))
        following, numbers = noise.normal(random, size)
        block.update(f"random_{name}", following)
        return numbers

    e, e_q, e_qd = white("base", 0, 12), white("joints", 1, n), white("speeds", 2, n)
    position, orientation = p + s_p * e[:3], rotation.product(rotation.about(s_R * e[3:6]), R)
    velocity = v + ca.vertcat(s_v * e[6:9], s_w * e[9:12])
    joints, speeds = q + s_q * e_q, qd + s_qd * e_qd
    state = State(orientation, velocity[:3], velocity[3:], joints, speeds)
    mechanism = constant_mechanism(robot)
    p_e, R_e = end_effector_pose(mechanism, position, orientation, joints)
    # fmt: off
    block.output("base_position", position, "m", "Measured position of B in I")
    block.output("base_orientation", orientation, "1", "Measured orientation of B in I, quaternion x, y, z, w")
    block.output("base_velocity", velocity, TWIST, "Measured velocity of B's origin and angular velocity, in I")
    block.output("joint_position", joints, rad, "Measured joint positions")
    block.output("joint_velocity", speeds, rad_s, "Measured joint velocities")
    block.output("end_effector_position", p_e, "m", "Position of E in I, from the measured joints and base")
    block.output("end_effector_orientation", R_e, "1", "Orientation of E in I, from the measured joints and base, quaternion x, y, z, w")
    block.output("end_effector_velocity", end_effector_velocity(mechanism, state), TWIST, "x_m', from the measured joints and base, in I")
    # fmt: on
    require_quaternions(block, {"true_base_orientation": R})
    block.terminal("base", "base_position", "base_orientation", "base_velocity")
    block.terminal("arm", "joint_position", "joint_velocity")
    block.terminal("hand", **END_EFFECTOR)
    return block
