"""The base robot as a device with a Zenoh link.

The device publishes set points, and reads the latest measured pose and twist. The loop reads the
device once per communication step, which is the cycle of the arm. Set points are published once per
`cycle`, a setting of the device. `cycle` is a whole number of communication steps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from freeflyer.fmi.component import Array, Port, memory
from freeflyer.foundation.units import TWIST
from freeflyer_adapters.base import access_control, commanders
from freeflyer_adapters.base import diagnosis as link_diagnosis
from freeflyer_adapters.base.link import OdometryLink, Received, is_usable
from freeflyer_adapters.base.options import LinkOptions
from freeflyer_adapters.base.rmw_zenoh import NO_PUBLISHER
from freeflyer_adapters.base.session import open_session
from freeflyer_adapters.device import parameters as device_parameters
from freeflyer_adapters.device.device import LifeCycle, SafeStop, State
from freeflyer_adapters.device.limits import BaseLimits
from freeflyer_adapters.device.permit import Permit
from freeflyer_adapters.device.quality import QualityMonitor
from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.errors import DeviceError
from freeflyer_adapters.foundation.histogram import Histogram
from freeflyer_adapters.foundation.pacing import Pacer
from freeflyer_adapters.foundation.pose import distance, twist_rotated

PATIENCE = 1.75
"""Limit of the age of the last sample [cycles].

If the age exceeds this limit, the cycle counts as lost. A smaller age counts as jitter.
"""
LISTEN = 25
"""Number of samples that are received before the first set point is published.

