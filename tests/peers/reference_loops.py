"""Two exchange rules, written out with FMPy's slaves, to tell by comparison which one a peer follows.

parallel:   all due components take what the sources show; all step; then all show what they have.
sequential: one due component after the other, in the order of `fmus`, takes its inputs, steps, and shows what it has at once.

Row k of a record is what every source shows at time k * smallest step, before anything happens at that instant.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from slaves import Array, Connection, Slave, StartValues, split, ticks, times


@dataclass(frozen=True)
class Rule:
    sequential: bool = False
    rounds: int = 0
    """How often, within initialisation mode, all outputs are read and then all inputs set."""
    initial_order: tuple[str, ...] = ()
    """If given: components initialised one after the other, each with the outputs of those before it."""
    late: bool = False
    """A component slower than the others shows a step when that step ends; if not, one smallest step after it has begun."""
    zero_inputs: bool = False
    """Connected inputs are zero in the first step."""


def run(
    fmus: Mapping[str, Path],
    connections: Sequence[Connection],
    start_values: StartValues,
    steps: Mapping[str, float],
    stop: float,
    recorded: Sequence[str],
    rule: Rule,
) -> dict[str, Array]:
    size, ratios, count = ticks(steps, stop)
    slaves = {name: Slave(name, path) for name, path in fmus.items()}
    sources = sorted({source for source, _ in connections} | set(recorded))
    outputs = {name: [split(s)[1] for s in sources if split(s)[0] == name] for name in fmus}
    inputs = {
        name: [(s, split(t)[1]) for s, t in connections if split(t)[0] == name] for name in fmus
    }
    shown: dict[str, Array] = {}
    made: dict[str, dict[str, Array]] = {}

    def read(name: str) -> dict[str, Array]:
        return {f"{name}.{output}": slaves[name].get(output) for output in outputs[name]}

    def read_all() -> None:
        for name in slaves:
            shown.update(read(name))

    def give(names: Iterable[str], scale: float = 1.0) -> None:
        for name in names:
            for source, target in inputs[name]:
                if source in shown:
                    slaves[name].set(target, scale * shown[source])

    def show(names: Iterable[str], k: int) -> None:
        for name in names:
            if (k + 1 if rule.late else k) % ratios[name] == 0:
                shown.update(made[name])

    try:
        for name, slave in slaves.items():
            slave.enter_initialization(start_values.get(name, {}))
        for _ in range(rule.rounds):
            read_all()
            give(slaves)
        for name in rule.initial_order or slaves:
            if rule.initial_order:
                give([name])
            slaves[name].exit_initialization()
            if rule.initial_order:
                shown.update(read(name))
        read_all()
        record = {signal: np.empty((count + 1, shown[signal].size)) for signal in recorded}
        record["time"] = times(0, count, size)
        for k in range(count + 1):
            for signal in recorded:
                record[signal][k] = shown[signal]
            if k == count:
                break
            due = [name for name in slaves if k % ratios[name] == 0]
            if not rule.sequential:
                give(due, 0.0 if rule.zero_inputs and k == 0 else 1.0)
            for name in slaves:
                if name in due:
                    if rule.sequential:
                        give([name])
                    slaves[name].step(k * size, ratios[name] * size)
                    made[name] = read(name)
                if rule.sequential:
                    show([name], k)
            if not rule.sequential:
                show(slaves, k)
        return record
    finally:
        for slave in slaves.values():
            slave.close()
