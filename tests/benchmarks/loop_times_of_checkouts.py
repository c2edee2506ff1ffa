"""Comparison of the loop times of two checkouts on the virtual facility, run alternately.

Usage: python loop_times_of_checkouts.py BEFORE AFTER [ROUNDS]

Both checkouts run with this Python and their own sources; each needs its compiled files. No other
load should run at the same time.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from test_loop_times import PATIENT

SECONDS = 10
SETTINGS = (*PATIENT, f"stop_s={SECONDS}")


def times(checkout: Path, folder: Path, name: str) -> dict[str, tuple[float, float]]:
    """Run the loop once; return p50 and p99 [us] of every histogram."""
    # A separate bus and port for each run.
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    links = (
        f'devices.arm_drive.channel="{name}"',
        f'devices.base_robot.connect=["tcp/127.0.0.1:{port}"]',
    )
    sets = [part for setting in (*SETTINGS, *links) for part in ("--set", setting)]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(
            str(checkout / root) for root in ("adapters", "cosim", "fmu_src")
        ),
    }
    # The loop runs on a facility in another process.
    command = [sys.executable, "-m", "freeflyer.cli.main"]
    with subprocess.Popen(
        [*command, "facility", "facility", *sets, "--out", str(folder / name)],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    ) as facility:
        assert facility.stdout is not None
        for line in facility.stdout:
            if "is there" in line:
                break
        loop = [*command, "hil", "facility", *sets, "--no-view", "--out", str(folder / name)]
        subprocess.run(loop, env=environment, check=True, capture_output=True)
        facility.send_signal(signal.SIGINT)
        facility.communicate(timeout=20.0)
    found = json.loads((folder / name / "summary.json").read_text())["real_time"]["times"]
    found |= json.loads((folder / name / "facility.json").read_text())["times"]
    return {key: (value["p50_us"], value["p99_us"]) for key, value in found.items()}


def main(before: str, after: str, rounds: str = "5") -> None:
    seen: dict[str, list[dict[str, tuple[float, float]]]] = {"before": [], "after": []}
    with tempfile.TemporaryDirectory() as folder:
        for k in range(int(rounds)):
            for label, checkout in (
                (("before", before), ("after", after))
                if k % 2 == 0
                else (("after", after), ("before", before))
            ):
                seen[label].append(times(Path(checkout).absolute(), Path(folder), f"{label}-{k}"))
                print(f"round {k + 1}, {label}: done", flush=True)
    print(f"medians over {rounds} alternate rounds of {SECONDS} s [us]: before, after, ratio")
    for key in seen["before"][0]:
        for i, share in enumerate(("p50", "p99")):
            old, new = (
                float(np.median([run[key][i] for run in seen[label]]))
                for label in ("before", "after")
            )
            print(
                f"  {key}, {share}: {old:.0f}, {new:.0f}, {new / old if old else float('nan'):.3f}"
            )


if __name__ == "__main__":
    main(*sys.argv[1:])
