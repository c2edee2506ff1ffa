"""Roles of signals in the control loop of a scenario.

The role of a signal is its meaning in the loop, for example `base_position`. By default, a variable
has a role if its name is the name of the role. The variables of the shipped blocks have these
names. A scenario with other variable names declares the roles in `[roles]`, for example
`base_position = "chaser.r_b"`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from freeflyer.foundation.signal_name import component_of, split

SINGLE: Mapping[str, int | None] = {
    "base_position": 3,
    "base_orientation": 4,
    "base_velocity": 6,
    "base_wrench": 6,
    "end_effector_position": 3,
    "end_effector_orientation": 4,
    "end_effector_velocity": 6,
    "joint_velocity": None,
    "joint_torque": None,
}
"""Roles that only one variable of the plant can have. The values are the numbers of elements.

None means one element for each joint. Positions [m], quaternions [x, y, z, w], velocities and
wrenches are in the inertial frame I.
"""
SEVERAL: Mapping[str, tuple[str, ...]] = {
    "orientations": (),
    "passivity_control": ("manipulator_passivity_control", "base_passivity_control"),
    "preview": ("preview",),
}
"""Roles that any number of signals can have. The values are the default names of the signals.

The role `orientations` is for quaternions of the plant that have no role in `SINGLE`. The role
`passivity_control` is for the Boolean parameters that enable the passivity controllers. The role
`preview` is for the Boolean parameters that select the reference of a later time.
"""
SWITCHES = ("passivity_control", "preview")
"""Roles of Boolean parameters. The prediction switches them off (`analysis.prediction`)."""


@dataclass(frozen=True, kw_only=True)
class SignalRoles:
    """Roles that a scenario declares.

    `declared` maps each role to its signals in the form COMPONENT.VARIABLE.
    """

    declared: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def variable(self, role: str, component: str) -> str:
        """Return the component's variable for a role of `SINGLE`."""
        return next(iter(self._declared(role, component)), role)

    def variables(self, role: str, component: str) -> tuple[str, ...]:
        """Return the component's variables for a role of `SEVERAL`."""
        return (*SEVERAL[role], *self._declared(role, component))

    def quaternions(self, component: str) -> frozenset[str]:
        """Return the component's variables that are orientations."""
        singles = (
            self.variable(role, component) for role in SINGLE if role.endswith("orientation")
        )
        return frozenset((*singles, *self.variables("orientations", component)))

    def _declared(self, role: str, component: str) -> list[str]:
        signals = self.declared.get(role, ())
        return [split(signal)[1] for signal in signals if component_of(signal) == component]
