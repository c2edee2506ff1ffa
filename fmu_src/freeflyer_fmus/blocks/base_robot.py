"""The facility's base robot: a position-controlled industrial robot that follows set points.

The robot accepts one set point per cycle, and follows it after a delay of some cycles. It responds
as a critically damped second-order system with a given bandwidth. Speed and acceleration are
limited. The block is sampled; several samples can be in one cycle. Its outputs are the motion at
the sample, and the acceleration, which is constant until the next sample.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from freeflyer_fmus.blocks.block import ACCELERATION, TWIST, Block
from freeflyer_fmus.blocks.robot_parameters import IDENTITY, require_quaternions
from freeflyer_fmus.equations import noise, rotation
from freeflyer_fmus.robot.robot import Robot

SX = ca.SX
LONGEST_DELAY = 8
"""Number of set points in the delay buffer. The largest delay is one cycle less."""


def base_robot(robot: Robot) -> Block:
    block = Block(
        "base_robot",
        "Position-controlled robot: delay, tracking bandwidth, limits of speed and acceleration",
    )
    # Parameters. The paper gives no data of the base robot. The defaults marked "assumed" are
    # assumptions.
    # fmt: off
    T = block.sampled_every("period", 1e-3, "Period of the servo loop and of the motion outputs")
    cycle = block.parameter("cycle", 0.004, "s", "Period at which set points are accepted", above=0.0)
    delay = block.parameter("delay_cycles", 2.0, "1", f"Delay of the set points in cycles, 0 to {LONGEST_DELAY - 1} (assumed)", minimum=0.0)
    block.require(
        LONGEST_DELAY - 1 - delay,
        0.0,
        "free space in the delay buffer (parameter delay_cycles)",
        f"choose at most {LONGEST_DELAY - 1} cycles",
    )
    bandwidth = block.parameter("bandwidth", 10.0, "Hz", "Natural frequency of the tracking response (assumed)", above=0.0)
    v_max = block.parameter("velocity_limit", [1.5, 2.0], ("m/s", "rad/s"), "Largest speeds (assumed)", above=0.0)
    a_max = block.parameter(
        "acceleration_limit", [10.0, 20.0], ("m/s2", "rad/s2"), "Largest accelerations (assumed)", above=0.0
    )
    position_noise = block.parameter(
        "position_noise", 1e-5, "m", "Standard deviation of the measured position (assumed)", minimum=0.0
    )
    orientation_noise = block.parameter(
        "orientation_noise", 1e-5, "rad", "Standard deviation of the measured orientation (assumed)", minimum=0.0
    )
    seed = block.parameter("seed", 2.0, "1", "Seed of the noise")

    # "delayed" marks inputs that get the value that their source had before the present instant.
    # The label does not mean the delay of `delay_cycles`.
    p_set = block.input("position_setpoint", np.zeros(3), "m", "Commanded position, in I (delayed)")
    R_set = block.input("orientation_setpoint", IDENTITY, "1", "Commanded orientation, quaternion x, y, z, w (delayed)")
    v_set = block.input("velocity_setpoint", np.zeros(6), TWIST, "Commanded velocity, in I (delayed)")

    p = block.state("true_position", np.zeros(3), "m", "True position, in I")
    R = block.state("true_orientation", IDENTITY, "1", "True orientation, quaternion x, y, z, w")
    v = block.state("true_velocity", np.zeros(6), TWIST, "True velocity, in I")
    a = block.state("base_acceleration", np.zeros(6), ACCELERATION, "Acceleration until the next sample, in I")
    age = block.state("age", 0.0, "1", "Samples since the last accepted set point", local=True)
    random = block.state("random", 1.0, "1", "State of the noise generator", local=True)
    begun = block.state("begun", 0.0, "1", "1 after the first sample", local=True)
    # fmt: on
    entry = 13
    memory = [
        block.state(
            f"setpoint_{k}",
            np.concatenate([np.zeros(3), IDENTITY, np.zeros(6)]),
            "1",
            f"Set point {k} cycles ago",
            local=True,
        )
        for k in range(LONGEST_DELAY)
    ]
    for k in range(LONGEST_DELAY):
        block.initial(f"setpoint_{k}", ca.vertcat(p, rotation.normalised(R), v))
    block.initial("true_orientation", rotation.normalised(R))
    block.initial("random", noise.first_state(seed))

    # Compute the motion since the last sample. The acceleration was set at the last sample. The
    # translation is exact. The rotation uses the mean angular velocity since the last sample.
    h = T * begun
    p_now = p + h * v[:3] + 0.5 * h**2 * a[:3]
    rotation_vector = h * v[3:] + 0.5 * h**2 * a[3:]
    R_now = rotation.normalised(rotation.product(rotation.about(rotation_vector), R))
    v_now = v + h * a

    # Accept a set point once per cycle, and shift the delay buffer then.
    samples = ca.floor(cycle / T + 0.5)
    take = ca.logic_or(begun == 0, age + 1 >= samples)
    newest = ca.vertcat(p_set, R_set, v_set)
    moved = [
        ca.if_else(take, new, old) for new, old in zip([newest, *memory[:-1]], memory, strict=True)
    ]
    target = SX.zeros(entry)
    for k, old in enumerate(moved):
        target += ca.if_else(ca.floor(delay + 0.5) == k, old, SX.zeros(entry))

    # Tracking law with limited acceleration.
    omega = 2.0 * ca.pi * bandwidth
    error = ca.vertcat(target[:3] - p_now, rotation.error(target[3:7], R_now))
    wanted = omega**2 * error + 2.0 * omega * (target[7:] - v_now)
    acceleration = ca.vertcat(_limited(wanted[:3], a_max[0]), _limited(wanted[3:], a_max[1]))
    # Limit the acceleration so that the next sample is within the speed limits.
    reached = v_now + T * acceleration
    kept = ca.vertcat(_limited(reached[:3], v_max[0]), _limited(reached[3:], v_max[1]))
    acceleration = (kept - v_now) / T

    # New states and noisy measurements.
    next_random, normal = noise.normal(random, 6)
    for name, value in {
        "true_position": p_now,
        "true_orientation": R_now,
        "true_velocity": v_now,
        "base_acceleration": acceleration,
        "age": ca.if_else(take, 0, age + 1),
        "random": next_random,
        "begun": SX(1),
    }.items():
        block.update(name, value)
    for k, value in enumerate(moved):
        block.update(f"setpoint_{k}", value)
    block.output(
        "base_position", p_now + position_noise * normal[:3], "m", "Measured position, in I"
    )
    measured = rotation.product(rotation.about(orientation_noise * normal[3:]), R_now)
    block.output("base_orientation", measured, "1", "Measured orientation, quaternion x, y, z, w")
    block.output("base_velocity", v_now, TWIST, "Measured velocity, in I")
    require_quaternions(block, {"orientation_setpoint": R_set, "true_orientation": R})
    block.terminal("base", "base_position", "base_orientation", "base_velocity")
    return block


def _limited(vector: SX, most: SX) -> SX:
    """Return `vector`. If its length is greater than `most`, scale it to the length `most`."""
    length = ca.sqrt(ca.sumsqr(vector) + 1e-300)
    return vector * ca.fmin(1.0, most / length)
