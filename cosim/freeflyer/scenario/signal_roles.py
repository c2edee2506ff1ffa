"""Which signals play which part in a scenario's loop: the base, the end-effector, the switches.

The default is a signal of the role's own name, as the shipped blocks have it. A scenario with other
names declares them in `[roles]`, for example `base_position = "chaser.r_b"`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from freeflyer.foundation.signal_name import component_of, split

SINGLE = (
    "base_position",
    "base_orientation",
    "base_velocity",
    "base_wrench",
    "end_effector_position",
    "end_effector_orientation",
    "end_effector_velocity",
    "joint_velocity",
    "joint_torque",
)
"""Variables of the plant; positions in m, orientations as quaternions [x, y, z, w], both in I."""
SEVERAL: Mapping[str, tuple[str, ...]] = {
    "orientations": (),
    "passivity_control": ("manipulator_passivity_control", "base_passivity_control"),
}
"""Roles of any number of signals, with the names that they have by default: further quaternions of the
plant, and the Boolean parameters that switch the passivity controllers."""
ROLES = (*SINGLE, *SEVERAL)


@dataclass(frozen=True, kw_only=True)
class SignalRoles:
    """`declared`: role -> COMPONENT.VARIABLE, one or several."""

    declared: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def variable(self, role: str, component: str) -> str:
        """Return the component's variable that plays a role of `SINGLE`."""
        return next(iter(self._own(role, component)), role)

    def variables(self, role: str, component: str) -> tuple[str, ...]:
        """Return the component's variables that play a role of `SEVERAL`."""
        return (*SEVERAL[role], *self._own(role, component))

    def quaternions(self, component: str) -> frozenset[str]:
        """Return the component's variables that are orientations."""
        singles = (
            self.variable(role, component) for role in SINGLE if role.endswith("orientation")
        )
        return frozenset((*singles, *self.variables("orientations", component)))

    def _own(self, role: str, component: str) -> list[str]:
        signals = self.declared.get(role, ())
        return [split(signal)[1] for signal in signals if component_of(signal) == component]
