"""'Did you mean': the nearest known name, for error messages."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def did_you_mean(name: str, candidates: Iterable[str]) -> str:
    """'; did you mean NAME?' or, where nothing is near, '; known are ...' for a short list, or nothing."""
    known = list(candidates)
    close = difflib.get_close_matches(name, known, n=1)
    if close:
        return f"; did you mean {close[0]!r}?"
    return f"; known are {', '.join(known)}" if 3 < len(known) <= 12 else ""
