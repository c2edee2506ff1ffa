"""Compute the map of the linearised loop over one base period n T_m (lifting).

A law is a linearised controller. The fast laws are sampled every T_m, the slow laws every n T_m. An
instant is a point in time at which laws are sampled. The state of the loop at an instant is
[x; signals; signals before the instant; pending outputs; memories]. x is the state of the plant. A
signal is an element of an output of the plant or of a law. In parallel exchange, an output of a law
is pending until the next sample of the law. A memory is the state of a law between two samples, for
example of a filter or a delay. The actions of the master at an instant are linear assignments to
elements of this state. An element is removed if no later action reads it.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from freeflyer.fmi.component import Array
from freeflyer.foundation.errors import ScenarioError

Indices = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """Sources of the inputs of a component.

    Both arrays have one element for each element of the inputs. `sources` contains the indices of
    the signals that are connected to the inputs. An element of `delayed` is true if the input
    receives the value that the signal had before the instant.
    """

    sources: Indices
    delayed: NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Plant:
    """Linear plant x' = A x + B u, y = C x around an operating point.

    x has rotation vectors instead of quaternions. Therefore the elements of x are independent. The
    outputs y are the first signals of the loop. If u is constant for T_m, the state after T_m is
    exactly `step` @ x + `step_input` @ u.
    """

    A: Array
    B: Array
    C: Array
    inputs: Inputs
    step: Array
    step_input: Array


def plant(A: Array, B: Array, C: Array, inputs: Inputs, tick: float) -> Plant:
    """Return the plant with `step` and `step_input` for the time `tick` [s].

    `step` and `step_input` are computed with the matrix exponential.
    """
    n, m = B.shape
    both = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * tick)
    return Plant(A=A, B=B, C=C, inputs=inputs, step=both[:n, :n], step_input=both[:n, n:])


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One sample of a linearised controller: z(k) = A z(k-1) + B u(k), y(k) = C z(k-1) + D u(k).

    u are the inputs, y the outputs, and z the memory. A controller without memory has only D.
    """

    A: Array
    B: Array
    C: Array
    D: Array

    def each(self, function: Callable[[Array], Array]) -> Sample:
        """Return a sample with `function` applied to each matrix."""
        A, B, C, D = map(function, self.matrices)
        return Sample(A=A, B=B, C=C, D=D)

    @property
    def matrices(self) -> tuple[Array, Array, Array, Array]:
        return self.A, self.B, self.C, self.D

    @property
    def gain(self) -> Array:
        """Gain from constant inputs to the outputs, after the memory has come to rest."""
        rest = np.linalg.lstsq(np.eye(len(self.A)) - self.A, self.B, rcond=None)[0]
        return np.asarray(self.D + self.C @ rest)


def sample(D: Array) -> Sample:
    """Return the sample of a controller without memory: y = D u."""
    outputs, inputs = D.shape
    return Sample(A=np.zeros((0, 0)), B=np.zeros((0, inputs)), C=np.zeros((outputs, 0)), D=D)


@dataclass(frozen=True, kw_only=True)
class Law:
    """Controller, linearised at an operating point.

    The outputs of the controller are the signals `first` to `last` - 1 of the loop. `slow` is true
    if the controller is sampled every n T_m, and false if it is sampled every T_m. `sample` is its
    sample at an instant at which all laws are sampled. `between` is its sample at another instant.
    They differ if the controller depends on the time since the last sample of the slow laws, for
    example if it delays a command by n T_m.
    """

    name: str
    sample: Sample
    between: Sample
    inputs: Inputs
    first: int
    last: int
    slow: bool

    def each(self, function: Callable[[Array], Array]) -> Law:
        """Return a law with `function` applied to each matrix."""
        return replace(self, sample=self.sample.each(function), between=self.between.each(function))


@dataclass(frozen=True, kw_only=True)
class Loop:
    """Linearised loop. `laws` are in order of execution. `width` is the number of signals.

    `tick` is T_m [s]. If `parallel` is true (parallel exchange), the outputs of a law reach other
    components only at the next sample of this law.
    """

    plant: Plant
    laws: tuple[Law, ...]
    width: int
    tick: float
    parallel: bool = False


