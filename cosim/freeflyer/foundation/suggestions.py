"""'Did you mean' suggestions for error messages."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def did_you_mean(name: str, candidates: Iterable[str]) -> str:
    """Return '; did you mean NAME?' for a similar candidate, else '; known are ...' or ''.

    The candidates are listed only if there are 4 to 12 of them.
    """
    known = list(candidates)
    close = difflib.get_close_matches(name, known, n=1)
    if close:
        return f"; did you mean {close[0]!r}?"
    return f"; known are {', '.join(known)}" if 3 < len(known) <= 12 else ""
