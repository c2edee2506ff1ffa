"""TOML from anybody: text as tables of plain values; ValueError, whose text says what is wrong, for whatever is none.

Python's `tomllib` takes what TOML 1.0 leaves to its reader: integers of any size, nesting until Python itself gives up, and keys of
any number of parts, for which it needs a time that grows with their square.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from freeflyer.foundation.bounded_file import content

LARGEST = 256 << 10
"""Bytes of a file; the largest that is shipped has 6 kB."""
DEEPEST = 40
"""Tables and arrays within each other."""
MOST_PARTS = 500
"""Dots of a line, other than those of a list's numbers."""
INTEGERS = range(-(1 << 63), 1 << 63)
"""What TOML 1.0 asks of every reader."""
_NUMBER_OF_A_LIST = re.compile(r"\d\.\d[\d_eE+-]*[ \t]*[,\]]")


def read(path: Path) -> dict[str, Any]:
    """A file's tables. OSError if it cannot be read, ValueError if it is no TOML that can be used."""
    try:
        text = content(path, LARGEST).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{error.reason} at byte {error.start}; UTF-8 is expected") from error
    return parsed(text)


def parsed(text: str) -> dict[str, Any]:
    """ValueError if it is no TOML that can be used."""
    for number, line in enumerate(text.split("\n"), 1):
        if (
            line.count(".") > MOST_PARTS
            and line.count(".") - len(_NUMBER_OF_A_LIST.findall(line)) > MOST_PARTS
        ):
            raise ValueError(f"a name of more than {MOST_PARTS} parts (at line {number})")
    try:
        tables = tomllib.loads(text)
    except RecursionError as error:
        raise ValueError(f"it is nested deeper than {DEEPEST} tables and arrays") from error
    except tomllib.TOMLDecodeError:
        raise
    except ValueError as error:  # Python's int() takes no more than some thousand digits
        raise ValueError("an integer of more than 64 bits") from error
    _check(tables, 0)
    return tables


def _check(value: Any, depth: int) -> None:
    if isinstance(value, dict | list):
        if depth > DEEPEST:
            raise ValueError(f"it is nested deeper than {DEEPEST} tables and arrays")
        for item in value.values() if isinstance(value, dict) else value:
            _check(item, depth + 1)
    elif isinstance(value, int) and value not in INTEGERS:
        raise ValueError("an integer of more than 64 bits")
