"""Component for a co-simulation FMU of FMI 2.0 or FMI 3.0.

FMPy loads, checks and calls the FMU.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import sys
import tempfile
import threading
import zipfile
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy import fmi2, fmi3
from fmpy.fmi1 import FMICallException
from fmpy.logging import addLoggerProxy
from fmpy.model_description import ModelVariable
from numpy.typing import NDArray

from freeflyer.fmi import unpacked
from freeflyer.fmi.component import Array, Port
from freeflyer.fmi.fmu_description import (
    REAL,
    describe_fmu,
    ports_in,
    terminals_of,
)
from freeflyer.foundation.errors import ComponentError, StepFailed, one_line
from freeflyer.foundation.own_fmus import OWN_TOOL, REQUIREMENT

TERMINATE_REQUESTED = "the FMU requests the end of the simulation"
DISCARD = 2
FATAL = 4
"""Status fmi2Fatal or fmi3Fatal. After this status, no function of the FMU may be called."""
CALLS = {
    2: ("fmi2SetReal", "fmi2DoStep", "fmi2GetReal"),
    3: ("fmi3SetFloat64", "fmi3DoStep", "fmi3GetFloat64"),
}
"""For FMI versions 2 and 3: the FMI functions that write inputs, make a step and read outputs."""

_LOADING = threading.Lock()
"""Lock for loading a library. Meanwhile FMPy changes the working directory of the process."""

# An FMI 2.0 log message is a format string with a variable number of arguments. FMPy contains a
# C function, the logger proxy, that formats such messages and calls a logger with the result. The
# proxy supports only one logger per process. This logger is `_route`. An FMU calls the logger with
# its environment pointer. We use a number as this pointer. The number is the key of the component
# in `_listeners`. `_route` stores the message in this component.
_listeners: dict[int, FmuComponent] = {}
_numbers = itertools.count(1)


def _listen(component: FmuComponent) -> int:
    number = next(_numbers)
    _listeners[number] = component
    return number


def _route(
    environment: int | None, name: object, status: int, category: object, message: bytes | None
) -> None:
    if environment in _listeners:
        _listeners[environment].note(category, message)


_LOGGER = fmi2.fmi2CallbackLoggerTYPE(_route)


def _remove_modules(directory: Path) -> None:
    """Remove the Python modules in the folder of an unpacked FMU from `sys.modules`.

    An FMU that is written in Python may import its modules in the interpreter of this process.
    Another FMU may contain different modules with the same names. Without this removal, the imports
    of the other FMU would find the modules of the first FMU.
    """
    inside = _inside(directory)
    for name, module in list(sys.modules.items()):
        if inside(getattr(module, "__file__", None)):
            del sys.modules[name]


def _remove_paths(directory: Path) -> None:
    inside = _inside(directory)
    sys.path[:] = [entry for entry in sys.path if not inside(entry)]


def _inside(directory: Path) -> Callable[[object], bool]:
    spellings = (str(directory), str(directory.resolve()))
    return lambda path: isinstance(path, str) and path.startswith(spellings)


class FmuComponent:
    """One co-simulation instance of an FMU.

    `name` is the name of the component, and `path` is the path of the FMU file. FMPy's class
    FMU2Slave or FMU3Slave calls the functions of the FMU.
    """

    _classes: tuple[Any, Any] = (fmi2.FMU2Slave, fmi3.FMU3Slave)

    def __init__(self, name: str, path: Path) -> None:
        self.name, self.path = name, path
        self.description = describe_fmu(path)
        self.version = 2 if self.description.fmiVersion.startswith("2") else 3
        self._ports, self._variables = ports_in(path)
        self.terminals = terminals_of(path)
        interface = self._interface()
        self.variable_step = bool(
            getattr(interface, "canHandleVariableCommunicationStepSize", True)
        )
        self._messages: deque[str] = deque(maxlen=5)
        self._moment: Callable[[], int] = lambda: 0
        self._noted_at = 0
        self._fatal = False
        self._left_validity = False
        self._listener = 0
        self._buffers: list[Any] = []
        self._check_binary(interface.modelIdentifier)
        self._directory = self._unpack()
        try:
            # FMPy changes the working directory of the process while it loads a library, and does
            # not restore it after a failed load. Only one thread at a time may do this.
            with _LOADING, contextlib.chdir(Path.cwd()):
                self._slave = self._instantiate(interface.modelIdentifier)
        except BaseException:
            _remove_paths(self._directory)
            unpacked.remove(self._directory)
            raise

    @property
    def ports(self) -> Mapping[str, Port]:
        return self._ports

    def variables_of(self, port: str) -> Sequence[ModelVariable]:
        """Return the model variables of a port, in the order of the port's elements."""
        return self._variables[port]

    # Loading

    def _interface(self) -> Any:
        interface = self.description.coSimulation
        if interface is None:
            raise ComponentError(
                f"FMU {self.path} of component {self.name} offers no co-simulation; an FMU with co-simulation is expected"
            )
        return interface

    def _check_binary(self, identifier: str) -> None:
        folder = fmpy.platform if self.version == 2 else fmpy.platform_tuple
        wanted = f"binaries/{folder}/{identifier}{fmpy.sharedLibraryExtension}"
        with zipfile.ZipFile(self.path) as archive:
            names = archive.namelist()
        if wanted not in names:
            found = sorted(
                {
                    name.split("/")[1]
                    for name in names
                    if name.startswith("binaries/") and name.count("/") > 1
                }
            )
            if folder in found:
                raise ComponentError(
                    f"FMU {self.path} has no library {identifier}{fmpy.sharedLibraryExtension} in binaries/{folder}"
                )
            raise ComponentError(
                f"FMU {self.path} has no binary for this platform ({folder}); it has binaries for {', '.join(found) or 'no platform'}; build the FMU for {folder}"
            )

    def _unpack(self) -> Path:
        try:
            return unpacked.take(self.path)
        except OSError as error:
            where = error.filename or tempfile.gettempdir()
            raise ComponentError(
                f"FMU {self.path} cannot be unpacked into {where}: {error.strerror}"
            ) from error

    def _arguments(self, identifier: str) -> dict[str, Any]:
        return {
            "guid": self.description.guid,
            "unzipDirectory": str(self._directory),
            "modelIdentifier": identifier,
            "instanceName": self.name,
        }

    def _instantiate(self, identifier: str) -> Any:
        try:
            if self.version == 2:
                slave = self._classes[0](**self._arguments(identifier))
                slave.instantiate(callbacks=self._callbacks(), loggingOn=True)
            else:
                slave = self._classes[1](**self._arguments(identifier))
                slave.instantiate(logMessage=self._log, loggingOn=True)
        except Exception as error:
            raise ComponentError(
                f"FMU {self.path} of component {self.name} cannot be instantiated: {self._reason(error)}"
            ) from error
        finally:
            self._remove_python_modules()
        return slave

    def _remove_python_modules(self) -> None:
        # The search through all modules takes 1 ms. Our own FMUs contain no Python modules.
        # Therefore the search is omitted for our own FMUs.
        if self.description.generationTool != OWN_TOOL:
            _remove_modules(self._directory)

    def _callbacks(self) -> Any:
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = _LOGGER
        callbacks.componentEnvironment = self._listener = _listen(self)
        callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
        callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
        # FMUs of the tool PythonFMU pass the final log text as the format string. The proxy would
        # interpret each "%" in this text. Therefore these FMUs call `_route` without the proxy.
        if not (self.description.generationTool or "").startswith("PythonFMU"):
            addLoggerProxy(ctypes.byref(callbacks))
        return callbacks

    def _log(
        self, environment: object, status: int, category: object, message: bytes | None
    ) -> None:
        self.note(category, message)

    def note(self, category: object, message: bytes | None) -> None:
        """Store a log message of the FMU with its log category.

        Only the last messages are kept. All kept messages are discarded in three cases: they have
        been used in the report of a failure, a step has succeeded, or a message has arrived at a
        later instant.
        """
        if message:
            if self._moment() != self._noted_at:
                self._messages.clear()
                self._noted_at = self._moment()
            self._messages.append(message.decode("utf-8", "replace"))
            self._left_validity |= category == REQUIREMENT.encode()

    def _failed(self, error: Exception) -> StepFailed:
        left, self._left_validity = self._left_validity, False
        return StepFailed(self.name, self._reason(error), left_validity=left)

    def _reason(self, error: Exception) -> str:
        """Return the stored log messages of the FMU. If there are none, return FMPy's message."""
        self._fatal |= getattr(error, "status", None) == FATAL
        messages = "; ".join(map(one_line, self._messages))
        self._messages.clear()
        return messages or one_line(error, 300)

    # Life cycle

    def enter_initialization(self, start: float, values: Mapping[str, Array]) -> None:
        try:
            for name, value in values.items():
                self._set(name, value)
            if self.version == 2:
                self._slave.setupExperiment(startTime=start)
                self._slave.enterInitializationMode()
            else:
                self._slave.enterInitializationMode(startTime=start)
        except (FMICallException, OSError) as error:
            raise ComponentError(f"component {self.name}: {self._reason(error)}") from error

    def exit_initialization(self) -> None:
        try:
            self._slave.exitInitializationMode()
        except (FMICallException, OSError) as error:
            raise ComponentError(
                f"component {self.name} cannot be initialised: {self._reason(error)}"
            ) from error

    def _set(self, name: str, value: Array) -> None:
        variables = self._variables[name]
        references = [variable.valueReference for variable in variables]
        numbers = [float(x) for x in value]
        kind = variables[0].type
        if kind == "Real":
            self._slave.setReal(references, numbers)
        elif kind == "Float64":
            self._slave.setFloat64(references, numbers)
        elif kind == "Boolean":
            self._slave.setBoolean(references, [bool(x) for x in numbers])
        elif kind in ("Integer", "Enumeration") and self.version == 2:
            self._slave.setInteger(references, [int(x) for x in numbers])
        elif kind in ("Enumeration", "Int64"):
            self._slave.setInt64(references, [int(x) for x in numbers])
        elif kind == "Int32":
            self._slave.setInt32(references, [int(x) for x in numbers])
        else:
            raise ComponentError(
                f"component {self.name}: variable {name} is of type {kind}; a value can be set only for a variable of type Real, Float64, Integer, Int32, Int64, Boolean or Enumeration"
            )

    # Used by the C core through cosim/freeflyer/master/native.py

    @property
    def instance(self) -> int:
        """Address of the FMU's instance."""
        return int(getattr(self._slave.component, "value", self._slave.component))

    def address(self, call: str) -> int:
        """Return the address of a function of the FMU's library."""
        return int(ctypes.cast(getattr(self._slave.dll, call), ctypes.c_void_p).value or 0)

    def references(self, names: Sequence[str]) -> NDArray[np.uint32]:
        """Return the value references of the ports `names`, one for each model variable.

        An FMI 2.0 array has one model variable for each element. An FMI 3.0 array is one model
        variable. Raises ComponentError if a variable is not real.
        """
        variables = self._reals(names)
        return np.array([variable.valueReference for variable in variables], dtype=np.uint32)

    def count_moments_by(self, moment: Callable[[], int]) -> None:
        """Set the function `moment`, which returns the number of the present instant of the run.

        The first log message at an instant discards the log messages of earlier instants.
        """
        self._moment = moment

    def failure(self, call: str, status: int) -> StepFailed:
        """Return the exception for a failure in the C core.

        The C core called the FMI function `call`, and this function returned `status`.
        """
        if self._noted_at != self._moment():
            self._messages.clear()
        if call == "fmi2DoStep" and status == DISCARD and self._terminate_requested():
            return StepFailed(self.name, TERMINATE_REQUESTED)
        return self._failed(FMICallException(call, status))

    # Used by the Python master

    def _reals(self, names: Sequence[str]) -> list[ModelVariable]:
        variables = [variable for name in names for variable in self._variables[name]]
        unsupported = [variable.name for variable in variables if variable.type not in REAL]
        if unsupported:
            raise ComponentError(
                f"component {self.name}: {unsupported[0]} is not a real variable; only real variables can be connected"
            )
        return variables

    def _bound(self, names: Sequence[str], buffer: Array) -> tuple[Any, int, Any, int]:
        """Return the value references and a pointer to `buffer`, each followed by its length.

        Later calls of the FMU use the memory of both arrays. Therefore the component keeps both
        arrays in `_buffers`.
        """
        variables = self._reals(names)
        references = (ctypes.c_uint32 * len(variables))(
            *(variable.valueReference for variable in variables)
        )
        pointer = buffer.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
        self._buffers.append((references, buffer))
        return references, len(variables), pointer, buffer.size

    def bind_inputs(self, names: Sequence[str], buffer: Array) -> Callable[[], None]:
        references, count, pointer, size = self._bound(names, buffer)
        slave, instance = self._slave, self._slave.component
        if self.version == 2:
            return self._guarded(lambda: slave.fmi2SetReal(instance, references, count, pointer))
        return self._guarded(
            lambda: slave.fmi3SetFloat64(instance, references, count, pointer, size)
        )

    def bind_outputs(self, names: Sequence[str], buffer: Array) -> Callable[[], None]:
        references, count, pointer, size = self._bound(names, buffer)
        slave, instance = self._slave, self._slave.component
        if self.version == 2:
            return self._guarded(lambda: slave.fmi2GetReal(instance, references, count, pointer))
        return self._guarded(
            lambda: slave.fmi3GetFloat64(instance, references, count, pointer, size)
        )

    def _guarded(self, call: Callable[[], object]) -> Callable[[], None]:
        def guarded() -> None:
            try:
                call()
            except (FMICallException, OSError) as error:
                raise self._failed(error) from error

        return guarded

    def step(self, time: float, size: float) -> None:
        try:
            if self.version == 2:
                self._slave.fmi2DoStep(self._slave.component, time, size, 1)
            elif self._slave.doStep(time, size)[1]:
                raise StepFailed(self.name, TERMINATE_REQUESTED)
        except FMICallException as error:
            if self.version == 2 and error.status == DISCARD and self._terminate_requested():
                raise StepFailed(self.name, TERMINATE_REQUESTED) from error
            raise self._failed(error) from error
        except OSError as error:
            raise self._failed(error) from error
        if self._messages:
            self._messages.clear()

    def _terminate_requested(self) -> bool:
        try:
            return bool(self._slave.getBooleanStatus(fmi2.fmi2Terminated))
        except (FMICallException, OSError):
            return False

    def close(self) -> None:
        slave, self._slave = self._slave, None
        if slave is not None:
            # An instance may reject terminate() after a failed step, but it must still be freed.
            # After the status FATAL, neither terminate() nor freeInstance() may be called.
            if not self._fatal:
                with contextlib.suppress(FMICallException, OSError):
                    slave.terminate()
                slave.freeInstance()
            _listeners.pop(self._listener, None)
            self._remove_python_modules()
            _remove_paths(self._directory)
            if self._fatal:
                unpacked.remove(self._directory)
            else:
                unpacked.give_back(self._directory)
