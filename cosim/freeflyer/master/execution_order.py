"""The execution order of the components at an instant.

An instant is a point in time at which steps may start.

A controller computes its outputs for the start of a step. Such an output depends on inputs at the
same instant, or it is declared as sampled. A controller must be stepped before other components use
its outputs at the same instant.

A plant computes its outputs for the end of a step. Therefore the outputs of a plant at an instant
are known from the step that ends at this instant. These outputs impose no order.

A delayed connection transfers the value that its source had before the instant. Therefore a delayed
connection imposes no order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from graphlib import CycleError, TopologicalSorter

from freeflyer.fmi.component import Component
from freeflyer.foundation.errors import GraphError
from freeflyer.foundation.signal_name import split
from freeflyer.master.connection import Connection


def controllers(
    components: Mapping[str, Component],
    connections: Sequence[Connection],
    samples: Mapping[str, bool],
) -> tuple[str, ...]:
    """Return the controllers in their execution order.

    In the result, each controller comes after the controllers whose outputs it uses through
    connections that are not delayed. For `samples`, see `build`. Raises GraphError if the
    connections form an algebraic loop.
    """
    used: dict[str, set[str]] = {name: set() for name in components}
    for connection in connections:
        source, variable = split(connection.source)
        used[source].add(variable)
    early = {
        name
        for name, component in components.items()
        if _is_early(name, component, used[name], samples.get(name))
    }
    sorter: TopologicalSorter[str] = TopologicalSorter()
    for name in components:  # independent components keep the order of the scenario
        sorter.add(name)
    for connection in connections:
        (source, _), (target, _) = split(connection.source), split(connection.target)
        if source in early and not connection.delayed:
            sorter.add(target, source)
    try:
        ordered = list(sorter.static_order())
    except CycleError as error:
        # graphlib lists the components of the loop against the direction of the data flow.
        loop = " -> ".join(reversed(error.args[1]))
        raise GraphError(
            f"algebraic loop: {loop}: each component needs an output of another component at the same instant; declare one of the connections delayed"
        ) from error
    return tuple(name for name in ordered if name in early)


def _is_early(name: str, component: Component, used: set[str], samples: bool | None) -> bool:
    """Return whether a component is a controller: its outputs are values at the start of a step.

    `samples` is the declaration for this component, or None. If `samples` is None, the ports
    decide. `used` contains the outputs with a connection. Only these outputs are considered. If no
    output has a connection, all outputs are considered.

    Raises GraphError if the ports decide and `used` contains outputs of both kinds: values at the
    start of a step, and values at the end of a step.
    """
    if samples is not None:
        return samples
    outputs = [
        port
        for port in component.ports.values()
        if port.causality == "output" and (not used or port.name in used)
    ]
    prompt = [port.name for port in outputs if port.prompt]
    settled = [port.name for port in outputs if not port.prompt]
    if prompt and settled and used:
        raise GraphError(
            f"component {name}: its output {prompt[0]} depends directly on its inputs and its output {settled[0]} does not, and "
            f"both outputs are connected; declare samples = true (outputs are values at the start of a step) or samples = false (outputs "
            f"are values at the end of a step)"
        )
    return bool(prompt)
