"""Desired motions: consistent derivatives, paths, rest at the ends, exact waypoints."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.interpolate import BPoly
from scipy.spatial.transform import Rotation

from freeflyer.foundation.errors import ComponentError
from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.blocks.reference_trajectory import reference_motion
from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.blocks.waypoint_trajectory import CAPACITY
from freeflyer_fmus.equations.trajectory import Motion, Shape
from freeflyer_fmus.equations.waypoints import UNUSED
from freeflyer_fmus.in_process_block import InProcessBlock
from freeflyer_fmus.robot.urdf import load_robot_file

SX = ca.SX
OUTPUTS = ("position", "orientation", "velocity", "acceleration")


def residuals(t: SX, motion: Motion) -> SX:
    """Return velocity and acceleration, less the derivatives of pose and velocity."""
    q = motion.orientation
    p_rate, q_rate, v_rate = (
        ca.jtimes(part, t, SX(1)) for part in (motion.position, q, motion.velocity)
    )
    w = 2 * (q[3] * q_rate[:3] - q_rate[3] * q[:3] + ca.cross(q[:3], q_rate[:3]))
    return ca.vertcat(
        p_rate - motion.velocity[:3],
        v_rate - motion.acceleration,
        w - motion.velocity[3:],
        ca.sumsqr(q) - 1,
    )


@cache
def declared() -> tuple[Block, ca.Function]:
    block = Block("motion", "test")
    motion = reference_motion(block, load_robot_file())
    names = list(block.variables)
    arguments = [block.symbols[name] for name in names]
    return block, ca.Function("f", [block.time, *arguments], [residuals(block.time, motion)])


@given(
    st.sampled_from(Shape),
    st.floats(0.05, 40.0),
    st.integers(0, 2**32 - 1),
)
def test_velocity_and_acceleration_are_the_derivatives_of_every_shape(
    shape: Shape, time: float, seed: int
) -> None:
    random = np.random.default_rng(seed)
    block, f = declared()
    values = {v.name: np.array(v.start) for v in block.variables.values()}
    values |= {
        "shape": np.array([float(shape)]),
        "translation_amplitude": random.normal(size=3),
        "second_amplitude": random.normal(size=3),
        "rotation_amplitude": random.normal(size=3),
        "start_offset": random.normal(size=6),
        "drift": 0.1 * random.normal(size=6),
        "fade_out_start": np.array([20.0]),
    }
    # The second derivative of the ramp has a kink at its ends. There it is not the derivative.
    assume(min(abs(time - end) for end in (5.0, 20.0, 25.0)) > 1e-6)
    assert np.abs(np.array(f(time, *values.values()))).max() < 1e-10


@cache
def shipped(name: str) -> Block:
    return BLOCKS[name](load_robot_file())


def moved(block: str, values: dict[str, object], times: np.ndarray) -> dict[str, np.ndarray]:
    """Return the outputs of a block at `times`, one row for each time."""
    component = InProcessBlock(shipped(block))
    component.enter_initialization(
        0.0, {name: np.atleast_1d(np.array(value, float)) for name, value in values.items()}
    )
    component.exit_initialization()
    rows: dict[str, list[np.ndarray]] = {name: [] for name in OUTPUTS}
    now = 0.0
    for time in times:
        if time > now:
            component.step(now, time - now)
            now = time
        for name, found in rows.items():
            found.append(component.value(name).copy())
    return {name: np.array(found) for name, found in rows.items()}


def test_a_line_ends_at_its_amplitude_and_rests() -> None:
    found = moved(
        "reference_trajectory",
        {"shape": Shape.line, "translation_amplitude": [0.1, 0.2, -0.3], "ramp_time": 8.0},
        np.array([0.0, 4.0, 8.0, 30.0]),
    )
    assert found["position"][2] - found["position"][0] == pytest.approx([0.1, 0.2, -0.3])
    assert found["position"][1] - found["position"][0] == pytest.approx([0.05, 0.1, -0.15])
    assert not found["velocity"][[0, 2, 3]].any()
    assert np.array_equal(found["position"][2], found["position"][3])


def test_hold_stays_at_the_start_pose_with_its_offset() -> None:
    offset = [0.1, -0.2, 0.3, 0.0, 0.0, 0.5]
    plain, held = (
        moved("reference_trajectory", {"shape": Shape.hold, "start_offset": o}, np.arange(3.0))
        for o in (np.zeros(6), offset)
    )
    assert np.array_equal(held["position"][0], held["position"][2])
    assert held["position"][0] - plain["position"][0] == pytest.approx(offset[:3])
    rotated = (
        Rotation.from_quat(held["orientation"]) * Rotation.from_quat(plain["orientation"]).inv()
    )
    assert rotated.as_rotvec() == pytest.approx(np.tile(offset[3:], (3, 1)), abs=1e-12)
    assert not held["velocity"].any()


def test_a_circle_has_a_constant_radius_after_the_ramp_and_passes_through_the_start() -> None:
    a, b = np.array([0.1, 0.0, 0.0]), np.array([0.0, 0.06, 0.08])
    found = moved(
        "reference_trajectory",
        {
            "shape": Shape.circle,
            "translation_amplitude": a,
            "second_amplitude": b,
            "ramp_time": 1.0,
            "frequency": 0.25,
        },
        np.array([0.0, 1.5, 2.0, 3.3, 4.0]),
    )
    path = found["position"] - found["position"][0]
    assert np.linalg.norm(path[1:] - b, axis=1) == pytest.approx(np.full(4, 0.1))
    assert path[4] == pytest.approx(np.zeros(3), abs=1e-12)


@pytest.mark.parametrize("shape", [Shape.sine, Shape.circle])
def test_after_the_fade_out_the_motion_rests_at_the_start_pose(shape: Shape) -> None:
    found = moved(
        "reference_trajectory",
        {"shape": shape, "fade_out_start": 12.0, "fade_out_time": 3.0},
        np.array([0.0, 11.0, 13.3, 15.0, 40.0]),
    )
    assert found["position"][3:] == pytest.approx(np.tile(found["position"][0], (2, 1)), abs=1e-15)
    assert np.abs(found["velocity"][1:3]).max() > 1e-3
    assert not found["velocity"][3:].any()
    assert not found["acceleration"][3:].any()


def test_a_drift_moves_and_rotates_the_target() -> None:
    drift = [0.01, 0.0, -0.02, 0.0, 0.3, 0.0]
    found = moved(
        "reference_trajectory", {"shape": Shape.hold, "drift": drift}, np.array([0.0, 5.0])
    )
    assert found["velocity"] == pytest.approx(np.tile(drift, (2, 1)))
    assert found["position"][1] - found["position"][0] == pytest.approx([0.05, 0.0, -0.1])
    rotated = (
        Rotation.from_quat(found["orientation"][1])
        * Rotation.from_quat(found["orientation"][0]).inv()
    )
    assert rotated.as_rotvec() == pytest.approx([0.0, 1.5, 0.0])


def waypoint_values(times: np.ndarray, points: np.ndarray) -> dict[str, object]:
    """Return the parameters for waypoints (n) [s] and (n, 7)."""
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    values: dict[str, object] = {
        "waypoint_t": np.pad(times, (0, CAPACITY - times.size), constant_values=UNUSED)
    }
    for name, column in zip(names, points.T, strict=True):
        fill = 1.0 if name == "qw" else 0.0
        values[f"waypoint_{name}"] = np.pad(
            column, (0, CAPACITY - times.size), constant_values=fill
        )
    return values


def drawn(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    times = np.concatenate([[0.0], np.cumsum(random.uniform(0.5, 3.0, count - 1))])
    rotations = Rotation.from_rotvec(random.normal(size=(count, 3)) * 0.3).as_quat()
    signs = random.choice([-1.0, 1.0], (count, 1))
    return times, np.hstack([random.normal(size=(count, 3)) * 0.1, signs * rotations])


@given(st.integers(0, 2**32 - 1), st.integers(1, CAPACITY))
def test_a_spline_passes_through_its_waypoints_and_rests_at_both_ends(seed: int, n: int) -> None:
    times, points = drawn(seed, n)
    found = moved("waypoint_trajectory", waypoint_values(times, points), np.append(times, 1e3))
    start = moved("reference_trajectory", {"shape": Shape.hold}, np.zeros(1))
    assert found["position"][:-1] - start["position"] == pytest.approx(points[:, :3], abs=1e-12)
    rotated = (
        Rotation.from_quat(found["orientation"][:-1])
        * Rotation.from_quat(start["orientation"]).inv()
    )
    away = (rotated * Rotation.from_quat(points[:, 3:]).inv()).magnitude()
    assert np.abs(away).max() < 1e-7
    for name in ("velocity", "acceleration"):
        assert not found[name][[0, -2, -1]].any()
    assert np.array_equal(found["position"][-2], found["position"][-1])


@given(st.integers(0, 2**32 - 1))
def test_a_spline_of_positions_equals_the_quintic_hermite_spline_of_scipy(seed: int) -> None:
    times, points = drawn(seed, 6)
    x = points[:, 0]
    slopes, curvatures = np.zeros(6), np.zeros(6)
    for k in range(1, 5):
        parabola = np.polyfit(times[k - 1 : k + 2] - times[k], x[k - 1 : k + 2], 2)
        slopes[k], curvatures[k] = parabola[1], 2.0 * parabola[0]
    spline = BPoly.from_derivatives(times, np.column_stack([x, slopes, curvatures]))
    at = np.linspace(0.0, times[-1], 40)
    found = moved("waypoint_trajectory", waypoint_values(times, points), at)
    scale = 1.0 + np.abs(spline.derivative(2)(at)).max()
    start = moved("reference_trajectory", {"shape": Shape.hold}, np.zeros(1))["position"][0, 0]
    assert found["position"][:, 0] - start == pytest.approx(spline(at), abs=1e-10 * scale)
    assert found["velocity"][:, 0] == pytest.approx(spline.derivative()(at), abs=1e-9 * scale)
    inner = at[1:-1]
    assert found["acceleration"][1:-1, 0] == pytest.approx(
        spline.derivative(2)(inner), abs=1e-8 * scale
    )


@given(st.integers(0, 2**32 - 1))
def test_velocity_and_acceleration_of_a_spline_are_its_derivatives(seed: int) -> None:
    times, points = drawn(seed, 5)
    h, at = 1e-5, float(times[-1]) * 0.37
    assume(np.abs(times - at).min() > 10 * h)
    found = moved(
        "waypoint_trajectory", waypoint_values(times, points), np.array([at - h, at, at + h])
    )
    v, a = found["velocity"][1], found["acceleration"][1]
    difference = (found["position"][2] - found["position"][0]) / (2 * h)
    assert v[:3] == pytest.approx(difference, abs=1e-6)
    relative = (
        Rotation.from_quat(found["orientation"][2])
        * Rotation.from_quat(found["orientation"][0]).inv()
    )
    assert v[3:] == pytest.approx(relative.as_rotvec() / (2 * h), abs=1e-6)
    rate = (found["velocity"][2] - found["velocity"][0]) / (2 * h)
    assert a == pytest.approx(rate, abs=1e-5 * (1.0 + np.abs(a).max()))


@pytest.mark.parametrize(
    "times",
    [
        [0.0, 2.0, 1.0],
        [0.0, 1.0, 0.0, 2.0],
        [0.0, 1.0, 1.0],
        [0.0, 0.0],
        [0.0, -1.0, 1.0],
        [0.0, 1.0, 0.0],
    ],
    ids=str,
)
def test_waypoints_that_are_not_sorted_by_time_are_rejected(times: list[float]) -> None:
    values = waypoint_values(np.array(times), np.tile([0, 0, 0, 0, 0, 0, 1.0], (len(times), 1)))
    with pytest.raises(ComponentError, match="sort the waypoints by time"):
        moved("waypoint_trajectory", values, np.zeros(1))


def test_waypoints_without_times_are_rejected() -> None:
    with pytest.raises(ComponentError, match=r"give each waypoint a time \(column t\)"):
        moved("waypoint_trajectory", {"waypoint_x": np.ones(CAPACITY)}, np.zeros(1))


def test_a_waypoint_without_a_direction_is_rejected() -> None:
    values = waypoint_values(np.array([0.0, 1.0]), np.zeros((2, 7)))
    with pytest.raises(ComponentError, match="quaternion"):
        moved("waypoint_trajectory", values, np.zeros(1))
