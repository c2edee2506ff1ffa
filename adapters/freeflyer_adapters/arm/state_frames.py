"""The host's reception from the arm: the newest state frame, how old it is at most, and what else is on the bus.

Every wait is bounded in frames and in time, so that a flood of frames cannot hold the loop.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping

import can

from freeflyer_adapters.arm.frames import ArmFrames
from freeflyer_adapters.can.link import Receiver, Sender, driver_message
from freeflyer_adapters.foundation import environment

MOST_FRAMES = 64
"""Taken at a time. A backlog of more is taken in the next cycles."""
FOREIGN, WITHIN = 3, 20
"""Command frames of another controller within so many of the arm's cycles that make a second controller."""
FLOOD = 10
"""Frames of other identifiers for each state frame that a sentence about lost cycles names."""
SLICE = 2e-4
"""[s]"""
Numbers = Mapping[str, list[float]]


class StateFrames:
    """`take` gets the numbers of a new state frame, when it was read, and a time before which it was not sent [ns]; it returns whether
    the frame is used.
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
        """Frames of other identifiers."""
        self.error = ""
        """The driver's own text of the last failure to receive."""
        self.stamp = 0.0
        """The interface's own time stamp of the newest frame [s]."""
        self._commands = Receiver(frames.command)
        self._foreign: deque[int] = deque(maxlen=FOREIGN)
        self._foreign_number: float | None = None
        self._empty_at = 0

    @property
    def problem(self) -> str | None:
        """A second arm, or a second controller, in one sentence."""
        state, command = self._frames.state, self._frames.command
        if self.receiver.senders.found:
            first, second = self.receiver.senders.counters
            return (
                f"two senders send the state frame {state.message.name} (0x{state.identifier:X}), with the counters {first} and "
                f"{second}: two arms are on this channel; switch one of them off"
            )
        seen = self._foreign
        if len(seen) == FOREIGN and self.receiver.accepted - seen[0] < WITHIN:
            number = (
                "" if self._foreign_number is None else f", of session {self._foreign_number:.0f}"
            )
            return (
                f"another controller sends the command frame {command.message.name} (0x{command.identifier:X}){number}; "
                f"stop that one first"
            )
        return None

    @property
    def errors(self) -> str:
        """What the driver itself said of frames that it did not send or receive, to end a sentence with."""
        said = []
        if self._sender.failed:
            said.append(f"{self._sender.failed} frames could not be sent: {self._sender.error}")
        if self.error:
            said.append(f"receiving failed: {self.error}")
        return f" ({'; '.join(said)})" if said else ""

    @property
    def flood(self) -> str:
        """That other nodes send many times as much, to end a sentence with."""
        if self.others < FLOOD * self.receiver.accepted:
            return ""
        return f"; a flood of frames: {self.others} of other identifiers came beside {self.receiver.accepted} state frames"

    def silence(self, what: str, receiver: Receiver, waited: float) -> str:
        """What to look at where no frame of a kind has come for `waited` [s]."""
        why = (
            f"; frames came but were refused: {dict(receiver.rejected)}"
            if receiver.rejected
            else ""
        )
        why += f"; {self.others} frames of other identifiers came" if self.others else ""
        return (
            f"sends no {what} frame within {waited:g} s{why}{self.errors}: is the arm (or `freeflyer facility`) running on this channel, "
            f"and not active for another controller?"
        )

    def wait(self, timeout: float) -> bool:
        """Wait for a state frame for `timeout` [s], and take the newest of those that are there."""
        clock, bus, identifier = (
            self._environment.monotonic_ns,
            self._bus,
            self._frames.state.identifier,
        )
        before = clock()
        end = before + max(1, int(timeout * 1e9))
        came, taken = False, 0
        while True:
            left = end - before
            if taken >= MOST_FRAMES and (came or left <= 0):
                return came
            taken += 1
            try:
                message = bus.recv(0.0 if came or left <= 0 else left * 1e-9)
            except can.CanError as error:
                self.error, message = driver_message(error), None
            else:
                if message is None:
                    self._empty_at = before
            now = clock()
            if message is None:
                if came or now >= end:
                    return came
            else:
                numbers = self.receiver.take(message)
                self.stamp = message.timestamp
                if numbers is not None:
                    came = self._take(numbers, now, self._empty_at) or came
                elif message.arbitration_id != identifier:
                    self._note_other(message)
                    if self.others and self.others % MOST_FRAMES == 0 and not came:
                        # A flood: a loop at real-time priority that never sleeps would be throttled.
                        self._environment.sleep(min(SLICE, max(left * 1e-9, 0.0)))
            before = now

    def _note_other(self, message: can.Message) -> None:
        command = self._frames.command
        if (
            message.arbitration_id != command.identifier
            or message.is_extended_id != command.extended
        ):
            self.others += 1
            return
        # What this controller has sent itself is given back by some interfaces.
        if not message.is_rx or message.data in self._sender.recent:
            return
        numbers = self._commands.take(message)
        if numbers is not None:
            self._foreign.append(self.receiver.accepted)
            self._foreign_number = numbers["controller"][0] if "controller" in numbers else None

    def receive(self, timeout: float) -> tuple[can.Message | None, bool]:
        """A frame, or None; and whether the interface has failed to receive."""
        try:
            return self._bus.recv(max(timeout, 0.0)), False
        except can.CanError as error:
            self.error = driver_message(error)
            return None, True

    def drain(self) -> None:
        """Throw away what waits, as far as it is bounded."""
        for _ in range(16 * MOST_FRAMES):
            before = self._environment.monotonic_ns()
            message, failed = self.receive(0.0)
            if message is None:
                if not failed:
                    self._empty_at = before
                break
        self.receiver.forget()
