"""Output directory of a sweep.

sweep.json contains the plan. The folder parts contains one Parquet file (a part) for each finished
batch of runs. results.parquet contains all runs. A part is written atomically: it is complete, or
it does not exist. Therefore an interrupted sweep can be started again with the same plan and the
same directory. Only the missing runs are then computed.
"""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as compute
import pyarrow.parquet as parquet

from freeflyer.analysis.sweep import stability
from freeflyer.analysis.sweep.designs import UNCHANGED, Levels
from freeflyer.analysis.sweep.plan import Plan
from freeflyer.analysis.sweep.task import Row
from freeflyer.foundation.errors import CosimError, ScenarioError
from freeflyer.foundation.output_file import check_writable, write_text, write_whole
from freeflyer.foundation.plugins import described
from freeflyer.scenario import metrics, run_state, scenario

PLAN, PARTS, RESULTS, LOCK = "sweep.json", "parts", "results.parquet", ".lock"


class Results:
    """Results of the finished runs of a plan. `runs` are the numbers of these runs."""

    def __init__(self, directory: Path, plan: Plan) -> None:
        self.directory, self.plan = directory, plan
        self.schema = schema(plan)
        self.runs: set[int] = set()

    @contextmanager
    def opened(self) -> Iterator[None]:
        """Lock the directory and read the finished runs.

        Raises ScenarioError if the directory is locked, or if it has results of another sweep.
        """
        if not (self.directory / PLAN).exists() and run_state.is_run(self.directory):
            raise ScenarioError(f"{self.directory} is the directory of a run, or a link to it; choose another --out for the sweep")  # fmt: skip
        check_writable(self.directory)
        made = [path for path in (self.directory, *self.directory.parents) if not path.exists()]
        self.directory.mkdir(parents=True, exist_ok=True)
        with (self.directory / LOCK).open("w") as lock:
            try:
                # The kernel releases the lock when the process ends, even after SIGKILL.
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise ScenarioError(
                    f"another sweep is running in {self.directory}; wait until it ends, or choose another --out"
                ) from error
            self._check_plan()
            self.runs = set(self._finished())
            try:
                yield
            except CosimError:
                if made and not self.runs:  # the sweep could not start
                    for name in (PLAN, LOCK):
                        (self.directory / name).unlink(missing_ok=True)
                    with suppress(OSError):
                        for path in made:
                            path.rmdir()
                raise

    def add(self, rows: Sequence[Row]) -> None:
        """Write a finished batch as one part. Raises OutputError."""
        table = pa.Table.from_pylist([self._whole(row) for row in rows], schema=self.schema)
        path = self.directory / PARTS / f"runs_{rows[0]['run']:08d}.parquet"
        write_whole(path, lambda partial: parquet.write_table(table, partial, compression="zstd"))
        self.runs.update(row["run"] for row in rows)

    def table(self) -> pa.Table:
        """Return all parts as one table, sorted by run."""
        tables = [parquet.read_table(path, schema=self.schema) for path in self._parts()]
        return (
            pa.concat_tables([self.schema.empty_table(), *tables])
            .sort_by("run")
            .replace_schema_metadata(self.schema.metadata)
        )

    def write(self) -> pa.Table:
        """Write all parts as one table, and return the table. Raises OutputError."""
        table = self.table()
        write_whole(
            self.directory / RESULTS,
            lambda partial: parquet.write_table(table, partial, compression="zstd"),
        )
        return table

    def _whole(self, row: Row) -> Row:
        design, case, values = self.plan.design(row["run"])
        swept = {}
        for axis, value in zip(self.plan.axes, values, strict=True):
            column = str(axis.target)
            as_text = self.schema.field(column).type == pa.string() and value is not UNCHANGED
            swept[column] = shown(value) if as_text else value
        changes = json.dumps(dict(self.plan.run(row["run"]).assignments))
        return {"design": design, "case": case, **swept, **row, "changes": changes}

    def _parts(self) -> list[Path]:
        return sorted((self.directory / PARTS).glob("runs_*.parquet"))

    def _finished(self) -> Iterator[int]:
        for path in self._parts():
            try:
                yield from parquet.read_table(path, columns=["run"]).column(0).to_pylist()
            except (OSError, pa.ArrowException):  # The runs of a damaged file are repeated.
                with suppress(OSError):
                    path.unlink()

    def _check_plan(self) -> None:
        """Compare the plan with the plan in sweep.json. Write the plan if there is no sweep.json.

        Raises ScenarioError if the plans differ, or if there are parts without a sweep.json.
        """
        path, content = self.directory / PLAN, self.plan.content
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            stored, title = found["plan"], found["title"]
        except FileNotFoundError:
            if self._parts():
                raise ScenarioError(
                    f"{self.directory} has results of a sweep, but no {PLAN}; choose another --out"
                ) from None
            about = {
                "title": self.plan.sweep.title,
                "sweep": self.plan.sweep.name,
                "runs": len(self.plan),
                "directory": str(self.plan.setup.path.parent.absolute()),
                "name": self.plan.setup.path.stem,
                "plan": content,
                "versions": dict(metrics.versions()),
            }
            write_text(path, json.dumps(about, indent=2) + "\n")
            return
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ScenarioError(
                f"{path} is not a plan of a sweep ({described(error)}); choose another --out"
            ) from error
        different = [
            key
            for key in content
            if not isinstance(stored, dict) or stored.get(key) != content[key]
        ]
        if different:
            raise ScenarioError(
                f"{self.directory} has results of another sweep ({title!r}; {' and '.join(different)} differ); choose another --out, or remove this directory"
            )


