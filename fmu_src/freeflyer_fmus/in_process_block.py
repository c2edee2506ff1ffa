"""In-process block: evaluates the equations of a block in Python.

Sampling and integration are the same as in the C runtime of the FMUs, with two exceptions: the
in-process block does not check the order of calls, and it does not use compensated summation. It
needs no compiler and can be stepped in a debugger. It can replace an FMU in any scenario
(`kind = "twin"`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import casadi as ca
import numpy as np

from freeflyer.foundation.errors import ComponentError, StepFailed, one_line
from freeflyer.foundation.keys import Key, Keys, declares, file_path, read
from freeflyer.foundation.port import Port, input_writer, output_reader
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer_fmus.blocks.block import Block, Requirement, Variable
from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.blocks.user_block import load_block
from freeflyer_fmus.errors import BlockError, FmuSourceError
from freeflyer_fmus.robot.robot import Array, Robot
from freeflyer_fmus.robot.urdf import DEFAULT_ROBOT, load_robot_file, robot_path


def ports(block: Block) -> dict[str, Port]:
    """Return the ports of a block by variable name."""
    owner = {element: v.name for v in block.having("input") for element in v.element_names}
    result = {}
    for variable in block.variables.values():
        depends = {
            name
            for element in variable.element_names
            for name in block.dependencies.get(element, [])
        }
        direct = {owner[name] for name in depends if name in owner}
        started = block.has_start(variable)
        result[variable.name] = Port(
            name=variable.name,
            size=variable.size,
            causality=variable.fmi_causality,
            units=variable.units,
            start=tuple(map(float, variable.start))
            if started and variable.start is not None
            else None,
            settable=started and variable.causality != "input",
            choices=variable.choices,
            boolean=variable.kind == "boolean",
            real=variable.kind == "real",
            direct=frozenset(direct),
            sampled=block.is_sampled and variable.fmi_causality == "output",
        )
    return result


@dataclass(frozen=True, kw_only=True)
class Linearisation:
    """Matrices of a block at a point: A (n, n), B (n, m), C (p, n), D (p, m).

    n is the number of states, m of inputs, and p of outputs. Continuous block: the rates change by
    A dx + B du, and the outputs by C dx + D du. Sampled block: x(k) changes by A dx(k-1) + B du(k),
    and y(k) by C dx(k-1) + D du(k). The elements are in the order of declaration
    (docs/fmu_variables.md), in SI units. A quaternion has four elements.
    """

    A: Array
    B: Array
    C: Array
    D: Array


class InProcessBlock:
    """One instance of a block, for a loop of one's own.

    `block` is a block, or the name of a shipped one. `robot` is the robot of a shipped block
    (default: the LWR 4+ with six joints). Set parameters, start values and inputs with `set`, call
    `start`, and then `step`, or integrate `derivatives` with any solver. `value` reads a variable.
    Units are those of docs/fmu_variables.md (SI). Raises BlockError if there is no such block.
    """

    # `_vectors` contains the parameters p, the inputs u, the states x and the outputs y.

    variable_step = True

    def __init__(
        self, block: Block | str, name: str | None = None, *, robot: Robot | None = None
    ) -> None:
        if isinstance(block, str):
            if block not in BLOCKS:
                raise BlockError(
                    f"there is no block {block!r}; the shipped blocks are {', '.join(BLOCKS)}{did_you_mean(block, BLOCKS)}"
                )
            block = BLOCKS[block](robot or load_robot_file())
        if not isinstance(block, Block):
            raise BlockError(
                f"the block is {one_line(repr(block), 80)} of type {type(block).__name__}; a Block or the name of a shipped block is expected"
            )
        self.block, self.name = block, name or block.name
        self._ports = ports(block)
        self._functions = {key: _Evaluator(function) for key, function in block.functions.items()}
        self._vectors = {key: block.start_values(key) for key in ("parameter", "input", "state")}
        self._vectors["output"] = np.zeros(
            sum(variable.size for variable in block.having("output"))
        )
        self._time = self._start = 0.0
        self._samples = 0

    @property
    def ports(self) -> Mapping[str, Port]:
        """Variables by name."""
        return self._ports

    @property
    def terminals(self) -> Mapping[str, Mapping[str, str]]:
        """Terminals: member names and their variables, by the name of the terminal."""
        return self.block.terminals

    def value(self, name: str) -> Array:
        """Return a view (size) of a variable. The view always contains the present values.

        Raises BlockError if the block has no such variable.
        """
        variable = self._variable(name)
        first = self.block.offset(name)
        return self._vectors[variable.causality][first : first + variable.size]

    def _variable(self, name: str) -> Variable:
        if name not in self.block.variables:
            raise BlockError(
                f"block {self.name} has no variable {name!r}{did_you_mean(name, self.block.variables)}"
            )
        return self.block.variables[name]

    def set(self, name: str, value: object) -> None:
        """Set a parameter, an input or a state: numbers, or the name of an option.

        One number sets all elements. After initialisation, set only inputs and tunable parameters;
        the method does not check this rule. Raises BlockError if the block has no such variable.
        Raises ComponentError if it is an output, or if a value is not finite or has the wrong size.
        """
        variable = self._variable(name)
        if variable.causality == "output":
            raise ComponentError(f"{self.name}.{name} is an output, which cannot be set")
        if variable.choices and isinstance(value, str):
            if value not in variable.choices:
                raise ComponentError(
                    f"{self.name}.{name} cannot be set to {value!r}; {' or '.join(variable.choices)} is expected"
                )
            value = variable.choices.index(value) + 1
        numbers = self._numbers(name, value)
        if numbers.size not in (1, variable.size):
            raise ComponentError(
                f"{self.name}.{name} cannot be set to {numbers.size} numbers; {variable.size} are expected"
            )
        if not np.isfinite(numbers).all():
            raise ComponentError(
                f"{self.name}.{name} cannot be set to {value}: it must be a finite number"
            )
        self.value(name)[:] = numbers

    def _numbers(self, name: str, value: object) -> Array:
        """Return a number or a vector of numbers as an array. Raises ComponentError."""
        try:
            numbers = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            numbers = np.zeros((0, 0))
        if numbers.ndim > 1:
            raise ComponentError(
                f"{self.name}.{name} cannot be set to {one_line(repr(value), 80)}; a number or a vector of numbers is expected"
            )
        return numbers

    @property
    def x(self) -> Array:
        """The states (n), in the order of declaration.

        Assign a vector to set them. The outputs of a continuous block are then computed again.
        Raises ComponentError for another size.
        """
        return self._vectors["state"].copy()

    @x.setter
    def x(self, values: Array) -> None:
        self._vectors["state"][:] = self._states(values)
        if not self.block.is_sampled:
            self._outputs()

    def _states(self, values: Array) -> Array:
        states = self._numbers("x", values)
        if states.shape != self._vectors["state"].shape:
            raise ComponentError(
                f"{self.name}.x cannot be set to {states.size} numbers; {self._vectors['state'].size} are expected"
            )
        return states

    # Life cycle

    def start(self, values: Mapping[str, object] | None = None, time: float = 0.0) -> None:
        """Set parameters, start values and inputs, and initialise the block at `time` [s].

        Raises ComponentError if a value or a requirement is violated.
        """
        for name, value in (values or {}).items():
            self.set(name, value)
        self.enter_initialization(time, {})
        self.exit_initialization()

    def enter_initialization(self, start: float, values: Mapping[str, Array]) -> None:
        """Set start values, and enter the initialization mode at the time `start` [s]."""
        self._time = self._start = start
        self._samples = 0
        for name, value in values.items():
            self.set(name, value)

    def exit_initialization(self) -> None:
        """Compute the outputs. Raises ComponentError if a requirement is violated."""
        try:
            (margins,) = self._evaluate("check")
            self._require(self.block.static_requirements, margins)
            (self._vectors["state"][:],) = self._evaluate("initial")
            self._outputs()
        except StepFailed as error:
            raise ComponentError(
                f"component {self.name} cannot be initialised: {error.reason}"
            ) from error

    def step(self, time: float, size: float) -> None:
        """Advance from `time` by `size` [s].

        Raises StepFailed if a requirement is violated, or if the step skips a sample.
        """
        self._time = time
        if self.block.period is not None:
            self._sample(time, size)
        else:
            self._integrate(time, size)
        self._time = time + size
        if not self.block.is_sampled:
            self._outputs()

    def close(self) -> None:
        """Release the component."""
        pass

    def bind_inputs(self, names: Sequence[str], buffer: Array) -> Callable[[], None]:
        """Return a function that copies `buffer` into the inputs `names`."""
        return input_writer([self.value(name) for name in names], buffer)

    def bind_outputs(self, names: Sequence[str], buffer: Array) -> Callable[[], None]:
        """Return a function that copies the outputs `names` into `buffer`."""
        return output_reader([self.value(name) for name in names], buffer)

    # Stepping: the algorithm of c/step.c

    def _sample(self, time: float, size: float) -> None:
        period = float(self.value(str(self.block.period))[0])
        begin, end = round(time * 1e9), round((time + size) * 1e9)
        tolerance = 1 + (end - begin) // 100
        if begin + tolerance >= self._due(period):
            new_states, outputs, margins = self._evaluate("update")
            self._require(self.block.running_requirements, margins)
            self._vectors["state"][:], self._vectors["output"][:] = new_states, outputs
            self._samples += 1
        if end > self._due(period) + tolerance:
            raise StepFailed(
                self.name,
                f"a communication step of {size:g} s passes over a sample of this block, whose period is {period:g} s; "
                f"choose a step that divides the period",
            )

    def _due(self, period: float) -> int:
        return round(self._start * 1e9) + round(self._samples * period * 1e9)

    def _integrate(self, time: float, size: float) -> None:
        x = self._vectors["state"]
        if not x.size or size <= 0.0:
            return
        name = self.block.step_parameter
        longest = float(self.value(name)[0]) if name else self.block.default_step
        count = int(np.ceil(size / longest - 1e-9))
        h = size / count
        before = x.copy()
        for i in range(count):
            t = time + i * h
            k1 = self._rates(t, x)
            k2 = self._rates(t + 0.5 * h, x + 0.5 * h * k1)
            k3 = self._rates(t + 0.5 * h, x + 0.5 * h * k2)
            k4 = self._rates(t + h, x + h * k3)
            x += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        if not np.isfinite(x).all():
            x[:] = before
            raise StepFailed(
                self.name,
                f"the states did not stay finite in a step of {size:g} s; the step was rejected: check the inputs",
                left_validity=True,
            )

    def derivatives(self, time: float, x: Array) -> Array:
        """Return dx/dt (n) of a continuous block for states x (n), and the inputs that are set.

        Raises BlockError for a sampled block, ComponentError for another size of `x`.
        """
        self._check_continuous()
        return self._rates(time, self._states(x))

    def _check_continuous(self) -> None:
        if self.block.is_sampled:
            raise BlockError(f"block {self.name} is sampled and has no derivatives; call `step`")

    def linearise(self) -> Linearisation:
        """Return the matrices at the present time, states and inputs, exact to rounding."""
        names = ("update",) if self.block.is_sampled else ("derivatives", "outputs")
        found = [self.block.functions[name].call(self.block.arguments) for name in names]
        results = found[0][:2] if self.block.is_sampled else [found[0][0], found[1][0]]
        _, _, u, x = self.block.arguments
        matrices = [ca.jacobian(result, by) for result in results for by in (x, u)]
        numbers = ca.Function("linearise", self.block.arguments, matrices).call(
            [self._time, *(self._vectors[key] for key in ("parameter", "input", "state"))]
        )
        A, B, C, D = (np.asarray(matrix) for matrix in numbers)
        return Linearisation(A=A, B=B, C=C, D=D)

    def rates(self) -> Array:
        """Return dx/dt (n) of a continuous block at its present time, inputs and states.

        Raises BlockError for a sampled block.
        """
        self._check_continuous()
        return self._rates(self._time, self._vectors["state"])

    def _rates(self, t: float, x: Array) -> Array:
        (dx,) = self._functions["derivatives"](
            t, self._vectors["parameter"], self._vectors["input"], x
        )
        return dx

    def _outputs(self) -> None:
        if self.block.is_sampled:
            _, outputs, margins = self._evaluate("update")
        else:
            outputs, margins = self._evaluate("outputs")
        self._require(self.block.running_requirements, margins)
        self._vectors["output"][:] = outputs

    def _evaluate(self, function: str) -> list[Array]:
        return self._functions[function](
            self._time, self._vectors["parameter"], self._vectors["input"], self._vectors["state"]
        )

    def _require(self, requirements: Sequence[Requirement], margins: Array) -> None:
        for requirement, (value, minimum) in zip(requirements, margins.reshape(-1, 2), strict=True):
            if value > minimum or (value == minimum and not requirement.strict):
                continue
            bound = "more than" if requirement.strict else "at least"
            raise StepFailed(
                self.name,
                f"{requirement.subject} is {value:.6g}; {bound} {minimum:g} is expected: {requirement.remedy}",
                left_validity=True,
            )


class _Evaluator:
    """CasADi function, called through its buffer interface. Such a call converts no arrays."""

    def __init__(self, function: ca.Function) -> None:
        self._buffer, self._evaluate = cast(tuple[Any, Callable[[], None]], function.buffer())
        self._arguments = [np.zeros(function.numel_in(i)) for i in range(function.n_in())]
        self._results = [np.zeros(function.numel_out(i)) for i in range(function.n_out())]
        for i, argument in enumerate(self._arguments):
            self._buffer.set_arg(i, memoryview(cast(Any, argument)))
        for i, result in enumerate(self._results):
            self._buffer.set_res(i, memoryview(cast(Any, result)))

    def __call__(self, *arguments: Any) -> list[Array]:
        for own, given in zip(self._arguments, arguments, strict=True):
            own[...] = given
        self._evaluate()
        return [result.copy() for result in self._results]


OPTIONS: Keys = {
    "block": Key(file_path(".py"), "the name of a shipped block, or a FILE.py; default: the name of the component"),
    "robot": Key(file_path(".toml"), "the name of a shipped robot, or the path of a robot file; default: the LWR 4+ with six joints"),
}  # fmt: skip


@declares(OPTIONS)
def in_process_component(name: str, options: Mapping[str, Any], directory: Path) -> InProcessBlock:
    """Create an in-process block from a scenario's component table, whose keys are `OPTIONS`.

    Raises ComponentError for an invalid option, block or robot.
    """
    common = ("kind", "step_s", "samples", "parameters")
    read(options, OPTIONS, ComponentError, f"component {name}: ", others=common)
    try:
        source = options.get("block", name)
        path = robot_path(options["robot"], directory) if "robot" in options else DEFAULT_ROBOT
        robot = load_robot_file(path)
        block = load_block(directory / source)(robot) if source.endswith(".py") else source
        return InProcessBlock(block, name, robot=robot)
    except FmuSourceError as error:
        raise ComponentError(f"component {name}: {error}") from error
