"""A peer's time stamps, compared by differences: two clocks that were never set alike."""

from __future__ import annotations

DRIFT = 1e-3
"""More than two clocks that are set now and then run apart: [s/s]."""
SMALLEST_STEP = 50_000_000
"""[ns] Less is taken for delay, more of a stamp that runs ahead for a clock that was set."""


class PeerClock:
    """Samples in the order of their numbers: how late each came, beside the quickest before it. Times in ns.

    A later sample with an earlier stamp means that the peer's clock was set back; one whose stamp runs ahead of its arrival, that it
    was set forward. Ages are then counted anew, as if the first sample after the step were as late as the one before.
    """

    def __init__(self) -> None:
        self.steps = 0
        self.step = 0
        """The last step [ns]; negative: back."""
        self.forget()

    @property
    def sentence(self) -> str:
        """What was noticed, for the operator; empty if nothing was."""
        if not self.steps:
            return ""
        how = f"set {'back' if self.step < 0 else 'forward'} by {abs(self.step) * 1e-9:.3f} s"
        return f"its clock was {how}{f', the last of {self.steps} times' if self.steps > 1 else ''}; ages are counted anew from there"

    def forget(self) -> None:
        """Begin anew, with another publisher."""
        self._quickest: int | None = None
        self._delay = self._stamp = self._arrived = 0

    def delay(self, stamp: int, arrived: int) -> int:
        """How much later the sample came than the quickest before it; what is quick is forgotten slowly, as clocks drift."""
        way = arrived - stamp
        if self._quickest is None:
            self._quickest = way
        else:
            ahead = stamp - self._stamp - (arrived - self._arrived)
            if stamp < self._stamp or ahead > self._delay + SMALLEST_STEP:
                self.steps += 1
                self.step = ahead
                self._quickest -= ahead
            self._quickest = min(self._quickest + int(DRIFT * (arrived - self._arrived)), way)
        self._delay, self._stamp, self._arrived = way - self._quickest, stamp, arrived
        return self._delay
