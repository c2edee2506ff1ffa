"""'Did you mean' suggestions for error messages."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable, Iterator


def did_you_mean(name: str, candidates: Iterable[str]) -> str:
    """Return a suggestion for an unknown name. The suggestion is appended to an error message.

    If a candidate is similar to `name`, the result is '; did you mean NAME?'. Otherwise, if there
    are 4 to 12 candidates, the result is '; known are ...' with all candidates. In all other cases
    the result is empty.
    """
    known = list(candidates)
    close = difflib.get_close_matches(name, known, n=1)
    if close:
        return f"; did you mean {close[0]!r}?"
    return f"; known are {', '.join(known)}" if 3 < len(known) <= 12 else ""


def unknown_keys(
    given: Iterable[str], known: Collection[str], also: Iterable[str] = ()
) -> Iterator[tuple[str, str]]:
    """Yield each key in `given` that is not in `known`, with the suggestion for it.

    The keys in `also` are suggested, too. The caller raises an exception for the first key.
    """
    for key in given:
        if key not in known:
            yield key, did_you_mean(key, [*known, *also])
