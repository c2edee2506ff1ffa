"""Untrusted records: `freeflyer audit` of a Parquet file with mutated origin, columns or bytes."""

from __future__ import annotations

import atexit
import copy
import json
import os
import tempfile
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import mutation
import pyarrow as pa
import pyarrow.parquet as parquet
import toml_mutation
from target import Target

from freeflyer.analysis.audit.audit import audit
from freeflyer.foundation.errors import CosimError
from freeflyer.master.provenance import KEY
from freeflyer.scenario import experiment, scenario


@cache
def _folder() -> Path:
    kept = tempfile.TemporaryDirectory(
        prefix="freeflyer-fuzz-", dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    )
    atexit.register(kept.cleanup)
    return Path(kept.name)


@cache
def _seed() -> tuple[pa.Table, dict[str, Any], bytes]:
    """Return a record of 20 rows, its origin and its bytes."""
    path = _folder() / "record.parquet"
    result = experiment.run(scenario.load("multirate_passive", ["stop_s=0.2"]))
    result.outcome.record.write(path)
    table = parquet.read_table(path)
    return table, json.loads(table.schema.metadata[KEY]), path.read_bytes()


def _column(rng: Random, table: pa.Table, k: int) -> pa.Table:
    """Replace a column by one of another type or with extreme values."""
    name, rows = table.column_names[k], table.num_rows
    made = rng.choice(
        (
            lambda: pa.array(
                [
                    rng.choice((0.0, -1.0, float("nan"), float("inf"), 1e308, 5e-324))
                    for _ in range(rows)
                ]
            ),
            lambda: pa.array(["x"] * rows),
            lambda: pa.array([None] * rows),
            lambda: pa.array([[1.0]] * rows),
            lambda: pa.array([2**62] * rows),
            lambda: pa.array([b"\xff"] * rows),
            lambda: pa.array([{"a": 1}] * rows),
            lambda: table.column(rng.randrange(table.num_columns)),
        )
    )
    return table.set_column(k, name, made())


def generate(rng: Random) -> bytes:
    table, origin, whole = _seed()
    kind = rng.random()
    if kind < 0.3:
        return mutation.damaged(rng, [whole])
    if kind < 0.65:
        origin = copy.deepcopy(origin)
        for _ in range(rng.randrange(1, 4)):
            toml_mutation.mutate(rng, origin, [origin])
        text = json.dumps(origin, default=str).encode()
        text = mutation.damaged(rng, [text], most=1) if rng.random() < 0.1 else text
        text = rng.choice((b"[" * 100_000, b"1" * 5000)) if rng.random() < 0.02 else text
        table = table.replace_schema_metadata({KEY: text})
    for _ in range(rng.randrange(3) if kind > 0.5 else 0):
        k = rng.randrange(table.num_columns)
        change = rng.randrange(4)
        if change == 0 and table.num_columns > 1:
            table = table.remove_column(k)
        elif change == 1:
            names = list(table.column_names)
            names[k] = rng.choice((*toml_mutation.KEYS, *names, f"{names[k]}[2]", "[", "]"))
            table = table.rename_columns(names)
        elif change == 2:
            table = table.slice(0, rng.randrange(3))
        else:
            table = _column(rng, table, k)
    sink = pa.BufferOutputStream()
    parquet.write_table(table, sink)
    return sink.getvalue().to_pybytes()


def audited(data: bytes) -> str:
    path = _folder() / "fuzz.parquet"
    path.write_bytes(data)
    found = audit(path)
    assert found.time.size >= 2
    return "audit"


RECORD = Target(name="record", generate=generate, call=audited, allowed=(CosimError,))
