"""Delays of samples, computed from the time stamps of a peer.

The offset between the clock of the peer and the clock of this machine is unknown. Therefore only
the difference between the delays of two samples can be computed.
"""

from __future__ import annotations

DRIFT = 1e-3
"""Upper bound of the drift between two clocks, even if a time service corrects them [s/s]."""
SMALLEST_STEP = 50_000_000
"""Smallest forward step of the peer's clock that is detected [ns].

If the time stamps advance by more than the times of arrival, either the delay has become smaller or
the clock was set forward. The delay relative to the fastest sample cannot become smaller than zero.
So if this excess is greater than the last delay plus `SMALLEST_STEP`, the clock was set forward.
"""


class PeerClock:
    """Delay of each sample relative to the fastest sample so far [ns].

    If a later sample has an earlier stamp, the peer's clock was set back. If the stamps advance by
    much more than the times of arrival, the peer's clock was set forward. Both are clock steps. The
    first sample after a clock step is assumed to have the same delay as the sample before it.
    """

    def __init__(self) -> None:
        self.steps = 0
        self.step = 0
        """The last clock step [ns]. Negative: the clock was set back."""
        self.reset()

    @property
    def sentence(self) -> str:
        """Message to the operator about clock steps; empty if there were no clock steps."""
        if not self.steps:
            return ""
        how = f"set {'back' if self.step < 0 else 'forward'} by {abs(self.step) * 1e-9:.3f} s"
        return f"its clock was {how}{f' (the last of {self.steps} clock steps)' if self.steps > 1 else ''}; the ages of later samples assume the same transport delay as before this step"

    def reset(self) -> None:
        """Discard the stored times, for another publisher."""
        self._fastest: int | None = None
        self._delay = self._stamp = self._arrived = 0

    def delay(self, stamp: int, arrived: int) -> int:
        """Return the delay of a sample relative to the fastest sample so far [ns].

        `stamp`: time stamp [ns, clock of the peer]. `arrived`: time of arrival [ns, clock of this
        machine]. The stored difference `arrived - stamp` of the fastest sample increases slowly
        with time, because the clocks drift.
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
