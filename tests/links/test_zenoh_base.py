"""The controller's end of the base link against a scripted base robot, over Zenoh on loopback."""

from __future__ import annotations

import re
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread

import numpy as np
import pytest
from lab import waited

from freeflyer_adapters.base.link import OdometryLink, Received, is_usable
from freeflyer_adapters.base.options import LinkOptions
from freeflyer_adapters.base.rmw_zenoh import Attachment
from freeflyer_adapters.base.ros_messages import Odometry, OdometryWriter
from freeflyer_adapters.base.sealed_odometry import sealed
from freeflyer_adapters.base.session import open_session
from freeflyer_adapters.base.zenoh_base import ZenohBase
from freeflyer_adapters.device.device import LifeCycle, SafeStop
from freeflyer_adapters.foundation.errors import DeviceError

UNWATCHED = 60.0
"""Watchdog of the base for tests with long pauses between two calls [s]."""
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
STILL = np.zeros(6)


def usable(received: Received) -> bool:
    return is_usable(received.odometry)


class ScriptedBase:
    """A base robot that publishes on request, stores all set points, and reports no publisher."""

    def __init__(self, options: LinkOptions) -> None:
        self.session = open_session([], options.connect, "scripted")
        self.link = OdometryLink(
            self.session, options, options.measured_topic, options.setpoint_topic
        )
        self.setpoints: list[Odometry] = []

    def send(self, position: np.ndarray | None = None, orientation: np.ndarray = IDENTITY) -> None:
        self.link.publish(np.zeros(3) if position is None else position, orientation, STILL)

    def send_as(
        self,
        sequence: int,
        stamp: int,
        *,
        gid: bytes | None = None,
        frame: str = "inertial",
        child: str = "base",
    ) -> None:
        """Send one sample at the origin, with any sequence number and stamp."""
        attachment = Attachment(sequence, stamp, self.link._gid if gid is None else gid).pack()
        payload = OdometryWriter(frame, child).write(stamp, np.zeros(3), IDENTITY, STILL)
        self.link.put(sealed(payload, attachment), attachment)

    def take(self) -> None:
        received = self.link.receive(usable)
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
    base.values["watchdog"][:] = UNWATCHED
    yield base
    base.deactivate()


@contextmanager
def flowing(there: ScriptedBase, position: np.ndarray | None = None) -> Iterator[None]:
    """Let the robot send one measurement per cycle."""
    done = Event()

    def flow() -> None:
        while not done.wait(0.004):
            there.send(position)

    thread = Thread(target=flow)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def configured(base: ZenohBase, there: ScriptedBase, position: np.ndarray | None = None) -> None:
    """Configure and activate `base` while the robot sends samples."""
    with flowing(there, position):
        base.configure()
        base.check_start()
        base.prepare()
        base.activate(lambda: False)
    base._sequence = 0  # samples that were sent without a reader are not lost cycles
    fresh(base, there, position)
    base._steps = 0


def fresh(base: ZenohBase, there: ScriptedBase, position: np.ndarray | None = None) -> None:
    """Send one sample and execute the step that reads it."""
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


def test_the_offset_from_the_start_is_reduced_slowly(here: ZenohBase, there: ScriptedBase) -> None:
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
        (
            {"position_setpoint": [0.01, 0.0, 0.0]},
            "jumps by 0.01 m in one cycle, its limit is 0.002 m",
        ),
        (
            {"velocity_setpoint": [0.0, 0.3, 0.0, 0.0, 0.0, 0.0]},
            "moves at 0.3 m/s, its limit is 0.2 m/s",
        ),
        ({"position_setpoint": [np.nan, 0.0, 0.0]}, "finite numbers are expected"),
        ({"orientation_setpoint": [0.0, 0.0, 0.0, 0.0]}, "squared norm"),
    ],
)
def test_a_set_point_beyond_a_limit_is_not_sent_and_stops_the_loop(
    here: ZenohBase, there: ScriptedBase, setpoint: dict[str, list[float]], sentence: str
) -> None:
    configured(here, there)
    published = here.published
    for name, value in setpoint.items():
        here.values[name][:] = value
    with pytest.raises(SafeStop, match=sentence):
        here.write()
    assert here.published == published


