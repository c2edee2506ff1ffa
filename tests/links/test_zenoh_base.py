"""The host's side of the base's link, sample by sample against a scripted base robot over real Zenoh sessions on loopback."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from threading import Event, Thread

import numpy as np
import pytest

from freeflyer_adapters.base.link import OdometryLink, is_usable
from freeflyer_adapters.base.options import LinkOptions
from freeflyer_adapters.base.rmw_zenoh import Attachment
from freeflyer_adapters.base.ros_messages import Odometry, OdometryWriter
from freeflyer_adapters.base.session import open_session
from freeflyer_adapters.base.zenoh_base import ZenohBase
from freeflyer_adapters.device import DeviceError, LifeCycle, SafeStop

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
STILL = np.zeros(6)


def waited(condition: Callable[[], bool], timeout: float = 5.0) -> bool:
    end = time.monotonic() + timeout
    while not condition() and time.monotonic() < end:
        time.sleep(0.002)
    return condition()


class ScriptedBase:
    """Publishes what it is told to, and keeps every set point; it does not tell whom it obeys."""

    def __init__(self, options: LinkOptions) -> None:
        self.session = open_session([], options.connect, "scripted")
        self.link = OdometryLink(self.session, options, options.measured_topic, options.setpoint_topic)
        self.setpoints: list[Odometry] = []

    def send(self, position: np.ndarray | None = None, orientation: np.ndarray = IDENTITY) -> None:
        self.link.publish(np.zeros(3) if position is None else position, orientation, STILL)

    def take(self) -> None:
        received = self.link.receive(is_usable)
        if received is not None:
            self.setpoints.append(received.odometry)

    def close(self) -> None:
        self.link.close()
        self.session.close()


@pytest.fixture
def there() -> Iterator[ScriptedBase]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    made = ScriptedBase(LinkOptions(connect=(f"tcp/127.0.0.1:{port}",)))
    yield made
    made.close()


@pytest.fixture
def here(there: ScriptedBase) -> Iterator[ZenohBase]:
    base = ZenohBase("base", there.link.options)
    base.values["orientation_setpoint"][:] = IDENTITY
    yield base
    base.deactivate()


def configured(base: ZenohBase, there: ScriptedBase, position: np.ndarray | None = None) -> None:
    """Samples flow until the base has one, as they do from a robot."""

    done = Event()

    def flow() -> None:
        while not done.wait(0.004):
            there.send(position)

    thread = Thread(target=flow)
    thread.start()
    try:
        base.configure()
        base.check_start()
        base.activate(lambda: False)
    finally:
        done.set()
        thread.join()
    base._sequence = 0  # what flowed while nobody read is no loss
    fresh(base, there, position)
    base._steps = 0


def fresh(base: ZenohBase, there: ScriptedBase, position: np.ndarray | None = None) -> None:
    """One sample, and the step that reads it."""
    there.send(position)
    end = time.monotonic() + 5.0
    while base._sequence != there.link._sequence and time.monotonic() < end:
        base._steps = 0
        base.read()
        time.sleep(0.0005)


def test_the_first_set_point_is_the_measured_pose(here: ZenohBase, there: ScriptedBase) -> None:
    where = np.array([0.003, 0.0, -0.002])
    configured(here, there, where)
    assert waited(lambda: (there.take(), bool(there.setpoints))[1])
    assert there.setpoints[0].position == pytest.approx(where)
    assert not there.setpoints[0].velocity.any()


def test_what_lies_between_is_taken_off_slowly(here: ZenohBase, there: ScriptedBase) -> None:
    configured(here, there, np.array([0.003, 0.0, 0.0]))
    distances = []
    for _ in range(60):
        here._steps = 0
        here.write()
        assert here._sent is not None
        distances.append(float(np.linalg.norm(here._sent[0])))
    steps = -np.diff([0.003, *distances])
    assert (steps <= 0.02 * 0.004 + 1e-12).all()
    assert distances[-1] == 0.0


@pytest.mark.parametrize(
    ("setpoint", "sentence"),
    [
        ({"position_setpoint": [0.6, 0.0, 0.0]}, "outside the workspace"),
        ({"position_setpoint": [0.01, 0.0, 0.0]}, "jumps by 0.01 m in one cycle, its limit is 0.002 m"),
        ({"velocity_setpoint": [0.0, 0.3, 0.0, 0.0, 0.0, 0.0]}, "moves at 0.3 m/s, its limit is 0.2 m/s"),
        ({"position_setpoint": [np.nan, 0.0, 0.0]}, "finite numbers are expected"),
        ({"orientation_setpoint": [0.0, 0.0, 0.0, 0.0]}, "squared norm"),
    ],
)
def test_a_set_point_beyond_a_limit_is_not_sent_and_stops(
    here: ZenohBase, there: ScriptedBase, setpoint: dict[str, list[float]], sentence: str
) -> None:
    configured(here, there)
    published = here.published
    for name, value in setpoint.items():
        here.values[name][:] = value
    with pytest.raises(SafeStop, match=sentence):
        here.write()
    assert here.published == published


def test_one_missing_sequence_number_is_one_lost_cycle_and_the_third_within_the_window_stops(
    here: ZenohBase, there: ScriptedBase
) -> None:
    configured(here, there)
    lost = here.monitor.lost
    for k in range(2):
        there.link._sequence += 1
        fresh(here, there)
        assert here.monitor.lost == lost + k + 1
        fresh(here, there)
    there.link._sequence += 1
    with pytest.raises(SafeStop, match=r"3 cycles within 0\.2 s were lost"):
        fresh(here, there)


def test_two_missing_in_a_row_stop(here: ZenohBase, there: ScriptedBase) -> None:
    configured(here, there)
    fresh(here, there)
    there.link._sequence += 2
    with pytest.raises(SafeStop, match="2 cycles in a row were lost"):
        fresh(here, there)


def test_silence_stops_by_the_age_of_the_last_sample(here: ZenohBase, there: ScriptedBase) -> None:
    here.values["lost_consecutive"][:] = 1000.0
    here.values["lost_in_window"][:] = 0.0
    configured(here, there)
    fresh(here, there)
    time.sleep(0.03)
    here._steps = here._ratio - 1
    with pytest.raises(SafeStop, match=r"the last measurement is 0\.\d+ s old, its limit is 0.02 s"):
        here.read()


def test_a_base_that_does_not_follow_stops(here: ZenohBase, there: ScriptedBase) -> None:
    configured(here, there)
    there.send(np.array([0.02, 0.0, 0.0]))
    time.sleep(0.01)
    here._take()
    here._steps = here._ratio - 1
    with pytest.raises(SafeStop, match=r"the base is 0\.02 m from its set point, its limit is 0\.01 m"):
        here.read()


def test_samples_that_cannot_be_used_are_counted_and_change_nothing(here: ZenohBase, there: ScriptedBase) -> None:
    configured(here, there)
    link, before = here._link, here.values["base_position"].copy()
    assert link is not None
    counts = link.counts

    def refused() -> int:
        here._take()
        return counts.malformed + counts.stale + counts.strangers

    writer = OdometryWriter("inertial", "base")
    gid, sequence = there.link._gid, there.link._sequence
    good = writer.write(time.time_ns(), np.full(3, 0.1), IDENTITY, STILL)
    nan = writer.write(time.time_ns(), np.full(3, np.nan), IDENTITY, STILL)
    later = Attachment(sequence + 1, time.time_ns(), gid).pack()
    for payload, attachment in (
        (good[:100], later),
        (good, later[:-1]),
        (good, None),
        (nan, later),
        (good, Attachment(sequence, time.time_ns(), gid).pack()),
        (good, Attachment(sequence + 1, 1, gid).pack()),
        (good, Attachment(sequence + 1, time.time_ns(), bytes(16)).pack()),
    ):
        seen = refused()
        there.link._publisher.put(payload, attachment=attachment)
        assert waited(lambda seen=seen: refused() == seen + 1), (payload[:8], attachment)  # type: ignore[misc]
        assert np.array_equal(here.values["base_position"], before)


def test_the_freshest_of_many_samples_is_read(here: ZenohBase, there: ScriptedBase) -> None:
    configured(here, there)
    for k in range(100):
        there.send(np.array([0.00001 * k, 0.0, 0.0]))
        time.sleep(0.001)  # congestion control DROP would be right to drop a burst
    time.sleep(0.2)
    here._take()
    assert here.values["base_position"][0] == pytest.approx(0.00099)


def test_an_approach_keeps_the_limits_of_set_points(here: ZenohBase, there: ScriptedBase) -> None:
    here.values["approach"][:] = 1.0
    here.values["approach_speed"][:] = [2.0, 2.0]
    with pytest.raises(DeviceError, match=r"approach to the start pose was given up: .*moves at 2 m/s, its limit is 0.2 m/s"):
        configured(here, there, np.array([0.3, 0.0, 0.0]))
    assert here.state.now is LifeCycle.inactive


def test_a_silent_base_is_said_to_be_silent(there: ScriptedBase) -> None:
    base = ZenohBase("base", there.link.options)
    base.values["configure_timeout"][:] = 0.3
    try:
        with pytest.raises(DeviceError, match="sends nothing on topic base_robot/measured"):
            base.configure()
    finally:
        base.deactivate()
