"""Bit-for-bit comparison of records: compare_revisions.py BEFORE [AFTER] [--folder DIR]

Installs both revisions into separate environments with the same dependencies and runs every shipped
scenario with both masters. Compares columns, units, values, `freeflyer.origin` and summary.json
(without wall time and versions). It takes minutes and is not part of the test suite. Use it for a
change that must not change any number. The exit code is 1 if there is a difference.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pyarrow.parquet as parquet

ROOT = Path(__file__).parents[1]
MASTERS = ("core", "python")
DIFFER = {"wall_s", "versions"}


def output(*command: str | Path, **options: Any) -> str:
    return subprocess.run(
        [str(part) for part in command], check=True, stdout=subprocess.PIPE, text=True, **options
    ).stdout


def installed(revision: str, folder: Path, constraints: Path | None) -> Path:
    """Install a revision into a new environment; return the environment's `bin` directory."""
    output("git", "clone", "--quiet", ROOT, folder / "source")
    output("git", "-C", folder / "source", "checkout", "--quiet", revision)
    output(sys.executable, "-m", "venv", folder / "venv")
    same = () if constraints is None else ("--constraint", constraints)
    output(
        folder / "venv/bin/pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        *same,
        folder / "source",
    )
    return folder / "venv" / "bin"


def ran(binaries: Path, scenario: str, master: str, out: Path) -> dict[str, Any]:
    """Run a scenario; return its exit code and the contents of its files."""
    done = subprocess.run(
        [str(binaries / "freeflyer"), "run", scenario, "--master", master, "--out", str(out)],
        capture_output=True,
        check=False,
    )
    table = parquet.read_table(out / "record.parquet")
    metadata = {
        key.decode(): json.loads(value)
        for key, value in table.schema.metadata.items()
        if key != b"pandas"
    }
    summary = json.loads((out / "summary.json").read_text())
    return {
        "exit code": done.returncode,
        "columns": table.column_names,
        "units": [field.metadata for field in table.schema],
        "metadata": metadata,
        "values": [(column.to_numpy() + 0.0).tobytes() for column in table.columns],
        "signs of zeros": [column.to_numpy().tobytes() for column in table.columns],
        "summary": {key: value for key, value in summary.items() if key not in DIFFER},
    }


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("before")
    parser.add_argument("after", nargs="?", default="HEAD")
    parser.add_argument("--folder", type=Path, help="keep environments and records there")
    arguments = parser.parse_args()
    with TemporaryDirectory() as temporary:
        # Both environments have the same versions of all other packages.
        folder = (arguments.folder or Path(temporary)).absolute()
        first = installed(arguments.before, folder / "before", None)
        frozen = output(first / "pip", "freeze", "--disable-pip-version-check").splitlines()
        constraints = folder / "constraints.txt"
        constraints.write_text(
            "\n".join(line for line in frozen if not line.startswith("freeflyer")) + "\n"
        )
        second = installed(arguments.after, folder / "after", constraints)
        names = sorted(
            path.stem
            for path in ROOT.glob("cosim/freeflyer/**/scenarios/*.toml")
            if not path.name.startswith("_")
        )
        # Every scenario with every master.
        differences = 0
        for scenario in names:
            for master in MASTERS:
                records = [
                    ran(b, scenario, master, folder / f"{b.parents[1].name}_{scenario}_{master}")
                    for b in (first, second)
                ]
                different = [key for key in records[0] if records[0][key] != records[1][key]]
                differences += bool(different)
                rows, columns = len(records[0]["values"][0]) // 8, len(records[0]["columns"])
                print(
                    f"{scenario:20s} {master:6s} {rows:6d} rows, {columns:4d} columns:",
                    ", ".join(different) or "identical",
                    flush=True,
                )
    return int(differences > 0)


if __name__ == "__main__":
    sys.exit(main())
