"""Hooks that the real-time loop calls at each instant: pacing, command writing, observation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from freeflyer.foundation.clock import seconds
from freeflyer.master.master import Master
from freeflyer_adapters.device.device import STATE, Device
from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.histogram import Histogram
from freeflyer_adapters.foundation.pacing import Pacer
from freeflyer_adapters.loop.activation import clocks_first, guarded
from freeflyer_adapters.loop.live_view import LiveValues
from freeflyer_adapters.recording.client import RecordingClient

VIEW_EVERY = 100
"""Number of instants between two updates of the live view."""


class Pacing:
    """Hook that starts each instant at an absolute deadline, if no device is the clock.

    If a device is the clock, the hook does nothing. `period` is the time between deadlines [ns].
    """

    def __init__(self, devices: Sequence[Device], period: int) -> None:
        self._clock = next((device for device in devices if device.is_clock), None)
        self.pacer = None if self._clock is not None else Pacer(period)
        self._woken = 0

    @property
    def woken(self) -> int:
        """Start of the present instant [ns, CLOCK_MONOTONIC]."""
        return self._clock.woken if self._clock is not None else self._woken

    def before(self, k: int) -> str | None:
        if self.pacer is not None:
            self._woken = self.pacer.wait()
        return None

    def after(self, k: int) -> None:
        pass


class CommandWriting:
    """Hook that writes the commands at the end of each instant.

    If an arm is the clock of the loop, its command is written first.
    """

    def __init__(self, devices: Sequence[Device], master: Master) -> None:
        self._in_order, self._master = clocks_first(devices), master

    def before(self, k: int) -> str | None:
        return None

    def after(self, k: int) -> None:
        for device in self._in_order:
            self._master.write_inputs_now(device.name)
            guarded(device, device.write)


class Observation:
    """Hook that updates the measured times, the recording and the live view.

    The hook runs after the commands are written. It sends nothing to the devices. `energies` are
    the names of the observed energies. `errors` maps the name of each error in the table [errors]
    of the scenario to a function that computes its present value. The live view shows energies and
    errors.
    """

    def __init__(
        self,
        devices: Sequence[Device],
        master: Master,
        pacing: Pacing,
        energies: Sequence[str],
        errors: Mapping[str, Callable[[], float]],
    ) -> None:
        self.devices, self._master, self._pacing = devices, master, pacing
        self._energies, self._errors = energies, errors
        self.period = master.schedule.tick
        self.compute = Histogram()
        self.view: LiveValues | None = None
        self.recording: RecordingClient | None = None
        self._times = {name: h for device in devices for name, h in device.histograms().items()}
        if pacing.pacer is not None:
            self._times["loop: wake-up"] = pacing.pacer.lateness
        self._shown_at = 0.0
        self._environment = environment.present()

    def before(self, k: int) -> str | None:
        return None

    def after(self, k: int) -> None:
        if self.recording is not None:
            self.recording.write(k)
        self.compute.add(self._environment.monotonic_ns() - self._pacing.woken)
        if self.view is not None and k % VIEW_EVERY == 0:
            self.view.write(self.numbers(k))

    @property
    def times(self) -> Mapping[str, Histogram]:
        return {"loop: compute": self.compute, **self._times}

    @property
    def names(self) -> list[str]:
        """Names and units of the values in the live view."""
        times = [
            "time [s]",
            "rate [Hz]",
            "longest compute [us]",
            *(f"longest: {name} [us]" for name in self._times),
        ]
        states = [f"{device.name}{STATE}" for device in self.devices]
        counts = [
            f"{device.name}: {name.replace('_', ' ')}"
            for device in self.devices
            for name in device.report()
        ]
        return [
            *times,
            *states,
            *self._errors,
            *(f"minimum {name} [J]" for name in self._energies),
            *counts,
        ]

    def numbers(self, k: int) -> list[float]:
        """Return the values in the order of `names`.

        Each value with the unit [us] is the longest duration since the last call of this method.
        """
        now = self._environment.monotonic()
        rate = VIEW_EVERY / max(now - self._shown_at, 1e-9)
        self._shown_at = now
        return [
            seconds(k * self.period), rate, self.compute.take_recent(), *(h.take_recent() for h in self._times.values()),
            *(float(device.state.now) for device in self.devices),
            *(error() for error in self._errors.values()),
            *(float(self._master.value(name).min()) for name in self._energies),
            *(value for device in self.devices for value in device.report().values()),
        ]  # fmt: skip
