"""Plan of a sweep: the checks before the first run, and the settings of each run."""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

from freeflyer.analysis.sweep import evaluation, stability
from freeflyer.analysis.sweep.designs import UNCHANGED, Axis, Levels, NamedDesigns, Target
from freeflyer.analysis.sweep.file import ONE_CASE, Sweep
from freeflyer.fmi.component import Array, Port
from freeflyer.foundation.errors import CosimError, ScenarioError
from freeflyer.foundation.signal_name import split
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.foundation.units import DIMENSIONLESS, converted, factor
from freeflyer.master import schedule
from freeflyer.scenario import assemble, description, metrics, parameters, scenario
from freeflyer.scenario.assemble import System
from freeflyer.scenario.inheritance import Raw
from freeflyer.scenario.overrides import assign
from freeflyer.scenario.scenario import Scenario
from freeflyer.scenario.steps import communication_steps

Assignments = tuple[tuple[str, Any], ...]
"""Targets (left sides of `--set`) with their values."""


@dataclass(frozen=True, kw_only=True)
class Setup:
    """Data that all runs of a sweep share. These data are sent to the workers."""

    tables: Raw
    path: Path
    cases: Mapping[str, Mapping[str, Any]]
    fmi: int | None
    evaluation: str | None
    files: Mapping[str, str]
    """SHA-256 of the files of each component, and of the evaluation."""

    def scenario(self, case: str, assignments: Assignments = ()) -> Scenario:
        """Return the scenario of one run. Raises ScenarioError.

        The values of the case are set first, then `assignments`.
        """
        tables = copy.deepcopy(self.tables)
        for target, value in self.cases[case].items():
            assign(tables, target, value, f"[cases.{case}] {target}")
        for target, value in assignments:
            assign(tables, target, value, target)
        return scenario.from_tables(tables, self.path)


@dataclass(frozen=True, kw_only=True)
class Run:
    """One run of a plan. It is sent to a worker."""

    number: int
    case: str
    assignments: Assignments


