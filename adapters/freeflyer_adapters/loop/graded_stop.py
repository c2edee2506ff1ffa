"""The graded stop: brings every device to rest. The sequence is the same for every reason.

This module defines the sequence of the stop for all devices together. The sequence for one arm is:
ramp down the torques, then engage the brakes. The sequence for one arm is implemented in
`freeflyer_adapters.device.ramp_down` and in the method `ramp_down` of the device.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from freeflyer_adapters.device.device import Device, LifeCycle
from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.pacing import Pacer

LONGEST_STOP = 5.0
"""Timeout of the graded stop [s].

If a device is not at rest after this time, only the watchdog of this device can still stop it.
"""
NOTHING_ACTIVE = "nothing was active"


def stop(devices: Sequence[Device], period: int, reason: str, *, orderly: bool) -> str:
    """Bring all active devices to rest and close all devices. Return a sentence about the result.

    The ramp-down of a device consists of steps. `period` [ns] is the time between two steps if no
    active device is the clock of the loop (see `activation.clocks_first`). `reason` is the reason
    of the stop. `orderly` is True if nothing has failed.
    """
    # Revoke all permits. Without a permit, only commands that reduce motion can be sent.
    for device in devices:
        with suppress(Exception):
            device.revoke(reason)
    # A device with an incomplete activation must be brought to rest as well.
    active = [
        device
        for device in devices
        if device.state.now is LifeCycle.active or device.may_have_power
    ]
    # Ramp down all active devices together. If an active device is the clock, its `ramp_down` waits
    # for the next state frame. Without such a device, a pacer waits between the steps.
    now = environment.present().monotonic
    start = now()
    pacer = None if any(device.is_clock for device in active) else Pacer(period)
    going = list(active)
    broken: list[Device] = []
    while going and now() - start < LONGEST_STOP:
        if pacer is not None:
            pacer.wait()
        elapsed = now() - start
        # A device that has finished its ramp-down holds its position. Its `ramp_down` is still
        # called until all devices have finished.
        done = [_ramped(device, elapsed, broken) for device in active]
        going = [device for device, is_done in zip(active, done, strict=True) if not is_done]
    took = now() - start
    unsure = [device.name for device in active if device in broken or not device.at_rest]
    for device in devices:
        # If a device fails, the other devices must still be deactivated.
        with suppress(Exception):
            if device in active and (not orderly or device.name in unsure):
                device.on_error(reason)
            device.deactivate()
    if not active:
        return NOTHING_ACTIVE
    if unsure:
        return f"after {took:.2f} s {', '.join(unsure)} had not confirmed to be at rest; only the watchdog of the device can still stop it"
    return f"all devices were brought to rest in {took:.2f} s"


def _ramped(device: Device, elapsed: float, broken: list[Device]) -> bool:
    """Execute one step of the ramp-down of a device. Return True if no further step is needed.

    No further step is needed if the ramp-down has finished, or if the driver has failed. A device
    with a failed driver is added to `broken`.
    """
    if device in broken:
        return True
    try:
        return device.ramp_down(elapsed)
    except Exception:
        broken.append(device)
        return True
