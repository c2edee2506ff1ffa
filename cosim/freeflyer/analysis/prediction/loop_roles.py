"""Roles of the components in the loop of a scenario: plant, controllers, scanned controller.

The plant has continuous states. The controllers sample the outputs of the plant. The prediction
varies the period of one controller. This controller is called the scanned controller.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from freeflyer.analysis.prediction.sensitivity import DifferentiableFmu
from freeflyer.foundation.clock import shown
from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.signal_name import component_of
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.master.graph import port
from freeflyer.scenario.assemble import System
from freeflyer.scenario.scenario import Scenario
from freeflyer.scenario.signal_roles import SINGLE, SWITCHES, SignalRoles


@dataclass(frozen=True, kw_only=True)
class Roles:
    """Roles of the components. `laws` are the controllers in execution order.

    `scanned` is the scanned controller. `parameter` is the name of its parameter for the period.
    `period` [ns] is its period in the scenario. `tick` is T_m [ns], the step of all other
    controllers. They are called the fast controllers.
    """

    plant: str
    laws: tuple[str, ...]
    scanned: str
    parameter: str
    period: int
    tick: int


def roles_of(
    scenario: Scenario, system: System, fmus: Mapping[str, DifferentiableFmu], scanned: str | None
) -> Roles:
    """Return the roles of the components.

    `fmus` are the components of the loop. `scanned` is the name of the scanned controller (default:
    the slowest controller whose period is a parameter). Raises ScenarioError if the loop does not
    meet the conditions of the prediction. The comments below give these conditions.
    """
    # All continuous states must belong to one component, the plant.
    plants = [name for name, fmu in fmus.items() if fmu.states]
    if len(plants) != 1:
        raise ScenarioError(
            f"scenario {scenario.name}: {len(plants)} connected components have continuous states"
            f"{' (' + ', '.join(plants) + ')' if plants else ''}; the prediction needs exactly one plant, and sampled controllers"
        )

    # Only a period that is a parameter can be scanned.
    driven = [name for name in fmus if name not in plants and system.wiring.inputs_of(name)]
    laws = tuple(name for name in (*system.wiring.first, *system.wiring.then) if name in driven)
    by_parameter = {
        spec.name: spec.step[1:] for spec in scenario.components if isinstance(spec.step, str)
    }
    periods = [name for name in laws if name in by_parameter]
    if scanned is not None and scanned not in periods:
        raise ScenarioError(
            f"--period {scanned}: {scanned} is not a controller whose step_s is a parameter ('=PARAMETER')"
            f"{did_you_mean(scanned, periods)}; possible controllers: {', '.join(periods) or 'none'}"
        )
    if not periods:
        raise ScenarioError(
            f"scenario {scenario.name}: no controller has a step_s that is a parameter ('=period'); the prediction needs such a "
            f"parameter to scan the period"
        )

    # If several controllers are equally slow, the last of them in execution order is chosen.
    chosen = (
        scanned or max(enumerate(periods), key=lambda item: (system.steps[item[1]], item[0]))[1]
    )

    # The prediction is for two rates. Therefore all other controllers must have the same step T_m.
    rest = {name: system.steps[name] for name in laws if name != chosen}
    tick = min(rest.values(), default=system.steps[plants[0]])
    for name, step in rest.items():
        if step != tick:
            raise ScenarioError(
                f"component {name}: its step is {shown(step)}; {shown(tick)} is expected, because all controllers except {chosen} "
                f"must have the same step"
            )

    # T_m must be a multiple of the plant's step, and in parallel exchange it must be equal to the
    # plant's step. The scanned period must be a multiple of T_m.
    plant_step = system.steps[plants[0]]
    if tick % plant_step or (scenario.exchange == "parallel" and plant_step != tick):
        raise ScenarioError(
            f"component {plants[0]}: its step is {shown(plant_step)}; {shown(tick)} is expected, the step of the fast controllers"
        )
    period = system.steps[chosen]
    if period % tick:
        below = period - period % tick
        fits = f"{shown(below)} or {shown(below + tick)}" if below else shown(tick)
        raise ScenarioError(
            f"component {chosen}: its period of {shown(period)} is not a multiple of {shown(tick)}, the step of the fast controllers; "
            f"{fits} would fit"
        )
    return Roles(
        plant=plants[0],
        laws=laws,
        scanned=chosen,
        parameter=by_parameter[chosen],
        period=system.steps[chosen],
        tick=tick,
    )


def check_signals(
    roles: SignalRoles, plant: str, components: Mapping[str, DifferentiableFmu]
) -> None:
    """Check the signals that a scenario declares in `[roles]`.

    Raises ScenarioError in these cases: a signal does not exist, its size does not fit the role, it
    is not a variable of the plant, or it has two roles. The switches may belong to any component.
    """
    used: dict[str, str] = {}
    for role, signals in roles.declared.items():
        for signal in signals:
            if role not in SWITCHES and component_of(signal) != plant:
                raise ScenarioError(f"roles.{role} is {signal}; a variable of {plant} is expected")
            found = port(components, signal, f"roles.{role}")
            size = 4 if role == "orientations" else SINGLE.get(role)
            if size is not None and found.size != size:
                raise ScenarioError(
                    f"roles.{role}: {signal} has {found.size} elements; {size} are expected"
                )
            if signal in used:
                raise ScenarioError(f"{signal} has two roles: {used[signal]} and {role}")
            used[signal] = role
    # If a role is not declared, the variable with the name of the role has this role.
    for role in SINGLE:
        other = used.get(f"{plant}.{role}", role)
        if role not in roles.declared and other != role:
            raise ScenarioError(f"{plant}.{role} has two roles: {role} and {other}")