class Plan:
    """All runs of a sweep, numbered from 0.

    The runs of one design in all cases have consecutive numbers. Therefore an unfinished sweep has
    the results of all cases for almost every design that it has started.
    The constructor loads the scenario of each case. In each case, it checks the first design, the
    last design and each value of each axis. If an axis is an interval, the constructor checks the
    two ends of the interval. Raises CosimError if a check fails.
    """

    def __init__(self, sweep: Sweep, fmi: int | None = None) -> None:
        self.sweep, self.designs = sweep, sweep.designs
        tables, path = scenario.tables(sweep.scenario, sweep.settings, sweep.path.parent)
        setup = Setup(
            tables=tables,
            path=path,
            cases=sweep.cases,
            fmi=fmi,
            evaluation=sweep.evaluation,
            files={},
        )
        first = next(iter(sweep.cases))
        with self._naming(first):
            self.evaluation = evaluation.load(sweep.evaluation) if sweep.evaluation else None
            plain = setup.scenario(first)
            with assemble.loaded(plain, fmi) as system:
                self.setup = replace(setup, files=files(plain, system, sweep.evaluation))
        self._own: dict[tuple[str, Target], tuple[Array, Port]] = {}
        self.units: dict[str, str] = {}
        for case in sweep.cases:
            with self._naming(case):
                self._check(case)
        self.errors = [f"{name}_error_{measure.unit}" for name, measure in plain.errors.items()]
        self.energies = list(plain.observed_energy)

    @property
    def axes(self) -> tuple[Axis, ...]:
        return self.designs.axes

    def __len__(self) -> int:
        return len(self.designs) * len(self.sweep.cases)

    def design(self, number: int) -> tuple[int, str, tuple[Any, ...]]:
        """Return the design number, the case, and the values of all axes for the run `number`."""
        design, place = divmod(number, len(self.sweep.cases))
        return design, list(self.sweep.cases)[place], self.designs[design]

    def run(self, number: int) -> Run:
        _, case, values = self.design(number)
        return Run(number=number, case=case, assignments=self.assignments(case, values))

    @property
    def content(self) -> dict[str, Any]:
        """All data that the results depend on. Two plans with equal content are the same sweep."""
        values = hashlib.sha256()
        for number in range(len(self.designs)):
            values.update(repr(self.designs[number]).encode())
        content = {
            "scenario": self.setup.tables,
            **({"evaluation": self.sweep.evaluation} if self.sweep.evaluation else {}),
            "cases": self.sweep.cases,
            "axes": {
                str(axis.target): {
                    "unit": axis.unit,
                    "relative": axis.relative,
                    "also": [str(target) for target in axis.also],
                    **({"not_in": list(axis.not_in)} if axis.not_in else {}),
                    "in_grid": axis in self.designs.grid,
                }
                for axis in self.axes
            },
            "designs": {"count": len(self.designs), "sha256": values.hexdigest()},
            **(
                {"named_designs": self.designs.settings}
                if isinstance(self.designs, NamedDesigns)
                else {}
            ),
            "fmi": self.setup.fmi,
            "files": dict(self.setup.files),
            "criterion": stability.criterion(),
            "package": metrics.versions()["freeflyer-cosim"],
        }
        result: dict[str, Any] = json.loads(json.dumps(content, default=str))
        return result

    def levels(self, target: str) -> tuple[Any, ...]:
        """Return the values of the grid axis that varies `target`."""
        return next(
            levels
            for axis, levels in zip(self.designs.grid, self.designs.levels, strict=True)
            if str(axis.target) == target
        )

    @staticmethod
    def first_of(axis: Axis) -> Any:
        return axis.source.values[0] if isinstance(axis.source, Levels) else axis.source.at(0.0)

    # Settings of a run

    def assignments(self, case: str, values: tuple[Any, ...]) -> Assignments:
        """Return the assignments for the run of one design in a case.

        `values` is the design: one value for each axis.
        """
        if isinstance(self.designs, NamedDesigns):
            # A case is a strategy: what it sets is not changed by a design.
            fixed = self.sweep.cases[case]
            given = self.designs.settings[values[0]].items()
            return tuple((target, value) for target, value in given if target not in fixed)
        found: dict[str, Any] = {}
        vectors: dict[str, Array] = {}
        pairs = [
            (axis, target, value)
            for axis, value in zip(self.axes, values, strict=True)
            for target in axis.targets
            if value is not UNCHANGED and case not in axis.not_in
        ]
        for axis, target, value in pairs:
            if (case, target) not in self._own:
                found[target.name] = (
                    value if axis.unit is None else {"value": value, "unit": axis.unit}
                )
                continue
            own, port = self._own[case, target]
            vector = vectors.setdefault(target.name, own.copy())
            first, last = target.elements or (1, own.size)
            place = slice(first - 1, last)
            if axis.relative:
                vector[place] = [product(number, value) for number in own[place]]
            elif axis.unit is None:
                vector[place] = value
            else:
                vector[place] = [
                    converted(value, factor(axis.unit, unit or DIMENSIONLESS))
                    for unit in port.units[place]
                ]
            found[target.name] = [float(number) for number in vector]
        return tuple(found.items())

    # Checks before the first run

    @contextmanager
    def _naming(self, case: str) -> Iterator[None]:
        """Add the sweep file and the case to the message of an error."""
        try:
            yield
        except CosimError as error:
            where = f"sweep {self.sweep.path}" + (f", case {case}" if case != ONE_CASE else "")
            raise ScenarioError(f"{where}: {error}") from error

    def _check(self, case: str) -> None:
        plain = self.setup.scenario(case)
        with assemble.loaded(plain, self.setup.fmi) as system:
            for axis in () if isinstance(self.designs, NamedDesigns) else self.axes:
                for target in axis.targets if case not in axis.not_in else ():
                    self._look_up(case, axis, target, plain, system)
            self.designs = self.designs.mapped(self._in_unit_of_parameter)
            for values in self._tried():
                changed = self.setup.scenario(case, self.assignments(case, values))
                given = parameters.resolve(changed, system.components)
                steps = communication_steps(changed, system.components, given)
                variable = {
                    name: component.variable_step for name, component in system.components.items()
                }
                schedule.build(steps, changed.stop, changed.record_every, variable)
            metrics.check(plain, system.components)
        # Load the first design in the same way as a run. This finds all other errors.
        with assemble.loaded(
            self.setup.scenario(case, self.assignments(case, self.designs[0])), self.setup.fmi
        ):
            pass

    def _tried(self) -> Iterator[tuple[Any, ...]]:
        """Yield the first design, the last design, and copies of the first design.

        In a copy, the value of one axis is replaced. There is one copy for each value of each axis.
        If an axis is an interval, only the two ends of the interval are used.
        """
        first, last = self.designs[0], self.designs[len(self.designs) - 1]
        yield first
        yield last
        for place, axis in enumerate(self.axes):
            ends = (
                axis.source.values
                if isinstance(axis.source, Levels)
                else (axis.source.at(0.0), axis.source.at(1.0))
            )
            for value in ends:
                yield (*first[:place], value, *first[place + 1 :])

    def _in_unit_of_parameter(self, axis: Axis) -> Axis:
        """Return an axis with numbers in the unit of its parameter, if this unit is known."""
        unit = self.units.get(str(axis.target))
        try:
            return axis.in_unit(unit) if unit else axis
        except ValueError as error:
            expected = "a number without unit" if unit == DIMENSIONLESS else unit
            raise ScenarioError(f"{axis.target}: {error}; {expected} is expected") from error

    def _look_up(
        self, case: str, axis: Axis, target: Target, plain: Scenario, system: System
    ) -> None:
        """Store the unit of a target of `axis`.

        Also store the scenario's value, if the axis has factors (`relative`) or if the target is
        only some elements of a vector. `plain` is the scenario of the case, without the values of a
        design. `system` has the loaded components of this scenario.
        Raises ScenarioError if the target cannot be varied.
        """
        needed = axis.relative or target.elements is not None
        # Reject targets that have no effect. A parameter of [robot] is looked up in the first
        # component that takes this parameter from [robot].
        component, parameter = split(target.name)
        if component in ("devices", "facility") or target.name == "record.signals":
            raise ScenarioError(
                f"{target.name} has no effect on the results of a sweep; a parameter of a component is expected"
            )
        if component == "robot" and component not in system.components:
            component = _first_user(plain, system, parameter)
        # A target that is not a variable (stop_s, step_s) cannot have elements or factors.
        if (
            component not in system.components
            or parameter not in system.components[component].ports
        ):
            if needed:
                known = [name for name, port in _ports(system, component).items() if port.settable]
                raise ScenarioError(
                    f"there is no parameter {target.name!r}{did_you_mean(parameter, known)}"
                )
            self.units[str(target)] = (
                "s" if parameter == "step_s" or target.name in ("stop_s", "record.every_s") else ""
            )
            return
        # The value in the scenario is needed only for factors and for targets with elements.
        port = system.components[component].ports[parameter]
        first, last = target.elements or (1, port.size)
        if last > port.size:
            raise ScenarioError(f"{target}: {target.name} has {port.size} elements")
        real = port.real and not (port.boolean or port.choices)
        own = port.units[first - 1] or DIMENSIONLESS if real else ""
        self.units[str(target)] = DIMENSIONLESS if axis.relative else axis.unit or own
        if not needed:
            return
        if not real:
            raise ScenarioError(
                f"{target} is not a real parameter; a sweep cannot vary its elements or multiply it by a factor"
            )
        value = parameters.current(system.components, system.values, component, parameter)
        self._own[case, target] = (value.copy(), port)


def product(number: float, by: float) -> float:
    """Return the product of two decimal numbers: 0.3 x 1.5 is 0.45, and not the float below it.

    A period must be a whole number of nanoseconds.
    """
    return float(Decimal(repr(float(number))) * Decimal(repr(float(by))))


def _ports(system: System, component: str) -> Mapping[str, Port]:
    return system.components[component].ports if component in system.components else {}


def _first_user(plain: Scenario, system: System, parameter: str) -> str:
    """Return the first component that takes `parameter` from [robot].

    If no component takes this parameter from [robot], "robot" is returned.
    """
    for spec in plain.components:
        port = system.components[spec.name].ports.get(parameter)
        if port is not None and port.settable and parameter not in spec.parameters:
            return spec.name
    return "robot"


def files(plain: Scenario, system: System, evaluated_by: str | None) -> dict[str, str]:
    """Return the SHA-256 of the files of each component, and of the evaluation `evaluated_by`."""
    found = description.files(plain, system.components)
    own = evaluation.source(evaluated_by)
    if own is not None:
        found["(evaluation)"] = hashlib.sha256(own.read_bytes()).hexdigest()
    return found
