"""File names that a caller passes."""

from __future__ import annotations

import os

from freeflyer.foundation.errors import CosimError, one_line


def text_of(name: object, subject: str, error: type[CosimError] = CosimError) -> str:
    """Return a name or path as a text. Raises `error` for a value of another type.

    `subject` is the subject of the message.
    """
    found = os.fspath(name) if isinstance(name, os.PathLike) else name
    if not isinstance(found, str):
        raise error(
            f"{subject} is {one_line(repr(name), 80)} of type {type(name).__name__}; a text or a path is expected"
        )
    return found
