"""Buffers for the components of a graph.

One vector contains the outputs of all components. Each component has its own buffer for its
connected inputs. A slave is a component with its input buffer and its part of the vector.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from freeflyer.fmi.component import Array, Component
from freeflyer.foundation.signal_name import split
from freeflyer.master.graph import Graph
from freeflyer.master.record import Signal

Places = NDArray[np.int64]
"""Indices of values in a buffer."""


@dataclass(frozen=True)
class Wires:
    """The values of one connection from the component `source` to a slave.

    Each value is copied: buffer[into[i]] = outputs[places[i]]. Here, `buffer` is the input buffer
    of the slave, and `outputs` is the vector of the outputs of all components.
    """

    source: str
    delayed: bool
    into: Places
    places: Places


class Slave:
    """A component with its buffers.

    `buffer` contains the values of the connected inputs one after the other, and `targets` contains
    the names of these inputs. `view` contains the values of the outputs, and `outputs` contains the
    names of these outputs. The first `used` outputs are needed by connections or limits. The other
    outputs are only recorded.

    `ratio` is the communication step in ticks. `now` is the vector of the outputs of all
    components, and `own` is the part of this vector with the outputs of this component. `before`
    contains the values for delayed connections, see `Slaves`.
    """

    def __init__(
        self,
        component: Component,
        ratio: int,
        targets: Sequence[str],
        wires: Sequence[Wires],
        outputs: Sequence[str],
        used: int,
        now: Array,
        before: Array,
        own: slice,
    ) -> None:
        self.component, self.ratio = component, ratio
        self.targets, self.wires = targets, wires
        self.outputs, self.used, self.view = outputs, used, now[own]
        # Until the first value of its source is copied, an input has the start value of its port.
        starts = [
            np.array(component.ports[target].start or [0.0] * component.ports[target].size)
            for target in targets
        ]
        self.buffer = np.concatenate([np.zeros(0), *starts])
        self._now, self._before = now, before
        self._prompt, self._delayed = (
            tuple(
                np.concatenate(
                    [
                        np.zeros(0, dtype=np.int64),
                        *(getattr(wire, end) for wire in wires if wire.delayed == delayed),
                    ]
                )
                for end in ("into", "places")
            )
            for delayed in (False, True)
        )

    @cached_property
    def write(self) -> Callable[[], None]:
        """Function that writes the buffer to the component's inputs."""
        return self.component.bind_inputs(self.targets, self.buffer) if self.targets else _nothing

    @cached_property
    def read(self) -> Callable[[], None]:
        """Function that reads all outputs of the component into `view`."""
        return self.component.bind_outputs(self.outputs, self.view) if self.outputs else _nothing

    def take_inputs(self) -> None:
        """Copy the source values of all connections to the buffer.

        For a delayed connection, this is the value from before the present instant.
        """
        into, places = self._prompt
        if into.size:
            self.buffer[into] = self._now[places]
        into, places = self._delayed
        if into.size:
            self.buffer[into] = self._before[places]

    def take_first_inputs(self, ready: set[str]) -> None:
        """Copy the source values of the connections whose source component is in `ready`.

        `ready` contains the names of the components that are already initialised.
        """
        for wire in self.wires:
            if wire.source in ready:
                self.buffer[wire.into] = self._now[wire.places]

    def take_present_inputs(self) -> None:
        """Copy the present source values of all connections, including delayed connections."""
        for wire in self.wires:
            self.buffer[wire.into] = self._now[wire.places]


class Slaves:
    """All slaves by name.

    `now` is the vector of the present outputs of all components. `before` has the same layout.
    `before` contains the values from before the present instant, but only for the outputs that are
    sources of delayed connections. `delayed` contains the indices of these outputs.

    `ratios` contains the communication step of each component in ticks. `watched` contains the
    names of the signals with limits.
    """

    def __init__(
        self, graph: Graph, ratios: Mapping[str, int], watched: Sequence[str] = ()
    ) -> None:
        used = {connection.source for connection in graph.connections} | set(watched)
        outputs = {
            name: _outputs(name, component, used) for name, component in graph.components.items()
        }
        self.places: dict[str, slice] = {}
        width = 0
        for name, component in graph.components.items():
            for variable in outputs[name]:
                size = component.ports[variable].size
                self.places[f"{name}.{variable}"] = slice(width, width + size)
                width += size
        self.now, self.before = np.zeros(width), np.zeros(width)
        delayed = [connection.source for connection in graph.connections if connection.delayed]
        self.delayed = np.unique(
            np.concatenate(
                [np.zeros(0, dtype=np.int64), *(self._range(signal) for signal in delayed)]
            )
        )
        self._by_name = {
            name: self._bind(graph, name, outputs[name], ratios[name], used)
            for name in graph.components
        }

    def __getitem__(self, name: str) -> Slave:
        return self._by_name[name]

    def keep_delayed(self) -> None:
        """Copy the source values of the delayed connections from `now` to `before`."""
        if self.delayed.size:
            self.before[self.delayed] = self.now[self.delayed]

    def value(self, signal: str) -> Array:
        """Return a view of the present value of the output COMPONENT.VARIABLE."""
        return self.now[self.places[signal]]

    def signals(self, graph: Graph, recorded: Callable[[str], bool]) -> tuple[list[Signal], Places]:
        """Return the signals of the record, and for each column of the record its index in `now`.

        The record contains the outputs for which `recorded` returns True. The signals have the
        order of the components in the graph. The signals of one component have the order of its
        ports.
        """
        signals, columns = [], [np.zeros(0, dtype=np.int64)]
        first = 0
        for name, component in graph.components.items():
            for variable, port in component.ports.items():
                signal = f"{name}.{variable}"
                if signal in self.places and recorded(signal):
                    signals.append(
                        Signal(name=signal, first=first, size=port.size, units=port.units)
                    )
                    columns.append(self._range(signal))
                    first += port.size
        return signals, np.concatenate(columns)

    def _range(self, signal: str) -> Places:
        place = self.places[signal]
        return np.arange(place.start, place.stop)

    def _bind(
        self, graph: Graph, name: str, outputs: Sequence[str], ratio: int, used: set[str]
    ) -> Slave:
        component, connections = graph.components[name], graph.inputs_of(name)
        targets = [split(connection.target)[1] for connection in connections]
        wires, first = [], 0
        for connection, target in zip(connections, targets, strict=True):
            last = first + component.ports[target].size
            source = split(connection.source)[0]
            wires.append(
                Wires(
                    source,
                    connection.delayed,
                    np.arange(first, last),
                    self._range(connection.source),
                )
            )
            first = last
        own = [self.places[f"{name}.{variable}"] for variable in outputs]
        part = slice(own[0].start, own[-1].stop) if own else slice(0, 0)
        needed = sum(f"{name}.{variable}" in used for variable in outputs)
        return Slave(component, ratio, targets, wires, outputs, needed, self.now, self.before, part)


def _outputs(name: str, component: Component, used: set[str]) -> list[str]:
    """Return the outputs of a component. The outputs in `used` come first.

    `used` contains the outputs that connections or limits need. Because these outputs come first,
    one FMI call can read them without the other outputs.
    """
    found = [
        port.name for port in component.ports.values() if port.causality == "output" and port.real
    ]
    return sorted(found, key=lambda variable: f"{name}.{variable}" not in used)


def _nothing() -> None:
    pass
