"""Round-trip time on the base's link with mutual TLS and access control, compared with plain TCP.

Run alone: `pytest -m benchmark -n 0 -s tests/benchmarks/test_tls_cost.py`.
"""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path
from queue import Queue

import numpy as np
import pytest
import zenoh
from lab import Lab, free_port, waited

from freeflyer_adapters.base import access_control, rmw_zenoh, ros_messages
from freeflyer_adapters.base.options import LinkOptions
from freeflyer_adapters.base.ros_messages import OdometryWriter
from freeflyer_adapters.base.session import open_session

pytestmark = pytest.mark.benchmark
PERIOD = 0.004
BLOCKS, SAMPLES = 10, 250


class Pair:
    """A controller, and a base robot that returns every set point as a measurement."""

    def __init__(self, stack: ExitStack, options: LinkOptions) -> None:
        ends = (
            access_control.robot_protection(options),
            access_control.controller_protection(options),
        )
        self.robot = open_session([], options.connect, "robot", ends[0])
        stack.callback(self.robot.close)
        self.host = open_session(options.connect, options.listen, "controller", ends[1])
        stack.callback(self.host.close)
        out, back = (
            rmw_zenoh.topic_key(
                options.domain, topic, ros_messages.TYPE_NAME, ros_messages.TYPE_HASH
            )
            for topic in (options.setpoint_topic, options.measured_topic)
        )
        fast = {
            "congestion_control": zenoh.CongestionControl.DROP,
            "priority": zenoh.Priority.REAL_TIME,
            "express": True,
        }
        answer = self.robot.declare_publisher(back, **fast)
        self.sender = self.host.declare_publisher(out, **fast)
        self.arrivals: Queue[int] = Queue()
        self.kept = [
            self.robot.declare_subscriber(out, lambda sample: answer.put(sample.payload)),
            self.host.declare_subscriber(
                back, lambda sample: self.arrivals.put(time.perf_counter_ns())
            ),
        ]
        self.message = OdometryWriter("inertial", "base").write(
            0, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(6)
        )
        assert waited(self._has_answer)

    def _has_answer(self) -> bool:
        self.sender.put(self.message)
        time.sleep(0.02)
        return not self.arrivals.empty()

    def round_trips(self, count: int, period: float) -> list[float]:
        """Return `count` round-trip times [us], one every `period` [s] or as fast as possible."""
        time.sleep(0.05)
        while not self.arrivals.empty():
            self.arrivals.get()
        found = []
        for _ in range(count):
            start = time.perf_counter_ns()
            self.sender.put(self.message)
            found.append((self.arrivals.get(timeout=2.0) - start) * 1e-3)
            time.sleep(max(0.0, period - (time.perf_counter_ns() - start) * 1e-9))
        return found


def test_tls_adds_little_to_the_round_trip_time_of_the_base_link(tmp_path: Path) -> None:
    lab = Lab(tmp_path / "lab")
    with ExitStack() as stack:
        pairs = {
            name: Pair(stack, Lab.options(folder, free_port()))
            for name, folder in (("tcp", None), ("tls", lab.good))
        }
        for period, title in ((PERIOD, f"every {PERIOD * 1e3:g} ms"), (0.0, "one after the other")):
            times: dict[str, list[float]] = {name: [] for name in pairs}
            for _ in range(BLOCKS):
                for name, pair in pairs.items():
                    times[name] += pair.round_trips(SAMPLES, period)
            for name, found in times.items():
                p50, p99, longest = np.percentile(found, [50, 99, 100])
                print(
                    f"{title}, {name}: {len(found)} round trips, p50 {p50:.0f} us, p99 {p99:.0f} us, longest {longest:.0f} us"
                )
            ratio = np.median(times["tls"]) / np.median(times["tcp"])
            print(f"{title}: tls / tcp = {ratio:.2f}")
            assert ratio < 3.0  # gross regressions only
