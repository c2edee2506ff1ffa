"""Two exchange rules with FMPy's slaves; the comparison shows which rule a peer follows.

parallel:   all due components take their inputs; all step; then all outputs become visible.
sequential: one due component after the other, in the order of `fmus`, takes its inputs and steps;
            its outputs are visible immediately.

Row k of a record contains the visible outputs at time k * smallest step, before any operation of
that instant.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from slaves import Array, Connection, Slave, StartValues, split, ticks, times


@dataclass(frozen=True)
class Rule:
    """An exchange rule: sequential or parallel, initialisation, delay of slow components."""

    sequential: bool = False
    rounds: int = 0
    """Number of rounds in initialisation mode: all outputs are read, then all inputs are set."""
    initial_order: tuple[str, ...] = ()
    """If not empty: each component is initialised with the outputs of those before it."""
    late: bool = False
    """A slow component's outputs become visible at the end of its step, else after one tick."""
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
    # The slaves, and the names of their connected or recorded signals.
    size, ratios, count = ticks(steps, stop)
    slaves = {name: Slave(name, path) for name, path in fmus.items()}
    sources = sorted({source for source, _ in connections} | set(recorded))
    outputs = {name: [split(s)[1] for s in sources if split(s)[0] == name] for name in fmus}
    inputs = {
        name: [(s, split(t)[1]) for s, t in connections if split(t)[0] == name] for name in fmus
    }
    # Outputs that inputs and record get, and outputs of the last step.
    visible: dict[str, Array] = {}
    made: dict[str, dict[str, Array]] = {}

    def read(name: str) -> dict[str, Array]:
        return {f"{name}.{output}": slaves[name].get(output) for output in outputs[name]}

    def read_all() -> None:
        for name in slaves:
            visible.update(read(name))

    def write_inputs(names: Iterable[str], scale: float = 1.0) -> None:
        for name in names:
            for source, target in inputs[name]:
                if source in visible:
                    slaves[name].set(target, scale * visible[source])

    def publish(names: Iterable[str], k: int) -> None:
        for name in names:
            if (k + 1 if rule.late else k) % ratios[name] == 0:
                visible.update(made[name])

    # Initialisation by the rule.
    try:
        for name, slave in slaves.items():
            slave.enter_initialization(start_values.get(name, {}))
        for _ in range(rule.rounds):
            read_all()
            write_inputs(slaves)
        for name in rule.initial_order or slaves:
            if rule.initial_order:
                write_inputs([name])
            slaves[name].exit_initialization()
            if rule.initial_order:
                visible.update(read(name))
        read_all()
        # Steps by the rule.
        record = {signal: np.empty((count + 1, visible[signal].size)) for signal in recorded}
        record["time"] = times(0, count, size)
        for k in range(count + 1):
            for signal in recorded:
                record[signal][k] = visible[signal]
            if k == count:
                break
            due = [name for name in slaves if k % ratios[name] == 0]
            if not rule.sequential:
                write_inputs(due, 0.0 if rule.zero_inputs and k == 0 else 1.0)
            for name in slaves:
                if name in due:
                    if rule.sequential:
                        write_inputs([name])
                    slaves[name].step(k * size, ratios[name] * size)
                    made[name] = read(name)
                if rule.sequential:
                    publish([name], k)
            if not rule.sequential:
                publish(slaves, k)
        return record
    finally:
        for slave in slaves.values():
            slave.close()
