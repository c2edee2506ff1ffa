"""Delays from the time stamps of a peer whose clock is not synchronised with this machine's."""

from __future__ import annotations

DRIFT = 1e-3
"""Upper bound of the drift between two clocks that are synchronised now and then [s/s]."""
SMALLEST_STEP = 50_000_000
"""[ns] A stamp that is ahead by more is taken as a clock step; by less, as a change of delay."""


class PeerClock:
    """Delay of each sample relative to the fastest one before it [ns].

    A later sample with an earlier stamp means that the peer's clock was set back. A stamp that is
    ahead of its arrival means that the clock was set forward. After a step, the delay of the first
    sample is assumed to be equal to that of the last sample before the step.
    """

    def __init__(self) -> None:
        self.steps = 0
        self.step = 0
        """The last step [ns]. Negative: set back."""
        self.reset()

    @property
    def sentence(self) -> str:
        """Message about clock steps for the operator; empty if there were none."""
        if not self.steps:
            return ""
        how = f"set {'back' if self.step < 0 else 'forward'} by {abs(self.step) * 1e-9:.3f} s"
        return f"its clock was {how}{f', the last of {self.steps} times' if self.steps > 1 else ''}; ages restart from there"

    def reset(self) -> None:
        """Restart with another publisher."""
        self._fastest: int | None = None
        self._delay = self._stamp = self._arrived = 0

    def delay(self, stamp: int, arrived: int) -> int:
        """Return the delay of a sample relative to the fastest one before it [ns].

        `stamp` [ns, clock of the peer], `arrived` [ns, clock of this machine]. The minimum grows
        slowly with time, because the clocks drift.
        """
        way = arrived - stamp
        if self._fastest is None:
            self._fastest = way
        else:
            ahead = stamp - self._stamp - (arrived - self._arrived)
            if stamp < self._stamp or ahead > self._delay + SMALLEST_STEP:
                self.steps += 1
                self.step = ahead
                self._fastest -= ahead
            self._fastest = min(self._fastest + int(DRIFT * (arrived - self._arrived)), way)
        self._delay, self._stamp, self._arrived = way - self._fastest, stamp, arrived
        return self._delay