class PeriodMap(NamedTuple):
    """Map of the loop's state over one base period: exp(`scale`) * `matrix`.

    `scale` is 0, unless the map has elements beyond the range of a double.
    """

    matrix: Array
    scale: float


class Instants:
    """Map of the loop's state over one instant and the following step T_m of the plant.

    The map is applied to all columns of a matrix. Each column is a state of the loop, and each row
    is one element of the state.
    """

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        n, w = loop.plant.A.shape[0], loop.width
        self._x, self._now, self._before, self.pending = slice(0, n), n, n + w, n + 2 * w
        ends = n + 3 * w + np.cumsum([len(law.sample.A) for law in loop.laws], dtype=int)
        self.memories = [
            slice(end - len(law.sample.A), end) for law, end in zip(loop.laws, ends, strict=True)
        ]
        self.size = int(ends[-1]) if ends.size else n + 3 * w
        self._delays = any(
            inputs.delayed.any()
            for inputs in (loop.plant.inputs, *(law.inputs for law in loop.laws))
        )

    def _read(self, rows: Array, inputs: Inputs) -> Array:
        places = inputs.sources + np.where(inputs.delayed, self._before, self._now)
        return np.asarray(rows[places])

    def apply(self, rows: Array, *, slow: bool) -> None:
        """Apply the actions of one instant and the step T_m to the matrix `rows`, in place.

        `rows` is (size, any number of columns). The fast laws are sampled. If `slow` is true, the
        slow laws are sampled, too.
        """
        loop, plant, now, w = self.loop, self.loop.plant, self._now, self.loop.width
        if self._delays:
            rows[self._before : self._before + w] = rows[now : now + w]
        rows[now : now + plant.C.shape[0]] = plant.C @ rows[self._x]
        due = [
            (law, law.sample if slow else law.between, memory)
            for law, memory in zip(loop.laws, self.memories, strict=True)
            if slow or not law.slow
        ]
        if loop.parallel:
            for law, _, _ in due:  # the outputs of the last step become visible
                rows[now + law.first : now + law.last] = rows[
                    self.pending + law.first : self.pending + law.last
                ]
        written = self.pending if loop.parallel else now
        for law, one, memory in due:
            u, z = self._read(rows, law.inputs), rows[memory].copy()
            rows[written + law.first : written + law.last] = one.C @ z + one.D @ u
            rows[memory] = one.A @ z + one.B @ u
        rows[self._x] = plant.step @ rows[self._x] + plant.step_input @ self._read(
            rows, plant.inputs
        )

    def after(self, rows: Array, *, slow: bool) -> Array:
        """Return a copy of `rows` to which `apply` was applied."""
        rows = rows.copy()
        self.apply(rows, slow=slow)
        return rows

    def matrix(self, *, slow: bool) -> Array:
        """Return the matrix (size, size) of `apply`."""
        return self.after(np.eye(self.size), slow=slow)

    def feedback(self) -> Array:
        """Return the gain from the plant's states to the plant's inputs through all laws.

        Its shape is (plant inputs, plant states). The gain is for a constant state of the plant and
        for memories at rest. In parallel exchange, an output can need several instants to reach the
        plant. Therefore several instants are computed, and the state of the plant is kept constant.
        """
        laws = tuple(
            replace(law, sample=(rest := sample(law.sample.gain)), between=rest)
            for law in self.loop.laws
        )
        instants = Instants(replace(self.loop, laws=laws))
        rows = np.eye(instants.size)[:, self._x]
        for _ in range(len(laws) + 1 if self.loop.parallel else 1):
            state = rows[self._x].copy()
            instants.apply(rows, slow=True)
            rows[self._x] = state
        return instants._read(rows, self.loop.plant.inputs)


