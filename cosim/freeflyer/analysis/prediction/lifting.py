"""The linear loop over one base period: fast laws renewed every T_m, slow laws held for n T_m.

The state at an instant is [x; signals; signals before the instant; answers not yet handed over]. What the master does at an
instant is a sequence of assignments to rows of it, each linear; what nobody reads later drops out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from freeflyer.fmi.component import Array

Indices = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """Where a component's inputs come from: elements of the loop's signals, and which of them are of before the instant."""

    sources: Indices
    delayed: NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Plant:
    """x' = A x + B u, y = C x around an operating point; y are the first signals. x without constraints (rotation vectors).

    `step` and `step_input`: x over T_m with held inputs, exactly.
    """

    A: Array
    B: Array
    C: Array
    inputs: Inputs
    step: Array
    step_input: Array


def plant(A: Array, B: Array, C: Array, inputs: Inputs, tick: float) -> Plant:
    """With its step over `tick` [s] by the matrix exponential."""
    n, m = B.shape
    both = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * tick)
    return Plant(A=A, B=B, C=C, inputs=inputs, step=both[:n, :n], step_input=both[:n, n:])


@dataclass(frozen=True, kw_only=True)
class Law:
    """A sampled component without memory around an operating point: outputs = gain inputs. `first`, `last`: its signals."""

    name: str
    gain: Array
    inputs: Inputs
    first: int
    last: int
    slow: bool


@dataclass(frozen=True, kw_only=True)
class Loop:
    """`laws` in the order of an instant. `tick`: T_m [s]. `parallel`: all outputs are handed over at the end of a step."""

    plant: Plant
    laws: tuple[Law, ...]
    width: int
    tick: float
    parallel: bool = False


class Instants:
    """What an instant of the loop, and the plant's step of T_m after it, make of the loop's state (rows)."""

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        n, w = loop.plant.A.shape[0], loop.width
        self._x, self._now, self._before, self._pending = slice(0, n), n, n + w, n + 2 * w
        self.size = n + 3 * w
        self._delays = any(
            inputs.delayed.any()
            for inputs in (loop.plant.inputs, *(law.inputs for law in loop.laws))
        )

    def _read(self, rows: Array, inputs: Inputs) -> Array:
        places = inputs.sources + np.where(inputs.delayed, self._before, self._now)
        return np.asarray(rows[places])

    def apply(self, rows: Array, *, slow: bool) -> None:
        """One instant and one T_m, in place: (size, any number of columns). `slow`: the slow laws are due too."""
        loop, plant, now, w = self.loop, self.loop.plant, self._now, self.loop.width
        if self._delays:
            rows[self._before : self._before + w] = rows[now : now + w]
        rows[now : now + plant.C.shape[0]] = plant.C @ rows[self._x]
        due = [law for law in loop.laws if slow or not law.slow]
        if loop.parallel:
            for law in due:  # what was answered at the last step begins to count
                rows[now + law.first : now + law.last] = rows[
                    self._pending + law.first : self._pending + law.last
                ]
            for law in due:
                rows[self._pending + law.first : self._pending + law.last] = law.gain @ self._read(
                    rows, law.inputs
                )
        else:
            for law in due:
                rows[now + law.first : now + law.last] = law.gain @ self._read(rows, law.inputs)
        rows[self._x] = plant.step @ rows[self._x] + plant.step_input @ self._read(
            rows, plant.inputs
        )

    def after(self, rows: Array, *, slow: bool) -> Array:
        """See `apply`; of a copy."""
        rows = rows.copy()
        self.apply(rows, slow=slow)
        return rows

    def matrix(self, *, slow: bool) -> Array:
        return self.after(np.eye(self.size), slow=slow)

    def feedback(self) -> Array:
        """(inputs of the plant, states): what all laws together answer to the plant's state at once (parallel: later)."""
        rows = np.eye(self.size)[:, self._x]
        for _ in range(len(self.loop.laws) + 1 if self.loop.parallel else 1):
            state = rows[self._x].copy()
            self.apply(rows, slow=True)
            rows[self._x] = state
        return self._read(rows, self.loop.plant.inputs)


def remembered(loop: Loop) -> Indices:
    """The elements of the loop's state that reach the plant's states (the first ones) sooner or later, whatever the slow laws'
    gains are: nothing else decides how it goes on.
    """
    # So that no element of a slow law is zero by chance.
    laws = tuple(
        replace(law, gain=np.ones_like(law.gain)) if law.slow else law for law in loop.laws
    )
    instants = Instants(replace(loop, laws=laws))
    return _ancestors(
        loop.plant.A.shape[0], *(instants.matrix(slow=slow) for slow in (False, True))
    )


def _ancestors(states: int, *maps: Array) -> Indices:
    kept = np.arange(states)
    while True:
        reach = np.any([np.abs(one[kept]).max(axis=0) > 0.0 for one in maps], axis=0)
        reach[kept] = True
        if np.count_nonzero(reach) == kept.size:
            return kept
        kept = np.flatnonzero(reach)


def reduced(loop: Loop, kept: Indices) -> tuple[Array, Array]:
    """The maps over T_m of what is remembered: where only the fast laws are due, and where all are. The plant's state is first."""
    instants = Instants(loop)
    columns = np.eye(instants.size)[:, kept]
    return instants.after(columns, slow=False)[kept], instants.after(columns, slow=True)[kept]


def lifted(loop: Loop, n: int) -> Array:
    """The map over n T_m, of what is remembered at the begin of a base period: its first elements are the plant's state."""
    fast, slow = reduced(loop, remembered(loop))
    return _at_begin(np.linalg.matrix_power(fast, n - 1) @ slow, loop.plant.A.shape[0])


def _at_begin(period: Array, states: int) -> Array:
    kept = _ancestors(states, period)
    return period[np.ix_(kept, kept)]


def lifted_maps(loops: Iterable[Loop]) -> Iterator[Array]:
    """The map over n T_m for n = 1, 2, ..., each of its own loop (laws may depend on the period). The fast map's power is
    carried on for as long as the fast laws stay the same to the last bit.
    """
    before: Loop | None = None
    for n, loop in enumerate(loops, start=1):
        states = loop.plant.A.shape[0]
        if before is None or not _same_but_slow(before, loop):
            kept = remembered(loop)
            fast, slow = reduced(loop, kept)
            power = np.linalg.matrix_power(fast, n - 1)
        else:
            slow, power = reduced(loop, kept)[1], fast @ power
        yield _at_begin(power @ slow, states)
        before = loop


def _same_but_slow(one: Loop, other: Loop) -> bool:
    if one.plant is not other.plant:
        return False
    return all(
        a.slow or np.array_equal(a.gain, b.gain) for a, b in zip(one.laws, other.laws, strict=True)
    )


def multipliers(maps: Sequence[Array]) -> list[NDArray[np.complex128]]:
    """Eigenvalues of each map, in one call where their sizes agree."""
    if len({one.shape for one in maps}) == 1:
        return list(np.linalg.eigvals(np.stack(maps)).astype(np.complex128))
    return [np.linalg.eigvals(one).astype(np.complex128) for one in maps]
