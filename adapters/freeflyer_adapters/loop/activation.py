"""The activation of all devices of a run. No other code enables their power."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from freeflyer.foundation.errors import CosimError, StepFailed
from freeflyer.master.master import message_of
from freeflyer_adapters.device.device import Device, SafeStop


def guarded(device: Device, call: Callable[[], object]) -> None:
    """Call a driver. Raises its other exceptions as SafeStop, so that the recording is kept."""
    try:
        call()
    except (StepFailed, CosimError):
        raise
    except Exception as error:
        raise SafeStop(device.name, message_of(error)) from error


def clocks_first(devices: Sequence[Device]) -> list[Device]:
    """Return the devices in the order of writing: the clock first, as the arm waits for it."""
    return sorted(devices, key=lambda device: not device.is_clock)


def prepare(devices: Sequence[Device]) -> None:
    """Check all start poses, then prepare all devices without power. Raises DeviceError."""
    for device in clocks_first(devices):
        guarded(device, device.check_start)
    for device in clocks_first(devices):
        guarded(device, device.prepare)


def activate(devices: Sequence[Device], is_interrupted: Callable[[], bool]) -> bool:
    """Activate all devices. Return False if the user has interrupted.

    The arm is last, because it needs commands as soon as it is active. Raises DeviceError, or
    SafeStop if a driver fails.
    """

    def meanwhile() -> bool:
        for device in devices:
            device.stay()
        return is_interrupted()

    for device in reversed(clocks_first(devices)):
        if is_interrupted():
            return False
        guarded(device, lambda device=device: device.activate(meanwhile))  # type: ignore[misc]
    return not is_interrupted()
