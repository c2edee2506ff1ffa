"""Load the components of a scenario and build the master.

Packages register kinds of components as Python entry points of the group freeflyer.components. They
register folders with FMUs as entry points of the group freeflyer.fmus.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from freeflyer.fmi.component import Component
from freeflyer.fmi.fmu import FmuComponent
from freeflyer.foundation import user_object
from freeflyer.foundation.errors import ComponentError, CosimError, ScenarioError, one_line
from freeflyer.foundation.keys import Key, Keys, declared_by, declares, expecting, file_path, read
from freeflyer.foundation.plugins import described, load, plugins
from freeflyer.foundation.signal_name import split
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.master import graph, schedule
from freeflyer.master.master import Master
from freeflyer.scenario import parameters
from freeflyer.scenario.keys import COMPONENT, FACILITY
from freeflyer.scenario.parameters import Values
from freeflyer.scenario.scenario import ComponentSpec, Scenario
from freeflyer.scenario.steps import communication_steps

Factory = Callable[[str, Mapping[str, Any], Path], Component]
FMU: Keys = {
    "fmu": Key(
        file_path(".fmu"),
        "a path, or the name of a shipped FMU; default: the name of the component",
    ),
    "fmi": Key(expecting({"enum": [2, 3]}, "2 or 3 is expected"), "FMI version", default=2),
}
OF_FMUS = ("fmu", "model_exchange")
"""Kinds of components that are FMUs."""
PYTHON: Keys = {
    "object": Key(file_path(".py"), '`"FILE.py:CALLABLE"` or `"MODULE:CALLABLE"`', default="")
}


def find_fmu(name: str, options: Mapping[str, Any], directory: Path) -> Path:
    """Return the path of a component's FMU. Raises ComponentError if there is no such FMU.

    `name` is the name of the component. `directory` is the folder of the scenario.
    `options` has the keys `FMU`. A path among them is relative to `directory`.
    """
    given = read(options, FMU, ComponentError, f"component {name}: ", others=COMPONENT)
    fmu, version = str(options.get("fmu", name)), given["fmi"]
    if fmu.endswith(".fmu"):
        return directory / fmu
    known: list[str] = []
    # The FMUs of this distribution (entry point `default`) are searched first. Therefore they are
    # found even if the entry point of a third-party package fails.
    for point in sorted(
        plugins("freeflyer.fmus").values(), key=lambda point: point.name != "default"
    ):
        folder = Path(load(point)()) / f"fmi{version}"
        path = folder / f"{fmu}.fmu"
        if path.is_file():
            return path
        known += [found.stem for found in folder.glob("*.fmu")]
    raise ComponentError(
        f"component {name}: no FMU {fmu!r} is shipped for FMI {version}{did_you_mean(fmu, sorted(known))}"
    )


@declares(FMU)
def fmu_component(name: str, options: Mapping[str, Any], directory: Path) -> Component:
    return FmuComponent(name, find_fmu(name, options, directory))


@declares(FMU)
def model_exchange_component(name: str, options: Mapping[str, Any], directory: Path) -> Component:
    # Imported here because only this kind needs SciPy's integrators.
    from freeflyer.fmi.model_exchange import ModelExchangeComponent

    return ModelExchangeComponent(name, find_fmu(name, options, directory))


@declares(PYTHON)
def python_component(name: str, options: Mapping[str, Any], directory: Path) -> Component:
    """Return the component that the user's function `options["object"]` creates.

    `options["object"]` is MODULE:CALLABLE or FILE.py:CALLABLE. The path FILE.py is relative to
    `directory`, the folder of the scenario. The function is called with the name of the component.
    Raises ComponentError if the function cannot be called or does not return a component.
    """
    given = read(options, PYTHON, ComponentError, f"component {name}: ", others=COMPONENT)
    where, colon, attribute = given["object"].partition(":")
    if not colon:
        raise ComponentError(
            f"component {name}: object = 'FILE.py:CALLABLE' or 'MODULE:CALLABLE' is expected"
        )
    try:
        maker = user_object.load(f"{where}:{attribute}", directory)
    except CosimError as error:
        raise ComponentError(f"component {name}: {error}") from error
    try:
        made: Component = maker(name)
    except CosimError:
        raise
    except (Exception, SystemExit) as error:  # user code can raise anything
        raise ComponentError(
            f"component {name}: {where}:{attribute} cannot be used: {described(error)}"
        ) from error
    if not hasattr(made, "ports") or not hasattr(made, "step"):
        raise ComponentError(
            f"component {name}: {where}:{attribute} returned a {type(made).__name__}; a component is expected"
        )
    return made


def _factory(spec: ComponentSpec) -> Factory:
    points = plugins("freeflyer.components")
    if spec.kind not in points:
        raise ComponentError(
            f"component {spec.name}: there is no kind {spec.kind!r}{did_you_mean(spec.kind, points)}"
        )
    factory: Factory = load(points[spec.kind], f"component {spec.name} of kind {spec.kind!r}")
    return factory


def check_devices(scenario: Scenario) -> None:
    """Check the keys of the devices, and the table [facility]. Raises CosimError."""
    for spec in scenario.devices:
        keys = declared_by(_factory(spec))
        if keys is not None:
            read(spec.options, keys, ComponentError, f"device {spec.name}: ", others=COMPONENT)
    if scenario.facility:
        import_module(FACILITY).read(scenario.facility)


def make(spec: ComponentSpec, directory: Path, fmi: int | None) -> Component:
    """Create a component from its specification. Raises ComponentError.

    `directory` is the folder of the scenario. `fmi`, if given, overrides the FMI version.
    """
    factory = _factory(spec)
    options = dict(spec.options)
    if fmi is not None and spec.kind in OF_FMUS:
        options["fmi"] = fmi
    try:
        return factory(spec.name, options, directory)
    except CosimError:
        raise
    except Exception as error:  # kinds of third-party packages can raise anything
        text = one_line(error)
        raise ComponentError(
            text if text.startswith("component ") else f"component {spec.name}: {text}"
        ) from error


def _check_inputs(wiring: graph.Graph, values: Values) -> None:
    """Raise ScenarioError if an input has both a value and a connection."""
    for connection in wiring.connections:
        component, variable = split(connection.target)
        if variable in values.get(component, {}):
            raise ScenarioError(
                f"{connection.target} cannot be set: it is driven by the connection from {connection.source}"
            )


def _recorded(scenario: Scenario, components: Mapping[str, Component]) -> Callable[[str], bool]:
    """Return a function whose argument is a signal. It returns whether this signal is recorded.

    Raises ScenarioError if a pattern of `[record] signals` matches no output.
    """
    outputs = {
        f"{name}.{port.name}"
        for name, component in components.items()
        for port in component.ports.values()
        if port.causality == "output" and port.real
    }
    chosen = {
        signal
        for measure in scenario.errors.values()
        for signal in (measure.actual, measure.desired)
    }
    chosen |= set(scenario.observed_energy.values())
    for pattern in scenario.record_signals:
        found = fnmatch.filter(outputs, pattern)
        if not found:
            raise ScenarioError(
                f"[record] signals: no output matches {pattern!r}{did_you_mean(pattern, outputs)}"
            )
        chosen |= set(found)
    return chosen.__contains__


@dataclass(frozen=True, kw_only=True)
class System:
    """A checked scenario with loaded components. The components are not initialised.

    `values` are the values that the scenario sets, by component and variable. `steps` has the
    communication step [ns] of each component. `wiring` is the graph of components and connections.
    """

    components: Mapping[str, Component]
    values: Values
    steps: Mapping[str, int]
    wiring: graph.Graph


@contextmanager
def loaded(scenario: Scenario, fmi: int | None = None) -> Iterator[System]:
    """Load and check a scenario. Close its components when the context ends. Raises CosimError.

    `fmi`, if given, overrides the FMI version of all FMUs.
    """
    components: dict[str, Component] = {}
    try:
        for spec in scenario.components:
            components[spec.name] = make(spec, scenario.directory, fmi)
        values = parameters.resolve(scenario, components)
        samples = {
            spec.name: spec.samples for spec in scenario.components if spec.samples is not None
        }
        connections = [
            connection
            for connection in scenario.connections
            if not connection.optional or graph.has_source(components, connection)
        ]
        wiring = graph.build(components, connections, samples, scenario.exchange)
        _check_inputs(wiring, values)
        steps = communication_steps(scenario, components, values)
        yield System(components=components, values=values, steps=steps, wiring=wiring)
    finally:
        for component in components.values():
            # If one component cannot be closed, the other components are still closed. No exception
            # is raised here, because the results of the run would then be lost.
            with suppress(Exception):
                component.close()


@contextmanager
def assembled(
    scenario: Scenario, fmi: int | None = None, rows: Path | None = None
) -> Iterator[tuple[Master, Values]]:
    """Load a scenario and initialise its master. Close the components when the context ends.

    Yields the master and the values that the scenario sets. `fmi`, if given, overrides the FMI
    version of all FMUs. `rows` is a new file for the rows of the record, or None. Raises
    CosimError.
    """
    with loaded(scenario, fmi) as system:
        variable_step = {
            name: component.variable_step for name, component in system.components.items()
        }
        plan = schedule.build(system.steps, scenario.stop, scenario.record_every, variable_step)
        recorded = _recorded(scenario, system.components)
        master = Master(system.wiring, plan, scenario.limits, recorded, rows)
        master.initialise(system.values)
        yield master, system.values
