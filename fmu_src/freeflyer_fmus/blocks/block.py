"""Block: declared variables and equations of one FMU.

The C code, both modelDescription.xml files, the documentation and the in-process block (evaluation
in Python) are derived from the block. A continuous block has derivatives. Its outputs are valid at
the end of a communication step. A sampled block has a `period`, and takes one sample per period. At
a sample, it reads its inputs at the start of the communication step and computes its outputs. It
holds its outputs until the next sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Literal

import casadi as ca
import numpy as np

from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.foundation.units import ACCELERATION as ACCELERATION
from freeflyer.foundation.units import TWIST as TWIST
from freeflyer.foundation.units import WRENCH as WRENCH
from freeflyer_fmus.errors import BlockError
from freeflyer_fmus.robot.robot import Array, Robot, constant
from freeflyer_fmus.units import UNITS

SX = ca.SX
Units = tuple[str, ...]

POSE_ERROR: Units = ("m",) * 3 + ("rad",) * 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Variable:
    """Variable of a block: a scalar (`size` 1, `is_array` False) or an array of `size` elements.

    `units` has one entry per element. `start` contains the start values; it is None for an output.
    A `tunable` parameter can be changed between steps. `choices` are the names of the options of an
    enumeration. A `local` state is not visible as an output. `nominal` is the typical magnitude of
    a state.
    """

    name: str
    size: int
    is_array: bool
    units: Units
    description: str
    causality: Literal["parameter", "input", "output", "state"]
    start: Array | None = None
    tunable: bool = False
    kind: Literal["real", "boolean", "enumeration"] = "real"
    choices: tuple[str, ...] = ()
    local: bool = False
    nominal: float = 1.0

    @property
    def element_names(self) -> tuple[str, ...]:
        """Names of the elements in FMI 2.0's structured naming."""
        return (
            tuple(f"{self.name}[{i + 1}]" for i in range(self.size))
            if self.is_array
            else (self.name,)
        )

    @property
    def fmi_causality(self) -> str:
        """Causality in FMI, which has no states."""
        if self.causality == "state":
            return "local" if self.local else "output"
        return self.causality


@dataclass(frozen=True, kw_only=True, eq=False)
class Requirement:
    """Condition `value >= minimum`, or `value > minimum` if `strict` is True.

    If the condition is violated, the FMU returns an error. The error message contains `subject`
    (what the value is), the value and `remedy` (what the user can do). If `initially` is True, the
    condition is checked only at initialisation and after a change of parameters. If `connection` is
    True, the condition shows that an input is connected. In initialization mode, this condition is
    not checked before the end of the mode, because the master may read outputs before it sets
    inputs.
    """

    value: SX
    minimum: SX
    strict: bool
    subject: str
    remedy: str
    initially: bool
    connection: bool


