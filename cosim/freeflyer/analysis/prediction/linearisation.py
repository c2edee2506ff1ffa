"""Linearise the loop of a scenario around an operating point, with directional derivatives of FMUs.

The passivity controllers are disabled, because they are nonlinear. As long as the loop is passive,
they have no effect anyway. A preview is disabled, too: the set point is at rest, but a later
reference may move. The signal roles of the scenario name two things: the variables that are
quaternions, and the parameters that switch passivity controllers and previews on and off.

The prediction varies the period of one controller. This controller is called the scanned
controller. All other controllers have the step T_m (`Roles.tick`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np

from freeflyer.analysis.prediction import lifting, tangent
from freeflyer.analysis.prediction.controller import LinearisedController
from freeflyer.analysis.prediction.lifting import Indices, Inputs, Law, Loop, Plant
from freeflyer.analysis.prediction.loop_roles import Roles, check_signals, roles_of
from freeflyer.analysis.prediction.sensitivity import DifferentiableFmu
from freeflyer.fmi.component import Array
from freeflyer.foundation.clock import seconds
from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.signal_name import split
from freeflyer.master import graph, schedule
from freeflyer.master.connection import Connection
from freeflyer.master.master import Master
from freeflyer.scenario import parameters
from freeflyer.scenario.assemble import System, find_fmu
from freeflyer.scenario.parameters import Values
from freeflyer.scenario.scenario import ComponentSpec, Scenario
from freeflyer.scenario.signal_roles import SWITCHES, SignalRoles
from freeflyer.scenario.steps import communication_steps

Point = Mapping[str, Array]
"""An operating point: the values of signals at one point in time. The keys are COMPONENT.VARIABLE.

