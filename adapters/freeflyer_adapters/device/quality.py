"""Monitor of the quality of a link. Too many lost cycles stop the loop.

The monitor counts cycles and reads no clock. Therefore it works in real time and in virtual
time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

from freeflyer.fmi.component import Array


class QualityMonitor:
    """Monitor of the lost cycles of one link.

    The monitor requests a stop after `consecutive` lost cycles in a row. It also requests a stop
    after `within` lost cycles in the last `window` cycles. If `within` is 0, this second condition
    is disabled. `cycle` [s] and `subject` are used only in messages.
    """

    def __init__(
        self, subject: str, *, consecutive: int, within: int = 0, window: int = 0, cycle: float
    ) -> None:
        self.subject, self.cycle = subject, cycle
        self.consecutive, self.within, self.window = consecutive, within, window
        self._row = 0
        self._recent: deque[int] = deque(maxlen=max(within, 1))
        self._count = 0
        self.lost = 0
        self.longest_row = 0

    @classmethod
    def of(cls, subject: str, settings: Mapping[str, Array], cycle: float) -> QualityMonitor:
        """Create the monitor from a device's settings; see `device.parameters`."""
        return cls(
            subject,
            consecutive=int(settings["lost_consecutive"][0]),
            within=int(settings["lost_in_window"][0]),
            window=round(float(settings["window"][0]) / cycle),
            cycle=cycle,
        )

    def lose(self, count: int) -> str | None:
        """Add `count` lost cycles. Return the first reason to stop, or None."""
        for done in range(count):
            reason = self.observe(lost=True)
            if reason:
                self.lost += count - done - 1
                return reason
        return None

    def observe(self, lost: bool) -> str | None:
        """Add one cycle. Return the reason to stop, or None."""
        self._count += 1
        if not lost:
            self._row = 0
            return None
        self.lost += 1
        self._row += 1
        self.longest_row = max(self.longest_row, self._row)
        self._recent.append(self._count)
        if self._row >= self.consecutive:
            return f"{self._row} cycles in a row were lost, the limit is {self.consecutive} ({self.subject}, cycles of {self.cycle:g} s)"
        if (
            self.within
            and len(self._recent) == self.within
            and self._count - self._recent[0] < self.window
        ):
            return (
                f"{self.within} cycles within {self.window * self.cycle:g} s were lost, the limit is {self.within} ({self.subject}, "
                f"cycles of {self.cycle:g} s)"
            )
        return None
