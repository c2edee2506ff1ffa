"""Settings of an arm of drives (`[devices.NAME.parameters]`), with defaults for a slower cycle."""

from __future__ import annotations

from dataclasses import replace

from freeflyer_adapters.device import settings

DEFAULTS = {"period": (0.004,), "state_age_limit": (0.04,), "lost_consecutive": (5.0,)}
DESCRIPTIONS = {
    "period": "Cycle of SYNC, and the arm's communication step",
    "state_age_limit": "Largest age of a drive's last TPDO",
    "lost_consecutive": "Lost cycles in a row (20 ms, as libfranka's 20 of 1 ms)",
    "configure_timeout": "Longest time for a response of a drive, and for all drives to become enabled",
}

DRIVES = tuple(
    replace(
        s,
        default=DEFAULTS.get(s.name, s.default),
        description=DESCRIPTIONS.get(s.name, s.description),
    )
    for s in settings.ARM
)
