"""Reader of the summary.json that a run has written. Its key `run` describes the run."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from freeflyer.foundation import bounded_file
from freeflyer.foundation.errors import RecordError
from freeflyer.foundation.keys import Schema, fits
from freeflyer.master.provenance import are_parameters
from freeflyer.scenario.run_state import DEAD, DESCRIPTION, UNFINISHED, owner

FORMAT = 1
"""Number of the format. A later version of the package may have a larger number."""
SEAL = "sha256"
LARGEST = 64 << 20
"""Largest accepted size [bytes] of the file."""
NUMBER: Schema = {"type": "number", "minimum": -1e308, "maximum": 1e308}
MAYBE: Schema = {"anyOf": [NUMBER, {"enum": [None]}]}
TEXT: Schema = {"type": "string"}
SWITCH: Schema = {"type": "boolean"}
TABLE: Schema = {"type": "object"}
RUN: Mapping[str, Schema] = {
    **dict.fromkeys(("started", "engine", "name", "directory", "scenario", "record_sha256"), TEXT),
    **dict.fromkeys(("machine", "parameters", "files"), TABLE),
    "changes": {"type": "array", "items": TEXT},
    "ssp": {"anyOf": [{"enum": [None]}, {"type": "object", "required": ["path", "step"], "properties": {"path": TEXT, "step": MAYBE}}]},
}  # fmt: skip
"""Members of a description that are read again."""
RESULT: Mapping[str, Schema] = {
    **dict.fromkeys(("diverged", "failed", "interrupted"), SWITCH),
    **dict.fromkeys(("steps", "versions", "observed_energy_j"), TABLE),
    "scenario": TEXT, "cause": {"anyOf": [TEXT, {"enum": [None]}]}, "simulated_s": NUMBER, "wall_s": MAYBE,
}  # fmt: skip
"""Further members of summary.json that are read again."""


def read(directory: Path) -> dict[str, Any]:
    """Read the summary.json of a run. Raises RecordError if it is not one of this version."""
    path = directory / "summary.json"
    try:
        found = json.loads(bounded_file.content(path, LARGEST))
        number = found["run"]["format"]
    except FileNotFoundError as error:
        if (directory / "sweep.json").exists():
            other = "is a sweep; give the number of a run (--case)"
        elif (user := owner(directory)) is not None:
            other = f"is a run that has not finished; it is in use by {user}"
        else:
            other = "has no summary.json; it is no run, or an incomplete one (`freeflyer recover` completes it)"  # fmt: skip
        raise RecordError(f"{directory} {other}") from error
    except OSError as error:
        raise RecordError(f"{path} cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise RecordError(f"{path} is not valid JSON; a file that a run has written is expected") from error  # fmt: skip
    except (KeyError, TypeError) as error:
        raise RecordError(f"{path} does not describe a run of freeflyer-cosim 0.2.0 or later: the key 'run' is missing") from error  # fmt: skip
    if type(number) is not int or number < 1:
        raise RecordError(f"{path} was changed after the run: its format is not a number as it was written")  # fmt: skip
    if number != FORMAT:
        raise RecordError(f"{path} has format {number!r:.20}, but this version of freeflyer-cosim reads format {FORMAT}; use the version that wrote it ({_version(found)})")  # fmt: skip
    wrong = wrong_of_run(found["run"]) or _wrong(found, RESULT) or _wrong_numbers(found)
    if wrong:
        raise RecordError(f"{path} was changed after the run: {wrong!r:.60} is not as it was written")  # fmt: skip
    seal = found.pop(SEAL, None)
    if seal is not None and seal != _hash(found):
        raise RecordError(f"{path} was changed after the run: its content does not agree with its hash ({SEAL})")  # fmt: skip
    result: dict[str, Any] = found
    return result


def sealed(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of summary.json with its hash, by which `read` detects a change."""
    return {**summary, SEAL: _hash(summary)}


def _hash(summary: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(summary, sort_keys=True).encode()).hexdigest()


def begun(directory: Path) -> dict[str, Any]:
    """Return the keys `scenario` and `run` of a run that has not finished, or an empty mapping."""
    # The process may have died while it completed the run of another one.
    folder = directory / (DEAD if (directory / DEAD).is_dir() else UNFINISHED)
    try:
        run = json.loads(bounded_file.content(folder / DESCRIPTION, LARGEST))["run"]
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return {}
    if wrong_of_run({"record_sha256": "", **run} if isinstance(run, dict) else run):
        return {}
    return {"scenario": run["name"], "run": run}


def wrong_of_run(run: Any) -> str | None:
    """Return the member of the description of a run that is not as it was written, or None."""
    if not isinstance(run, dict):
        return "run"
    wrong = _wrong(run, RUN)
    return wrong if wrong or are_parameters(run["parameters"]) else "parameters"


def _wrong(table: Mapping[str, Any], schemas: Mapping[str, Schema]) -> str | None:
    return next((key for key, schema in schemas.items() if not fits(table.get(key), schema)), None)


def _wrong_numbers(found: Mapping[str, Any]) -> str | None:
    """Return the error or the observed energy that is not as it was written, or None."""
    errors = {name: value for name, value in found.items() if "_error_" in name}
    for tables, keys in ((errors, ("max", "last_10_s")), (found["observed_energy_j"], ("min",))):
        for name, value in tables.items():
            if not isinstance(value, dict) or _wrong(value, dict.fromkeys(keys, MAYBE)):
                return str(name)
    return None


def _version(found: Mapping[str, Any]) -> str:
    versions = found.get("versions")
    return str(versions.get("freeflyer-cosim") if isinstance(versions, dict) else "unknown")