class Block:
    """Variables and equations of one FMU.

    `name` is the name of the FMU, an identifier, and `description` a text in its model description.
    Raises BlockError for another name.

    Each declaration of a variable returns a symbol. The equations are expressions in these symbols.
    The block derives functions from the equations. Their arguments are (t, p, u, x). t is the time
    [s]. p is a flat vector of all parameters, u of all inputs, and x of all states.

    `robot` is the robot whose motion the block computes, or None. Its FMUs then contain the scene
    of this robot for viewers.
    """

    robot: Robot | None = None

    def __init__(self, name: str, description: str) -> None:
        if not (name.isidentifier() and name.isascii()):
            raise BlockError(
                f"block {name!r}: the name must be an identifier (letters a to z, digits, underscores)"
            )
        self.name, self.description = name, description
        self.variables: dict[str, Variable] = {}
        self.symbols: dict[str, SX] = {}
        self.time = SX.sym("t")
        self.requirements: list[Requirement] = []
        self.terminals: dict[str, dict[str, str]] = {}
        self._next: dict[str, SX] = {}
        self._initial: dict[str, SX] = {}
        self._outputs: dict[str, SX] = {}
        self._kinds: set[str] = set()
        self.period: str | None = None
        self.step_parameter: str | None = None
        self.default_step = 1e-3

    # Declarations

    def parameter(
        self,
        name: str,
        start: object,
        unit: str | Units,
        description: str,
        *,
        tunable: bool = False,
        minimum: float | None = None,
        above: float | None = None,
    ) -> SX:
        """Declare a parameter.

        `minimum` is the smallest allowed value. `above` is an exclusive lower bound. Raises
        BlockError if the start value violates the bound.
        """
        symbol = self._declare(name, "parameter", start, unit, description, tunable=tunable)
        bound = minimum if minimum is not None else above
        if bound is not None:
            given = self.start_of(name)
            if not ((given >= bound).all() if above is None else (given > bound).all()):
                raise BlockError(
                    f"block {self.name}: the start value of {name!r} is {given}, which violates its bound {bound:g}"
                )
            for element, part in zip(
                self.variables[name].element_names, ca.vertsplit(symbol), strict=True
            ):
                self.require(
                    part,
                    bound,
                    f"parameter {element}",
                    "correct the parameter",
                    strict=above is not None,
                )
        return symbol

    def choice(
        self,
        name: str,
        options: type[IntEnum],
        start: IntEnum,
        description: str,
        *,
        tunable: bool = True,
    ) -> SX:
        """Declare a parameter of FMI type Enumeration.

        Raises BlockError if the options are not numbered from 1.
        """
        choices = tuple(option.name for option in options)
        if [int(option) for option in options] != list(range(1, len(choices) + 1)):
            raise BlockError(f"block {self.name}: the options of {name!r} must be numbered from 1")
        return self._declare(
            name,
            "parameter",
            int(start),
            "1",
            description,
            tunable=tunable,
            kind="enumeration",
            choices=choices,
        )

    def switch(self, name: str, start: bool, description: str, *, tunable: bool = True) -> SX:
        """Declare a parameter of FMI type Boolean."""
        return self._declare(
            name, "parameter", float(start), "1", description, tunable=tunable, kind="boolean"
        )

    def input(self, name: str, start: object, unit: str | Units, description: str) -> SX:
        """Declare an input.

        The input is a scalar if `start` is a scalar. The input is an array if `start` is a
        sequence.
        """
        return self._declare(name, "input", start, unit, description)

    def state(
        self,
        name: str,
        start: object,
        unit: str | Units,
        description: str,
        *,
        local: bool = False,
        nominal: float = 1.0,
    ) -> SX:
        """Declare a state.

        The FMU has an output of the same name, or a local variable if `local` is True. The start
        value of the state can be set. `nominal` is the typical magnitude of the state. Solvers
        scale their tolerances by `nominal`.
        """
        if not 0.0 < nominal < float("inf"):
            raise BlockError(
                f"block {self.name}: the nominal value of {name!r} is {nominal}; a number above 0 is expected"
            )
        return self._declare(name, "state", start, unit, description, local=local, nominal=nominal)

    def sampled_every(self, name: str, start: float, description: str) -> SX:
        """Make the block a sampled block. The fixed parameter `name` is the period [s]."""
        if self.period is not None:
            raise BlockError(
                f"block {self.name}: the block already has the period {self.period!r}; a second period {name!r} is not possible"
            )
        self.period = name
        self.default_step = start
        return self.parameter(name, start, "s", description, above=0.0)

    def integrated_every(self, name: str, start: float, description: str) -> SX:
        """Let the fixed parameter `name` set the integration step [s] of a continuous block."""
        self.step_parameter = name
        return self.parameter(name, start, "s", description, minimum=1e-6)

    def terminal(self, name: str, *variables: str, **members: str) -> None:
        """Declare a terminal: a group of inputs and outputs that are connected together.

        If two terminals are connected, each output is connected to the input with the same member
        name. For a variable in `variables`, the member name is the name of the variable. `members`
        contains the other variables, each as MEMBER_NAME = name of the variable.
        """
        group = {variable: variable for variable in variables} | members
        for variable in group.values():
            if variable not in self.variables or self.variables[variable].causality == "parameter":
                raise BlockError(
                    f"block {self.name}: terminal {name!r} has the member {variable!r}, which is neither an input nor an output"
                )
        self.terminals[name] = group

    # Equations

    def initial(self, state: str, value: SX) -> None:
        """Set the value of a state after initialisation.

        The value is an expression of parameters, inputs and start values. In this expression, the
        symbol of a state is the start value of the state.
        """
        self._assign(self._initial, state, value)

    def derivative(self, state: str, value: SX) -> None:
        """Set dx/dt of a state in a continuous block."""
        self._kinds.add("derivative")
        self._assign(self._next, state, value)

    def update(self, state: str, value: SX) -> None:
        """Set the value x(k) of a state at sample k, in a sampled block.

        The value is an expression of the states x(k-1) before this sample and of the inputs at
        sample k. The symbol of a state is x(k-1).
        """
        self._kinds.add("update")
        self._assign(self._next, state, value)

    def output(self, name: str, value: SX, unit: str | Units, description: str) -> None:
        """Declare an output and its equation. The output has the size of `value`."""
        value = SX(value)
        self._declare(
            name, "output", np.zeros(value.numel()), unit, description, is_array=value.numel() > 1
        )
        self._assign(self._outputs, name, value)

    def require(
        self,
        value: SX,
        minimum: SX | float,
        subject: str,
        remedy: str,
        *,
        strict: bool = False,
        initially: bool = False,
        connection: bool = False,
    ) -> None:
        """Add a requirement (see `Requirement` for the arguments).

        The requirement is checked at every sample or step. If the requirement depends only on
        parameters, or if `initially` is True, the requirement is checked only at initialisation and
        after a change of parameters.
        """
        self.requirements.append(
            Requirement(
                value=SX(value),
                minimum=SX(minimum),
                strict=strict,
                subject=subject,
                remedy=remedy,
                initially=initially,
                connection=connection,
            )
        )

    # Derived functions and properties

    @property
    def is_sampled(self) -> bool:
        """Whether the block takes samples. A continuous block has derivatives instead."""
        return self.period is not None

    @property
    def differentiated(self) -> list[Variable]:
        """The states that have derivatives: those of a continuous block."""
        return [] if self.is_sampled else self.having("state")

    def having(self, *causalities: str) -> list[Variable]:
        """Return the variables with one of these causalities, in order of declaration."""
        return [
            variable for variable in self.variables.values() if variable.causality in causalities
        ]

    @property
    def arguments(self) -> list[SX]:
        """Symbols (t, p, u, x) of the arguments of all functions."""
        return [
            self.time,
            self._symbols("parameter"),
            self._symbols("input"),
            self._symbols("state"),
        ]

    @cached_property
    def static_requirements(self) -> list[Requirement]:
        """Requirements that depend only on parameters, and requirements with `initially`.

        They are checked only at initialisation and after a change of parameters.
        """
        others = ca.vertcat(self.time, *self.arguments[2:])
        return [
            r
            for r in self.requirements
            if r.initially or not ca.depends_on(ca.vertcat(r.value, r.minimum), others)
        ]

    @cached_property
    def running_requirements(self) -> list[Requirement]:
        return [r for r in self.requirements if r not in self.static_requirements]

    @cached_property
    def functions(self) -> dict[str, ca.Function]:
        """Functions of (t, p, u, x) by name.

        All blocks: `initial` -> x, `check` -> margins of the static requirements.
        Sampled blocks: `update` -> x(k), outputs, margins.
        Continuous blocks: `derivatives` -> dx/dt, `outputs` -> outputs, margins.
        A margin is the pair (value, minimum) of a requirement.
        Raises BlockError if equations are missing or inconsistent.
        """
        # Check that each state has an equation, and that all equations are of the right kind.
        names = [variable.name for variable in self.having("state")]
        missing = [name for name in names if name not in self._next]
        if missing:
            raise BlockError(f"block {self.name}: no equation for the states {', '.join(missing)}")
        wrong = "derivative" if self.is_sampled else "update"
        if wrong in self._kinds:
            kind = "sampled" if self.is_sampled else "continuous"
            raise BlockError(f"block {self.name}: it is {kind}, so `{wrong}` is not applicable")
        if not self._outputs and not names:
            raise BlockError(f"block {self.name}: it has neither outputs nor states")
        self._check_symbols()
        # Make the functions. They share common subexpressions.
        initial = ca.vertcat(*(self._initial.get(name, self.symbols[name]) for name in names))
        rates = ca.vertcat(*(self._next[name] for name in names))
        outputs = ca.vertcat(*self._outputs.values())
        margins = self._margins(self.running_requirements)
        derived = {
            "initial": self._function("initial", [initial]),
            "check": self._function("check", [self._margins(self.static_requirements)]),
        }
        if self.is_sampled:
            return derived | {"update": self._function("update", [rates, outputs, margins])}
        return derived | {
            "derivatives": self._function("derivatives", [rates]),
            "outputs": self._function("outputs", [outputs, margins]),
        }

    @cached_property
    def linked(self) -> int:
        """Number of linked outputs: all output elements up to the last one that is in a terminal.

        The elements are in the order of declaration. The number is 0 for a sampled block. The
        outputs in terminals are usually connected. If a master reads only linked outputs, the FMU
        does not compute the other outputs.
        """
        members = {variable for group in self.terminals.values() for variable in group.values()}
        ends = [
            self.offset(v.name) + v.size
            for v in self.having("output")
            if v.name in members and not self.is_sampled
        ]
        return max(ends, default=0)

    @cached_property
    def linked_outputs(self) -> ca.Function:
        """Function (t, p, u, x) -> linked outputs, margins. Only continuous blocks have it."""
        outputs, margins = self.functions["outputs"].call(self.arguments)
        return self._function("linked_outputs", [outputs[: self.linked], margins])

    @cached_property
    def sensitivities(self) -> dict[str, ca.Function]:
        """Directional derivatives of every function except `check`. Margins are left out.

        J is the Jacobian of the results of NAME by its arguments (t, p, u, x).
        `forward_NAME`: (t, p, u, x, seed) -> J seed. The seed has the size of the arguments.
        `reverse_NAME`: (t, p, u, x, seed) -> J^T seed. The seed has the size of the results.
        """
        derived = {}
        knowns = ca.vertcat(*self.arguments)
        for name, function in self.functions.items():
            if name == "check":
                continue
            results = function.call(self.arguments)
            value = ca.vertcat(*(results[:2] if name == "update" else results[:1]))
            for kind, count in (("forward", knowns.numel()), ("reverse", value.numel())):
                seed = SX.sym("seed", count)
                product = ca.jtimes(value, knowns, seed, kind == "reverse")
                derived[f"{kind}_{name}"] = self._function(
                    f"{kind}_{name}", [product], [*self.arguments, seed]
                )
        return derived

    @cached_property
    def dependencies(self) -> dict[str, list[str]]:
        """Direct dependencies of every element of an output, a state or a derivative.

        A dependency is `time`, an element of an input, or an element of a state of a continuous
        block. Its value at an instant affects the dependent element at the same instant.
        """
        knowns = ["time", *self._elements("input")]
        given = ca.vertcat(self.time, self._symbols("input"))
        if not self.is_sampled:
            knowns += self._elements("state")
            given = ca.vertcat(given, self._symbols("state"))
        return self._sparsity(self._unknowns(), given, knowns)

    @cached_property
    def initial_dependencies(self) -> dict[str, list[str]]:
        """Dependencies at the end of initialisation.

        At the end of initialisation, the states depend on parameters, inputs and start values.
        """
        knowns = [
            "time",
            *(
                name
                for causality in ("parameter", "input", "state")
                for name in self._elements(causality)
            ),
        ]
        start = {
            v.name: self._initial.get(v.name, self.symbols[v.name]) for v in self.having("state")
        }
        expressions = self._unknowns()
        together = ca.vertcat(SX(0, 1), *expressions.values())
        if start:
            together = ca.substitute(together, self._symbols("state"), ca.vertcat(*start.values()))
        substituted = dict(zip(expressions, ca.vertsplit(together), strict=True))
        # Before the first sample, an importer that reads a state gets the initial value.
        for variable in self.having("state"):
            substituted |= zip(
                variable.element_names, ca.vertsplit(start[variable.name]), strict=True
            )
        return self._sparsity(substituted, ca.vertcat(*self.arguments), knowns)

    def _elements(self, *causalities: str) -> list[str]:
        return [name for variable in self.having(*causalities) for name in variable.element_names]

    def _unknowns(self) -> dict[str, SX]:
        """Return the expressions of all outputs, states and derivatives `der(...)`, by element."""
        found: dict[str, SX] = {}
        for variable in self.having("output", "state"):
            # After a sample, an importer that reads a state of a sampled block gets the updated
            # value, which depends on the inputs.
            expression = self._outputs.get(variable.name)
            if expression is None:
                expression = (
                    self._next[variable.name] if self.is_sampled else self.symbols[variable.name]
                )
            found |= zip(variable.element_names, ca.vertsplit(expression), strict=True)
        for variable in self.differentiated:
            names = [f"der({element})" for element in variable.element_names]
            found |= zip(names, ca.vertsplit(self._next[variable.name]), strict=True)
        return found

    @staticmethod
    def _sparsity(
        unknowns: dict[str, SX], given: SX, knowns: Sequence[str]
    ) -> dict[str, list[str]]:
        rows = ca.vertcat(SX(0, 1), *unknowns.values())
        pattern = ca.jacobian_sparsity(rows, given)
        result: dict[str, list[str]] = {name: [] for name in unknowns}
        names = list(unknowns)
        for row, column in zip(*pattern.get_triplet(), strict=True):
            result[names[row]].append(knowns[column])
        return {name: sorted(found, key=knowns.index) for name, found in result.items()}

    def has_start(self, variable: Variable) -> bool:
        """Return whether the start value of `variable` can be set.

        The start value of an output cannot be set. The start value of a state cannot be set if the
        initial value of this state is computed only from other values.
        """
        if variable.causality == "output":
            return False
        expression = self._initial.get(variable.name)
        return expression is None or bool(ca.depends_on(expression, self.symbols[variable.name]))

    def start_of(self, name: str) -> Array:
        """Return the start value (size) of a variable."""
        start = self.variables[name].start
        assert start is not None
        return start

    def start_values(self, *causalities: str) -> Array:
        """Return the start values of all variables with this causality, as one vector."""
        parts = [
            variable.start for variable in self.having(*causalities) if variable.start is not None
        ]
        return np.concatenate(parts) if parts else np.zeros(0)

    def offset(self, name: str) -> int:
        """Return the index of the variable's first element in the flat vector of its causality."""
        position = 0
        for variable in self.having(self.variables[name].causality):
            if variable.name == name:
                return position
            position += variable.size
        raise KeyError(name)

    # Internal

    def _declare(
        self,
        name: str,
        causality: Literal["parameter", "input", "output", "state"],
        start: object,
        unit: str | Units,
        description: str,
        *,
        is_array: bool | None = None,
        **more: object,
    ) -> SX:
        # The name becomes a C identifier. The description becomes one line of XML and of Markdown.
        if name in self.variables or name == "time" or not (name.isidentifier() and name.isascii()):
            raise BlockError(
                f"block {self.name}: {name!r} is not an identifier, is declared twice, or is the reserved name 'time'"
            )
        if not (isinstance(description, str) and description.isprintable()):
            raise BlockError(
                f"block {self.name}: the description of {name!r} must be one line of printable text"
            )
        # The start value determines the size, and whether the variable is an array.
        values = np.atleast_1d(np.asarray(start, dtype=np.float64)).ravel()
        array = np.ndim(np.asarray(start)) > 0 if is_array is None else is_array
        units = (unit,) * values.size if isinstance(unit, str) else tuple(unit)
        for one in units:
            if one not in UNITS:
                raise BlockError(
                    f"block {self.name}: {name!r} has the unit {one!r}, which is unknown{did_you_mean(one, UNITS)}"
                )
        if len(units) != values.size:
            raise BlockError(
                f"block {self.name}: {name!r} has {values.size} elements but {len(units)} units"
            )
        self.variables[name] = Variable(
            name=name,
            size=values.size,
            is_array=array,
            units=units,
            description=description,
            causality=causality,
            start=None if causality == "output" else constant(values, (values.size,)),
            **more,  # type: ignore[arg-type]
        )
        self.symbols[name] = SX.sym(name, values.size)
        return self.symbols[name]

    def _assign(self, into: dict[str, SX], name: str, value: SX) -> None:
        if name not in self.variables or self.variables[name].size != value.numel() or name in into:
            raise BlockError(
                f"block {self.name}: the equation for {name!r} is not valid: the variable is undeclared, has another equation, or has another size"
            )
        into[name] = ca.densify(ca.reshape(SX(value), -1, 1))

    def _symbols(self, causality: str) -> SX:
        return ca.vertcat(
            SX(0, 1), *(self.symbols[variable.name] for variable in self.having(causality))
        )

    def _margins(self, requirements: Sequence[Requirement]) -> SX:
        return ca.densify(
            ca.vertcat(SX(0, 1), *(ca.vertcat(r.value, r.minimum) for r in requirements))
        )

    def _function(
        self, name: str, results: Sequence[SX], arguments: Sequence[SX] | None = None
    ) -> ca.Function:
        shared = ca.cse([ca.densify(SX(result)) for result in results])
        return ca.Function(f"{self.name}_{name}", arguments or self.arguments, shared)

    def _check_symbols(self) -> None:
        used = ca.symvar(
            ca.vertcat(
                SX(0), *self._next.values(), *self._outputs.values(), *self._initial.values()
            )
        )
        known = {str(symbol) for argument in self.arguments for symbol in ca.vertsplit(argument)}
        undeclared = sorted({str(symbol) for symbol in used} - known)
        if undeclared:
            raise BlockError(
                f"block {self.name}: the equations use undeclared symbols {', '.join(undeclared)}"
            )
