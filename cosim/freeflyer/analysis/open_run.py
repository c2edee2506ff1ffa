"""Open the directory of a run again, or repeat one run of a sweep."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

from freeflyer.foundation.errors import RecordError
from freeflyer.foundation.file_name import text_of
from freeflyer.scenario import saved_run
from freeflyer.scenario.experiment import Result, run


def open_run(directory: str | os.PathLike[str], *, case: int | None = None) -> Result:
    """Return the result of a run from its directory, or that of one run of a sweep.

    Without `case`, `directory` is the directory of a finished run, and nothing is simulated. With
    `case`, `directory` is that of a sweep; the run of this number is simulated again, with a
    complete record, and a warning is given if its numbers differ from its row. The errors of the
    result are in [m] and [deg]. Raises RecordError if there is no such run, or if the record has
    been changed after the run. Raises CosimError if the run cannot be repeated.
    """
    folder = Path(text_of(directory, "the run", RecordError))
    # Reading a sweep needs the extra `sweep`.
    if case is None and not (folder / "sweep.json").is_file():
        return saved_run.open_run(folder)
    from freeflyer.analysis.sweep.repeat import run_of

    if not isinstance(case, int) or isinstance(case, bool):
        raise RecordError(f"{folder} is a sweep, and case is {case!r}; the number of a run is expected")  # fmt: skip
    found = run_of(folder, case)
    result = run(found.scenario, fmi=found.fmi)
    different = found.differences(result)
    if different:
        warnings.warn(f"run {case} of {folder} is different now: {'; '.join(different[:3])}", stacklevel=2)  # fmt: skip
    return result
