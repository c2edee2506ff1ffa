"""Reader of the summary.json that a run has written. Its key `run` describes the run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from freeflyer.foundation import bounded_file
from freeflyer.foundation.errors import RecordError

FORMAT = 1
"""Number of the format. A later version of the package may have a larger number."""
LARGEST = 64 << 20
"""Largest accepted size [bytes] of the file."""
KINDS: Mapping[str, type] = {
    "started": str, "machine": dict, "engine": str, "name": str, "directory": str, "changes": list,
    "scenario": str, "record_sha256": str, "parameters": dict, "files": dict,
}  # fmt: skip
"""Types of the members of a description that are read again."""


def read(directory: Path) -> dict[str, Any]:
    """Read the summary.json of a run. Raises RecordError if it is not one of this version."""
    path = directory / "summary.json"
    try:
        found = json.loads(bounded_file.content(path, LARGEST))
        number = found["run"]["format"]
    except FileNotFoundError as error:
        other = "it is a sweep: give the number of a run (--case)" if (directory / "sweep.json").exists() else "it is no run, or an incomplete one (`freeflyer recover` completes it)"  # fmt: skip
        raise RecordError(f"{directory} has no summary.json: {other}") from error
    except OSError as error:
        raise RecordError(f"{path} cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise RecordError(f"{path} is not valid JSON; a file that a run has written is expected") from error  # fmt: skip
    except (KeyError, TypeError) as error:
        raise RecordError(f"{path} does not describe a run of freeflyer-cosim 0.2.0 or later: the key 'run' is missing") from error  # fmt: skip
    if number != FORMAT:
        raise RecordError(f"{path} has format {number!r}, but this version of freeflyer-cosim reads format {FORMAT}; use the version that wrote it ({_version(found)})")  # fmt: skip
    wrong = [key for key, kind in KINDS.items() if not isinstance(found["run"].get(key), kind)]
    if not wrong and not all(isinstance(own, dict) for own in found["run"]["parameters"].values()):
        wrong = ["parameters"]
    if wrong or not isinstance(found.get("versions"), dict):
        raise RecordError(f"{path} was changed after the run: {', '.join(wrong) or 'versions'} is not as it was written")  # fmt: skip
    result: dict[str, Any] = found
    return result


def begun(directory: Path) -> dict[str, Any]:
    """Return the keys `scenario` and `run` of a run that has not finished, or an empty mapping."""
    try:
        path = directory / "unfinished" / "run.json"
        run = json.loads(bounded_file.content(path, LARGEST))["run"]
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return {}
    wrong = [key for key, kind in KINDS.items() if key != "record_sha256" and not isinstance(run.get(key), kind)]  # fmt: skip
    return {} if wrong else {"scenario": run["name"], "run": run}


def _version(found: Mapping[str, Any]) -> str:
    versions = found.get("versions")
    return str(versions.get("freeflyer-cosim") if isinstance(versions, dict) else "unknown")
