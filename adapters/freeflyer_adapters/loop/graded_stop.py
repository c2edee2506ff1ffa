"""The graded stop: every device is brought to rest under its own clock, whatever ended the loop."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from freeflyer_adapters.device.device import Device, LifeCycle
from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.pacing import Pacer

LONGEST_STOP = 5.0
"""After so long [s] the graded stop is given up, and the devices are left to their own watchdogs."""
NOTHING_ACTIVE = "nothing was active"


def stop(devices: Sequence[Device], period: int, reason: str, *, orderly: bool) -> str:
    """Bring every active device to rest, and close all; returns how they were left. `orderly`: nothing has failed.

    First of all every device loses its permit: from then on nothing is sent but what lowers.
    """
    for device in devices:
        with suppress(Exception):
            device.revoke(reason)
    # Also a device whose activation was given up half-way must be seen to come to rest.
    active = [
        device
        for device in devices
        if device.state.now is LifeCycle.active or device.may_have_power
    ]
    now = environment.present().monotonic
    begin = now()
    pacer = None if any(device.is_clock for device in active) else Pacer(period)
    going = list(active)
    broken: list[Device] = []
    while going and now() - begin < LONGEST_STOP:
        if pacer is not None:
            pacer.wait()
        elapsed = now() - begin
        # A device that is done goes on holding until all are.
        done = [_ramped(device, elapsed, broken) for device in active]
        going = [device for device, is_done in zip(active, done, strict=True) if not is_done]
    took = now() - begin
    unsure = [device.name for device in active if device in broken or not device.at_rest]
    for device in devices:
        with suppress(Exception):  # one that fails even now must not keep the others from their end
            if device in active and (not orderly or device.name in unsure):
                device.on_error(reason)
            device.deactivate()
    if not active:
        return NOTHING_ACTIVE
    if unsure:
        return f"after {took:.2f} s {', '.join(unsure)} had not confirmed to be at rest, and is left to its own watchdog"
    return f"all devices were brought to rest in {took:.2f} s"


def _ramped(device: Device, elapsed: float, broken: list[Device]) -> bool:
    """Whether the device is done; one whose driver fails is left alone from then on."""
    if device in broken:
        return True
    try:
        return device.ramp_down(elapsed)
    except Exception:
        broken.append(device)
        return True
