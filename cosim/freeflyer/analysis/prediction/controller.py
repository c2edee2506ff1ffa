"""Linearise one controller with its memory, with directional derivatives of its FMU.

The memory of a sampled controller is a set of discrete states, for example the values of a filter.
FMI defines no derivatives with respect to such states. The FMUs of this project provide them: with
respect to the memory before a sample, and of the memory after the sample.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from freeflyer.analysis.prediction.lifting import Sample
from freeflyer.analysis.prediction.sensitivity import DifferentiableFmu
from freeflyer.fmi.component import Array
from freeflyer.foundation.clock import seconds
from freeflyer.foundation.errors import ComponentError, StepFailed

DISTURBANCE = 1e-4
"""Size of a disturbance of inputs [SI]. It is small enough for quaternions, which remain valid."""

Start = Mapping[str, Array]
"""Parameters, start values and inputs of a controller at an operating point."""


class LinearisedController:
    """Samples of a controller (`sample`), linearised at operating points.

    `inputs` and `outputs` are its variables that are part of the loop. `tick` is T_m [ns]. `memory`
    contains the names of the states that affect the outputs.
    """

    def __init__(
        self, fmu: DifferentiableFmu, inputs: Sequence[str], outputs: Sequence[str], tick: int
    ) -> None:
        self.fmu, self.inputs, self.outputs, self.tick = fmu, inputs, outputs, tick
        self.memory: list[str] = []
        self._derivative = fmu.bind_derivative(outputs, inputs)
        self._timed = False

    def find_memory(self, start: Start, period: int, other: int) -> None:
        """Find the variables in which the controller keeps its memory.

        `period` [ns] is the period of the controller, and `other` that of the slow controllers. An
        element can have no effect at `start` by chance. Therefore the inputs are disturbed here.
        Raises ComponentError.
        """
        random = np.random.default_rng(0)
        disturbed = {
            name: value + DISTURBANCE * random.uniform(-1.0, 1.0, value.shape)
            if name in self.inputs
            else value
            for name, value in start.items()
        }
        self.fmu.restart(disturbed)
        self.memory = list(self.fmu.discrete_states)
        self._bind()
        if not self.memory:
            return
        self._timed = period == self.tick and other > period
        both = self._both(disturbed, period, other)
        self._timed &= not all(map(np.array_equal, *(one.matrices for one in both)))
        self.memory = self._used(both)
        self._timed &= bool(self.memory)
        self._bind()

    def samples(self, start: Start, period: int, other: int) -> tuple[Sample, Sample]:
        """Return the sample at an instant of all controllers, and the sample between such instants.

        The arguments are those of `find_memory`. Raises ComponentError, also if the samples depend
        on a time, but not on the time since the last sample of the slow controllers.
        """
        both = self._both(start, period, other)
        if self._timed and other > period and all(map(np.array_equal, *(b.matrices for b in both))):
            raise ComponentError(
                f"component {self.fmu.name} does not follow the period of the slow controllers; a period that refers to theirs ('=COMPONENT.PARAMETER') is expected"
            )
        return both

    def _both(self, start: Start, period: int, other: int) -> tuple[Sample, Sample]:
        if not self.memory:
            self.fmu.restart(start)
            only = self._split(self._derivative())
            return only, only
        # After one sample, the memory is at rest. Later samples change only the time.
        self._sampled(start, period, 1)
        between = self._split(self._derivative())
        if not self._timed or other == period:
            return between, between
        self._continued(period, 1, other // period)
        return self._split(self._derivative()), between

    def accepts(self, start: Start, period: int) -> bool:
        """Return whether the controller can take a sample from `start`, with this period [ns]."""
        try:
            self._sampled(start, period, 1)
        except ComponentError:
            return False
        return True

    def responses(
        self, start: Start, period: int, count: int, disturbed: int
    ) -> tuple[Array, Array]:
        """Return a disturbance of the inputs (m), and the changes of the outputs (count, p).

        The inputs are disturbed for `disturbed` samples, from the second of the controller on. The
        rows are the changes at this sample and at the next samples. Raises ComponentError.
        """
        sizes = [self.fmu.ports[name].size for name in self.inputs]
        u, y = np.zeros(sum(sizes)), np.zeros(sum(self.fmu.ports[n].size for n in self.outputs))
        write = self.fmu.bind_inputs(self.inputs, u)
        read = self.fmu.bind_outputs(self.outputs, y)
        rest = np.concatenate([start[name] for name in self.inputs])
        disturbance = DISTURBANCE * np.random.default_rng(0).uniform(-1.0, 1.0, u.size)
        runs = []
        for size in (0.0, 1.0):
            self._sampled(start, period, 1)
            outputs = []
            for k in range(count):
                u[:] = rest + disturbance * (size if k < disturbed else 0.0)
                write()
                self._continued(period, k + 1, k + 2)
                read()
                outputs.append(y.copy())
            runs.append(np.array(outputs))
        return disturbance, runs[1] - runs[0]

    def _bind(self) -> None:
        self._derivative = self.fmu.bind_derivative(
            [*self.outputs, *self.memory], [*self.inputs, *self.memory]
        )

    def _split(self, jacobian: Array) -> Sample:
        p = sum(self.fmu.ports[name].size for name in self.outputs)
        m = sum(self.fmu.ports[name].size for name in self.inputs)
        return Sample(
            A=jacobian[p:, m:], B=jacobian[p:, :m], C=jacobian[:p, m:], D=jacobian[:p, :m]
        )

    def _sampled(self, start: Start, period: int, count: int) -> None:
        """Restart the FMU, and let it take samples with constant inputs."""
        self.fmu.restart(start)
        self._continued(period, 0, count)

    def _continued(self, period: int, first: int, last: int) -> None:
        try:
            for k in range(first, last):
                self.fmu.step(seconds(k * period), seconds(period))
        except StepFailed as error:
            raise ComponentError(f"component {error}") from error

    def _used(self, samples: Sequence[Sample]) -> list[str]:
        """Return the variables of the memory that affect the outputs at any sample."""
        A, C = (
            sum(np.abs(matrix) for matrix in matrices)
            for matrices in zip(*((one.A, one.C) for one in samples), strict=True)
        )
        owner = np.repeat(
            np.arange(len(self.memory)), [self.fmu.ports[name].size for name in self.memory]
        )
        reach = C.max(axis=0, initial=0.0) > 0.0
        for _ in range(reach.size):
            reach |= A[reach].max(axis=0, initial=0.0) > 0.0
        return [self.memory[k] for k in dict.fromkeys(owner[reach].tolist())]
