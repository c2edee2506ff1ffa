"""Virtual base robot: the device end of the Zenoh link, connected to a base-robot model."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from freeflyer.fmi.component import Array, Port
from freeflyer.foundation.units import TWIST
from freeflyer_adapters.base import access_control, commanders
from freeflyer_adapters.base import options as link_options
from freeflyer_adapters.base.link import Received, is_usable
from freeflyer_adapters.base.session import open_session
from freeflyer_adapters.device.device import LifeCycle
from freeflyer_adapters.facility.base_logic import MOST_USED, BaseLogic
from freeflyer_adapters.facility.link_faults import LinkFaults
from freeflyer_adapters.facility.settings import FacilitySettings
from freeflyer_adapters.facility.virtual_device import VirtualDevice
from freeflyer_adapters.facility.zenoh_faults import FAULT_KINDS, FaultyOdometryLink, ZenohTamper
from freeflyer_adapters.foundation.pose import twist_rotated

PROOF = 0.04
"""Duration of the test of a new publisher [s].

During the test, set points must arrive at the rate of their time stamps. No set point is accepted
before the end of the test."""


class VirtualBase(VirtualDevice[BaseLogic]):
    """A virtual base robot. The robot listens on the endpoints to which the host connects."""

    fault_kinds = FAULT_KINDS

    def __init__(
        self,
        name: str,
        raw: Mapping[str, Any],
        directory: Path,
        settings: FacilitySettings,
        period: float,
    ) -> None:
        self.name, self.settings, self.period = name, settings, period
        self.options = o = link_options.options_from(name, raw, directory)
        # Ports that are connected to the model.
        self.commands = (
            Port(
                name="position_setpoint", size=3, causality="output", units=("m",) * 3, sampled=True
            ),
            Port(
                name="orientation_setpoint",
                size=4,
                causality="output",
                units=("1",) * 4,
                sampled=True,
                start=(0, 0, 0, 1),
            ),
            Port(name="velocity_setpoint", size=6, causality="output", units=TWIST, sampled=True),
        )
        self.measurements = (
            Port(name="base_position", size=3, causality="input", units=("m",) * 3),
            Port(
                name="base_orientation",
                size=4,
                causality="input",
                units=("1",) * 4,
                start=(0, 0, 0, 1),
            ),
            Port(name="base_velocity", size=6, causality="input", units=TWIST),
        )
        # Create the controller, then the Zenoh session, then the link and its faults.
        self._used: deque[bytes] = deque(maxlen=MOST_USED)
        """Expired publishers of all sessions."""
        self.logic = self._new_logic()
        self._pose = (np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
        self._calls = 0
        self._session: Any = open_session([], o.connect, name, access_control.robot_protection(o))
        # The Zenoh tokens of the commanders name the certificates that may command the robot. The
        # tokens exist as long as the session.
        self._commanders = commanders.announce(self._session, o)
        self.faults = LinkFaults(settings.faults_of(name), period, settings.seed, ZenohTamper())
        self._link = FaultyOdometryLink(self._session, o, o.measured_topic, o.setpoint_topic)
        self._link.faults = self.faults

    def _new_logic(self) -> BaseLogic:
        s = self.settings
        return BaseLogic(
            period=self.period,
            watchdog=round(s.base_watchdog_s / self.period),
            silence=round(s.forget_after_s / self.period),
            jump=(s.base_jump_m, s.base_jump_rad),
            used=self._used,
            proof=round(PROOF / self.period),
        )

    def begin_session(self, parameters: Mapping[str, Array]) -> None:
        """Start a session. The robot holds the model's start pose until set points arrive."""
        self.logic = self._new_logic()
        self.begin_faults(self.faults, self._link)
        self._link.reset_source()
        self._link.report_obeyed(False)
        self._pose = (parameters["true_position"].copy(), parameters["true_orientation"].copy())
        self.logic.hold(*self._pose)

    def receive(self, values: Mapping[str, Array]) -> None:
        if self.begin_cycle():
            self._link.receive(self._take)
            was_active = self.logic.life.now is LifeCycle.active
            self.logic.tick()
            is_active = self.logic.life.now is LifeCycle.active
            if is_active and self._link.other_source:
                self.logic.refuse(self._link.other_source)
            self._link.report_obeyed(is_active)
            if was_active and not is_active:
                # The session of this publisher has ended. Accept a different publisher next.
                self._link.reset_source()
        values["position_setpoint"][:] = self.logic.position
        values["orientation_setpoint"][:] = self.logic.orientation
        values["velocity_setpoint"][:] = self.logic.velocity

    def power_off(self) -> None:
        self.logic.hold(*self._pose)

    def _take(self, received: Received) -> bool | None:
        """Return the result of `BaseLogic.take`, or False if the set point is not usable."""
        odometry = received.odometry
        if not is_usable(odometry):
            return False
        velocity = twist_rotated(odometry.orientation, odometry.velocity)
        return self.logic.take(
            odometry.position,
            odometry.orientation,
            velocity,
            self._pose,
            received.attachment.gid,
            received.delay * 1e-9,
            received.attachment.stamp * 1e-9,
        )

    def send(self, values: Mapping[str, Array]) -> None:
        position, orientation = values["base_position"], values["base_orientation"]
        self._pose = (position.copy(), orientation.copy())
        self._link.flush()
        self._calls += 1
        if self._link.silent:
            return
        if self._calls % self.settings.measure_every == 0:
            self._link.publish(position, orientation, values["base_velocity"])

    def report(self) -> Mapping[str, float]:
        counts = self._link.counts
        return {
            "setpoints_accepted": float(counts.accepted),
            "setpoints_skipped": float(counts.skipped),
            "setpoints_refused": float(counts.malformed + counts.stale + counts.other_sources),
            "setpoints_before_the_first_followed": float(counts.undecided),
            "clock_steps": float(counts.clock_steps),
            "active": float(self.logic.life.now is LifeCycle.active),
        }

    def close(self) -> None:
        self._link.close()
        self._session.close()
