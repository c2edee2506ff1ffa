"""Settings of an arm with CiA 402 drives, from the table `[devices.NAME.parameters]`.

The settings are the same as for other arms. Some defaults differ, because the cycle is slower.
"""

from __future__ import annotations

from dataclasses import replace

from freeflyer_adapters.device import parameters as device_parameters

DEFAULTS = {"period": (0.004,), "state_age_limit": (0.04,), "lost_consecutive": (5.0,)}
DESCRIPTIONS = {
    "period": "Period of SYNC. This is also the communication step of the device",
    "state_age_limit": "Largest age of a drive's last TPDO",
    "lost_consecutive": "Number of consecutive lost cycles at which the loop stops. The default corresponds to 20 ms, as for libfranka (20 cycles of 1 ms)",
    "configure_timeout": "Longest wait for a response of a drive, and longest time until all drives are enabled",
}

DRIVES = tuple(
    replace(
        s,
        default=DEFAULTS.get(s.name, s.default),
        description=DESCRIPTIONS.get(s.name, s.description),
    )
    for s in device_parameters.ARM
)
