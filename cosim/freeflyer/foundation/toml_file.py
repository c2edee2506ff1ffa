"""Parser for untrusted TOML. The result consists of tables with plain values.

TOML 1.0 permits a parser to limit the size of integers and the nesting depth. Python's parser
`tomllib` sets no such limits: it accepts integers of much more than 64 bits, and nesting up to
Python's recursion limit. In addition, the time that `tomllib` needs for a dotted key (a.b.c) is
quadratic in the number of parts of the key. Therefore this module limits the integers, the nesting
and the dotted keys.
"""

from __future__ import annotations

import datetime
import re
import tomllib
from pathlib import Path
from typing import Any

from freeflyer.foundation.bounded_file import content
from freeflyer.foundation.errors import one_line
from freeflyer.foundation.units import is_quantity

LARGEST = 256 << 10
"""Largest allowed size of a file [bytes]. The largest shipped file has 6 kB."""
DEEPEST = 40
"""Largest allowed nesting depth of tables and arrays."""
MOST_PARTS = 500
"""Largest allowed number of dots in a line.

This number limits the parts of a dotted key. The decimal points of numbers in a list do not count.
"""
INTEGERS = range(-(1 << 63), 1 << 63)
"""The integers that every TOML 1.0 parser must accept."""
_NUMBER_OF_A_LIST = re.compile(r"\d\.\d[\d_eE+-]*[ \t]*[,\]]")


def read(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises OSError if the file cannot be read, ValueError if the content is invalid.
    """
    try:
        text = content(path, LARGEST).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{error.reason} at byte {error.start}; UTF-8 is expected") from error
    return parsed(text)


def parsed(text: str) -> dict[str, Any]:
    """Parse TOML text.

    Raises ValueError if the text is invalid or exceeds a limit. The message contains the reason.
    """
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
    except ValueError as error:  # Python's int() rejects more than a few thousand digits
        raise ValueError("an integer of more than 64 bits") from error
    _check(tables, 0)
    return tables


def as_written(value: object) -> str:
    """Return a value for a message, as it is written in TOML. At most 200 characters.

    A value with a unit has the form that `--set` accepts: 20 ms. None is a missing value.
    """
    return one_line(_written(value), 200)


def _written(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_written, value))}]"
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    if isinstance(value, dict) and value:
        if is_quantity(value):
            number, unit = _written(value["value"]), value["unit"]
            return (
                f"{number.removesuffix('.0')} {unit if isinstance(unit, str) else _written(unit)}"
            )
        return f"{{ {', '.join(f'{key} = {_written(item)}' for key, item in value.items())} }}"
    return "missing" if value is None else repr(value)


def _check(value: Any, depth: int) -> None:
    if isinstance(value, dict | list):
        if depth > DEEPEST:
            raise ValueError(f"it is nested deeper than {DEEPEST} tables and arrays")
        for item in value.values() if isinstance(value, dict) else value:
            _check(item, depth + 1)
    elif isinstance(value, int) and value not in INTEGERS:
        raise ValueError("an integer of more than 64 bits")
