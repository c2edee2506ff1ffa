"""Reception of state frames by the host, and detection of other senders on the bus.

Every wait is limited in frames and in time, so that a flood of frames cannot block the loop.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping

import can

from freeflyer_adapters.arm.frames import ArmFrames
from freeflyer_adapters.can.link import Receiver, Sender, driver_message
from freeflyer_adapters.foundation import environment

MOST_FRAMES = 64
"""Largest number of frames per wait. The next cycles read the rest of a backlog."""
FOREIGN, WITHIN = 3, 20
"""FOREIGN command frames of another controller within WITHIN cycles are a second controller."""
FLOOD = 10
"""Frames of other identifiers per state frame from which errors report a flood."""
SLICE = 2e-4
"""Sleep during a flood [s]."""
Numbers = Mapping[str, list[float]]


class StateFrames:
    """Reader of the state frames of one arm.

    `take(numbers, now, empty_at)` processes a new state frame, and returns whether it is used.
    `numbers`: values by role [SI]; `now` [ns]: when the frame was read; `empty_at` [ns]: time of
    the last empty receive buffer, before which the frame was not sent.
    """

    def __init__(
        self,
        bus: can.BusABC,
        frames: ArmFrames,
        sender: Sender,
        take: Callable[[Numbers, int, int], bool],
    ) -> None:
        self._bus, self._frames, self._sender, self._take = bus, frames, sender, take
        self._environment = environment.present()
        self.receiver = Receiver(frames.state)
        self.others = 0
        """Number of frames with other identifiers."""
        self.error = ""
        """The driver's message for the last failed reception."""
        self.stamp = 0.0
        """Time stamp of the newest frame, from the interface [s]."""
        self._commands = Receiver(frames.command)
        self._foreign: deque[int] = deque(maxlen=FOREIGN)
        self._foreign_number: float | None = None
        self._empty_at = 0

    @property
    def problem(self) -> str | None:
        """Message about a second arm or a second controller; None if neither was detected."""
        state, command = self._frames.state, self._frames.command
        if self.receiver.senders.found:
            first, second = self.receiver.senders.counters
            return (
                f"two senders send the state frame {state.message.name} (0x{state.identifier:X}), with the counters {first} and "
                f"{second}: two arms are on this channel; switch one of them off"
            )
        foreign = self._foreign
        if len(foreign) == FOREIGN and self.receiver.accepted - foreign[0] < WITHIN:
            number = (
                "" if self._foreign_number is None else f", of session {self._foreign_number:.0f}"
            )
            return (
                f"another controller sends the command frame {command.message.name} (0x{command.identifier:X}){number}; "
                f"stop the other controller first"
            )
        return None

    @property
    def errors(self) -> str:
        """The driver's errors as the end of a sentence; empty if there are none."""
        errors = []
        if self._sender.failed:
            errors.append(f"{self._sender.failed} frames could not be sent: {self._sender.error}")
        if self.error:
            errors.append(f"receiving failed: {self.error}")
        return f" ({'; '.join(errors)})" if errors else ""

    @property
    def flood(self) -> str:
        """Note about a flood of other frames as the end of a sentence; empty if there is none."""
        if self.others < FLOOD * self.receiver.accepted:
            return ""
        return f"; a flood of frames: {self.others} with other identifiers were received beside {self.receiver.accepted} state frames"

    def silence(self, what: str, receiver: Receiver, waited: float) -> str:
        """Return an error message for a frame type that was not received within `waited` [s]."""
        why = (
            f"; frames were received but rejected: {dict(receiver.rejected)}"
            if receiver.rejected
            else ""
        )
        why += f"; {self.others} frames with other identifiers were received" if self.others else ""
        return (
            f"sends no {what} frame within {waited:g} s{why}{self.errors}: is the arm (or `freeflyer facility`) running on this channel, "
            f"and not active for another controller?"
        )

    def wait(self, timeout: float) -> bool:
        """Wait up to `timeout` [s] for a state frame, and read all pending frames.

        Return whether a state frame was used.
        """
        clock, bus, identifier = (
            self._environment.monotonic_ns,
            self._bus,
            self._frames.state.identifier,
        )
        before = clock()
        end = before + max(1, int(timeout * 1e9))
        used, taken = False, 0
        while True:
            # After MOST_FRAMES, wait on only if no state frame was used and time is left.
            left = end - before
            if taken >= MOST_FRAMES and (used or left <= 0):
                return used
            taken += 1
            # Once a state frame was used, read only what is pending.
            try:
                message = bus.recv(0.0 if used or left <= 0 else left * 1e-9)
            except can.CanError as error:
                self.error, message = driver_message(error), None
            else:
                if message is None:
                    self._empty_at = before
            # `take` decides about state frames; other frames are counted.
            now = clock()
            if message is None:
                if used or now >= end:
                    return used
            else:
                numbers = self.receiver.take(message)
                self.stamp = message.timestamp
                if numbers is not None:
                    used = self._take(numbers, now, self._empty_at) or used
                elif message.arbitration_id != identifier:
                    self._note_other(message)
                    if self.others and self.others % MOST_FRAMES == 0 and not used:
                        # In a flood, sleep: the kernel throttles a real-time loop that never does.
                        self._environment.sleep(min(SLICE, max(left * 1e-9, 0.0)))
            before = now

    def _note_other(self, message: can.Message) -> None:
        """Count a frame of another identifier, and record a command frame of another controller."""
        command = self._frames.command
        if (
            message.arbitration_id != command.identifier
            or message.is_extended_id != command.extended
        ):
            self.others += 1
            return
        # Some interfaces echo the frames that this controller has sent.
        if not message.is_rx or message.data in self._sender.recent:
            return
        numbers = self._commands.take(message)
        if numbers is not None:
            self._foreign.append(self.receiver.accepted)
            self._foreign_number = numbers["controller"][0] if "controller" in numbers else None

    def receive(self, timeout: float) -> tuple[can.Message | None, bool]:
        """Return a frame or None after `timeout` [s], and whether the reception failed."""
        try:
            return self._bus.recv(max(timeout, 0.0)), False
        except can.CanError as error:
            self.error = driver_message(error)
            return None, True

    def drain(self) -> None:
        """Discard the pending frames, up to a limit."""
        for _ in range(16 * MOST_FRAMES):
            before = self._environment.monotonic_ns()
            message, failed = self.receive(0.0)
            if message is None:
                if not failed:
                    self._empty_at = before
                break
        self.receiver.reset()
