"""Reception of state frames by the host, and detection of other senders on the bus.

The duration of every wait is limited, even if frames arrive without a pause. Therefore a flood of
frames cannot block the loop.

Role: name of a quantity in a frame (`frames.py`). Controller: a host that sends command frames.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping

import can

from freeflyer.foundation.errors import one_line
from freeflyer_adapters.arm.frames import ArmFrames
from freeflyer_adapters.can.link import Receiver, Sender
from freeflyer_adapters.foundation import environment

MOST_FRAMES = 64
"""Number of frames after which a wait ends if a state frame was used or the timeout is over.

Later waits read the remaining frames.
"""
FOREIGN, WITHIN = 3, 20
"""Condition for a second controller.

A second controller is detected if FOREIGN command frames of another controller arrive within
WITHIN cycles.
"""
MOST_PER_CYCLE, BURST = 1.5, 24
"""Condition for a second arm.

In N cycles, more than N * MOST_PER_CYCLE + BURST state frames arrive. BURST allows for frames that
have waited on the bus.
"""
FLOOD = 10
"""Condition for a flood: at least FLOOD frames with other identifiers per accepted state frame."""
SLICE = 2e-4
"""Duration of one sleep during a flood [s]."""
Numbers = Mapping[str, list[float]]


class StateFrames:
    """Reader of the state frames of one arm.

    `bus`: open CAN bus. `sender`: sender of the command frames of this host.
    `take(numbers, now, empty_at)` processes a new state frame, and returns whether the frame is
    used. `numbers`: role -> values in SI units. `now` [ns]: time when the frame was read.
    `empty_at` [ns]: last time when the receive buffer was empty. The frame was not sent before
    this time.
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
        """Number of frames that are neither state frames nor command frames."""
        self.error = ""
        """The driver's message for the last failed reception."""
        self.stamp = 0.0
        """Time stamp [s] of the newest frame, set by the CAN interface."""
        self._commands = Receiver(frames.command)
        self._foreign: deque[int] = deque(maxlen=FOREIGN)
        self._foreign_number: float | None = None
        self._empty_at = 0

    @property
    def received(self) -> int:
        """Number of state frames that arrived, including rejected frames."""
        return self.receiver.accepted + self.receiver.refused

    @property
    def problem(self) -> str | None:
        """Message about a second arm or a second controller, or None if there is neither."""
        command = self._frames.command
        if self.receiver.senders.found:
            first, second = self.receiver.senders.counters
            return self._two_senders(f"with the counters {first} and {second}")
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

    def rate_problem(self, frames: int, cycles: float) -> str | None:
        """Return a message about a second arm, or None.

        `frames`: number of state frames that arrived in `cycles` cycles. One arm sends one frame in
        a cycle. If the frames of two arms arrive in long bursts, their counters do not show the
        second arm. Then only the number of frames shows the second arm.
        """
        if frames <= MOST_PER_CYCLE * cycles + BURST:
            return None
        return self._two_senders(f"{frames} frames in {cycles:.0f} cycles")

    def _two_senders(self, evidence: str) -> str:
        state = self._frames.state
        return (
            f"two senders send the state frame {state.message.name} (0x{state.identifier:X}), {evidence}: two arms are on this "
            f"channel; switch one of them off"
        )

    @property
    def errors(self) -> str:
        """Text about errors of the driver, for the end of a message.

        The text is empty if there are no errors.
        """
        errors = []
        if self._sender.failed:
            errors.append(f"{self._sender.failed} frames could not be sent: {self._sender.error}")
        if self.error:
            errors.append(f"receiving failed: {self.error}")
        return f" ({'; '.join(errors)})" if errors else ""

    @property
    def flood(self) -> str:
        """Text about a flood of other frames, for the end of a message.

        The text is empty if there is no flood.
        """
        if self.others < FLOOD * self.receiver.accepted:
            return ""
        return f"; a flood of frames: {self.others} frames with other identifiers were received in addition to {self.receiver.accepted} state frames"

    def silence(self, what: str, receiver: Receiver, waited: float) -> str:
        """Return an error message for a frame type that was not received within `waited` [s].

        `what`: name of the frame type. `receiver`: receiver of this frame type.
        """
        why = (
            f"; frames were received but rejected: {dict(receiver.rejected)}"
            if receiver.rejected
            else ""
        )
        why += f"; {self.others} frames with other identifiers were received" if self.others else ""
        return (
            f"sends no {what} frame within {waited:g} s{why}{self.errors}: is the arm (or `freeflyer facility`) running on this channel, "
            f"or has another controller activated the arm?"
        )

    def wait(self, timeout: float) -> bool:
        """Wait up to `timeout` [s] for a state frame. Then read the pending frames.

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
            # After MOST_FRAMES frames, continue only if no state frame was used and time is left.
            left = end - before
            if taken >= MOST_FRAMES and (used or left <= 0):
                return used
            taken += 1
            # After a state frame was used, read only the pending frames.
            try:
                message = bus.recv(0.0 if used or left <= 0 else left * 1e-9)
            except can.CanError as error:
                self.error, message = one_line(error, 300), None
            else:
                if message is None:
                    self._empty_at = before
            # `take` decides whether a state frame is used. Other frames are counted.
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
                        # Sleep during a flood, because the kernel throttles a real-time process
                        # that never sleeps.
                        self._environment.sleep(min(SLICE, max(left * 1e-9, 0.0)))
            before = now

    def _note_other(self, message: can.Message) -> None:
        """Record a command frame of another controller. Count a frame with another identifier."""
        command = self._frames.command
        if (
            message.arbitration_id != command.identifier
            or message.is_extended_id != command.extended
        ):
            self.others += 1
            return
        # Ignore frames that this controller has sent: some interfaces return them.
        if not message.is_rx or message.data in self._sender.recent:
            return
        numbers = self._commands.take(message)
        if numbers is not None:
            self._foreign.append(self.receiver.accepted)
            self._foreign_number = numbers["controller"][0] if "controller" in numbers else None

    def receive(self, timeout: float) -> tuple[can.Message | None, bool]:
        """Return a frame, and whether the reception failed.

        The frame is None if no frame arrives within `timeout` [s].
        """
        try:
            return self._bus.recv(max(timeout, 0.0)), False
        except can.CanError as error:
            self.error = one_line(error, 300)
            return None, True

    def drain(self) -> None:
        """Discard the pending frames. The number of discarded frames is limited."""
        for _ in range(16 * MOST_FRAMES):
            before = self._environment.monotonic_ns()
            message, failed = self.receive(0.0)
            if message is None:
                if not failed:
                    self._empty_at = before
                break
        self.receiver.reset()
