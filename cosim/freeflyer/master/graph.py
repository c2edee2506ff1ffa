"""The graph of components and connections, and its checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from freeflyer.fmi.component import Component, Port
from freeflyer.foundation.errors import GraphError
from freeflyer.foundation.signal_name import split
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.foundation.units import same
from freeflyer.master import execution_order
from freeflyer.master.connection import Connection

Exchange = Literal["sequential", "parallel"]
"""The coupling scheme of the components.

Sequential (Gauss-Seidel): a controller reads its inputs and computes its outputs at an instant.
Other components use these outputs at the same instant.
Parallel (Jacobi): at an instant, every component uses outputs of steps that ended at this instant
or before. The output of a controller is available at the end of its step. Therefore this output
reaches the other components one controller step later than in sequential exchange.
"""


@dataclass(frozen=True, kw_only=True)
class Graph:
    """Checked components and connections with their execution order.

    `first` contains the names of the controllers, and `then` contains the names of all other
    components. At an instant, the master steps the controllers one after the other. The master then
    writes the inputs of all other components. Finally it steps these components.
    """

    components: Mapping[str, Component]
    connections: tuple[Connection, ...]
    first: tuple[str, ...]
    then: tuple[str, ...]

    def inputs_of(self, component: str) -> list[Connection]:
        """Return the connections to the inputs of a component."""
        return [
            connection
            for connection in self.connections
            if split(connection.target)[0] == component
        ]


def has_source(components: Mapping[str, Component], connection: Connection) -> bool:
    """Return whether the source of a connection exists."""
    component, variable = split(connection.source)
    return component in components and variable in components[component].ports


def port(components: Mapping[str, Component], signal: str, subject: str) -> Port:
    """Return the port with the name COMPONENT.VARIABLE.

    Raises GraphError if the port does not exist. The message starts with `subject`. If a similar
    name exists, the message suggests it.
    """
    component, variable = split(signal)
    if component not in components:
        raise GraphError(
            f"{subject}: there is no component {component!r}{did_you_mean(component, components)}"
        )
    ports = components[component].ports
    if variable not in ports:
        raise GraphError(
            f"{subject}: component {component!r} has no variable {variable!r}{did_you_mean(variable, ports)}"
        )
    return ports[variable]


def expand(
    components: Mapping[str, Component], connections: Sequence[Connection]
) -> list[Connection]:
    """Replace each connection of two terminals by the connections of their members.

    Two members match if they have the same name, and if one of them is an output and the other one
    is an input. The output is connected to the input. Raises GraphError if a terminal does not
    exist, or if no members match.
    """
    single = [connection for connection in connections if not connection.of_terminals]
    given = {(connection.source, connection.target, connection.delayed) for connection in single}
    for connection in connections:
        if connection.of_terminals:
            # Omit the connections that are also declared as connections of single variables.
            members = _members(components, connection)
            single += [m for m in members if (m.source, m.target, m.delayed) not in given]
    return single


def _members(components: Mapping[str, Component], connection: Connection) -> list[Connection]:
    subject, found = f"connection {connection}", []
    ends = [
        (split(end)[0], _terminal(components, end, subject))
        for end in (connection.source, connection.target)
    ]
    for (source, ours), (target, theirs) in (ends, ends[::-1]):
        for member in ours.keys() & theirs.keys():
            output, entry = f"{source}.{ours[member]}", f"{target}.{theirs[member]}"
            kinds = [port(components, end, subject).causality for end in (output, entry)]
            if kinds == ["output", "input"]:
                found.append(Connection(source=output, target=entry, delayed=connection.delayed))
    if not found:
        raise GraphError(f"{subject}: no output of one terminal is an input of the other terminal")
    return sorted(found, key=str)


def _terminal(components: Mapping[str, Component], end: str, subject: str) -> Mapping[str, str]:
    component, name = split(end)
    if component not in components:
        raise GraphError(
            f"{subject}: there is no component {component!r}{did_you_mean(component, components)}"
        )
    terminals: Mapping[str, Mapping[str, str]] = getattr(components[component], "terminals", {})
    if name not in terminals:
        raise GraphError(
            f"{subject}: component {component!r} has no terminal {name!r}{did_you_mean(name, terminals)}"
        )
    return terminals[name]


def build(
    components: Mapping[str, Component],
    connections: Sequence[Connection],
    samples: Mapping[str, bool] | None = None,
    exchange: Exchange = "sequential",
) -> Graph:
    """Check all connections and determine the execution order.

    The ports of a component declare which outputs are values at the start of a step. `samples`
    replaces these declarations for a component. True: all its outputs are values at the start of a
    step, and the component is a controller. False: all its outputs are values at the end of a step.

    In parallel exchange, the outputs of all components are values at the end of a step. Therefore
    the components need no execution order, and `samples` and `delayed` have no effect.

    Raises GraphError if a connection is invalid or the connections form an algebraic loop.
    """
    connections = expand(components, connections)
    driven: dict[str, Connection] = {}
    for connection in connections:
        _check(components, connection)
        if connection.target in driven:
            raise GraphError(
                f"input {connection.target} has two sources: {driven[connection.target].source} and {connection.source}"
            )
        driven[connection.target] = connection
    if exchange == "parallel":
        connections = [replace(connection, delayed=False) for connection in connections]
        samples = dict.fromkeys(components, False)
    first = execution_order.controllers(components, connections, samples or {})
    then = tuple(name for name in components if name not in first)
    return Graph(components=components, connections=tuple(connections), first=first, then=then)


def _check(components: Mapping[str, Component], connection: Connection) -> None:
    subject = f"connection {connection}"
    source, target = (
        port(components, connection.source, subject),
        port(components, connection.target, subject),
    )
    if source.causality != "output":
        raise GraphError(
            f"{subject}: {connection.source} is of causality {source.causality}; an output is expected"
        )
    if target.causality != "input":
        raise GraphError(
            f"{subject}: {connection.target} is of causality {target.causality}; an input is expected"
        )
    if source.size != target.size:
        raise GraphError(f"{subject}: sizes differ: {source.size} and {target.size}")
    for index, (given, wanted) in enumerate(zip(source.units, target.units, strict=True)):
        if not same(given, wanted):
            element = f" at element {index + 1}" if source.size > 1 else ""
            raise GraphError(f"{subject}: units differ{element}: {given} and {wanted}")
