"""Pulses and a sine that are added to the joint torques and to the base wrench."""

from __future__ import annotations

import casadi as ca
import numpy as np

from freeflyer_fmus.blocks.block import WRENCH, Block
from freeflyer_fmus.blocks.robot_parameters import joint_units
from freeflyer_fmus.equations import disturbances
from freeflyer_fmus.robot.robot import Robot


def disturbance(robot: Robot) -> Block:
    n = robot.joint_count
    torque = joint_units(robot, "N.m", "N")
    block = Block("disturbance", "Pulses and a sine on the joint torques and on the base wrench")
    # fmt: off
    block.sampled_every("period", 1e-3, "Sampling time: that of the manipulator controller")
    start = block.parameter("pulse_start", 10.0, "s", "Start of the first pulse", minimum=0.0)
    length = block.parameter("pulse_length", 0.1, "s", "Length of a pulse", minimum=0.0)
    repeat = block.parameter("pulse_repeat", 0.0, "s", "Time from one pulse to the next (0: one pulse)", minimum=0.0)
    frequency = block.parameter("sine_frequency", 0.1, "Hz", "Frequency of the sine", minimum=0.0)
    acts = disturbances.pulse(block.time, start, length, repeat)
    wave = ca.sin(2.0 * ca.pi * frequency * block.time)
    for name, size, unit, what in (
        ("joint_torque", n, torque, "tau: joint torques (forces for prismatic joints)"),
        ("base_wrench", 6, WRENCH, "Force on the base and torque about B, in I"),
    ):
        pulse = block.parameter(f"pulse_{name}", np.zeros(size), unit, f"Amplitude of the pulse on {name}")
        sine = block.parameter(f"sine_{name}", np.zeros(size), unit, f"Amplitude of the sine on {name}")
        commanded = block.input(f"commanded_{name}", np.zeros(size), unit, f"{what}, without disturbance")
        block.output(name, commanded + pulse * acts + sine * wave, unit, f"{what}, with disturbance")
    # fmt: on
    return block
