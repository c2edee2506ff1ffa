"""Virtual arm: the device end of the CAN link, connected to an arm model.

The frames, the E2E protection and the watchdog are those of a real arm.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import can
import numpy as np

from freeflyer.fmi.component import Array
from freeflyer_adapters.arm import options as arm_options
from freeflyer_adapters.arm.frames import LIMIT_ROLES, ArmFrames, Mode
from freeflyer_adapters.can.link import Receiver, Sender, open_bus
from freeflyer_adapters.device.device import LifeCycle
from freeflyer_adapters.device.ramp_down import RampDown
from freeflyer_adapters.facility.arm_logic import MOST_USED, ArmLogic, Command
from freeflyer_adapters.facility.can_faults import FAULT_KINDS, CanTamper, FaultyBus
from freeflyer_adapters.facility.link_faults import LinkFaults
from freeflyer_adapters.facility.settings import FacilitySettings
from freeflyer_adapters.facility.virtual_device import VirtualDevice, arm_ports
from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.errors import DeviceError
from freeflyer_adapters.foundation.histogram import Histogram

MOST_FRAMES = 256
"""Maximum number of frames that the arm reads in one cycle."""
SENSED = ("joint_position", "joint_velocity", "joint_torque")


class VirtualArm(VirtualDevice[ArmLogic]):
    """A virtual arm. Per cycle, it receives one command frame and sends one state frame on CAN."""

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
        self._environment = environment.present()
        self.options = arm_options.options_from(name, raw, directory)
        n = self.options.joints
        self.frames = ArmFrames(self.options.frames, n)
        self.frames.check_activation(name, self.options.implicit)
        if settings.arm_watchdog_cycles >= self.frames.cycles // 2:
            raise DeviceError(
                f"[facility] arm_watchdog_cycles is {settings.arm_watchdog_cycles}; {name} has {self.frames.cycles} cycle numbers, "
                f"and less than half of this number is expected"
            )
        # Ports that are connected to the model.
        self.commands, self.measurements = arm_ports(n)
        self.round_trip = Histogram()
        """Time from the sending of a state frame to the arrival of the command that answers it."""
        self._before: dict[str, float] = {}
        self._velocity = np.zeros(n)
        self._limits: dict[str, list[float]] = {}
        self._sent_at = 0.0
        # The link. Faults are applied between the bus and the device.
        self.logic = self._first_logic()
        seen = [self.frames.command]
        self.faults = LinkFaults(
            settings.faults_of(name),
            period,
            settings.seed,
            CanTamper(ArmFrames(self.options.frames, n), period),
        )
        bus = open_bus(
            self.options.interface, self.options.channel, self.frames.is_fd, seen, self.options.bus
        )
        self._bus = FaultyBus(bus, self.faults)
        self._receiver = Receiver(self.frames.command)
        self._sender = Sender(self._bus, self.frames.state)
        self._describer = (
            None if self.frames.description is None else Sender(self._bus, self.frames.description)
        )

    def _first_logic(self) -> ArmLogic:
        s = self.settings
        return ArmLogic(
            self.options.joints,
            cycle=self.period,
            watchdog=s.arm_watchdog_cycles,
            silence=round(s.forget_after_s / self.period),
            cycles=self.frames.cycles,
            implicit=self.options.implicit,
            used=deque(maxlen=min(MOST_USED, max(1, self.frames.controllers // 2))),
            ramp=RampDown(time=s.ramp_down_time_s, damping=s.ramp_down_damping),
        )

    def begin_session(self, parameters: Mapping[str, Array]) -> None:
        """Start a session. The model defines the joint limits. The cycle number continues."""
        self._limits = {
            role: list(map(float, parameters[role])) for role in LIMIT_ROLES if role in parameters
        }
        self._before = self._totals()
        self.logic = self.logic.again()
        if "joint_effort_limit" in self._limits:
            steps = [0.5 * f.resolution for f in self.frames.command.fields["joint_torque_command"]]
            self.logic.effort = np.array(self._limits["joint_effort_limit"]) + steps
        self._velocity[:] = 0.0
        self.begin_faults(self.faults, self._bus)

    def receive(self, values: Mapping[str, Array]) -> None:
        if self.begin_cycle():
            self.logic.begin(self._commands(), self._velocity)
        values["joint_torque_command"][:] = self.logic.torque
        values["brake"][0] = float(self.logic.braked)

    def power_off(self) -> None:
        self.logic.fail("the arm has no power")

    def fail(self) -> None:
        self.logic.fail("a drive has failed")

    def _commands(self) -> list[Command]:
        """Return the commands since the last state frame. Read at most `MOST_FRAMES` frames."""
        commands = []
        for _ in range(MOST_FRAMES):
            message = self._next()
            if message is None:
                break
            numbers = self._receiver.take(message)
            if numbers is None:
                continue
            answered = int(numbers.get("answered_cycle", (self.logic.cycle,))[0])
            commands.append(
                Command(
                    controller=int(numbers.get("controller", (1,))[0]),
                    mode=self.frames.mode(numbers["mode"][0]) if "mode" in numbers else Mode.torque,
                    answered=answered,
                    torque=np.array(numbers["joint_torque_command"]),
                )
            )
            trip = message.timestamp - self._sent_at
            if (
                answered == self.logic.cycle
                and 0.0 <= trip < 1.0
                and self.logic.life.now is LifeCycle.active
            ):
                self.round_trip.add(int(trip * 1e9))
        return commands

    def _next(self) -> can.Message | None:
        try:
            return self._bus.recv(0.0)
        except can.CanError:
            return None

    def send(self, values: Mapping[str, Array]) -> None:
        logic = self.logic
        self._velocity[:] = values["joint_velocity"]
        self._bus.flush()
        if self._bus.silent:
            return
        self._sent_at = self._environment.time_ns() * 1e-9
        self._sender.send({
            "cycle": (float(logic.cycle),),
            "echoed_cycle": (float(logic.echoed),),
            "obeyed_controller": (float(logic.controller),),
            "life_cycle": (float(self.frames.life_cycle_number(logic.life.now)),),
            "brakes": (float(logic.braked),),
            "command_age": (float(min(logic.command_age, 255)),),
            **{name: values[name].tolist() for name in SENSED},
        })  # fmt: skip
        due = (
            logic.life.now is not LifeCycle.active
            and logic.cycle % self.settings.describe_every == 0
        )
        if self._describer is not None and due:
            joints = (float(self.options.joints),)
            self._describer.send(
                {"joint_count": joints, "cycle_time": (self.period,), **self._limits}
            )

    def report(self) -> Mapping[str, float]:
        return {
            "cycle": float(self.logic.cycle),
            "state_frames_sent": float(self._sender.sent),
            "commands_accepted": float(self._receiver.accepted),
            "commands_rejected": float(self._receiver.refused),
            **self._totals(),
        }

    def _totals(self) -> dict[str, float]:
        """Return the counters over all sessions."""
        return {
            "commands_late_or_lost": self._before.get("commands_late_or_lost", 0.0)
            + self.logic.total_lost,
            "commands_of_strangers": self._before.get("commands_of_strangers", 0.0)
            + self.logic.foreign,
            "commands_beyond_limits": self._before.get("commands_beyond_limits", 0.0)
            + self.logic.excessive,
            "commands_outside_active": self._before.get("commands_outside_active", 0.0)
            + self.logic.ignored,
        }

    def histograms(self) -> Mapping[str, Histogram]:
        return {f"{self.name}: round trip of state frame and command": self.round_trip}

    def close(self) -> None:
        self._bus.shutdown()
