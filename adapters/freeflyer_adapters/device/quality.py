"""The quality of a link: how many cycles in a row, or within a window, may be lost before the loop must stop.

No clock is read here: cycles are counted, so the same monitor watches a link in real time and a simulated one at any speed.
"""

from __future__ import annotations

from collections import deque


class QualityMonitor:
    """Stop on `consecutive` lost cycles in a row, or on `within` lost ones in the last `window` cycles (0: that rule is off)."""

    def __init__(
        self, subject: str, *, consecutive: int, within: int = 0, window: int = 0, cycle: float
    ) -> None:
        self.subject, self.consecutive, self.within, self.window, self.cycle = (
            subject,
            consecutive,
            within,
            window,
            cycle,
        )
        self._row = 0
        self._recent: deque[int] = deque(maxlen=max(within, 1))
        self._count = 0
        self.lost = 0
        self.longest_row = 0

    def lose(self, count: int) -> str | None:
        """Several lost cycles at once; the first reason to stop, if there is one."""
        for done in range(count):
            reason = self.observe(lost=True)
            if reason:
                self.lost += count - done - 1
                return reason
        return None

    def observe(self, lost: bool) -> str | None:
        """One cycle; the reason to stop, in one sentence, if there is one."""
        self._count += 1
        if not lost:
            self._row = 0
            return None
        self.lost += 1
        self._row += 1
        self.longest_row = max(self.longest_row, self._row)
        self._recent.append(self._count)
        if self._row >= self.consecutive:
            return f"{self._row} cycles in a row were lost, {self.consecutive} are one too many ({self.subject}, cycles of {self.cycle:g} s)"
        if (
            self.within
            and len(self._recent) == self.within
            and self._count - self._recent[0] < self.window
        ):
            return (
                f"{self.within} cycles within {self.window * self.cycle:g} s were lost, one too many ({self.subject}, "
                f"cycles of {self.cycle:g} s)"
            )
        return None