25 samples are sufficient, because a second publisher is detected within 20 samples.
"""


class ZenohBase:
    """The base robot. `freeflyer_adapters.device.device.Device` documents the methods."""

    is_clock = False

    def __init__(self, name: str, options: LinkOptions) -> None:
        self.name, self.options = name, options
        self.state = State(name)
        self._environment = environment.present()
        # Ports: settings, set points, measurements.
        ports = [
            *device_parameters.ports(device_parameters.BASE),
            Port(name="position_setpoint", size=3, causality="input", units=("m",) * 3),
            Port(
                name="orientation_setpoint",
                size=4,
                causality="input",
                units=("1",) * 4,
                start=(0.0, 0.0, 0.0, 1.0),
            ),
            Port(name="velocity_setpoint", size=6, causality="input", units=TWIST),
            Port(name="base_position", size=3, causality="output", units=("m",) * 3, sampled=True),
            Port(
                name="base_orientation", size=4, causality="output", units=("1",) * 4, sampled=True
            ),
            Port(name="base_velocity", size=6, causality="output", units=TWIST, sampled=True),
        ]
        self.ports: Mapping[str, Port] = {port.name: port for port in ports}
        self.values = memory(self.ports.values())
        # Counts, state and link. The link exists from `configure` to `deactivate`.
        self.age = Histogram()
        """Age of every sample when it was read: the present time minus its time stamp.

        The age is meaningful only if both ends of the link use the same clock.
        """
        self.published = 0
        self._link: OdometryLink | None = None
        self._session: Any = None
        self._arrived = 0
        self._steps = 0
        self._sequence = 0
        self._silent = 0
        self._published_at = 0
        self._delay = 0
        self.permit = self._new_permit()
        self._sent: tuple[Array, Array] | None = None
        self._offset = (np.zeros(3), np.zeros(3))
        self._reports_obedience = False
        self._clock_sentence = ""

    @property
    def woken(self) -> int:
        return 0

    @property
    def step(self) -> float:
        return float(self.values["period"][0])

    # Before any motion

    def configure(self) -> None:
        v, o = self.values, self.options
        # The settings must be consistent before a link is opened.
        device_parameters.check(self.name, device_parameters.BASE, v)
        if not v["start_orientation"].any():
            raise DeviceError(
                f"{self.name}.start_orientation is all zero; a unit quaternion x, y, z, w is expected"
            )
        cycle = float(v["cycle"][0])
        self._ratio = round(cycle / self.step)
        if self._ratio < 1 or abs(self._ratio * self.step - cycle) > 1e-9:
            raise DeviceError(
                f"{self.name}: the cycle of {cycle:g} s is not a multiple of the step of {self.step:g} s"
            )
        if v["watchdog"][0] < 2.0 * cycle:
            raise DeviceError(
                f"{self.name}.watchdog is {v['watchdog'][0]:g} s; at least {2.0 * cycle:g} s, two cycles of set points, are expected"
            )
        self.limits = BaseLimits(v)
        self.monitor = QualityMonitor.of(f"measurements of {self.name}", v, cycle)
        self._late = round(PATIENCE * cycle * 1e9)
        self._age_limit = round(float(v["age_limit"][0]) * 1e9)
        # The link has no publisher yet. So it does not disturb a controller that is in command.
        self._session = open_session(
            o.connect, o.listen, self.name, access_control.controller_protection(o)
        )
        self._link = link = OdometryLink(
            self._session, o, o.setpoint_topic, o.measured_topic, publishes=False
        )
        self.permit = self._new_permit()
        self._observe(LISTEN)
        # The certificate of this session must have the permission to send set points. There must be
        # exactly one base robot, and no other controller.
        if refused := commanders.refusal(self._session, o, self.name):
            raise DeviceError(refused)
        others = link.publishers(o.measured_topic)
        link.known = frozenset(others)
        if len(others) > 1:
            raise DeviceError(
                f"{self.name}: sessions {' and '.join(others)} publish topic {o.measured_topic}: there are two base robots; stop one of them"
            )
        others = link.publishers(o.setpoint_topic)
        if others:
            raise DeviceError(
                f"{self.name}: session {others[0]} already publishes commands on topic {o.setpoint_topic}; this controller is session {link.identity}: "
                f"stop session {others[0]} first"
            )
        self._reports_obedience = self._refuse_another_controller() is not None
        self.state.to(LifeCycle.inactive)

    def _new_permit(self) -> Permit:
        # A base robot does not report its life cycle state. It may have stopped during a suspension
        # of this process. Therefore the permit allows no set point after a suspension, not even a
        # repetition of the last set point.
        return Permit(
            "the base robot",
            watchdog=round(float(self.values["watchdog"][0]) * 1e9),
            reports_state=False,
        )

    def _observe(self, samples: int, meanwhile: Callable[[], bool] = lambda: False) -> None:
        """Receive samples and publish nothing. Return early if `meanwhile` returns True.

        `samples` is the number of samples. Raises DeviceError if the samples do not arrive in time,
        or if a second publisher is detected.
        """
        assert self._link is not None
        v, o, link = self.values, self.options, self._link
        end = self._environment.monotonic() + float(v["configure_timeout"][0])
        for _ in range(samples):
            while not self._take():
                if meanwhile():
                    return
                if self._environment.monotonic() > end:
                    why = (
                        f"; samples were received but rejected: {link.counts.last_fault}"
                        if link.counts.last_fault
                        else ""
                    )
                    why = why or link_diagnosis.why_silent(self._session, o)
                    raise DeviceError(
                        f"{self.name}: no valid sample on topic {o.measured_topic} via {', '.join(o.connect)} within "
                        f"{v['configure_timeout'][0]:g} s{why}"
                    )
                self._environment.sleep(0.001)
            if link.second_source:
                raise DeviceError(
                    f"{self.name}: {link.second_source}: there are two base robots; stop one of them"
                )

    def _refuse_another_controller(self) -> str | None:
        """Return the GID of the publisher in command, or NO_PUBLISHER.

        Returns None if the base robot does not report the publisher in command. Raises DeviceError
        if another publisher is in command.
        """
        assert self._link is not None
        obeyed = self._link.obeyed_publisher()
        if obeyed not in (None, NO_PUBLISHER, self._link.gid):
            raise DeviceError(
                f"{self.name} accepts commands from publisher {obeyed} already; this controller is {self._link.gid or 'session ' + self._link.identity}: "
                f"stop publisher {obeyed} first"
            )
        return obeyed

    @property
    def cannot_refuse(self) -> list[str]:
        """Sentences about what this base robot cannot reject or report by itself."""
        if self._reports_obedience:
            return []
        return [
            "like a plain ROS 2 node, it does not report the publisher from which it accepts commands; therefore the base robot itself must end the "
            "motion after a stop and reject late set points (interface control document)"
        ]

    @property
    def _start(self) -> tuple[Array, Array]:
        return self.values["start_position"], _unit(self.values["start_orientation"])

    @property
    def _start_gap(self) -> tuple[float, float]:
        """Distance [m] and angle [rad] between the last measured pose and the start pose."""
        return distance(self.values["base_position"], self.values["base_orientation"], *self._start)

    @property
    def _is_at_start(self) -> bool:
        return all(
            size <= most
            for size, most in zip(self._start_gap, self.values["start_tolerance"], strict=True)
        )

    def check_start(self) -> None:
        self._observe(1)
        v, gap = self.values, self._start_gap
        if not self._is_at_start and not v["approach"][0]:
            raise DeviceError(
                f"{self.name} is at {_shown(v['base_position'], v['base_orientation'])}, but the scenario starts at "
                f"{_shown(*self._start)}: the distance is {gap[0]:.4f} m and {np.degrees(gap[1]):.3f} deg, at most {v['start_tolerance'][0]:g} m and "
                f"{np.degrees(v['start_tolerance'][1]):.3g} deg are allowed; move the base robot to the start pose, or set its parameter approach = true"
            )

    def prepare(self) -> None:
        pass

    def stay(self) -> None:
        """Repeat the last set point while the arm is being activated.

        Without this repetition, the watchdog of the base robot would expire.
        """
        due = self._published_at + round(float(self.values["cycle"][0]) * 1e9)
        if (
            self.state.now is LifeCycle.active
            and self._sent is not None
            and self._environment.monotonic_ns() >= due
        ):
            self._take()
            self._publish(*self._sent, np.zeros(6))

    def activate(self, meanwhile: Callable[[], bool]) -> None:
        """Take command of the base robot and move it to the start pose.

        The first set point is the measured pose. The method returns early if `meanwhile` returns
        True. Raises DeviceError if the base robot does not take set points, or if the approach to
        the start pose fails.
        """
        v, start, link = self.values, self._start, self._link
        assert link is not None
        self._observe(1, meanwhile)
        if meanwhile():
            return
        # Subscribe to the reports before the first set point, so that no report is missed.
        link.watch_publishers()
        link.begin_publishing()
        link.watch_obedience()
        if others := link.publishers(self.options.setpoint_topic):
            raise DeviceError(
                f"{self.name}: session {others[0]} also publishes commands on topic {self.options.setpoint_topic}; stop one of the two controllers"
            )
        self.permit.take(self._environment.monotonic_ns())
        self._take_command(meanwhile)
        if not self._is_at_start:
            self._approach(start, meanwhile)
        # The base robot may now differ from the start pose by a small offset. `write` adds this
        # offset to the set points and reduces it in every cycle. So the set points do not jump.
        measured = Rotation.from_quat(v["base_orientation"])
        self._offset = (
            v["base_position"] - start[0],
            (measured * Rotation.from_quat(start[1]).inv()).as_rotvec(),
        )
        link.reset_counts()
        self._publish(v["base_position"].copy(), v["base_orientation"].copy(), np.zeros(6))
        self._sequence = 0
        self.state.to(LifeCycle.active)

    def _take_command(self, meanwhile: Callable[[], bool]) -> None:
        """Publish the measured pose until the base robot reports that this publisher is in command.

        If the base robot has no such report, this method returns after one set point. Raises
        DeviceError if the report does not arrive in time, or if the permit is lost.
        """
        assert self._link is not None
        v, cycle = self.values, float(self.values["cycle"][0])
        end = self._environment.monotonic() + float(v["configure_timeout"][0])
        while True:
            self._publish(v["base_position"].copy(), v["base_orientation"].copy(), np.zeros(6))
            if not self._reports_obedience or self._link.obedience():
                return
            self._refuse_lost_permit()
            if self._environment.monotonic() > end:
                self._refuse_another_controller()
                raise DeviceError(
                    commanders.refusal(self._session, self.options, self.name)
                    or f"{self.name} does not take set points of {self.options.setpoint_topic}, although these set points are equal to its measured pose: "
                    f"the base robot either receives no set points, receives other messages, or rejects the set points"
                )
            if meanwhile():
                return
            self._take()
            self._environment.sleep(cycle)

    def _refuse_lost_permit(self) -> None:
        if self.permit.lost:
            raise DeviceError(f"{self.name} was not activated: {self.permit.lost}")

    def _approach(self, start: tuple[Array, Array], meanwhile: Callable[[], bool]) -> None:
        """Move from the measured pose to `start`, not faster than `approach_speed`.

        Raises DeviceError if a limit is exceeded, if measurements are missing, if the permit is
        lost, or if the start pose is not reached.
        """
        v, cycle = self.values, float(self.values["cycle"][0])
        # The base moves along a straight line and rotates about a fixed axis. Both motions have the
        # same duration.
        first = v["base_position"].copy()
        first_orientation = Rotation.from_quat(v["base_orientation"])
        rotation = Rotation.from_quat(start[1]) * first_orientation.inv()
        rotation_vector = rotation.as_rotvec()
        path = start[0] - first
        duration = max(
            float(np.linalg.norm(path)) / float(v["approach_speed"][0]),
            rotation.magnitude() / float(v["approach_speed"][1]),
            cycle,
        )
        count = int(np.ceil(duration / cycle))
        # The pacer skips missed deadlines. So the approach is not faster after a suspension of this
        # process.
        pacer = Pacer(round(cycle * 1e9))
        settle = round(1.0 / cycle)
        for i in range(1, count + settle + 1):
            share = min(1.0, i / count)
            position = first + share * path
            orientation = (
                Rotation.from_rotvec(share * rotation_vector) * first_orientation
            ).as_quat()
            moving = (
                np.concatenate([path, rotation_vector]) / duration if i < count else np.zeros(6)
            )
            reason = self.limits.setpoint(position, orientation, moving, self._sent)
            if reason:
                raise DeviceError(
                    f"{self.name}: the approach to the start pose was given up: {reason}"
                )
            self._publish(position, orientation, moving)
            pacer.wait()
            # The measurement must follow the set point.
            self._take()
            reason = self.limits.measured(
                v["base_position"], v["base_orientation"], (position, orientation)
            )
            if self._environment.monotonic_ns() - self._arrived > self._age_limit:
                reason = f"no measurement for {(self._environment.monotonic_ns() - self._arrived) * 1e-9:.3g} s"
            if reason:
                raise DeviceError(
                    f"{self.name}: the approach to the start pose was given up: {reason}"
                )
            self._refuse_lost_permit()
            if meanwhile():
                return  # the loop ends before its first instant; the base holds its pose
            gap = distance(v["base_position"], v["base_orientation"], *start)
            if i > count and all(
                size < 0.5 * most for size, most in zip(gap, v["start_tolerance"], strict=True)
            ):
                return
        raise DeviceError(
            f"{self.name} did not reach the start pose within {(count + settle) * cycle:.3g} s"
        )

    # Every cycle

    def read(self) -> None:
        permit, link = self.permit, self._link
        if sentence := permit.hold_up(self._environment.monotonic_ns()):
            raise SafeStop(self.name, sentence)
        before = self._sequence
        received = self._take()
        self._steps += 1
        reason = None
        if received:
            # Gaps in the sequence numbers show lost samples. The number of cycles without a recent
            # sample (`_silent`) is subtracted, because these cycles were already counted as lost.
            missing = self._sequence - before - 1 - self._silent if before else 0
            reason = self.monitor.lose(max(missing, 0))
            self._silent = 0
            self.monitor.observe(lost=False)
        if self._steps % self._ratio and not reason:
            return
        # Check once per cycle that the last sample is recent.
        silence = self._environment.monotonic_ns() - self._arrived
        if silence > self._late:
            self._silent += 1
            reason = self.monitor.observe(lost=True) or reason
        age = silence + self._delay
        if age > self._age_limit:
            reason = (
                reason
                or f"the last measurement is {age * 1e-9:.4g} s old, its limit is {self._age_limit * 1e-9:g} s"
            )
        # Stop if a second base robot or a second controller appears, or if the base robot does not
        # take set points any more.
        if link is not None:
            reason = link.second_source or link.new_publisher() or reason
            if link.obedience() is False:
                reason = (
                    reason or "the base robot does not take set points any more; it holds its place"
                )
                permit.report(False, 0)
        if self._sent is not None:
            reason = reason or self.limits.measured(
                self.values["base_position"], self.values["base_orientation"], self._sent
            )
        if reason:
            # If this process was suspended, report only the suspension, because the suspension has
            # caused the other reasons.
            raise SafeStop(self.name, permit.hold_up(self._environment.monotonic_ns()) or reason)

    def write(self) -> None:
        if self._steps % self._ratio:
            return
        v = self.values
        cycle = float(v["cycle"][0])
        self._offset = (
            _shortened(self._offset[0], float(v["approach_speed"][0]) * cycle),
            _shortened(self._offset[1], float(v["approach_speed"][1]) * cycle),
        )
        position = v["position_setpoint"] + self._offset[0]
        orientation = v["orientation_setpoint"]
        if self._offset[1].any():
            orientation = (
                Rotation.from_rotvec(self._offset[1]) * Rotation.from_quat(_unit(orientation))
            ).as_quat()
        reason = self.limits.setpoint(position, orientation, v["velocity_setpoint"], self._sent)
        if reason is None and not self.permit.allows(self._environment.monotonic_ns()):
            reason = self.permit.lost or "it has not been activated"
        if reason:
            raise SafeStop(self.name, reason)
        self._publish(position, orientation.copy(), v["velocity_setpoint"])

    # The end

    def revoke(self, reason: str) -> None:
        """Withdraw the permit. After this call, only the last set point can be repeated.

        If this process was suspended, the last set point is not repeated either, and the publisher
        is undeclared.
        """
        is_held_up = self.permit.hold_up(self._environment.monotonic_ns())
        self.permit.lose(reason)
        if is_held_up and self._link is not None:
            self._link.end_publishing()

    def ramp_down(self, elapsed: float) -> bool:
        """Repeat the last set point with zero velocity while the arm comes to rest.

        Returns True, because the base robot itself needs no ramp-down.
        """
        self._take()
        self._steps += 1
        # After an incomplete activation nothing is sent, because a set point could complete the
        # activation.
        is_active = self.state.now is LifeCycle.active
        if (
            is_active
            and self._sent is not None
            and self._link is not None
            and self._steps % self._ratio == 0
        ):
            self._publish(*self._sent, np.zeros(6))
        return True

    @property
    def at_rest(self) -> bool:
        """Always True: a base robot holds the last set point by itself."""
        return True

    def on_error(self, reason: str) -> None:
        if self.state.now is LifeCycle.active:
            self.state.to(LifeCycle.safe_stop)

    def deactivate(self) -> None:
        if self.state.now in (LifeCycle.active, LifeCycle.safe_stop):
            self.state.to(LifeCycle.inactive)
        link, self._link = self._link, None
        session, self._session = self._session, None
        if link is not None:
            self._counts, self._clock_sentence = link.counts, link.clock.sentence
            link.close()
        if session is not None:
            session.close()

    @property
    def may_have_power(self) -> bool:
        return self._sent is not None and self._link is not None

    @property
    def remarks(self) -> list[str]:
        """Sentences with further information about the run, for the operator."""
        return [self._clock_sentence] if self._clock_sentence else []

    def report(self) -> Mapping[str, float]:
        counts = self._link.counts if self._link is not None else self._counts
        return {
            "samples_accepted": float(counts.accepted),
            "samples_skipped": float(counts.skipped),
            "samples_refused": float(counts.malformed + counts.stale + counts.other_sources),
            "clock_steps": float(counts.clock_steps),
            "cycles_lost": float(self.monitor.lost),
            "longest_loss_cycles": float(self.monitor.longest_row),
            "setpoints_published": float(self.published),
        }

    def histograms(self) -> Mapping[str, Histogram]:
        return {f"{self.name}: age of samples when read": self.age}

    # Samples

    def _take(self) -> bool:
        assert self._link is not None
        received = self._link.receive(_is_usable)
        if received is None:
            return False
        odometry, v = received.odometry, self.values
        orientation = odometry.orientation
        v["base_position"][:] = odometry.position
        v["base_orientation"][:] = orientation
        v["base_velocity"][:] = twist_rotated(orientation, odometry.velocity)
        self._delay = received.delay
        self.permit.report(True, received.arrived)
        self._arrived, self._sequence = received.arrived, received.attachment.sequence
        if self.state.now is LifeCycle.active:
            self.age.add(max(0, self._environment.time_ns() - received.attachment.stamp))
        return True

    def _publish(self, position: Array, orientation: Array, velocity: Array) -> None:
        """Publish a set point if the permit allows this. Otherwise, do nothing.

        No error is raised here, because `read` and `write` raise SafeStop if the permit is lost.
        """
        assert self._link is not None
        now = self._environment.monotonic_ns()
        if not (self.permit.allows(now) or self.permit.may_ramp_down(now)):
            return
        self._link.publish(position, orientation, velocity)
        self.permit.wrote(now)
        self._sent = (np.array(position), np.array(orientation))
        self._published_at = now
        self.published += 1


def _is_usable(received: Received) -> bool:
    return is_usable(received.odometry)


def _unit(quaternion: Array) -> Array:
    return quaternion / float(np.linalg.norm(quaternion))


def _shortened(vector: Array, by: float) -> Array:
    size = float(np.linalg.norm(vector))
    return vector * 0.0 if size <= by else vector * (1.0 - by / size)


def _shown(position: Array, orientation: Array) -> str:
    roll, pitch, yaw = Rotation.from_quat(orientation).as_euler("xyz", degrees=True)
    return f"[{', '.join(f'{x:z.4f}' for x in position)}] m, roll {roll:.3f}, pitch {pitch:.3f}, yaw {yaw:.3f} deg"
