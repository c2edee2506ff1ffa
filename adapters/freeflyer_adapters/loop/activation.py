"""The activation of all devices of a run. No other code enables the power of the devices."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from freeflyer.foundation.errors import CosimError, StepFailed
from freeflyer.master.master import message_of
from freeflyer_adapters.device.device import Device, SafeStop


def guarded(device: Device, call: Callable[[], object]) -> None:
    """Call a function of a device's driver.

    StepFailed and CosimError are raised unchanged. Every other exception is raised as SafeStop. If
    SafeStop is raised, the loop ends the run in an orderly way and keeps the results.
    """
    try:
        call()
    except (StepFailed, CosimError):
        raise
    except Exception as error:
        raise SafeStop(device.name, message_of(error)) from error


def clocks_first(devices: Sequence[Device]) -> list[Device]:
    """Return the devices in the order in which their commands are written.

    The clock of the loop is the device whose state frames trigger the loop: each state frame starts
    one cycle. Only an arm can be the clock. The clock is first, because the arm waits for its
    command. Without a clock, the order is not changed.
    """
    return sorted(devices, key=lambda device: not device.is_clock)


def prepare(devices: Sequence[Device]) -> None:
    """Check all start poses. Then prepare all devices, but do not enable their power.

    Raises DeviceError if a start pose is not correct, or if a device cannot be prepared.
    """
    for device in clocks_first(devices):
        guarded(device, device.check_start)
    for device in clocks_first(devices):
        guarded(device, device.prepare)


def activate(devices: Sequence[Device], is_interrupted: Callable[[], bool]) -> bool:
    """Activate all devices. Return True, or False if the user has interrupted the activation.

    `is_interrupted` returns True after the user has interrupted the run. The clock of the loop (an
    arm) is activated last, because it needs commands as soon as it is active. Raises DeviceError if
    a device cannot be activated, and SafeStop if a driver fails.
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
