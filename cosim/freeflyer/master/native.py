"""Execution of a master in C.

The C code in cosim/freeflyer/master/core is called the core. It steps co-simulation FMUs without
Python's global interpreter lock (GIL). For any other component, it calls Python. The record is
bit-for-bit identical to the record of `Master.run`.
"""

from __future__ import annotations

import time
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from cffi import FFI
from numpy.typing import NDArray

from freeflyer.fmi.component import Array
from freeflyer.fmi.fmu import CALLS, TERMINATE_REQUESTED, FmuComponent
from freeflyer.foundation.clock import seconds
from freeflyer.foundation.errors import ComponentError, CosimError, StepFailed
from freeflyer.foundation.interrupts import interrupts
from freeflyer.master.master import Master, Outcome, Progress, message_of
from freeflyer.master.slaves import Places, Slave

DIRECTORY = Path(__file__).parent / "core"
LIBRARY = DIRECTORY / "prebuilt" / "core.so"
LONGEST = 2**53
"""Upper limit of the stop time [ns].

The core converts a time [ns] to a double, and divides this double by 1e9. Below this limit, the
double is exact. Therefore the result in seconds is the same as in Python.
"""
PAUSE = 0.05
"""Approximate wall-clock time [s] of one call of the core.

After each call, the progress is updated and interrupts are checked.
"""
SET, STEP, GET, LIMIT = range(4)


@cache
def _library() -> tuple[FFI, Any]:
    header = (DIRECTORY / "core.h").read_text(encoding="utf-8")
    ffi = FFI()
    ffi.cdef("\n".join(line for line in header.splitlines() if not line.startswith("#")))
    try:
        return ffi, ffi.dlopen(str(LIBRARY))
    except OSError as error:
        raise CosimError(
            f"the native core {LIBRARY} cannot be loaded ({error}). The core is built when the package is installed. Reinstall the "
            f"package, or use --master python"
        ) from error


def run(master: Master, progress: Progress | None = None) -> Outcome:
    """Run a master in C, with the same result as `Master.run`.

    `progress` is called now and then with the simulated time [s]. Raises ComponentError if a
    component fails at instant 0.
    """
    return Run(master).run(progress)


