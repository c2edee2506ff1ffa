"""Limits, quality monitor, ramp-down and life cycle: every rule acts, with its value and unit."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from freeflyer_adapters.device import parameters as device_parameters
from freeflyer_adapters.device.device import TRANSITIONS, LifeCycle, State
from freeflyer_adapters.device.limits import ArmLimits, BaseLimits
from freeflyer_adapters.device.parameters import Setting
from freeflyer_adapters.device.quality import QualityMonitor
from freeflyer_adapters.device.ramp_down import AT_REST, RampDown

N = 6
ARM = {
    port.name: np.array(port.start) for port in device_parameters.ports(device_parameters.ARM, N)
}
BASE = {port.name: np.array(port.start) for port in device_parameters.ports(device_parameters.BASE)}
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
torques = st.lists(st.floats(-1e9, 1e9), min_size=N, max_size=N).map(np.array)


def arm(**changed: float) -> ArmLimits:
    return ArmLimits(
        {**ARM, **{name: np.full(ARM[name].size, value) for name, value in changed.items()}}, 1e-3
    )


def base(**changed: list[float]) -> BaseLimits:
    return BaseLimits({**BASE, **{name: np.array(value) for name, value in changed.items()}})


# The arm


@given(torques, torques)
def test_sent_torques_are_within_effort_and_rate_limits(
    wanted: np.ndarray, before: np.ndarray
) -> None:
    limits = arm(joint_effort_limit=50.0, torque_rate_limit=2000.0)
    before = np.clip(before, -50.0, 50.0)
    sent, reason = limits.command(wanted, before)
    assert reason is None
    assert (np.abs(sent) <= 50.0 + 1e-12).all()
    assert (np.abs(sent - before) <= 2.0 + 1e-12).all()
    assert (np.array_equal(sent, wanted)) == (not +limits.acted)


def test_a_limit_that_clips_is_counted_by_name() -> None:
    limits = arm(joint_effort_limit=5.0, torque_rate_limit=1e6)
    limits.command(np.full(N, 6.0), np.zeros(N))
    assert dict(+limits.acted) == {"joint_effort_limit": 1}
    limits = arm(joint_effort_limit=50.0, torque_rate_limit=1000.0)
    limits.command(np.full(N, 6.0), np.zeros(N))
    assert dict(+limits.acted) == {"torque_rate_limit": 1}


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_non_finite_torque_stops_and_is_not_sent(bad: float) -> None:
    before = np.full(N, 0.5)
    sent, reason = arm().command(np.array([0.0, bad, 0.0, 0.0, 0.0, 0.0]), before)
    assert np.array_equal(sent, before)
    assert reason is not None
    assert "N m" in reason


def test_a_joint_too_fast_stops() -> None:
    limits = arm(joint_velocity_limit=1.5)
    velocity = np.array([0.0, 0.0, -1.6, 0.0, 0.0, 0.0])
    assert (
        limits.measured(np.zeros(N), velocity)
        == "joint 3 moves at -1.6 rad/s, its limit is 1.5 rad/s"
    )
    assert limits.measured(np.zeros(N), np.full(N, 1.5)) is None


def test_a_joint_near_the_end_of_its_range_stops() -> None:
    limits = arm(joint_upper_limit=1.0, joint_lower_limit=-1.0, joint_limit_margin=0.1)
    assert limits.measured(np.full(N, 0.9), np.zeros(N)) is None
    position = np.array([0.0, 0.0, 0.0, 0.0, -0.95, 0.0])
    assert (
        limits.measured(position, np.zeros(N))
        == "joint 5 is at -0.95 rad, its range is -0.9 to 0.9 rad"
    )


@pytest.mark.parametrize("where", ["position", "velocity"])
def test_a_nan_measurement_stops(where: str) -> None:
    values = {"position": np.zeros(N), "velocity": np.zeros(N)}
    values[where][3] = np.nan
    reason = arm().measured(values["position"], values["velocity"])
    assert reason is not None
    assert reason.startswith("joint 4")


# The base robot


def test_a_set_point_within_all_limits_passes() -> None:
    assert (
        base().setpoint(np.full(3, 0.1), IDENTITY, np.zeros(6), (np.full(3, 0.1), IDENTITY)) is None
    )


@pytest.mark.parametrize(
    ("position", "velocity", "sentence"),
    [
        ([0.6, 0.0, 0.0], [0.0] * 6, r"outside the workspace .* to \[0.5, 0.5, 0.5\] m"),
        (
            [0.0, 0.0, 0.0],
            [0.3, 0.0, 0.0, 0.0, 0.0, 0.0],
            r"moves at 0.3 m/s, its limit is 0.2 m/s",
        ),
        (
            [0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.6, 0.0],
            r"moves at 0.6 rad/s, its limit is 0.5 rad/s",
        ),
        ([0.003, 0.0, 0.0], [0.0] * 6, r"jumps by 0.003 m in one cycle, its limit is 0.002 m"),
        ([np.nan, 0.0, 0.0], [0.0] * 6, r"finite numbers are expected"),
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0, np.inf, 0.0, 0.0], r"finite numbers are expected"),
    ],
)
def test_a_set_point_beyond_a_limit_stops(
    position: list[float], velocity: list[float], sentence: str
) -> None:
    reason = base().setpoint(
        np.array(position), IDENTITY, np.array(velocity), (np.zeros(3), IDENTITY)
    )
    assert reason is not None
    assert re.search(sentence, reason), reason


def test_a_set_point_with_too_large_a_rotation_in_one_cycle_stops() -> None:
    rotated = np.array([np.sin(0.005), 0.0, 0.0, np.cos(0.005)])
    reason = base().setpoint(np.zeros(3), rotated, np.zeros(6), (np.zeros(3), IDENTITY))
    assert reason == "the base's set point jumps by 0.01 rad in one cycle, its limit is 0.005 rad"


def test_a_zero_quaternion_stops() -> None:
    assert "squared norm" in str(base().setpoint(np.zeros(3), np.zeros(4), np.zeros(6), None))


def test_a_base_that_does_not_follow_stops() -> None:
    far = np.array([0.06, 0.0, 0.0])
    assert (
        base().measured(far, IDENTITY, (np.zeros(3), IDENTITY))
        == "the base is 0.06 m from its set point, the limit is 0.01 m"
    )
    assert base().measured(far, IDENTITY, (far, IDENTITY)) is None
    assert base().measured(far * np.nan, IDENTITY, (far, IDENTITY)) is not None


# Quality of a link


def monitor(consecutive: int = 2, within: int = 3, window: int = 50) -> QualityMonitor:
    return QualityMonitor(
        "samples", consecutive=consecutive, within=within, window=window, cycle=0.004
    )


@given(
    st.lists(st.booleans(), max_size=300), st.integers(1, 6), st.integers(0, 6), st.integers(1, 60)
)
def test_the_monitor_stops_exactly_by_its_rules(
    lost: list[bool], consecutive: int, within: int, window: int
) -> None:
    watched = monitor(consecutive, within, window)
    for k, is_lost in enumerate(lost):
        reason = watched.observe(is_lost)
        row = 0
        for past in reversed(lost[: k + 1]):
            if not past:
                break
            row += 1
        recent = sum(lost[max(0, k + 1 - window) : k + 1])
        expected = is_lost and (row >= consecutive or (within > 0 and recent >= within))
        assert (reason is not None) == expected
    assert watched.lost == sum(lost)


def test_the_bases_defaults_are_two_in_a_row_and_three_in_200_ms() -> None:
    v = BASE
    watched = monitor(
        int(v["lost_consecutive"][0]),
        int(v["lost_in_window"][0]),
        round(v["window"][0] / v["cycle"][0]),
    )
    assert watched.observe(True) is None
    reason = watched.observe(True)
    assert reason is not None
    assert "2 cycles in a row were lost" in reason
    watched = monitor(2, 3, 50)
    pattern = [True, *[False] * 20, True, *[False] * 20]
    assert not any(watched.observe(x) for x in pattern)
    reason = watched.observe(True)
    assert reason is not None
    assert "3 cycles within 0.2 s were lost" in reason


def test_the_arms_default_is_twenty_in_a_row() -> None:
    watched = QualityMonitor("frames", consecutive=int(ARM["lost_consecutive"][0]), cycle=1e-3)
    assert not any(watched.observe(True) for _ in range(19))
    assert watched.observe(True) is not None
    assert watched.longest_row == 20


def test_random_loss_of_five_per_cent_stops_the_base_soon() -> None:
    """The rule stops the base after 4.5 s at 1 % loss, after 0.2 s at 5 % (means; facility.md)."""
    random = np.random.default_rng(1)

    def time_to_stop(share: float) -> float:
        watched = monitor()
        k = 0
        while watched.observe(bool(random.random() < share)) is None:
            k += 1
        return k * 0.004

    assert 0.1 < np.median([time_to_stop(0.05) for _ in range(200)]) < 0.6
    assert 2.0 < np.median([time_to_stop(0.01) for _ in range(200)]) < 9.0


# Ramp-down


@given(torques, st.floats(0.0, 2.0))
def test_the_ramp_ends_without_torque_and_never_adds_to_it_at_rest(
    last: np.ndarray, elapsed: float
) -> None:
    ramp = RampDown(time=0.25, damping=5.0)
    torque = ramp.torque(last, np.zeros(N), elapsed)
    assert (np.abs(torque) <= np.abs(last) + 1e-12).all()
    if elapsed >= 0.25:
        assert not torque.any()


def test_the_ramp_damps_motion_and_ends_at_rest_or_after_twice_its_time() -> None:
    ramp = RampDown(time=0.25, damping=5.0)
    moving, still = np.full(N, 1.0), np.full(N, 0.5 * AT_REST)
    assert (ramp.torque(np.zeros(N), moving, 1.0) == -5.0).all()
    assert not ramp.over(still, 0.2)
    assert ramp.over(still, 0.25)
    assert not ramp.over(moving, 0.3)
    assert ramp.over(moving, 0.5)


# Life cycle and settings


@given(st.lists(st.sampled_from(list(LifeCycle)), max_size=30))
def test_only_transitions_in_the_table_are_accepted(wanted: list[LifeCycle]) -> None:
    state = State("a device")
    for following in wanted:
        before = state.now
        if following == before or following in TRANSITIONS[before]:
            state.to(following)
            assert state.now is following
        else:
            with pytest.raises(RuntimeError, match="not a transition"):
                state.to(following)
            assert state.now is before


def test_active_is_reached_from_inactive_only() -> None:
    assert [s for s in LifeCycle if LifeCycle.active in TRANSITIONS[s]] == [LifeCycle.inactive]


@pytest.mark.parametrize(
    "setting", [*device_parameters.ARM, *device_parameters.BASE], ids=lambda s: s.name
)
def test_every_limit_has_a_default_a_unit_and_an_effect(setting: Setting) -> None:
    assert setting.default
    assert setting.description
    if setting.effect:
        assert setting.effect in ("clips", "stops", "refuses")
    if setting.name.endswith(("limit", "tolerance", "speed", "time", "margin")):
        assert setting.unit


@given(st.integers(1, 10**9), st.integers(1, 50))
def test_a_gap_of_any_size_is_counted_quickly(gap: int, consecutive: int) -> None:
    watched = monitor(consecutive, 0, 50)
    reason = watched.lose(gap)
    assert (reason is not None) == (gap >= consecutive)
    assert watched.lost == gap


@given(torques, torques, st.floats(1.0, 1e5))
def test_the_effort_limit_holds_for_any_earlier_torque(
    wanted: np.ndarray, before: np.ndarray, rate: float
) -> None:
    sent, _ = arm(joint_effort_limit=10.0, torque_rate_limit=rate).command(wanted, before)
    assert (np.abs(sent) <= 10.0).all()
