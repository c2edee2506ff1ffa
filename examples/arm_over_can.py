"""Move joint 1 of the virtual arm with python-can and the DBC file.

The script is a controller of its own: it answers each state frame of the arm with one command. The
same script would move a real arm with this protocol (docs/interface_control_document.md). Read
docs/safety.md before you try.
This example needs the extra `hil`.
"""

import binascii
import random
import time
from importlib.resources import files
from typing import Any

import can
import cantools

from freeflyer_adapters import VirtualFacility

IDLE, TORQUE, BRAKE, CLAIM, ACTIVATE = 0, 1, 2, 3, 4
INACTIVE, ACTIVE = 1, 2
database: Any = cantools.database.load_file(str(files("freeflyer_adapters.arm") / "arm.dbc"))
command, state = (database.get_message_by_name(name) for name in ("ArmCommand", "ArmState"))
session = random.randrange(1, 1 << 16)
counter = 0


def crc(data: bytes, data_id: int) -> bytes:
    """Return the CRC-16 of E2E profile 5 over a frame without its first two bytes."""
    return binascii.crc_hqx(data + data_id.to_bytes(2, "little"), 0xFFFF).to_bytes(2, "little")


def answer(bus: can.BusABC, cycle: int, mode: int, torque: float = 0.0) -> None:
    """Answer the state frame of a cycle."""
    global counter
    values = {signal.name: 0 for signal in command.signals} | {
        "E2eCounter": counter, "AnsweredCycle": cycle, "Controller": session, "Mode": mode,
        "TorqueCommand1": torque,
    }  # fmt: skip
    data = bytes(command.encode(values))
    frame = crc(data[2:], 0x4000 + command.frame_id) + data[2:]
    counter = (counter + 1) % 256
    bus.send(
        can.Message(
            arbitration_id=command.frame_id,
            data=frame,
            is_fd=True,
            bitrate_switch=True,
            is_extended_id=False,
        )
    )


def mode_and_torque(arm: dict[str, Any], moved_since: float | None) -> tuple[int, float]:
    """Return what the state of the arm asks for: a claim, the activation, or torque and damping."""
    if arm["Controller"] != session:
        return CLAIM, 0.0
    if arm["LifeCycle"] == INACTIVE:
        return ACTIVATE, 0.0
    push = 3.0 if moved_since is not None and time.monotonic() - moved_since < 0.5 else 0.0
    return TORQUE, push - 4.0 * arm["Velocity1"]


with VirtualFacility(
    "facility", {"devices.arm_drive.channel": "arm_over_can", "facility.arm_watchdog_cycles": 200}
) as facility:
    with can.Bus(interface="local", channel="arm_over_can", fd=True) as bus:
        since, start = None, 0.0
        arm: dict[str, Any] = {}
        while since is None or time.monotonic() - since < 2.0:
            message = bus.recv(1.0)
            if message is None or message.arbitration_id != state.frame_id:
                continue
            if crc(bytes(message.data[2:]), 0x4000 + state.frame_id) != message.data[:2]:
                continue
            arm = state.decode(message.data, decode_choices=False)
            if arm["LifeCycle"] == ACTIVE and since is None:
                since, start = time.monotonic(), arm["Position1"]
            answer(bus, arm["Cycle"], *mode_and_torque(arm, since))
        answer(bus, arm["Cycle"], BRAKE)
        print(f"joint 1 has moved by {arm['Position1'] - start:.3f} rad")
    facility.wait_for("disconnected")
print(*facility.lines, sep="\n")
