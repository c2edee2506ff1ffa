"""The part of a sweep that runs on a worker (a process of Dask).

A worker receives a batch, which is a list of runs. It computes these runs one after the other. Each
run gives one row of the table of results.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from distributed import get_worker

from freeflyer.analysis.sweep import evaluation, stability
from freeflyer.analysis.sweep.plan import Run, Setup, files
from freeflyer.fmi import unpacked
from freeflyer.foundation.errors import CosimError, ScenarioError, one_line
from freeflyer.foundation.plugins import described
from freeflyer.scenario import assemble, experiment, metrics
from freeflyer.scenario.experiment import Result

Row = dict[str, Any]
_one_at_a_time = threading.Lock()
"""Lock that lets only one thread of a worker compute at a time.

The lock is necessary, because loading an FMU changes the working directory of the process.
"""
_checked: list[Mapping[str, str]] = []
"""One entry for each plan that this worker has checked: the hashes of the plan's files."""


class WorkerRefused(ScenarioError):
    """The package version or the files of the worker differ from those of the sweep."""


def run_batch(setup: Setup, version: str, runs: Sequence[Run]) -> list[Row]:
    """Compute `runs` and return their rows in the same order.

    The row of a failed run contains the cause. Raises WorkerRefused if this worker does not have
    the package version `version`, or if its files differ from the files in `setup`.
    """
    with _one_at_a_time:
        _check_worker(setup, version)
        with _folders_kept():
            return [row(setup, run) for run in runs]


def row(setup: Setup, run: Run) -> Row:
    """Compute one run and return its row. A failed run also gives a row."""
    start = time.perf_counter()
    try:
        # Record only the signals that the results need.
        by = evaluation.load(setup.evaluation) if setup.evaluation else None
        scenario = replace(
            setup.scenario(run.case, run.assignments),
            record_signals=tuple(by.signals) if by else (),
        )
        result = experiment.run(scenario, fmi=setup.fmi)
        found = {**measured(result), **(evaluation.measured(by, result) if by else {})}
    # The cause can be a rejected value, a lack of memory, or any exception of a third-party
    # component.
    except Exception as error:
        found = failure(one_line(error) if isinstance(error, CosimError) else described(error))
    return {"run": run.number, **found, "run_s": time.perf_counter() - start}


def measured(result: Result) -> Row:
    """Return the columns of the row of a run that was simulated.

    The columns are values of summary.json, the maximum of each error before the last window, and
    the verdict.
    """
    summary, record = result.summary, result.outcome.record
    before = {
        name: stability.earlier(record.time, error, result.outcome.simulated)
        for name, error in result.errors.items()
    }
    found: Row = {
        key: summary[key]
        for key in ("diverged", "failed", "cause", "diverged_at_s", "simulated_s", "wall_s")
    }
    for name, most in before.items():
        found[f"{name}_max"] = summary[name]["max"]
        found[f"{name}_{stability.LAST}"] = summary[name][stability.LAST]
        found[f"{name}_{stability.EARLIER}"] = most
    for name, energy in summary["observed_energy_j"].items():
        found[f"{name}_observed_energy_min_j"] = energy["min"]
    return {"stable": stability.stable(summary, before), **found}


def failure(cause: str) -> Row:
    """Return the columns of the row of a run that failed. `cause` is one line."""
    return {"stable": False, "diverged": False, "failed": True, "cause": cause}


def _folders_kept() -> AbstractContextManager[None]:
    """Keep the unpacked FMUs in the local folder of the worker.

    If this code does not run on a worker, the unpacked FMUs are not kept.
    """
    try:
        return unpacked.kept_in(Path(get_worker().local_directory))
    except ValueError:
        return nullcontext()


def _check_worker(setup: Setup, version: str) -> None:
    """Raise WorkerRefused if this worker has another package version or other files.

    `version` and the hashes in `setup` are those of the process that started the sweep. The files
    are checked once per plan.
    """
    here = metrics.versions()["freeflyer-cosim"]
    if here != version:
        raise WorkerRefused(
            f"it has freeflyer-cosim {here}, but {version} is expected; install the same version on the worker"
        )
    if setup.files in _checked:
        return
    plain = setup.scenario(next(iter(setup.cases)))
    with assemble.loaded(plain, setup.fmi) as system:
        found = files(plain, system, setup.evaluation)
    other = [name for name, digest in setup.files.items() if found.get(name) != digest]
    if other:
        raise WorkerRefused(
            f"its file of component {other[0]} is not the same as in the sweep; install the same build on the worker"
        )
    _checked.append(setup.files)