def test_a_missing_sequence_number_is_a_lost_cycle_and_the_third_in_the_window_stops_the_loop(
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


def test_two_missing_samples_in_a_row_stop_the_loop(here: ZenohBase, there: ScriptedBase) -> None:
    configured(here, there)
    fresh(here, there)
    there.link._sequence += 2
    with pytest.raises(SafeStop, match="2 cycles in a row were lost"):
        fresh(here, there)


def test_an_old_last_sample_stops_the_loop(here: ZenohBase, there: ScriptedBase) -> None:
    here.values["lost_consecutive"][:] = 1000.0
    here.values["lost_in_window"][:] = 0.0
    configured(here, there)
    fresh(here, there)
    time.sleep(0.03)
    here._steps = here._ratio - 1
    with pytest.raises(
        SafeStop, match=r"the last measurement is 0\.\d+ s old, its limit is 0.02 s"
    ):
        here.read()


def test_a_base_that_does_not_follow_stops_the_loop(here: ZenohBase, there: ScriptedBase) -> None:
    configured(here, there)
    there.send(np.array([0.02, 0.0, 0.0]))
    time.sleep(0.01)
    here._take()
    here._steps = here._ratio - 1
    with pytest.raises(
        SafeStop, match=r"the base is 0\.02 m from its set point, the limit is 0\.01 m"
    ):
        here.read()


def test_invalid_samples_are_counted_and_have_no_effect(
    here: ZenohBase, there: ScriptedBase
) -> None:
    configured(here, there)
    link, before = here._link, here.values["base_position"].copy()
    assert link is not None
    counts = link.counts

    def refused() -> int:
        here._take()
        return counts.malformed + counts.stale + counts.other_sources

    last = link._last
    assert last is not None
    gid, sequence, stamp = there.link._gid, last.sequence, last.stamp + 1000
    good = OdometryWriter("inertial", "base").write(stamp, np.full(3, 0.1), IDENTITY, STILL)
    nan = OdometryWriter("inertial", "base").write(stamp, np.full(3, np.nan), IDENTITY, STILL)
    elsewhere = OdometryWriter("inertial", "gripper").write(stamp, np.full(3, 0.1), IDENTITY, STILL)
    later = Attachment(sequence + 1, stamp, gid).pack()
    for payload, attachment, why in (
        (good[:100], later, "byte"),
        (good, later[:-1], "32 bytes"),
        (good, b"", "0 bytes"),
        (nan, later, "an invalid pose or twist"),
        (elsewhere, later, "a pose of 'gripper' in 'inertial'"),
        (
            good,
            Attachment(sequence, stamp, gid).pack(),
            f"sequence number {sequence} after {sequence}",
        ),
        (
            good,
            Attachment(sequence - 1, stamp, gid).pack(),
            f"sequence number {sequence - 1} after {sequence}",
        ),
        (
            good,
            Attachment(sequence + 1, last.stamp, gid).pack(),
            "the time stamp has advanced by 0 s",
        ),
        (good, Attachment(sequence + 1, stamp, bytes(16)).pack(), "a sample from 00000000"),
        (None, later, "wrong checksum"),
    ):
        seen = refused()
        there.link.put(good if payload is None else sealed(payload, attachment), attachment)
        assert waited(lambda seen=seen: refused() == seen + 1), why  # type: ignore[misc]
        assert why in counts.last_fault
        assert np.array_equal(here.values["base_position"], before)
    there.link.put(sealed(good, later), later)
    assert waited(here._take), "the correct sample is used"
    assert here.values["base_position"] == pytest.approx(np.full(3, 0.1))


def test_the_latest_of_many_samples_is_read(here: ZenohBase, there: ScriptedBase) -> None:
    configured(here, there)
    for k in range(100):
        there.send(np.array([0.00001 * k, 0.0, 0.0]))
        time.sleep(0.001)  # congestion control DROP may drop samples of a burst
    time.sleep(0.2)
    here._take()
    assert here.values["base_position"][0] == pytest.approx(0.00099)


def test_an_approach_keeps_the_limits_of_set_points(here: ZenohBase, there: ScriptedBase) -> None:
    here.values["approach"][:] = 1.0
    here.values["approach_speed"][:] = [2.0, 2.0]
    with pytest.raises(
        DeviceError,
        match=r"approach to the start pose was given up: .*moves at 2 m/s, its limit is 0.2 m/s",
    ):
        configured(here, there, np.array([0.3, 0.0, 0.0]))
    assert here.state.now is LifeCycle.inactive


def test_a_base_that_sends_nothing_is_reported(there: ScriptedBase) -> None:
    base = ZenohBase("base", there.link.options)
    base.values["configure_timeout"][:] = 0.3
    try:
        with pytest.raises(DeviceError, match="no valid sample on topic base_robot/measured"):
            base.configure()
    finally:
        base.deactivate()


# Publication


def test_configuration_and_the_check_of_the_start_publish_and_announce_nothing(
    here: ZenohBase, there: ScriptedBase
) -> None:
    with flowing(there):
        here.configure()
        here.check_start()
        here.prepare()
    assert here._link is not None
    assert here._link.gid == ""
    assert there.link.publishers(there.link.options.setpoint_topic) == []
    there.take()
    assert there.setpoints == []
    assert here.published == 0


def test_each_activation_declares_a_new_publisher(here: ZenohBase, there: ScriptedBase) -> None:
    configured(here, there)
    link = here._link
    assert link is not None
    topic = there.link.options.setpoint_topic
    assert waited(lambda: there.link.publishers(topic) == [link.identity])
    first = link.gid
    link.end_publishing()
    assert waited(lambda: there.link.publishers(topic) == [])
    link.begin_publishing()
    assert link.gid != first
    assert len(bytes.fromhex(link.gid)) == 16
    assert waited(lambda: there.link.publishers(topic) == [link.identity])


def test_without_a_publisher_nothing_is_sent(here: ZenohBase, there: ScriptedBase) -> None:
    configured(here, there)
    assert waited(lambda: (there.take(), bool(there.setpoints))[1])
    assert here._link is not None
    here._link.end_publishing()
    there.take()
    there.setpoints.clear()
    here._link.publish(np.zeros(3), IDENTITY, STILL)
    time.sleep(0.05)
    there.take()
    assert there.setpoints == []


def test_another_commander_prevents_the_configuration(here: ZenohBase, there: ScriptedBase) -> None:
    options = there.link.options
    other = OdometryLink(there.session, options, options.setpoint_topic, options.measured_topic)
    try:
        with (
            flowing(there),
            pytest.raises(
                DeviceError,
                match=f"session {other.identity} already publishes commands on topic base_robot/setpoint",
            ),
        ):
            here.configure()
    finally:
        other.close()


def test_activation_waits_for_the_obedience_token_and_its_withdrawal_stops_the_loop(
    here: ZenohBase, there: ScriptedBase
) -> None:
    there.link.report_obeyed(False)
    done = Event()

    def report() -> None:
        while not done.wait(0.001):
            there.take()
            there.link.report_obeyed(bool(there.setpoints))

    thread = Thread(target=report)
    thread.start()
    try:
        configured(here, there)
    finally:
        done.set()
        thread.join()
    assert here.cannot_refuse == []
    assert here._link is not None
    assert here._link.obedience() is None
    fresh(here, there)
    there.link.report_obeyed(False)
    end = time.monotonic() + 5.0
    reason = "the base robot does not take set points any more; it holds its place"
    with pytest.raises(SafeStop, match=reason):  # noqa: PT012
        while time.monotonic() < end:
            fresh(here, there)
            here._steps = here._ratio - 1
            here.read()
    assert here.permit.lost


def test_a_base_that_reports_another_publisher_is_rejected(
    here: ZenohBase, there: ScriptedBase
) -> None:
    there.link._source = bytes(range(16))
    there.link.report_obeyed(True)
    with (
        flowing(there),
        pytest.raises(
            DeviceError,
            match=f"base accepts commands from publisher {bytes(range(16)).hex()} already; this controller is session",
        ),
    ):
        here.configure()


def test_a_base_without_obedience_token_is_reported(here: ZenohBase, there: ScriptedBase) -> None:
    configured(here, there)
    assert len(here.cannot_refuse) == 1
    assert "does not report the publisher from which it accepts commands" in here.cannot_refuse[0]


# Suspensions and late samples


def suspended(base: ZenohBase) -> None:
    """Suspend the loop for longer than the watchdog of the base."""
    base.permit.watchdog = 20_000_000
    time.sleep(0.05)


def test_after_a_suspension_no_set_point_is_sent_not_even_by_the_graded_stop(
    here: ZenohBase, there: ScriptedBase
) -> None:
    configured(here, there)
    suspended(here)
    published = here.published
    with pytest.raises(
        SafeStop,
        match=r"the loop was held up for 0\.\d+ s, longer than the watchdog of the base robot \(0\.02 s\)",
    ):
        here.write()
    here.revoke("the loop was suspended")
    for k in range(20):
        assert here.ramp_down(k * 1e-3)
    assert here.published == published
    assert here._link is not None
    assert waited(lambda: there.link.publishers(there.link.options.setpoint_topic) == [])


def test_a_suspension_is_detected_when_the_next_sample_is_read(
    here: ZenohBase, there: ScriptedBase
) -> None:
    here.values["age_limit"][:] = 10.0
    here.values["lost_consecutive"][:] = 1000.0
    here.values["lost_in_window"][:] = 0.0
    configured(here, there)
    suspended(here)
    there.send()
    with pytest.raises(SafeStop, match="the loop was held up for"):
        here.read()


def test_the_graded_stop_holds_the_last_set_point_without_velocity(
    here: ZenohBase, there: ScriptedBase
) -> None:
    here.values["watchdog"][:] = 10.0
    configured(here, there)
    here.values["position_setpoint"][:] = [0.001, 0.0, 0.0]
    here.values["velocity_setpoint"][:] = 0.01
    here.write()
    here.revoke("the user stopped")
    with pytest.raises(SafeStop, match="the user stopped"):
        here.write()
    there.setpoints.clear()
    for k in range(3 * here._ratio):
        there.send()
        here.ramp_down(k * 1e-3)
    assert waited(
        lambda: (there.take(), bool(there.setpoints) and there.setpoints[-1].position[0] > 0.0)[1]
    )
    assert there.setpoints[-1].position == pytest.approx([0.001, 0.0, 0.0])
    assert not there.setpoints[-1].velocity.any()


def test_a_sample_that_was_delayed_in_transit_counts_as_old(
    here: ZenohBase, there: ScriptedBase
) -> None:
    here.values["lost_consecutive"][:] = 1000.0
    here.values["lost_in_window"][:] = 0.0
    configured(here, there)
    assert here._link is not None
    last = here._link._last
    assert last is not None
    time.sleep(0.06)
    there.send_as(last.sequence + 1, last.stamp + 4_000_000)
    assert waited(here._take)
    here._steps = here._ratio - 1
    with pytest.raises(
        SafeStop, match=r"the last measurement is 0\.0[5-9]\d* s old, its limit is 0\.02 s"
    ):
        here.read()


@pytest.mark.parametrize("step", [-3600.0, -1.0, 1.0, 3600.0])
def test_a_clock_step_of_the_base_is_counted_and_no_sample_is_rejected(
    here: ZenohBase, there: ScriptedBase, step: float
) -> None:
    configured(here, there)
    there.link._wall += round(step * 1e9)
    for _ in range(5):
        fresh(here, there)
    assert here.report()["clock_steps"] == 1.0
    assert here.report()["samples_refused"] == 0.0


# One link, sample by sample


@pytest.fixture
def receiving(there: ScriptedBase) -> Iterator[OdometryLink]:
    options = there.link.options
    session = open_session(options.connect, options.listen, "receiver")
    link = OdometryLink(
        session, options, options.setpoint_topic, options.measured_topic, publishes=False
    )
    assert waited(lambda: bool(session.info.peers_zid()))
    there.send()
    assert waited(lambda: link.take() is not None or (there.send(), False)[1])
    time.sleep(0.02)
    link.take()
    yield link
    link.close()
    session.close()


def received(link: OdometryLink, judge: Callable[[Received], bool] = usable) -> Received | None:
    """Return the next sample, or None if it was rejected."""
    before = link.counts.malformed + link.counts.stale + link.counts.other_sources
    found: list[Received] = []

    def arrived() -> bool:
        one = link.receive(judge)
        found.extend([] if one is None else [one])
        return (
            bool(found)
            or link.counts.malformed + link.counts.stale + link.counts.other_sources > before
        )

    assert waited(arrived)
    return found[0] if found else None


NOW = 1_700_000_000_000_000_000


@pytest.mark.parametrize(
    ("frame", "child", "sentence"),
    [
        (
            "world",
            "base",
            r"a pose of 'base' in 'world' \(child_frame_id, header.frame_id\); 'base' in 'inertial' is expected",
        ),
        ("inertial", "arm", "a pose of 'arm' in 'inertial'"),
        ("base", "inertial", "a pose of 'inertial' in 'base'"),
        ("", "", "a pose of '' in ''"),
    ],
)
def test_a_pose_of_other_frames_is_rejected(
    there: ScriptedBase, receiving: OdometryLink, frame: str, child: str, sentence: str
) -> None:
    there.send_as(1, NOW, frame=frame, child=child)
    assert received(receiving) is None
    assert re.search(sentence, receiving.counts.last_fault)
    assert receiving.counts.malformed == 1
    there.send_as(2, NOW)
    assert received(receiving) is not None, "the publisher of a rejected sample is not the source"


def test_stamps_set_back_are_a_clock_step_and_equal_ones_are_stale(
    there: ScriptedBase, receiving: OdometryLink
) -> None:
    there.send_as(1, NOW)
    assert received(receiving) is not None
    there.send_as(2, NOW - 10**9)
    found = received(receiving)
    assert found is not None
    assert found.delay < 5_000_000
    assert receiving.counts.clock_steps == 1
    there.send_as(3, NOW - 10**9)
    assert received(receiving) is None
    assert receiving.counts.stale == 1
    there.send_as(2, NOW)
    assert received(receiving) is None
    assert receiving.counts.stale == 2
    assert (receiving.counts.accepted, receiving.counts.clock_steps) == (2, 1)


def test_a_sample_that_the_caller_rejects_is_counted_and_its_publisher_is_not_the_source(
    there: ScriptedBase, receiving: OdometryLink
) -> None:
    seen: list[Received] = []

    def reject(one: Received) -> bool:
        seen.append(one)
        return False

    there.send_as(1, NOW, gid=b"a" * 16)
    assert received(receiving, reject) is None
    assert (seen[0].attachment.gid, seen[0].odometry.frame) == (b"a" * 16, "inertial")
    assert receiving.counts.malformed == 1
    there.send_as(1, NOW, gid=b"b" * 16)
    assert received(receiving) is not None
    there.send_as(2, NOW + 1, gid=b"a" * 16)
    assert received(receiving) is None
    assert receiving.counts.other_sources == 1


@pytest.mark.parametrize("ahead", [-3600.0, -0.5, 0.5, 3600.0])
def test_the_clock_of_a_rejected_publisher_does_not_affect_the_delay_of_another(
    there: ScriptedBase, receiving: OdometryLink, ahead: float
) -> None:
    """Two publishers have different clocks. One is rejected before the other sends."""
    there.send_as(1, NOW + round(ahead * 1e9), gid=b"a" * 16)
    assert received(receiving, lambda _: False) is None
    time.sleep(0.6)
    there.send_as(1, NOW + 600_000_000, gid=b"b" * 16)
    found = received(receiving)
    assert found is not None
    assert found.delay < 20_000_000
    assert receiving.counts.clock_steps == 0


def test_a_watchdog_shorter_than_two_cycles_is_rejected_with_both_numbers(here: ZenohBase) -> None:
    here.values["watchdog"][:] = 0.003
    with pytest.raises(
        DeviceError,
        match=r"base\.watchdog is 0\.003 s; at least 0\.008 s, two cycles of set points, are expected",
    ):
        here.configure()
