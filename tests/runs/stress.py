"""Many processes that run, sweep and audit in one folder, while others are killed.

    python tests/runs/stress.py --rounds 20 --processes 20 --kills 10

Each round starts its processes in a new folder, kills some of them at random times, and checks
everything that they leave: `check` returns what is wrong.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import pyarrow.parquet as parquet

import freeflyer as ff
from freeflyer.foundation.errors import CosimError
from freeflyer.master.record import Record
from freeflyer.scenario import run_state, saved_run

SCENARIO = "multirate_passive"
PERIODS = (0.1, 0.2, 0.3)
OUT = Path("freeflyer_out")
SHARED = ("shared", "replaced")
"""Directories that several runs claim: with the default, and with --overwrite."""
RUN = re.compile(rf"{SCENARIO}-\d{{8}}-\d{{6}}-[0-9a-f]{{8}}(-\d+)?")
FILES = {"record.parquet", "summary.json", "energy_audit.json", "energy_audit.png", "energy_audit.pdf"}  # fmt: skip
OF_SWEEP = {"sweep.json", "parts", "results.parquet", ".lock", "stability_map.png", "stability_map.pdf"}  # fmt: skip
LEFT_BY_KILL = re.compile(r"\.unfinished-.*|\.new-.*|.*\.partial|.*\.claim-.*|.*\.link-.*")
"""Files and folders that a killed process may leave, see docs/runs.md."""

Command = tuple[str, ...]


KINDS = {"run": 8, "shared": 4, "replaced": 3, "audit": 3, "sweep": 2}
"""Kinds of commands, and how often they are drawn."""


def command(draw: random.Random, kinds: Sequence[str]) -> Command:
    """Return the arguments of a random command."""
    kind = draw.choices(kinds, [KINDS[kind] for kind in kinds])[0]
    period = ("--set", f"base_controller.period={draw.choice(PERIODS)}")
    time_ = ("--set", f"stop_s={draw.choice([0.5, 2, 200, 200])}", "--set", "record.every_s=0.02")
    if kind == "audit":
        return ("audit", str(OUT / draw.choice([SCENARIO, *SHARED])))
    if kind == "sweep":
        return ("sweep", "sweep.toml", "--workers", "1")
    where = () if kind == "run" else ("--out", str(OUT / kind))
    return ("run", SCENARIO, *period, *time_, *where, *(("--overwrite",) if kind == "replaced" else ()))  # fmt: skip


SWEEP = f"""
title = "Stress"
scenario = "{SCENARIO}"
set = ["stop_s=12"]

