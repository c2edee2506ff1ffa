"""Read vector parameters from the columns of a CSV file.

`NAME = { csv = "FILE" }` sets one parameter for each column: column `x` sets the parameter NAME_x.
The first line has the names of the columns. Each further line has one number for each column, in
the unit of the parameter. A parameter with more elements than lines keeps its remaining start
values.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from freeflyer.foundation.errors import ScenarioError

LARGEST = 1 << 20
"""Largest size [bytes] of a file."""


def located(parameters: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return `parameters` with an absolute path in each `{ csv = ... }`.

    A relative path is relative to `folder`.
    """
    return {
        name: {**value, "csv": str((folder / value["csv"]).absolute())}
        if isinstance(value, dict) and isinstance(value.get("csv"), str)
        else value
        for name, value in parameters.items()
    }


def expanded(parameters: Mapping[str, Any], folder: Path, where: str) -> dict[str, Any]:
    """Return `parameters` with the columns of each CSV file in place of `{ csv = ... }`.

    A relative path is relative to `folder`. `where` is the prefix of error messages. Raises
    ScenarioError.
    """
    found: dict[str, Any] = {}
    for name, value in parameters.items():
        if not (isinstance(value, dict) and "csv" in value):
            found[name] = value
            continue
        subject = f"{where}{name}"
        if value.keys() != {"csv"} or not isinstance(value["csv"], str):
            raise ScenarioError(f'{subject} is {value!r}; {{ csv = "FILE" }} is expected')
        for column, numbers in _columns(folder / value["csv"], subject).items():
            found[f"{name}_{column}"] = {"first": numbers}
    return found


def _columns(path: Path, subject: str) -> dict[str, list[float]]:
    try:
        size = path.stat().st_size
        if not path.is_file() or size > LARGEST:
            raise ScenarioError(
                f"{subject}: {path} is not a regular file of at most {LARGEST} bytes"
            )
        reader = csv.reader(path.read_text(encoding="utf-8-sig").splitlines())
        lines = [([field.strip() for field in line], reader.line_num) for line in reader]
    except (OSError, ValueError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise ScenarioError(f"{subject}: {path} cannot be read: {reason}") from error
    rows = [(line, number) for line, number in lines if any(line)]
    header = rows[0][0] if rows else []
    if (
        len(rows) < 2
        or len(set(header)) < len(header)
        or not all(name.isidentifier() for name in header)
    ):
        raise ScenarioError(
            f"{subject}: {path} has the first line {','.join(header)!r}; "
            "different names of columns are expected there, and numbers in the lines below"
        )
    for row, number in rows[1:]:
        if len(row) != len(header) or not all(map(_is_number, row)):
            raise ScenarioError(
                f"{subject}: line {number} of {path} is {','.join(row)!r}; {len(header)} numbers are expected"
            )
    return {
        name: [float(field) for field in column]
        for name, column in zip(
            header, zip(*(row for row, _ in rows[1:]), strict=True), strict=True
        )
    }


def _is_number(text: str) -> bool:
    try:
        return "_" not in text and abs(float(text)) <= 1e300
    except ValueError:
        return False