def schema(plan: Plan) -> pa.Schema:
    """Return the schema of the results. Units are stored in the same way as in record.parquet."""
    fields: list[tuple[str, pa.DataType, str]] = [
        ("run", pa.int64(), ""),
        ("design", pa.int64(), ""),
        ("case", pa.string(), ""),
    ]
    for axis in plan.axes:
        fields.append((str(axis.target), _kind(axis.source), plan.units.get(str(axis.target), "")))
    fields += [
        ("stable", pa.bool_(), ""),
        ("diverged", pa.bool_(), ""),
        ("failed", pa.bool_(), ""),
        ("cause", pa.string(), ""),
    ]
    fields += [(name, pa.float64(), "s") for name in ("diverged_at_s", "simulated_s")]
    for name in plan.errors:
        unit = name.rpartition("_")[2]
        fields += [
            (f"{name}_{which}", pa.float64(), unit)
            for which in ("max", stability.LAST, stability.EARLIER)
        ]
    fields += [(f"{name}_observed_energy_min_j", pa.float64(), "J") for name in plan.energies]
    if plan.evaluation is not None:
        fields += [(name, pa.float64(), unit) for name, unit in plan.evaluation.columns.items()]
    fields += [(name, pa.float64(), "s") for name in ("wall_s", "run_s")]
    fields.append(("changes", pa.string(), ""))
    names = [name for name, _, _ in fields]
    for name in names:
        if names.count(name) > 1:
            raise ScenarioError(
                f"the evaluation has a column {name!r}, which the results have already; choose another name"
            )
    units = {name: unit for name, _, unit in fields}
    return pa.schema(
        [pa.field(name, kind, metadata={"unit": unit}) for name, kind, unit in fields],
        metadata={"PANDAS_ATTRS": json.dumps({"units": units, "title": plan.sweep.title})},
    )


def _kind(source: object) -> pa.DataType:
    values: Sequence[Any] = source.values if isinstance(source, Levels) else (0.0,)
    if all(isinstance(value, bool) for value in values):
        return pa.bool_()
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        return pa.float64()
    return pa.string()


def shown(value: Any) -> str:
    return value if isinstance(value, str) else scenario.literal(value)


def per_case(table: pa.Table) -> Sequence[Mapping[str, Any]]:
    """Count the runs of each case: total, stable, diverged, failed, and unjudged.

    A run is unjudged if it is too short for a verdict.
    """
    found = []
    for case in dict.fromkeys(table.column("case").to_pylist()):
        rows = table.filter(compute.equal(table.column("case"), case))
        counts = {
            name: sum(value is True for value in rows.column(name).to_pylist())
            for name in ("stable", "diverged", "failed")
        }
        found.append(
            {
                "case": case,
                "runs": rows.num_rows,
                **counts,
                "unjudged": rows.column("stable").null_count,
            }
        )
    return found


def frequent_failure(table: pa.Table) -> str | None:
    """Return the most frequent cause of failed runs, or None if no run failed."""
    causes = [
        cause
        for cause, failed in zip(
            table.column("cause").to_pylist(), table.column("failed").to_pylist(), strict=True
        )
        if failed
    ]
    return max(sorted(set(causes)), key=causes.count) if causes else None
