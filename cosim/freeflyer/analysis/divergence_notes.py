"""Cause of a divergence that a user cannot see in the robot: a sampled damper above its limit.

A controller holds its wrench for the period T. Its damping K_D, on the inertia M~ that a motion
moves, makes this motion unstable if K_D T / (2 M~) is above 1 (`held_axis`). A passivity controller
does not help, because it adds damping. The matched law has no such limit.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np

from freeflyer.analysis.prediction.held_axis import CoupledDamper, coupled_damper
from freeflyer.fmi.component import Array, Component
from freeflyer.foundation.clock import seconds
from freeflyer.foundation.signal_name import component_of, split
from freeflyer.master.provenance import Provenance
from freeflyer.master.record import Record
from freeflyer.scenario.assemble import make
from freeflyer.scenario.scenario import Scenario

DISTURBANCE = 1e-4
"""Disturbance of a velocity, wrench or torque [SI], for central differences."""
KINDS = ("fmu", "twin", "model_exchange")
"""Kinds of components that are loaded again. Components of users can have side effects."""


@dataclass(frozen=True, kw_only=True)
class Port:
    """Variables of the controller of a port: it measures `velocity` (6), and commands `output`.

    `body` is the body at the port, and `period` is the symbol of the controller's period.
    """

    velocity: str
    output: str
    body: str
    period: str


PORTS = (
    Port(
        velocity="end_effector_velocity", output="joint_torque", body="end-effector", period="T_m"
    ),
    Port(velocity="base_velocity", output="base_wrench", body="base", period="T_b"),
)


def notes(scenario: Scenario, record: Record, fmi: int | None = None) -> list[str]:
    """Return a sentence for each controller whose sampled damper was above its limit at the start.

    `record` is the record of a diverged run of `scenario`, and `fmi` is that of the run. Controller
    and plant are loaded again, and are stepped from the first row of the record with small
    disturbances. There is no sentence if this is not possible: for components of other kinds, for
    components between controller and plant, or if the inputs are not recorded.
    """
    provenance, found = record.provenance, []
    if provenance is None or not record.rows:
        return []
    for name, parameters in provenance.parameters.items():
        for port in PORTS:
            try:
                damper = _damper(scenario, record, provenance, name, port, fmi)
            except Exception:  # FMUs of third parties can fail in any way: then there is no note
                damper = None
            if damper is None or damper.ratio <= 1.0:
                continue
            symbol = f"K_D {port.period} / {'' if provenance.exchange == 'parallel' else '2 '}M~"
            found.append(
                f"The sampled damper of {name} was unstable at the start: {symbol} = {damper.ratio:.3g} in "
                f"{damper.motion(port.body)}, and 1 is the limit. M~ is the inertia that this motion moves, "
                f"and {port.period} = {parameters['period']:g} s is the period. The robot can be controlled with "
                f"{name}.discretisation = matched, with less damping K_D, or with a shorter period."
            )
    return found


def _damper(
    scenario: Scenario,
    record: Record,
    provenance: Provenance,
    name: str,
    port: Port,
    fmi: int | None,
) -> CoupledDamper | None:
    """Return the sampled damper of the controller `name` at the start, or None."""
    sources, own = provenance.sources, provenance.parameters[name]
    measured = sources.get(f"{name}.{port.velocity}", "")
    driven = [
        target
        for target, source in sources.items()
        if source == f"{name}.{port.output}" and component_of(target) == component_of(measured)
    ]
    if own.get("discretisation") != "emulated" or len(driven) != 1:
        return None
    plant, entry = split(driven[0])
    specs = {spec.name: spec for spec in scenario.components}
    if not all(specs[each].kind in KINDS for each in (name, plant)):
        return None
    gains = []
    for each, known, unknown in (
        (name, port.velocity, port.output),
        (plant, entry, split(measured)[1]),
    ):
        with closing(make(specs[each], scenario.directory, fmi)) as component:
            off = scenario.roles.variables("passivity_control", each)
            start = _start(component, {**provenance.parameters[each], **dict.fromkeys(off, False)})
            start |= {
                split(target)[1]: np.atleast_1d(record[source][0])
                for target, source in sources.items()
                if component_of(target) == each
            }
            step = seconds(provenance.steps[each])
            gains.append(_gain(component, start, known, unknown, step))
    torque_by_velocity, velocity_by_torque = gains
    acceleration = velocity_by_torque / seconds(provenance.steps[plant])
    return coupled_damper(
        -acceleration @ torque_by_velocity,
        np.array(own["damping"], dtype=float),
        float(own["period"]),
        late=provenance.exchange == "parallel",
    )


def _start(component: Component, given: Mapping[str, Any]) -> dict[str, Array]:
    """Return the parameters and start values of a component from its provenance."""
    return {
        name: np.atleast_1d(
            np.array(port.choices.index(given[name]) + 1 if port.choices else given[name], float)
        )
        for name, port in component.ports.items()
        if name in given and port.settable
    }


def _gain(
    component: Component, start: Mapping[str, Array], known: str, unknown: str, step: float
) -> Array:
    """Return the derivative (n, m) of the change of an output in a step by an input (m).

    The output of a controller does not depend on its value before. The change of the output of a
    plant is from the start to the end of the step [s].
    """
    u, y = (np.zeros(component.ports[name].size) for name in (known, unknown))
    component.enter_initialization(0.0, start)
    component.exit_initialization()
    write, read = component.bind_inputs([known], u), component.bind_outputs([unknown], y)
    columns, taken = [], 0
    for disturbance in DISTURBANCE * np.eye(u.size):
        changes = []
        for sign in (1.0, -1.0):
            u[:] = start[known] + sign * disturbance
            write()
            read()
            before = 0.0 if component.ports[unknown].prompt else y.copy()
            component.step(taken * step, step)
            taken += 1
            read()
            changes.append(y - before)
        columns.append((changes[0] - changes[1]) / (2.0 * DISTURBANCE))
    return np.array(columns).T
