"""Component for a model-exchange FMU.

A model-exchange FMU computes only the derivatives of its states. SciPy's solver DOP853 integrates
the states with a tight tolerance.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import fmi2, fmi3
from fmpy.fmi1 import FMICallException
from scipy.integrate import DOP853

from freeflyer.fmi.component import Array
from freeflyer.fmi.fmu import FmuComponent
from freeflyer.foundation.errors import ComponentError, StepFailed

RELATIVE_TOLERANCE = 1e-10
ABSOLUTE_TOLERANCE = 1e-12


class ModelExchangeComponent(FmuComponent):
    """One model-exchange instance of an FMU.

    An FMU with event indicators or time events is rejected with ComponentError.
    """

    _classes = (fmi2.FMU2Model, fmi3.FMU3Model)

    def __init__(self, name: str, path: Path) -> None:
        super().__init__(name, path)
        if self.description.numberOfEventIndicators:
            self.close()
            raise ComponentError(
                f"FMU {path} has event indicators; only model exchange without events is supported"
            )

    def _interface(self) -> Any:
        interface = self.description.modelExchange
        if interface is None:
            raise ComponentError(
                f"FMU {self.path} of component {self.name} offers no model exchange; an FMU with model exchange is expected"
            )
        return interface

    def exit_initialization(self) -> None:
        super().exit_initialization()
        model = self._slave
        needed = True
        while needed:
            needed, *_, event, when = (
                model.newDiscreteStates() if self.version == 2 else model.updateDiscreteStates()
            )
        if event:
            raise ComponentError(
                f"FMU {self.path} of component {self.name} has a time event at {when:g} s; only model exchange without events is "
                f"supported"
            )
        model.enterContinuousTimeMode()
        states = (
            len(self.description.derivatives)
            if self.version == 2
            else model.getNumberOfContinuousStates()
        )
        self._x = np.zeros(states)
        self._dx = np.zeros_like(self._x)
        if states:
            model.getContinuousStates(self._pointer(self._x), self._x.size)
        self._first_step: float | None = None

    @staticmethod
    def _pointer(array: Array) -> Any:
        return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))

    def _rates(self, time: float, x: Array) -> Array:
        model, n = self._slave, x.size
        x = np.ascontiguousarray(x)
        model.setTime(time)
        model.setContinuousStates(self._pointer(x), n)
        if self.version == 2:
            model.getDerivatives(self._pointer(self._dx), n)
        else:
            model.getContinuousStateDerivatives(self._pointer(self._dx), n)
        return self._dx.copy()

    def step(self, time: float, size: float) -> None:
        try:
            if not self._x.size:
                self._slave.setTime(time + size)
                return
            end = time + size
            solver = DOP853(
                self._rates,
                time,
                self._x,
                end,
                rtol=RELATIVE_TOLERANCE,
                atol=ABSOLUTE_TOLERANCE,
                first_step=self._first_step and min(self._first_step, end - time),
            )
            while solver.status == "running":
                solver.step()
            if solver.status != "finished":
                raise StepFailed(
                    self.name, f"the integration from {time:g} s to {end:g} s did not converge"
                )
            # Each communication step creates a new solver. The next solver starts with the last
            # step size of this solver. Therefore the next solver need not search for a step size.
            self._first_step = max(solver.h_abs, 1e-6)
            self._x = solver.y
            self._rates(end, self._x)
            self._slave.completedIntegratorStep()
        except (FMICallException, OSError) as error:
            raise self._failed(error) from error
