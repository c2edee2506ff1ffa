"""Random faults: run of one seed with checks, and a program that runs many seeds.

    python tests/faults/schedules.py FIRST COUNT

prints the error of each seed that fails, and at the end the number of runs per kind of end.
"""

from __future__ import annotations

import sys
import traceback
from collections import Counter

from fault_bench import Observed, assert_safe, run, shipped, with_faults

from freeflyer_adapters.facility.link_faults import TAMPERING

WITHIN = 0.2
"""Duration of the scenario [s]."""
RAMP = 0.05
"""Short ramp-down of host and facility [s], so that a schedule takes less time."""
HOW = (
    ("went on", "scenario finished"),
    ("the arm's watchdog", "the arm went to safe_stop by itself"),
    ("the arm's own fault", "the arm went to fault by itself"),
    ("lost state frames", "(state frames of arm_drive"),
    ("lost measurements of the base", "(measurements of base_robot"),
    ("the base's watchdog", "does not take set points any more"),
    ("a second publisher", "two publishers send topic"),
    ("too old", "old, its limit is"),
    ("a joint beyond its range", "its range is"),
    ("a joint too fast", "rad/s, its limit is"),
    ("following error", "from its set point"),
)


def schedule(seed: int) -> Observed:
    """Run one to six random faults of both devices and check `fault_bench.assert_safe`."""
    # Half of the seeds only change the content of packets, which is harder to detect.
    kinds = [] if seed % 2 else list(TAMPERING)
    drawn = {
        "seed": seed,
        "count": 1 + seed % 6,
        "within_s": 0.8 * WITHIN,
        "longest_s": 0.3,
        "kinds": kinds,
    }
    quick = {"describe_every": 10, "ramp_down_time_s": RAMP}
    seen = run(
        with_faults(
            shipped(WITHIN, f"devices.arm_drive.parameters.ramp_down_time={RAMP}"),
            seed=seed,
            random_faults=drawn,
            **quick,
        )
    )
    assert_safe(seen)
    return seen


def ending(seen: Observed) -> str:
    if seen.error:
        return "not activated"
    return next((name for name, text in HOW if text in seen.stop), "otherwise: " + seen.stop[:100])


def main(first: int, count: int) -> int:
    endings: Counter[str] = Counter()
    packets: Counter[str] = Counter()
    failed = 0
    for seed in range(first, first + count):
        try:
            seen = schedule(seed)
        except Exception:
            failed += 1
            print(f"seed {seed}:\n{traceback.format_exc()}", flush=True)
            continue
        endings[ending(seen)] += 1
        packets.update(seen.acted)
        if (seed - first) % 250 == 249:
            print(f"{seed - first + 1} done, {failed} failed", file=sys.stderr, flush=True)
    for name, number in endings.most_common():
        print(f"{number:6d}  {name}")
    print(f"packets changed or lost: {dict(packets)}")
    print(f"{count} schedules from seed {first}: {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2])))
