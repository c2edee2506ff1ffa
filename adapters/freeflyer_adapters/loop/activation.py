"""The activation of a run's devices: the one path by which a run gives them power."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from freeflyer.foundation.errors import CosimError, StepFailed
from freeflyer.master.master import message_of
from freeflyer_adapters.device.device import Device, SafeStop


def guarded(device: Device, call: Callable[[], object]) -> None:
    """Call a driver. SafeStop for whatever it raises in its own way, so that what was recorded is kept."""
    try:
        call()
    except (StepFailed, CosimError):
        raise
    except Exception as error:
        raise SafeStop(device.name, message_of(error)) from error


def clocks_first(devices: Sequence[Device]) -> list[Device]:
    """The order in which devices are written: the arm waits for its answer."""
    return sorted(devices, key=lambda device: not device.is_clock)


def prepare(devices: Sequence[Device]) -> None:
    """Check every start pose, then prepare every device; nothing gets power. Raises DeviceError."""
    for device in clocks_first(devices):
        guarded(device, device.check_start)
    for device in clocks_first(devices):
        guarded(device, device.prepare)


def activate(devices: Sequence[Device], is_interrupted: Callable[[], bool]) -> bool:
    """Activate all, the arm last: from then on it waits for its commands. False if the user has interrupted.

    Raises DeviceError, or SafeStop if a driver fails.
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