`LoopModel.recorded` lists the signals.
"""


class LoopModel:
    """The loop of a loaded scenario. `opened` creates this object.

    `plant_at` linearises the plant. After `prepare`, `loop` linearises the controllers, and
    combines them with the linearised plant. `shortest` is the shortest period of the scanned
    controller that all controllers accept, in units of T_m. A controller can reject a period, for
    example if its filter is slower. `shortest` is at most the period of the scenario.
    """

    def __init__(
        self,
        scenario: Scenario,
        system: System,
        fmus: Mapping[str, DifferentiableFmu],
        scanned: str | None,
    ) -> None:
        """Prepare the functions that compute the derivatives of all FMUs.

        Raises CosimError if the loop cannot be linearised.
        """
        self.scenario, self.system, self.fmus = scenario, system, fmus
        self.roles = roles_of(scenario, system, fmus, scanned)
        check_signals(scenario.roles, self.roles.plant, fmus)
        self.quaternions = scenario.roles.quaternions(self.roles.plant)
        self._linked = self._linked_parameters()
        self.shortest = 1

        # The signals of the loop are the connected outputs. The outputs of the plant come first,
        # then the outputs of the controllers.
        plant, used = (
            self.roles.plant,
            {connection.source for connection in system.wiring.connections},
        )
        self.signals: dict[str, slice] = {}
        width = 0
        for name in (plant, *self.roles.laws):
            for port in fmus[name].ports.values():
                if f"{name}.{port.name}" in used:
                    self.signals[f"{name}.{port.name}"] = slice(width, width + port.size)
                    width += port.size
        self._width = width

        # The functions for the derivatives are prepared only once, because they are called often
        # along a trajectory.
        self._inputs = {name: self._inputs_of(name) for name in (plant, *self.roles.laws)}
        fmu, states = fmus[plant], fmus[plant].states
        self._outputs = [name for name in fmu.ports if f"{plant}.{name}" in used]
        self._check_feedthrough(fmu)
        rates = [f"der({name})" for name in states]
        self._rates_by_state, self._rates_by_input = (
            fmu.bind_derivative(rates, k) for k in (states, self.driven(plant))
        )
        self._outputs_by_state = fmu.bind_derivative(self._outputs, states)
        self.controllers = {
            name: LinearisedController(
                fmus[name],
                self.driven(name),
                [split(s)[1] for s in self.signals if split(s)[0] == name],
                self.roles.tick,
            )
            for name in self.roles.laws
        }

    def values(self, period: int) -> Values:
        """Return all parameter values [SI] for this period [ns] of the scanned controller."""
        values = {name: dict(own) for name, own in self.system.values.items()}
        for name, parameter in self._linked:
            values[name][parameter] = np.array([seconds(period)])
        return values

    def started(self, period: int, stop: int, record_every: int) -> Master:
        """Return an initialised master.

        `period` is the period of the scanned controller, `stop` the end of the run, and
        `record_every` the time between two rows of the record. All are in ns. Raises CosimError.
        """
        steps = dict(self.system.steps)
        steps[self.roles.scanned] = period
        variable_step = {name: component.variable_step for name, component in self.fmus.items()}
        limits = [limit for limit in self.scenario.limits if split(limit.signal)[0] in self.fmus]
        master = Master(
            self.system.wiring, schedule.build(steps, stop, record_every, variable_step), limits
        )
        master.initialise(self.values(period))
        return master

    def recorded(self) -> list[str]:
        """Return the names of the signals of an operating point.

        The signals are the plant's states, and all outputs that are connected to an input.
        """
        states = [f"{self.roles.plant}.{name}" for name in self.fmus[self.roles.plant].states]
        return list(
            dict.fromkeys(
                [*states, *(connection.source for connection in self.system.wiring.connections)]
            )
        )

    def plant_at(self, point: Point) -> Plant:
        """Return the plant linearised at a point, with rotation vectors instead of quaternions."""
        name = self.roles.plant
        fmu = self.fmus[name]
        fmu.restart(
            {
                **self.system.values[name],
                **{state: point[f"{name}.{state}"] for state in fmu.states},
                **self._inputs_at(name, point),
            }
        )
        into, back = self.chart(point)
        A, B = back @ self._rates_by_state() @ into, back @ self._rates_by_input()
        return lifting.plant(
            A, B, self._outputs_by_state() @ into, self._inputs[name], seconds(self.roles.tick)
        )

    def chart(self, point: Point) -> tuple[Array, Array]:
        """Return the tangent chart of the plant's states (`tangent.chart`).

        Raises ScenarioError if a state has the form of a unit quaternion, but is not declared as a
        quaternion.
        """
        states = self.fmus[self.roles.plant].states
        values = [point[f"{self.roles.plant}.{state}"] for state in states]
        for state, value in zip(states, values, strict=True):
            is_unit = value.size == 4 and abs(np.linalg.norm(value) - 1.0) < 1e-9
            if is_unit and state not in self.quaternions:
                raise ScenarioError(
                    f"component {self.roles.plant}: its state {state} has four elements of norm 1; a quaternion must be "
                    f'declared: [roles] orientations = ["{self.roles.plant}.{state}"]'
                )
        return tangent.chart(states, values, self.quaternions)

    def outputs_of_plant(self, names: Sequence[str], point: Point) -> Array:
        """Return the derivative of the outputs `names` with respect to the plant's states.

        The derivative is taken at the point of the last call of `plant_at`. Pass the same `point`
        here: it is used only for the charts. All quaternions are replaced by rotation vectors, in
        the states and in the outputs.
        """
        fmu = self.fmus[self.roles.plant]
        into, _ = self.chart(point)
        values = [point[f"{self.roles.plant}.{name}"] for name in names]
        _, back = tangent.chart(names, values, self.quaternions)
        return back @ fmu.bind_derivative(names, fmu.states)() @ into

    def plant_value(self, name: str) -> Array:
        """Return the value of an output of the plant at the point of the last `plant_at` call."""
        value = np.zeros(self.fmus[self.roles.plant].ports[name].size)
        self.fmus[self.roles.plant].bind_outputs([name], value)()
        return value

    def states_of_plant(self, names: Sequence[str], point: Point) -> Indices:
        """Return the indices of the states `names` in the coordinates of the chart (`chart`)."""
        states, places, first = self.fmus[self.roles.plant].states, {}, 0
        for state in states:
            size = point[f"{self.roles.plant}.{state}"].size
            size -= state in self.quaternions
            places[state] = range(first, first + size)
            first += size
        return np.array([place for name in names for place in places[name]])

    def inputs_of_plant(self, names: Sequence[str]) -> Indices:
        """Return the indices of the plant's inputs `names` in the columns of B of the plant.

        B has a column for each element of the inputs that are connected to signals of the loop.
        Raises ScenarioError if one of the `names` is not such an input.
        """
        places, first = {}, 0
        for name in self.driven(self.roles.plant):
            size = self.fmus[self.roles.plant].ports[name].size
            places[name] = range(first, first + size)
            first += size
        for name in names:
            if name not in places:
                raise ScenarioError(
                    f"{self.roles.plant}.{name} has no source in the loop; a connection from a controller is expected"
                )
        return np.array([place for name in names for place in places[name]])

    def loop(self, plant: Plant, point: Point, period: int) -> Loop:
        """Return the loop linearised at a point.

        `plant` is the result of `plant_at` for this point. `period` is the period of the scanned
        controller [ns].
        """
        values, laws = self.values(period), []
        for name in self.roles.laws:
            places = [place for signal, place in self.signals.items() if split(signal)[0] == name]
            sample, between = self.controllers[name].samples(
                self._start(name, values, point), self.period_of(name, period), period
            )
            law = Law(
                name=name,
                sample=sample,
                between=between,
                inputs=self._inputs[name],
                first=places[0].start if places else 0,
                last=places[-1].stop if places else 0,
                slow=name == self.roles.scanned,
            )
            laws.append(law)
        tick, parallel = seconds(self.roles.tick), self.scenario.exchange == "parallel"
        return Loop(plant=plant, laws=tuple(laws), width=self._width, tick=tick, parallel=parallel)

    def prepare(self, point: Point) -> None:
        """Find the memories of the controllers and the shortest period, near a point.

        Raises CosimError.
        """
        period = self.roles.period
        values = self.values(period)
        for name, controller in self.controllers.items():
            controller.find_memory(
                self._start(name, values, point), self.period_of(name, period), period
            )
        self.shortest = self._shortest_period(point) // self.roles.tick

    def _shortest_period(self, point: Point) -> int:
        tick, own = self.roles.tick, self.roles.period
        concerned = {self.roles.scanned, *(name for name, _ in self._linked)} & set(self.roles.laws)
        for period in range(tick, own, tick):
            values = self.values(period)
            if all(
                self.controllers[name].accepts(
                    self._start(name, values, point), self.period_of(name, period)
                )
                for name in concerned
            ):
                return period
        return own

    def responses(self, name: str, point: Point, count: int, disturbed: int) -> tuple[Array, Array]:
        """Return the simulated response of a controller (`LinearisedController.responses`)."""
        period = self.roles.period
        return self.controllers[name].responses(
            self._start(name, self.values(period), point),
            self.period_of(name, period),
            count,
            disturbed,
        )

    def period_of(self, name: str, period: int) -> int:
        """Return the period [ns] of a controller, if the scanned controller has the `period`."""
        return period if name == self.roles.scanned else self.roles.tick

    def _start(self, name: str, values: Values, point: Point) -> dict[str, Array]:
        return {**values[name], **self._inputs_at(name, point)}

    # Inputs

    def connections_of(self, name: str) -> list[Connection]:
        """Return the connections from signals of the loop to inputs of the component.

        Connections from other components, for example from a trajectory generator, are left out.
        The values of these connections do not depend on the loop.
        """
        return [c for c in self.system.wiring.inputs_of(name) if c.source in self.signals]

    def driven(self, name: str) -> list[str]:
        """Return the inputs of a component that are connected to signals of the loop.

        The Jacobians of this component with respect to its inputs have their columns in the order
        of this list.
        """
        return [split(connection.target)[1] for connection in self.connections_of(name)]

    def _inputs_of(self, name: str) -> Inputs:
        sources: list[int] = []
        delayed: list[bool] = []
        for connection in self.connections_of(name):
            place = self.signals[connection.source]
            sources += range(place.start, place.stop)
            delayed += [connection.delayed] * (place.stop - place.start)
        return Inputs(
            sources=np.array(sources, dtype=np.intp), delayed=np.array(delayed, dtype=np.bool_)
        )

    def _inputs_at(self, name: str, point: Point) -> dict[str, Array]:
        return {split(c.target)[1]: point[c.source] for c in self.system.wiring.inputs_of(name)}

    # Checks

    def _linked_parameters(self) -> list[tuple[str, str]]:
        """Return (component, parameter) for all parameters that depend on the scanned period.

        These parameters are found by a comparison of all parameter values for two periods.
        """
        roles, found = self.roles, []
        one, other = (_resolved(self.scenario, self.fmus, roles, k * roles.tick) for k in (1, 2))
        for name, values in one.items():
            found += [
                (name, parameter)
                for parameter in values
                if not np.array_equal(values[parameter], other[name][parameter])
            ]
        return found

    def _check_feedthrough(self, fmu: DifferentiableFmu) -> None:
        """Raise ScenarioError if an output depends on inputs, or if a state is not an output."""
        for name in self._outputs:
            if fmu.ports[name].prompt:
                raise ScenarioError(
                    f"component {fmu.name} has continuous states, but its output {name} depends directly on its inputs; the prediction "
                    f"needs a plant whose outputs depend only on its states"
                )
        for name in fmu.states:
            if fmu.ports[name].causality != "output":
                raise ScenarioError(
                    f"component {fmu.name}: its state {name} is not an output; the prediction needs all states of the plant as outputs"
                )


@contextmanager
def opened(scenario: Scenario, scanned: str | None = None) -> Iterator[LoopModel]:
    """Load the loop of a scenario. Close its components when the context ends. Raises CosimError.

    `scanned` is the name of the scanned controller (default: the slowest controller).
    """
    fmus: dict[str, DifferentiableFmu] = {}
    try:
        for spec in (specs := _connected(scenario)):
            fmus[spec.name] = _differentiable(spec, scenario)
        quiet = replace(
            scenario,
            components=tuple(
                _switched_off(spec, fmus[spec.name], scenario.roles) for spec in specs
            ),
        )
        samples = {spec.name: spec.samples for spec in specs if spec.samples is not None}
        values = parameters.resolve(quiet, fmus)
        wiring = graph.build(fmus, quiet.connections, samples, quiet.exchange)
        steps = communication_steps(quiet, fmus, values)
        system = System(components=fmus, values=values, steps=steps, wiring=wiring)
        yield LoopModel(quiet, system, fmus, scanned)
    finally:
        for fmu in fmus.values():
            with suppress(Exception):
                fmu.close()


def _connected(scenario: Scenario) -> list[ComponentSpec]:
    """Return the components that have connections. Other components are not part of the loop."""
    ends = {
        split(end)[0]
        for connection in scenario.connections
        for end in (connection.source, connection.target)
    }
    return [spec for spec in scenario.components if spec.name in ends]


def _differentiable(spec: ComponentSpec, scenario: Scenario) -> DifferentiableFmu:
    if spec.kind != "fmu":
        raise ScenarioError(
            f"component {spec.name} is of kind {spec.kind!r}; the prediction needs FMUs with directional derivatives (kind 'fmu')"
        )
    return DifferentiableFmu(spec.name, find_fmu(spec.name, spec.options, scenario.directory))


def _switched_off(spec: ComponentSpec, fmu: DifferentiableFmu, roles: SignalRoles) -> ComponentSpec:
    switches = []
    for role in SWITCHES:
        for name in (n for n in roles.variables(role, spec.name) if n in fmu.ports):
            if not (fmu.ports[name].boolean and fmu.ports[name].settable):
                raise ScenarioError(f"roles.{role}: {spec.name}.{name} is not a Boolean parameter")
            switches.append(name)
    return replace(spec, parameters={**spec.parameters, **dict.fromkeys(switches, False)})


def _resolved(
    scenario: Scenario, fmus: Mapping[str, DifferentiableFmu], roles: Roles, period: int
) -> Values:
    changed = tuple(
        replace(spec, parameters={**spec.parameters, roles.parameter: seconds(period)})
        if spec.name == roles.scanned
        else spec
        for spec in scenario.components
    )
    return parameters.resolve(replace(scenario, components=changed), fmus)
