"""Further results of a sweep, computed by an object of the user."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import Any, Protocol, cast

from rich.console import RenderableType

from freeflyer.foundation import user_object
from freeflyer.foundation.errors import CosimError
from freeflyer.foundation.plugins import described
from freeflyer.scenario.experiment import Result


class Evaluation(Protocol):
    """The object that the key `evaluation` of a sweep file names.

    `signals` are patterns of recorded signals, as in `[record]` of a scenario. `columns` maps the
    name of each further column of the results to its unit. All values are numbers.
    """

    signals: Sequence[str]
    columns: Mapping[str, str]

    def measure(self, result: Result) -> Mapping[str, float]:
        """Return the values of all columns for one run. It is called on a worker."""
        ...

    def report(
        self, rows: Sequence[Mapping[str, Any]], axes: Sequence[str], folder: Path
    ) -> RenderableType:
        """Return what the command prints at the end. Files may be written into `folder`.

        `rows` are the rows of results.parquet. `axes` are the names of the columns of the axes.
        """
        ...


def load(text: str) -> Evaluation:
    """Return the evaluation. `text` is FILE.py:OBJECT, with an absolute path, or MODULE:OBJECT.

    Raises CosimError.
    """
    found = user_object.load(text, Path())
    missing = [
        name for name in ("signals", "columns", "measure", "report") if not hasattr(found, name)
    ]
    if missing:
        raise CosimError(
            f"evaluation {text} has no {missing[0]!r}; signals, columns, measure and report are expected"
        )
    if not isinstance(found.columns, Mapping) or not all(
        isinstance(name, str) and isinstance(unit, str) for name, unit in found.columns.items()
    ):
        raise CosimError(f"evaluation {text}: columns must map names to units")
    return cast(Evaluation, found)


def reported(
    by: Evaluation, text: str, rows: Sequence[Mapping[str, Any]], axes: Sequence[str], folder: Path
) -> RenderableType:
    """Return the report of the evaluation `by`. `text` is its name in the sweep file.

    Raises CosimError if the evaluation raises any exception. The results of the sweep are kept.
    """
    try:
        return by.report(rows, axes, folder)
    except CosimError:
        raise
    except Exception as error:  # user code can raise anything
        raise CosimError(
            f"evaluation {text} cannot report the results in {folder}: {described(error)}"
        ) from error


def measured(by: Evaluation, result: Result) -> dict[str, float]:
    """Return the numbers of all columns for one run. Raises CosimError if they are not numbers."""
    found = dict(by.measure(result))
    if found.keys() != by.columns.keys():
        raise CosimError(
            f"the evaluation measured {', '.join(sorted(map(str, found)))}; its columns are {', '.join(by.columns)}"
        )
    for name, value in found.items():
        if isinstance(value, bool) or not isinstance(value, Real):
            raise CosimError(f"the evaluation measured {name} = {value!r}; a number is expected")
    return {name: float(value) for name, value in found.items()}


def source(text: str | None) -> Path | None:
    """Return the file of an evaluation, if it can be found."""
    where = (text or "").rpartition(":")[0]
    if where.endswith(".py"):
        return Path(where)
    spec = importlib.util.find_spec(where) if where else None
    return Path(spec.origin) if spec is not None and spec.origin is not None else None
