"""Blocks that disturb a loop: pulses, noise, delays, limits, thrusters."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from freeflyer.foundation.errors import ComponentError
from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.equations.kinematics import end_effector_pose
from freeflyer_fmus.equations.mechanism import constant_mechanism
from freeflyer_fmus.in_process_block import InProcessBlock
from freeflyer_fmus.robot.urdf import load_robot_file

T = 1e-3


@cache
def declared(name: str) -> Block:
    return BLOCKS[name](load_robot_file())


def samples(
    name: str, parameters: dict[str, object], inputs: dict[str, object], count: int, output: str
) -> np.ndarray:
    """Return an output (count, size) at the first samples.

    An input may be a function of the time.
    """
    component = InProcessBlock(declared(name))
    values = {
        key: np.resize(np.asarray(value, float), component.value(key).size)
        for key, value in parameters.items()
    }
    component.enter_initialization(0.0, values)
    component.exit_initialization()
    found = []
    for k in range(count):
        for key, value in inputs.items():
            component.value(key)[:] = value(k * T) if callable(value) else value
        component.step(k * T, T)
        found.append(component.value(output).copy())
    return np.array(found)


@given(
    start=st.integers(0, 40),
    length=st.integers(1, 20),
    repeat=st.integers(0, 60),
    axis=st.integers(0, 5),
)
def test_a_pulse_acts_from_its_start_for_its_length_and_repeats(
    start: int, length: int, repeat: int, axis: int
) -> None:
    amplitude = np.eye(6)[axis] * 3.0
    parameters = {
        "pulse_start": start * T,
        "pulse_length": length * T,
        "pulse_repeat": repeat * T,
        "pulse_base_wrench": amplitude,
    }
    found = samples(
        "disturbance", parameters, {"commanded_base_wrench": np.ones(6)}, 100, "base_wrench"
    )
    since = np.arange(100) - start
    if repeat:
        since = np.where(since >= 0, since % repeat, since)
    acts = (since >= 0) & (since < length)
    assert np.array_equal(found, 1.0 + acts[:, None] * amplitude)


def test_a_sine_is_added_to_the_torques() -> None:
    parameters = {"sine_joint_torque": [1, 2, 3, 4, 5, 6], "sine_frequency": 7.0}
    found = samples("disturbance", parameters, {}, 50, "joint_torque")
    wave = np.sin(2.0 * np.pi * 7.0 * np.arange(50) * T)
    assert found == pytest.approx(wave[:, None] * np.arange(1, 7), abs=1e-12)


def test_noise_has_the_given_deviations_and_the_end_effector_follows_the_noisy_joints() -> None:
    parameters = {
        "position_noise": 1e-3,
        "orientation_noise": 2e-3,
        "velocity_noise": 3e-3,
        "angular_velocity_noise": 4e-3,
        "joint_position_noise": 5e-3,
        "joint_velocity_noise": 6e-3,
        "seed": 11,
    }
    component = InProcessBlock(declared("measurement_noise"))
    component.enter_initialization(
        0.0, {k: np.resize(v, component.value(k).size).astype(float) for k, v in parameters.items()}
    )
    component.exit_initialization()
    names = (
        "base_position",
        "base_orientation",
        "base_velocity",
        "joint_position",
        "joint_velocity",
    )
    start = {name: component.value(f"true_{name}").copy() for name in names}
    found: dict[str, list[np.ndarray]] = {name: [] for name in (*names, "end_effector_position")}
    for k in range(3000):
        component.step(k * T, T)
        for name, values in found.items():
            values.append(component.value(name).copy())
    series = {name: np.array(values) for name, values in found.items()}
    angles = Rotation.from_quat(series["base_orientation"]).as_rotvec()
    deviations = [
        (series["base_position"], 1e-3),
        (angles, 2e-3),
        (series["base_velocity"][:, :3], 3e-3),
        (series["base_velocity"][:, 3:], 4e-3),
        (series["joint_position"] - start["joint_position"], 5e-3),
        (series["joint_velocity"], 6e-3),
    ]
    for values, deviation in deviations:
        assert values.std(axis=0) == pytest.approx(np.full(values.shape[1], deviation), rel=0.08)
        assert np.abs(values.mean(axis=0)).max() < 0.1 * deviation
    everything = np.hstack([values for values, _ in deviations])
    correlation = np.corrcoef(everything.T) - np.eye(everything.shape[1])
    assert np.abs(correlation).max() < 0.1, "the numbers are independent"
    p, _ = end_effector_pose(
        constant_mechanism(load_robot_file()),
        *(
            ca.SX(ca.DM(series[name][-1]))
            for name in ("base_position", "base_orientation", "joint_position")
        ),
    )
    assert np.array(ca.evalf(p)).ravel() == pytest.approx(series["end_effector_position"][-1])


def test_without_noise_the_measurements_are_exact() -> None:
    q = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_quat()
    found = samples("measurement_noise", {}, {"true_base_orientation": q}, 3, "base_orientation")
    assert np.array_equal(found, np.tile(q, (3, 1)))


@pytest.mark.parametrize(("delay", "late"), [(0.0, 0), (0.005, 5)])
def test_a_command_acts_one_period_later(delay: float, late: int) -> None:
    commands = {"commanded_base_wrench": lambda t: np.full(6, 1.0 + np.floor((t + 1e-9) / 0.005))}
    parameters = {"command_period": 0.005, "delay": delay}
    found = samples("base_command_delay", parameters, commands, 20, "base_wrench")[:, 0]
    held = 1.0 + np.floor(np.arange(20) / 5)
    expected = np.concatenate([np.zeros(late), held[: 20 - late]])
    assert np.array_equal(found, expected)


def test_a_delay_that_is_not_a_period_is_rejected() -> None:
    with pytest.raises(ComponentError, match="set delay to 0 or to command_period"):
        samples("arm_command_delay", {"delay": 0.002}, {}, 1, "joint_torque")


def test_actuators_saturate_each_axis() -> None:
    command = np.array([3.0, -3.0, 0.5, 9.0, -9.0, 0.1])
    found = samples(
        "base_actuators",
        {"limit": [1, 1, 1, 2, 2, 2]},
        {"commanded_base_wrench": command},
        1,
        "base_wrench",
    )
    assert list(found[0]) == [1.0, -1.0, 0.5, 2.0, -2.0, 0.1]


@given(st.floats(-12.0, 12.0))
def test_thrusters_give_the_mean_of_the_command_over_the_period(force: float) -> None:
    parameters = {
        "on_off": True,
        "base_period": 0.1,
        "thruster_wrench": 10.0,
        "minimum_on_time": 0.02,
    }
    command = {"commanded_base_wrench": np.full(6, force)}
    found = samples("base_actuators", parameters, command, 100, "base_wrench")[:, 0]
    assert set(np.abs(found)) <= {0.0, 10.0}
    mean = found.mean()
    wanted = float(np.clip(force, -10.0, 10.0))
    if abs(wanted) < 1.0:  # half of the minimum on-time
        assert mean == 0.0
    elif abs(wanted) < 2.0:
        assert mean == pytest.approx(np.copysign(2.0, wanted))
    else:
        assert mean == pytest.approx(wanted, abs=0.0501)
    on = np.flatnonzero(found)
    assert np.array_equal(on, np.arange(on.size)), "on from the start of the period"
