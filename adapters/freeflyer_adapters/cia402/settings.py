"""Numbers of `[devices.NAME.parameters]` for an arm of drives: those of every arm, with the defaults of a slower cycle."""

from __future__ import annotations

from dataclasses import replace

from freeflyer_adapters.device import settings

DEFAULTS = {"period": (0.004,), "state_age_limit": (0.04,), "lost_consecutive": (5.0,)}
DESCRIPTIONS = {
    "period": "Cycle of SYNC, and the arm's communication step",
    "state_age_limit": "Largest age of a drive's last TPDO",
    "lost_consecutive": "Lost cycles in a row (20 ms, as libfranka's 20 of 1 ms)",
    "configure_timeout": "How long a drive may take for an answer, and all of them to become enabled",
}

DRIVES = tuple(
    replace(
        s,
        default=DEFAULTS.get(s.name, s.default),
        description=DESCRIPTIONS.get(s.name, s.description),
    )
    for s in settings.ARM
)
