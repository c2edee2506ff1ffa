"""What a worker does with a few runs of a sweep: run them one after the other, and give a row for each."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from distributed import get_worker

from freeflyer.analysis.sweep import verdict
from freeflyer.analysis.sweep.plan import Run, Setup, files
from freeflyer.fmi import unpacked
from freeflyer.foundation.errors import CosimError, ScenarioError
from freeflyer.scenario import assemble, experiment, metrics
from freeflyer.scenario.experiment import Result

Row = dict[str, Any]
_one_at_a_time = threading.Lock()
"""FMUs are loaded from their own folders, and a process has one working directory: threads of a worker would be in each other's way."""
_checked: list[Mapping[str, str]] = []


class WorkerRefused(ScenarioError):
    """A worker that would compute something else than the command's own machine."""


def run_batch(setup: Setup, version: str, runs: Sequence[Run]) -> list[Row]:
    """Rows of finished runs, in order. Whatever goes wrong in a run is its row; WorkerRefused if this worker cannot take part."""
    with _one_at_a_time:
        _check_worker(setup, version)
        with _folders_kept():
            return [row(setup, run) for run in runs]


def row(setup: Setup, run: Run) -> Row:
    begin = time.perf_counter()
    try:
        scenario = replace(
            setup.scenario(run.case, run.assignments), record_signals=()
        )  # what is measured, and no more
        found = measured(experiment.run(scenario, fmi=setup.fmi))
    except (
        Exception
    ) as error:  # a refused value, memory, or anything that a component of others raises
        said = str(error) if isinstance(error, CosimError) else f"{type(error).__name__}: {error}"
        found = failure(" ".join(said.split()))
    return {"run": run.number, **found, "run_s": time.perf_counter() - begin}


def measured(result: Result) -> Row:
    """A run's results as columns: what summary.json has, the errors before their last window, and the verdict."""
    summary, record = result.summary, result.outcome.record
    before = {
        name: verdict.earlier(record.time, error, result.outcome.simulated)
        for name, error in result.errors.items()
    }
    found: Row = {
        key: summary[key]
        for key in ("diverged", "failed", "cause", "diverged_at_s", "simulated_s", "wall_s")
    }
    for name, most in before.items():
        found[f"{name}_max"] = summary[name]["max"]
        found[f"{name}_{verdict.LAST}"] = summary[name][verdict.LAST]
        found[f"{name}_{verdict.EARLIER}"] = most
    for name, energy in summary["observed_energy_j"].items():
        found[f"{name}_observed_energy_min_j"] = energy["min"]
    return {"stable": verdict.stable(summary, before), **found}


def failure(cause: str) -> Row:
    return {"stable": False, "diverged": False, "failed": True, "cause": cause}


def _folders_kept() -> AbstractContextManager[None]:
    """Folders of unpacked FMUs go from run to run, and away with the worker; the function may also be called without one."""
    try:
        return unpacked.kept_in(Path(get_worker().local_directory))
    except ValueError:
        return nullcontext()


def _check_worker(setup: Setup, version: str) -> None:
    """Refuse another version of this package, and files that are not those of the plan; once for each plan."""
    here = metrics.versions()["freeflyer-cosim"]
    if here != version:
        raise WorkerRefused(
            f"it has freeflyer-cosim {here}, and {version} is expected: install the same version there"
        )
    if setup.files in _checked:
        return
    plain = setup.scenario(next(iter(setup.cases)))
    with assemble.loaded(plain, setup.fmi) as system:
        found = files(plain, system)
    other = [name for name, digest in setup.files.items() if found.get(name) != digest]
    if other:
        raise WorkerRefused(
            f"its file of component {other[0]} is not that of the sweep: install the same build there"
        )
    _checked.append(setup.files)
