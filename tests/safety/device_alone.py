"""Search model of the virtual arm alone, with any frame from any sender in every cycle.

The model checks the guarantees of the interface control document about an activation.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from freeflyer_adapters.arm.frames import Mode
from freeflyer_adapters.device.device import LifeCycle
from freeflyer_adapters.device.ramp_down import RampDown
from freeflyer_adapters.facility.arm_logic import ArmLogic, Command

WATCHDOG, SILENCE, CYCLES, OLDEST = 2, 3, 64, 6
NUMBERS = (1, 2)
IGNORED = frozenset(
    {
        "events",
        "lost",
        "foreign",
        "excessive",
        "ignored",
        "total_lost",
        "subject",
        "ramp",
        "effort",
    }
)
"""Counters and constants."""
STILL = np.zeros(0)


def arm(implicit: bool = False, watchdog: int = WATCHDOG, silence: int = SILENCE) -> ArmLogic:
    made = ArmLogic(
        0,
        cycle=1e-3,
        watchdog=watchdog,
        silence=silence,
        ramp=RampDown(time=1e-3, damping=1.0),
        cycles=CYCLES,
        implicit=implicit,
    )
    made.cycle = CYCLES // 2
    return made


def shift(logic: ArmLogic, echo: int = WATCHDOG) -> None:
    """Make the cycle numbers relative to the middle of their range, and limit their age."""
    middle = CYCLES // 2
    answered, echoed = (
        (logic.cycle - number) % CYCLES for number in (logic._answered, logic.echoed)
    )
    logic._answered = middle - (answered if answered < logic.watchdog else OLDEST)
    logic.echoed = middle - (echoed if echoed < echo else OLDEST)
    logic.cycle = middle
    logic._quiet = min(logic._quiet, logic.silence + 1) if logic.controller else 0
    if logic.braked:
        logic._stopping = 0
    logic.events.clear()


class DeviceAlone:
    """Virtual arm that receives one frame of any content, or none, in every cycle."""

    def __init__(self) -> None:
        self.arm = arm()
        self.echoes: list[int] = [0] * OLDEST
        """Session numbers in the last state frames, the newest last."""
        self.was_active: set[int] = set()
        """Session numbers that were active, or that have commanded the brakes."""
        self.bad: str | None = None

    def moves(self) -> Iterator[tuple[str, Callable[[Any], None]]]:
        yield "no frame", lambda world: world.cycle(None)
        yield "the arm fails", lambda world: world.fail()
        yield "a new session", lambda world: world.renew()
        for number, mode, age in itertools.product(NUMBERS, [*Mode, None], range(WATCHDOG + 2)):
            frame = (number, mode, age)
            yield (
                f"frame {number} {mode.name if mode else mode} {age}",
                lambda world, f=frame: world.cycle(f),
            )

    def fail(self) -> None:
        if self.arm.life.now is LifeCycle.active:
            self.was_active.add(self.arm.controller)
        self.arm.fail("it fails")

    def renew(self) -> None:
        """Start the next session of the facility after the session of the arm has ended."""
        if self.arm.session_is_over:
            self.arm = self.arm.again()

    def cycle(self, frame: tuple[int, Mode | None, int] | None) -> None:
        """Execute one cycle with a frame (session number, mode, age in cycles), and check it."""
        logic, before, accepted = self.arm, self.arm.life.now, self.arm.controller
        number, mode, age = frame or (0, None, 0)
        commands = []
        if frame is not None:
            commands = [
                Command(
                    controller=number,
                    mode=mode,
                    answered=(logic.cycle - age) % CYCLES,
                    torque=STILL,
                )
            ]
        last = (logic.cycle - logic._answered) % CYCLES
        cycle, answered = logic.cycle, logic._answered
        logic.begin(commands, STILL)
        # Check for effects that must never occur.
        now, is_used = logic.life.now, logic._answered != answered
        if now is LifeCycle.active and before is not LifeCycle.active:
            self.bad = self._bad_activation(frame, before)
        elif is_used and (before is not LifeCycle.active or number != accepted):
            self.bad = "a command was used outside active, or of another session"
        elif is_used and (age >= WATCHDOG or age > last):
            self.bad = "a command as old as the watchdog, or older than the one before, was used"
        elif now is LifeCycle.active and (cycle - logic._answered) % CYCLES >= WATCHDOG:
            self.bad = "active without a command for as long as the watchdog"
        elif not logic.braked and now not in (LifeCycle.active, LifeCycle.safe_stop):
            self.bad = f"brakes released in {now.name}"
        elif (
            before in (LifeCycle.safe_stop, LifeCycle.fault)
            and now is LifeCycle.inactive
            and number in self.was_active
        ):
            self.bad = "an expired number has ended a stop"
        elif accepted and logic.controller not in (0, accepted):
            self.bad = "a claim has replaced the accepted number"
        elif not accepted and logic.controller in self.was_active - {0}:
            self.bad = "an expired number was claimed"
        # Numbers that have expired.
        if mode is Mode.brake and number == accepted:
            self.was_active.add(number)
        if before is LifeCycle.active and now is not LifeCycle.active:
            self.was_active.add(accepted)
        self.echoes = [*self.echoes[1:], logic.controller]

    def _bad_activation(
        self, frame: tuple[int, Mode | None, int] | None, before: LifeCycle
    ) -> str | None:
        if frame is None:
            return "active without a frame"
        number, mode, age = frame
        if mode is not Mode.activate:
            return f"active by mode {mode}"
        if before is not LifeCycle.inactive:
            return f"active from {before.name}"
        if number in self.was_active:
            return "active by an expired number"
        if age >= WATCHDOG:
            return "active by an answer as old as the watchdog"
        if self.echoes[-1 - age] != number:
            return "active by an answer to a state frame without the number"
        return None

    def normalise(self) -> None:
        shift(self.arm)

    def violation(self) -> str | None:
        return self.bad
