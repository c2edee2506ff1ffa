"""The activation of all devices of a run. No other code enables the power of the devices."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from freeflyer.foundation.errors import CosimError, StepFailed
from freeflyer.master.master import message_of
from freeflyer_adapters.device.device import Device, SafeStop


def guarded(device: Device, call: Callable[[], object]) -> None:
    """Call a function of a device's driver.

    StepFailed and CosimError are raised unchanged. Every other exception is raised as SafeStop, so
    that the recording is kept.
    """
    try:
        call()
    except (StepFailed, CosimError):
        raise
    except Exception as error:
        raise SafeStop(device.name, message_of(error)) from error


def clocks_first(devices: Sequence[Device]) -> list[Device]:
    """Return the devices in the order in which their commands are written.

    If an arm is the clock of the loop, this arm is first, because the arm waits for its command.
    """
    return sorted(devices, key=lambda device: not device.is_clock)


def prepare(devices: Sequence[Device]) -> None:
    """Check all start poses, then prepare all devices without power.

    Raises DeviceError if a start pose is not correct, or if a device cannot be prepared.
    """
    for device in clocks_first(devices):
        guarded(device, device.check_start)
    for device in clocks_first(devices):
        guarded(device, device.prepare)


def activate(devices: Sequence[Device], is_interrupted: Callable[[], bool]) -> bool:
    """Activate all devices. Return False if the user has interrupted the activation.

    The arm is activated last, because it needs commands as soon as it is active. Raises DeviceError
    if a device cannot be activated, and SafeStop if a driver fails.
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
