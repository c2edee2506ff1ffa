"""Worst-case bus load that the drives and the host cause on a classic CAN bus.

The bus load is the share of the time in which the bus is busy.
"""

from __future__ import annotations

from collections.abc import Sequence

from freeflyer_adapters.can.bus_load import frame_time
from freeflyer_adapters.cia402.process_data import ACTUAL, SPEED, TARGET
from freeflyer_adapters.foundation.errors import DeviceError

SDO_FRAMES = 2
"""Number of frames per cycle that the calculation assumes besides SYNC, PDOs and heartbeats.

These frames of 8 bytes are one SDO request and one SDO response, or an EMCY.
"""
LONGEST = 0.1
"""Longest cycle that an error message suggests [s]."""


def load(
    joints: int, cycle: float, bitrate: float, heartbeat: float, *, measured_velocity: bool
) -> float:
    """Return the worst-case bus load as a fraction.

    The load includes SYNC, PDOs, heartbeats, and the frames that SDO_FRAMES counts. `joints`:
    number of drives. `cycle`, `heartbeat`: periods [s]. `bitrate` [bit/s]. `measured_velocity`:
    whether the drives send TPDO2.
    """

    def taken(size: int) -> float:
        return frame_time(size, False, nominal=bitrate)

    pdos = [TARGET, ACTUAL, SPEED] if measured_velocity else [TARGET, ACTUAL]
    cyclic = taken(0) + joints * sum(taken(pdo.layout.size) for pdo in pdos) + SDO_FRAMES * taken(8)
    return cyclic / cycle + (joints + 1) * taken(1) / heartbeat


def check(
    name: str,
    joints: int,
    cycle: float,
    bitrate: float,
    heartbeat: float,
    largest: float,
    *,
    measured_velocity: bool,
) -> float:
    """Return the bus load. Raises DeviceError if the bus load is above `largest`.

    The message contains possible remedies. `name`: name of the device in the message. For the other
    arguments, see `load`.
    """
    share = load(joints, cycle, bitrate, heartbeat, measured_velocity=measured_velocity)
    if share <= largest:
        return share
    remedies = []
    fits = [ms for ms in range(1, round(1e3 * LONGEST) + 1)
            if load(joints, 1e-3 * ms, bitrate, heartbeat, measured_velocity=measured_velocity) <= largest]  # fmt: skip
    if fits:
        remedies.append(f"a cycle of {fits[0]} ms fits")
    if measured_velocity:
        less = load(joints, cycle, bitrate, heartbeat, measured_velocity=False)
        verdict = "fits" if less <= largest else "is still too much"
        remedies.append(
            f'velocity = "estimated" (no {SPEED.name}) would take {100 * less:.0f} %, which {verdict}'
        )
    if (
        bitrate < 1e6
        and load(joints, cycle, 1e6, heartbeat, measured_velocity=measured_velocity) <= largest
    ):
        remedies.append("1 Mbit/s fits")
    raise DeviceError(
        f"device {name}: {joints} drives at a cycle of {1e3 * cycle:g} ms take up to {100 * share:.0f} % of a CAN bus of "
        f"{bitrate / 1e3:g} kbit/s, but the limit is {100 * largest:.0f} %: {'; '.join(remedies) or 'use several buses'}"
    )


def table(
    joints: Sequence[int] = (6, 7),
    cycles: Sequence[int] = (1, 2, 3, 4, 5, 8),
    heartbeat: float = 0.1,
) -> list[str]:
    """Return the Markdown table of bus loads at 1 Mbit/s in docs/cia402.md. `cycles` [ms]."""
    rows = [
        "| cycle | " + " | ".join(f"{n} drives | {n} drives, with TPDO2" for n in joints) + " |",
        "|---|" + "---|---|" * len(joints),
    ]
    for ms in cycles:
        shares = [
            load(n, 1e-3 * ms, 1e6, heartbeat, measured_velocity=v)
            for n in joints
            for v in (False, True)
        ]
        rows.append(f"| {ms} ms | " + " | ".join(f"{100 * share:.0f} %" for share in shares) + " |")
    return rows


if __name__ == "__main__":
    print("\n".join(table()))
