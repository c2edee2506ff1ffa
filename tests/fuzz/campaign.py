"""Fuzzing campaign: run many inputs on a target and report the outcomes and all faults.

A fault is reported with the seed and the bytes of its input.

python tests/fuzz/campaign.py --target cdr --inputs 1000000 --processes 2
python tests/fuzz/campaign.py --target cdr --seed 4711        # repeat one input
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

sys.path.insert(0, str(Path(__file__).parent))  # for use as a script
from target import Target

MOST_FAULTS = 20
"""A campaign stops after this number of faults."""


class Hang(BaseException):
    """Time limit exceeded; not an Exception, so that the code under test does not catch it."""


@dataclass(frozen=True)
class Fault:
    seed: int
    data: bytes
    what: str

    def __str__(self) -> str:
        shown = self.data.hex()
        return f"seed {self.seed}: {self.what}\n  {shown}"


@dataclass
class Findings:
    """Result of a campaign.

    `outcomes`: number of inputs by outcome. `seconds`: wall time. `slowest`: time [s] and seed of
    the slowest input.
    """

    target: str
    inputs: int = 0
    seconds: float = 0.0
    slowest: tuple[float, int] = (0.0, 0)
    outcomes: Counter[str] = field(default_factory=Counter)
    faults: list[Fault] = field(default_factory=list)

    def add(self, other: Findings) -> None:
        self.inputs += other.inputs
        self.seconds = max(self.seconds, other.seconds)
        self.slowest = max(self.slowest, other.slowest)
        self.outcomes += other.outcomes
        self.faults += other.faults

    def __str__(self) -> str:
        rows = [f"  {count:9d} {name}" for name, count in self.outcomes.most_common()]
        head = (
            f"{self.target}: {self.inputs} inputs in {self.seconds:.1f} s, {len(self.faults)} faults; "
            f"slowest {self.slowest[0] * 1e3:.1f} ms (seed {self.slowest[1]})"
        )
        return "\n".join([head, *rows, *map(str, self.faults)])


@contextmanager
def _time_limit(seconds: float) -> Iterator[None]:
    def end(_: int, __: FrameType | None) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _size() -> float:
    """Return the peak memory of this process [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def one(target: Target, data: bytes) -> str:
    """Run one input and return the outcome; exceptions that are not allowed are not caught."""
    try:
        return target.call(data) or "value"
    except target.allowed as error:
        return type(error).__name__


def run(target: Target, first: int, count: int) -> Findings:
    """Run the inputs of the seeds first ... first + count - 1."""
    found = Findings(target.name)
    # Fill the caches of the target before its memory is measured.
    for seed in range(first, first + min(count, 200)):
        _try(target, seed, found)
    before = _size()
    begin = time.perf_counter()
    for seed in range(first, first + count):
        if len(found.faults) >= MOST_FAULTS:
            break
        found.inputs += 1
        start = time.perf_counter()
        outcome = _try(target, seed, found)
        found.slowest = max(found.slowest, (time.perf_counter() - start, seed))
        found.outcomes[outcome] += 1
        if _size() > before + target.growth:
            found.faults.append(
                Fault(
                    seed, target.input(seed), f"the process has grown by {_size() - before:.0f} MiB"
                )
            )
            break
    found.seconds = time.perf_counter() - begin
    return found


def _try(target: Target, seed: int, found: Findings) -> str:
    data = target.input(seed)
    try:
        with _time_limit(target.time_limit):
            return one(target, data)
    except Hang:
        what = f"no answer within {target.time_limit:g} s"
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        what = f"{type(error).__name__}: {' '.join(str(error).split())[:200]} ({Path(place.filename).name}:{place.lineno})"
    if all(fault.seed != seed for fault in found.faults):
        found.faults.append(Fault(seed, data, what))
    return "FAULT"


def run_in_processes(name: str, first: int, count: int, processes: int) -> Findings:
    """As `run`, with one range of seeds per process."""
    share = -(-count // processes)
    parts = [(name, first + k * share, min(share, count - k * share)) for k in range(processes)]
    found = Findings(name)
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        for part in pool.starmap(_part, parts):
            found.add(part)
    return found


def _part(name: str, first: int, count: int) -> Findings:
    from targets import TARGETS

    return run(TARGETS[name], first, count)


def main() -> int:
    from targets import TARGETS

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--target", choices=sorted(TARGETS), required=True)
    parser.add_argument(
        "--seed", type=int, default=0, help="first seed; without --inputs, the only seed"
    )
    parser.add_argument("--inputs", type=int)
    parser.add_argument("--processes", type=int, default=1)
    arguments = parser.parse_args()
    target = TARGETS[arguments.target]
    if arguments.inputs is None:
        data = target.input(arguments.seed)
        print(data.hex(), repr(data), sep="\n", flush=True)
        print(one(target, data))
        return 0
    found = run_in_processes(target.name, arguments.seed, arguments.inputs, arguments.processes)
    print(found)
    return 1 if found.faults else 0


if __name__ == "__main__":
    sys.exit(main())
