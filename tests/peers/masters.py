"""The compared masters and their exchange rules; a record of our master in the same form."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import closed_loop
import container_peer
import ecos_peer
import libcosim_peer
import numpy as np
from reference_loops import Rule
from slaves import Array

from freeflyer.master.graph import Exchange
from freeflyer.scenario.assemble import assembled
from freeflyer.scenario.scenario import load

FOUR = len(closed_loop.COMPONENTS)
CONTROLLERS_FIRST = closed_loop.COMPONENTS
PLANT_FIRST = (*CONTROLLERS_FIRST[2:], *CONTROLLERS_FIRST[:2])


@dataclass(frozen=True)
class Peer:
    run: Callable[..., dict[str, Array]]
    versions: tuple[int, ...]
    rule: Rule
    order: tuple[str, ...] = CONTROLLERS_FIRST
    """Order of the FMUs; a container initialises and, if sequential, steps them in this order."""
    nests: bool = False
    """A component of a slower step is in a nested container, which is before the others."""

    @property
    def exchange(self) -> Exchange:
        return "sequential" if self.rule.sequential else "parallel"

    def fmus(self, version: int, base_step: float) -> dict[str, Path]:
        """Return the FMUs by name, in the peer's order."""
        paths = closed_loop.fmus(version)
        slow = ["base_controller"] if self.nests and base_step > 0.001 else []
        return {
            name: paths[name]
            for name in (*slow, *(name for name in self.order if name not in slow))
        }

    def rule_for(self, fmus: Mapping[str, Path]) -> Rule:
        """Return the rule with the initial order of the container's components."""
        return (
            replace(self.rule, initial_order=tuple(fmus)) if self.rule.initial_order else self.rule
        )


PEERS = {
    "libcosim": Peer(libcosim_peer.run, (2,), Rule(rounds=FOUR, late=True)),
    "ecos": Peer(ecos_peer.run, (2,), Rule(rounds=FOUR)),
    "container, parallel": Peer(
        container_peer.run,
        (2, 3),
        Rule(late=True, initial_order=PLANT_FIRST),
        order=PLANT_FIRST,
        nests=True,
    ),
    "container, sequential": Peer(
        partial(container_peer.run, sequential=True),
        (2, 3),
        Rule(sequential=True, late=True),
        nests=True,
    ),
}


def arguments(
    base_step: float,
    stop: float,
    *,
    scenario: str = "multirate_passive",
    moving: bool = True,
    **options: object,
) -> tuple[object, ...]:
    """Return the arguments of every peer's `run` after the FMUs."""
    values = closed_loop.start_values(scenario, moving=moving, **options)  # type: ignore[arg-type]
    return (
        closed_loop.connections(scenario),
        values,
        closed_loop.steps(base_step),
        stop,
        closed_loop.RECORDED,
    )


def own_master(
    version: int,
    exchange: Exchange,
    base_step: float,
    stop: float,
    *,
    scenario: str = "multirate_passive",
    moving: bool = True,
) -> dict[str, Array]:
    changes = [
        f"stop_s={stop}",
        "record.every_s=0.001",
        f'exchange="{exchange}"',
        f"base_controller.step_s={base_step}",
    ]
    if moving:
        changes += [f"free_flyer.{name}={value}" for name, value in closed_loop.MOVING.items()]
    with assembled(load(scenario, changes), version) as (master, _):
        record = master.run().record
    return {"time": record.time, **{signal: record[signal] for signal in closed_loop.RECORDED}}


def difference(
    a: Mapping[str, Array], b: Mapping[str, Array], signals: Sequence[str] = closed_loop.RECORDED
) -> float:
    """Return the largest difference over the instants that both records contain."""
    _, in_a, in_b = np.intersect1d(
        np.round(a["time"] * 1e3), np.round(b["time"] * 1e3), return_indices=True
    )
    assert len(in_a) > 100
    return max(float(np.nanmax(np.abs(a[signal][in_a] - b[signal][in_b]))) for signal in signals)


def before_the_instant(record: Mapping[str, Array]) -> dict[str, Array]:
    """Shift a sequential record to the peers' form: controllers as sampled one step earlier."""
    shifted = {
        signal: values[:-1]
        for signal, values in record.items()
        if signal.split(".")[0].endswith("controller")
    }
    return {name: values[1:] for name, values in record.items()} | shifted