def relevant(loop: Loop) -> Indices:
    """Return the indices of the relevant elements of the loop's state.

    An element is relevant if it can affect the plant's states. The plant's states come first. The
    result does not depend on the gains of slow laws.
    """
    # All gains of slow laws are set to 1 here, because a gain can be zero by chance.
    laws = tuple(law.each(np.ones_like) if law.slow else law for law in loop.laws)
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
    """Return two maps of the elements `kept` over T_m.

    `kept` are indices of the loop's state. The first map is for an instant at which only fast laws
    are sampled. The second map is for an instant at which all laws are sampled.
    """
    instants = Instants(loop)
    columns = np.eye(instants.size)[:, kept]
    return instants.after(columns, slow=False)[kept], instants.after(columns, slow=True)[kept]


def without_slow_laws(loop: Loop) -> Loop:
    """Return the loop with all outputs of the slow laws at 0."""
    laws = (law.each(np.zeros_like) if law.slow else law for law in loop.laws)
    return replace(loop, laws=tuple(laws))


def lifted(loop: Loop, n: int) -> PeriodMap:
    """Return the map of the relevant elements over n T_m. The plant's states come first."""
    return next(lifted_maps([loop], n))


def period_map(fast: Array, slow: Array, n: int) -> PeriodMap:
    """Return the map over n T_m from both results of `reduced`.

    If the fast laws alone are unstable, the power of `fast` can be beyond the range of a double.
    The power of `fast` divided by its spectral radius is not.
    """
    found = np.linalg.matrix_power(fast, n - 1) @ slow
    if np.isfinite(found).all():
        return PeriodMap(found, 0.0)
    radius = float(np.abs(np.linalg.eigvals(fast)).max())
    return PeriodMap(
        np.linalg.matrix_power(fast / radius, n - 1) @ slow, (n - 1) * math.log(radius)
    )


def _without_irrelevant(matrix: Array, states: int) -> Array:
    """Remove the elements of the state that do not affect the plant in a later period.

    The first `states` elements are the plant's states.
    """
    kept = _ancestors(states, matrix)
    return matrix[np.ix_(kept, kept)]


def lifted_maps(loops: Iterable[Loop], first: int = 1) -> Iterator[PeriodMap]:
    """Yield the maps of the loops over n T_m, for n = `first`, `first` + 1, ....

    The laws of a loop may depend on n. The map over n T_m contains the power n - 1 of the map in
    which only fast laws are sampled. As long as the fast laws of two successive loops are bitwise
    equal, this power is updated by one multiplication. Raises ScenarioError if a map over T_m has
    elements beyond the range of a double.
    """
    before: Loop | None = None
    for n, loop in enumerate(loops, start=first):
        states = loop.plant.A.shape[0]
        if before is None or not _same_fast_laws(before, loop):
            kept = relevant(loop)
            fast, slow = reduced(loop, kept)
            power = np.linalg.matrix_power(fast, n - 1)
        else:
            slow, power = reduced(loop, kept)[1], fast @ power
        if not (np.isfinite(fast).all() and np.isfinite(slow).all()):
            raise ScenarioError(
                f"the linearised loop has numbers above {sys.float_info.max:.2g}; smaller gains, or larger masses and inertias, are expected"
            )
        found = PeriodMap(power @ slow, 0.0)
        if not np.isfinite(found.matrix).all():
            found = period_map(fast, slow, n)
        yield found._replace(matrix=_without_irrelevant(found.matrix, states))
        before = loop


def _same_fast_laws(one: Loop, other: Loop) -> bool:
    if one.plant is not other.plant:
        return False
    return all(
        a.slow
        or all(
            map(
                np.array_equal,
                (*a.sample.matrices, *a.between.matrices),
                (*b.sample.matrices, *b.between.matrices),
            )
        )
        for a, b in zip(one.laws, other.laws, strict=True)
    )


def multipliers(maps: Sequence[Array]) -> list[NDArray[np.complex128]]:
    """Return the eigenvalues of each map.

    If all maps have the same size, a single call computes all eigenvalues.
    """
    if len({one.shape for one in maps}) == 1:
        return list(np.linalg.eigvals(np.stack(maps)).astype(np.complex128))
    return [np.linalg.eigvals(one).astype(np.complex128) for one in maps]
