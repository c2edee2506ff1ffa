"""Histogram of cycle times with a constant memory size."""

from __future__ import annotations

from collections.abc import Mapping

BINS = 100_000
"""Number of bins. Each bin is 1 us wide. The last bin also counts all longer durations.

`Histogram.longest` is the exact longest duration, even if it exceeds the range of the bins.
"""


class Histogram:
    """Histogram of durations [ns]."""

    def __init__(self) -> None:
        self._counts = [0] * BINS
        self.count = 0
        self.longest = 0
        self._recent = 0

    def add(self, duration: int) -> None:
        self.count += 1
        if duration > self.longest:
            self.longest = duration
        if duration > self._recent:
            self._recent = duration
        index = duration // 1000
        self._counts[index if 0 <= index < BINS else (0 if index < 0 else BINS - 1)] += 1

    def take_recent(self) -> float:
        """Return the longest duration since the last call of this method [us]."""
        recent, self._recent = self._recent, 0
        return recent / 1000.0

    def quantile(self, share: float) -> float:
        """Return the upper edge [us] of the bin that contains the quantile `share` (0 to 1).

        Returns 0 if the histogram is empty.
        """
        wanted, seen = share * self.count, 0
        for index, count in enumerate(self._counts):
            seen += count
            if count and seen >= wanted:
                return index + 1.0
        return 0.0

    def summary(self) -> Mapping[str, float]:
        return {
            "count": self.count,
            "p50_us": self.quantile(0.5),
            "p99_us": self.quantile(0.99),
            "p999_us": self.quantile(0.999),
            "max_us": self.longest / 1000.0,
        }