class Run:
    """One run of a master in C. This class copies the master into the C structures of core.h.

    C pointers do not keep Python objects alive. Therefore the list `_alive` contains all Python
    objects whose memory the structures use.
    """

    def __init__(self, master: Master) -> None:
        if master.schedule.stop >= LONGEST:
            raise ComponentError(
                f"a run of {seconds(master.schedule.stop):g} s is too long for the native core; less than "
                f"{LONGEST / 1e9:.0f} s is expected; use --master python"
            )
        self.master = master
        self._ffi, self._library = _library()
        self._alive: list[Any] = []
        self._order = [master.slaves[name] for name in (*master.graph.first, *master.graph.then)]
        self._failure: BaseException | None = None
        self._cause: str | None = None
        self._core = self._ffi.new("Core *")
        self._fill()

    def run(self, progress: Progress | None) -> Outcome:
        master, core, end = self.master, self._core, self._library
        outcome = master.outcome()
        start = time.perf_counter()
        chunk, ended = 64, end.PAUSED
        with interrupts() as interrupted:
            while ended == end.PAUSED:
                if interrupted:
                    self.cancel()
                before = time.perf_counter()
                ended = self._library.core_run(core, min(core.at + chunk, core.ticks + 1))
                # Adapt the number of instants per call, so that a call takes approximately PAUSE.
                spent = time.perf_counter() - before
                chunk = max(1, min(2 * chunk, int(chunk * PAUSE / max(spent, 1e-9))))
                if progress and ended == end.PAUSED:
                    progress(seconds(core.at * core.tick))
        outcome.wall = time.perf_counter() - start
        master.record.rows = core.rows
        outcome.steps = {
            slave.component.name: int(core.slave[i].steps) for i, slave in enumerate(self._order)
        }
        outcome.steps = {name: outcome.steps[name] for name in master.graph.components}
        outcome.interrupted = bool(core.cancel) and core.at < core.ticks
        if ended == end.LIMIT_EXCEEDED:
            outcome.diverged, outcome.cause = True, self._cause
        elif ended == end.FAILED:
            error = self._step_failure()
            master.reject_failure_at_start(core.at, error)
            outcome.stopped_by(error)
        elif outcome.interrupted:
            outcome.cause = "interrupted by the user"
        master.finish(outcome, core.at, whole=ended != end.FAILED)
        return outcome

    def cancel(self) -> None:
        """Make the next instant the last instant. Any thread may call this method."""
        self._core.cancel = 1

    # Callbacks from C

    def _called(self, index: int, operation: int, moment: float, size: float) -> int:
        """Execute an operation of a component in Python, or check a limit.

        The core calls this method. `index` is the number of the component or of the limit. For
        STEP, `moment` is the time at the start of the step and `size` is its length [s]. The result
        is 1 if the run must stop, otherwise 0.
        """
        try:
            if operation == LIMIT:
                self._cause = self.master.watches[index]()
                return int(self._cause is not None)
            slave = self._order[index]
            if operation == STEP:
                slave.component.step(moment, size)
            else:
                (slave.write if operation == SET else slave.read)()
        except BaseException as error:  # no exception can pass through C; see `_step_failure`
            self._failure = error
            return 1
        return 0

    def _step_failure(self) -> StepFailed:
        """Return the failure that stopped the core.

        If the failure is a StepFailed, it is returned. Any other Exception that a component raised
        in a step is converted to StepFailed. All other exceptions, for example KeyboardInterrupt,
        are raised again.
        """
        core = self._core
        if self._failure is not None:
            error = self._failure
            if isinstance(error, StepFailed):
                return error
            if core.operation != STEP or not isinstance(error, Exception):
                raise error
            return StepFailed(self._order[core.index].component.name, message_of(error))
        component = self._order[core.index].component
        assert isinstance(component, FmuComponent)
        if core.status == self._library.TERMINATE_REQUESTED:
            return StepFailed(component.name, TERMINATE_REQUESTED)
        return component.failure(CALLS[component.version][core.operation], core.status)

    # Filling the structures

    def _fill(self) -> None:
        core, master = self._core, self.master
        slaves, schedule = master.slaves, master.schedule
        core.slave = self._new("Slave[]", len(self._order))
        core.slaves, core.first = len(self._order), len(master.graph.first)
        for place, slave in enumerate(self._order):
            self._fill_slave(core.slave[place], slave)
        core.call = self._keep(self._ffi.callback("Call", self._called))
        core.delays = len(slaves.delayed)
        core.before, core.now = (
            self._pointers(self._addresses(array, slaves.delayed))
            for array in (slaves.before, slaves.now)
        )
        core.limit = self._new("Limit[]", len(master.watches))
        core.limits = len(master.watches)
        for place, watch in enumerate(master.watches):
            limit = core.limit[place]
            limit.value, limit.count = self._doubles(watch.view), watch.view.size
            limit.bound, limit.minimum, limit.euclidean = (
                watch.limit.bound,
                watch.limit.is_minimum,
                watch.limit.euclidean,
            )
        core.tick, core.ticks, core.record_ratio = (
            schedule.tick,
            schedule.ticks,
            schedule.record_ratio,
        )
        core.columns, core.recorded = (
            len(master.columns),
            self._pointers(self._addresses(slaves.now, master.columns)),
        )
        times, rows = master.record.storage
        core.row_time, core.row = self._doubles(times), self._doubles(rows)

    def _fill_slave(self, native: Any, slave: Slave) -> None:
        component, slaves = slave.component, self.master.slaves
        native.ratio, native.wires = slave.ratio, slave.buffer.size
        targets = [self._addresses(slave.buffer, wire.into) for wire in slave.wires]
        sources = [
            self._addresses(slaves.before if wire.delayed else slaves.now, wire.places)
            for wire in slave.wires
        ]
        native.target, native.source = self._pointers(*targets), self._pointers(*sources)
        native.input_value, native.output_value = (
            self._doubles(slave.buffer),
            self._doubles(slave.view),
        )
        native.inputs.values, native.outputs.values = slave.buffer.size, slave.view.size
        native.used.values = sum(
            component.ports[variable].size for variable in slave.outputs[: slave.used]
        )
        # The core calls the FMI functions of an FmuComponent directly, and not its methods. A
        # subclass overrides methods. Therefore the core must call Python for a subclass.
        if type(component) is FmuComponent:
            self._fill_fmu(native, slave, component)

    def _fill_fmu(self, native: Any, slave: Slave, component: FmuComponent) -> None:
        version = native.fmi = component.version
        native.instance = self._ffi.cast("void *", component.instance)
        for call, function in zip(("set", "step", "get"), CALLS[version], strict=True):
            kind = f"{call.capitalize()}{version} *"
            setattr(native, f"{call}{version}", self._ffi.cast(kind, component.address(function)))
        inputs, outputs = component.references(slave.targets), component.references(slave.outputs)
        native.input, native.output = (
            self._keep(self._ffi.from_buffer("uint32_t[]", array)) for array in (inputs, outputs)
        )
        native.inputs.references, native.outputs.references = inputs.size, outputs.size
        native.used.references = component.references(slave.outputs[: slave.used]).size
        core = self._core
        component.count_moments_by(lambda: int(core.at))

    def _keep(self, thing: Any) -> Any:
        self._alive.append(thing)
        return thing

    def _new(self, kind: str, count: int) -> Any:
        return self._keep(self._ffi.new(kind, count))

    def _doubles(self, array: Array) -> Any:
        return self._keep(self._ffi.from_buffer("double[]", array))

    @staticmethod
    def _addresses(array: Array, places: Places) -> NDArray[np.uintp]:
        return (array.ctypes.data + array.itemsize * places).astype(np.uintp)

    def _pointers(self, *addresses: NDArray[np.uintp]) -> Any:
        """Return a C array of pointers to doubles. It contains all given addresses in order."""
        every = np.concatenate([np.zeros(0, dtype=np.uintp), *addresses])
        return self._ffi.cast("double **", self._keep(self._ffi.from_buffer(every)))