[grid]
"base_controller.period" = [0.1, 0.2]
"""


def start(folder: Path, arguments: Command) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", "import os, sys; os.nice(5); from freeflyer.cli.main import main; sys.exit(main())", *arguments],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=folder, start_new_session=True,
    )  # fmt: skip


def round_of(
    folder: Path, seed: int, processes: int, kills: int, kinds: Sequence[str] = tuple(KINDS)
) -> tuple[Counter[str], list[str]]:
    """Run one round. Return counts, and what is wrong."""
    draw = random.Random(seed)
    (folder / "sweep.toml").write_text(SWEEP)
    counts: Counter[str] = Counter()
    wrong = []
    with inside(folder):  # something to audit, and to replace
        earlier = ff.run(SCENARIO, {"stop_s": 1})
        for place in (None, *(OUT / name for name in SHARED)):
            earlier.save(place)
    running = [
        (one, start(folder, one)) for one in (command(draw, kinds) for _ in range(processes))
    ]
    begin = time.monotonic()
    # Some processes are killed at any time, also during their start, which takes long because all
    # share the cores. The others are killed some time after they have claimed a directory.
    span = 0.35 * processes + 0.5
    moments = {
        process.pid: draw.uniform(0.2, 1.0) * span
        if arguments[0] != "run" or draw.random() < 0.3
        else None
        for arguments, process in draw.sample(running, kills)
    }
    while any(process.poll() is None for _, process in running if process.pid in moments):
        now = time.monotonic() - begin
        for pid in claims(folder / OUT):
            if moments.get(pid, 0.0) is None:
                moments[pid] = now + draw.uniform(0.0, 3.0)
        for _, process in running:
            moment = moments.get(process.pid)
            if moment is not None and moment < now and process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                counts["killed"] += 1
                process.wait()
        time.sleep(0.005)
    for arguments, process in running:
        error = process.communicate(timeout=300)[1]
        counts[f"exit code {process.returncode}"] += 1
        if process.returncode not in (0, 2, 3, -signal.SIGKILL) or "Traceback" in error:
            wrong.append(f"{' '.join(arguments)}: exit code {process.returncode}: {error}")
        if process.returncode in (2, 3) and not expected(error):
            wrong.append(f"{' '.join(arguments)}: {error}")
    with inside(folder):
        wrong += list(check(OUT, counts))
        for path in [run.directory for run in ff.runs(OUT) if run.state == "incomplete"]:
            recovered(path, counts, wrong)
        wrong += [f"after recovery: {one}" for one in check(OUT, Counter())]
    return counts, wrong


def claims(folder: Path) -> Iterator[int]:
    """Yield the processes that hold the directories in a folder."""
    for path in folder.glob("*/unfinished/process.json"):
        with suppress(OSError, ValueError):
            yield json.loads(path.read_text())["pid"]


def expected(error: str) -> bool:
    """Return whether a command that was rejected gives one of the documented reasons."""
    texts = ("in use", "an incomplete run", "other files than a run", "another process has claimed it", "another sweep is running",
             "is not finished", "it has an incomplete run", "has no record", "does not exist", "No such file", "has the record of another run", "cannot be read", "no summary.json")  # fmt: skip
    return len(error.splitlines()) == 1 and any(text in error for text in texts)


def recovered(path: Path, counts: Counter[str], wrong: list[str]) -> None:
    """Complete an incomplete run, and check it."""
    try:
        result, _ = saved_run.complete(path)
    except CosimError as error:
        if "nothing to recover" not in str(error):
            wrong.append(f"{path}: {error}")
        counts["without rows"] += 1
        return
    counts["recovered"] += 1
    counts["recovered rows"] += result.record.rows
    if ff.open_run(path).record.digest != result.record.digest:
        wrong.append(f"{path} was recovered with other rows")


def check(folder: Path, counts: Counter[str]) -> Iterator[str]:
    """Yield what is wrong in a folder of runs."""
    if not folder.exists():
        return
    for path in sorted(folder.iterdir()):
        if path.name == SCENARIO and path.is_symlink():
            target = os.readlink(path)
            if not RUN.fullmatch(target) or run_state.state(path) != "finished":
                yield f"{path} links to {target}, which is {run_state.state(path)}"
        elif LEFT_BY_KILL.fullmatch(path.name):
            counts["leftovers"] += 1
        elif path.name == "sweep" or (path / "sweep.json").exists():
            yield from check_sweep(path)
        elif not (RUN.fullmatch(path.name) or re.fullmatch(r"(shared|replaced)(\.\d+)*", path.name)):  # fmt: skip
            yield f"{path} is not documented"
        else:
            yield from check_run(path, counts)


def check_run(path: Path, counts: Counter[str]) -> Iterator[str]:
    """Yield what is wrong in the directory of a run."""
    state = run_state.state(path)
    counts[state] += 1
    files = {name for name in os.listdir(path) if not LEFT_BY_KILL.fullmatch(name)}
    if state == "running":
        yield f"{path} is running"
    elif state == "finished":
        try:
            result = ff.open_run(path)  # compares the record with record_sha256
        except CosimError as error:
            yield f"{path}: {error}"
            return
        counts[f"verdict {result.verdict}"] += 1
        if more := files - FILES - {"unfinished", "unfinished.dead"}:
            yield f"{path} has {more}"
        digest = result.record.digest
        origin = result.record.provenance
        assert origin is not None
        if origin.parameters["base_controller"] != result.summary["run"]["parameters"]["base_controller"]:  # fmt: skip
            yield f"{path}: the summary belongs to another run"
        if (path / "energy_audit.json").exists():
            counts["audits"] += 1
            if json.loads((path / "energy_audit.json").read_text())["record_sha256"] != digest:
                yield f"{path}: the audit belongs to another record"
    elif state == "incomplete":
        # A process that was killed while it wrote its results leaves a whole record.
        if (path / "record.parquet").exists():
            Record.read(path / "record.parquet")
        if more := files - FILES - {"unfinished", "unfinished.dead"}:
            yield f"{path} has {more}"
    elif state == "other":
        # An audit of a directory that a run replaced at the same time.
        yield f"{path} has only {files}"


def check_sweep(path: Path) -> Iterator[str]:
    """Yield what is wrong in the directory of a sweep."""
    if more := {name for name in os.listdir(path) if not LEFT_BY_KILL.fullmatch(name)} - OF_SWEEP:
        yield f"{path} has {more}"
    for part in [*path.glob("parts/*.parquet"), *path.glob("results.parquet")]:
        if parquet.read_table(part).num_rows not in (1, 2):
            yield f"{part} is not whole"


@contextmanager
def inside(folder: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--processes", type=int, default=20)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    total: Counter[str] = Counter()
    failures = 0
    for number in range(arguments.seed, arguments.seed + arguments.rounds):
        folder = Path(tempfile.mkdtemp(prefix="freeflyer-stress-"))
        counts, wrong = round_of(folder, number, arguments.processes, arguments.kills)
        total += counts
        print(f"round {number}: {dict(sorted(counts.items()))}", flush=True)
        if wrong:
            failures += 1
            print(f"  kept: {folder}", *wrong, sep="\n  ", flush=True)
        else:
            shutil.rmtree(folder)
    print(f"{arguments.rounds} rounds, {failures} with errors: {dict(sorted(total.items()))}")
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
