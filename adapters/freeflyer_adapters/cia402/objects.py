"""Object dictionary entries of a drive (CiA 301 and CiA 402-2), and the shipped EDS file."""

from __future__ import annotations

import io
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import canopen
from canopen.objectdictionary.eds import import_eds

from freeflyer.foundation.bounded_file import content
from freeflyer.foundation.errors import one_line
from freeflyer_adapters.foundation.errors import DeviceError

LARGEST_EDS = 4 * 2**20
"""Largest EDS file [bytes]; a typical drive has about 100 KiB."""
SHIPPED_EDS = Path(__file__).with_name("drive.eds")
CYCLIC_SYNCHRONOUS_TORQUE = 10
SUPPORTS_TORQUE = 1 << 9
"""Bit of mode 10 in the object 6502h (supported drive modes)."""
RAMP_AND_DISABLE = 2
"""Value of 605Ah and 605Eh: slow down on the quick stop ramp, then disable power."""

# Discard the log of canopen if the user has installed no handler. Errors of canopen are reported by
# DeviceError.
logging.getLogger("canopen").addHandler(logging.NullHandler())


@dataclass(frozen=True, kw_only=True)
class Entry:
    """Object in the dictionary of a drive.

    `use`: how the host uses the object. `optional`: whether a drive without the object is accepted.
    """

    index: int
    sub: int = 0
    name: str
    unit: str = ""
    use: str
    optional: bool = False

    def __str__(self) -> str:
        return f"{self.index:04X}h" + (f":{self.sub:02X}" if self.sub else "")


DEVICE_TYPE = Entry(index=0x1000, name="Device type", use="compared with profile 402")
SYNC_PERIOD = Entry(
    index=0x1006,
    name="Communication cycle period",
    unit="us",
    use="written: the cycle",
    optional=True,
)
CONSUMER_HEARTBEAT = Entry(
    index=0x1016,
    sub=1,
    name="Consumer heartbeat time",
    unit="ms",
    use="written: the host's node number and the timeout",
)
PRODUCER_HEARTBEAT = Entry(
    index=0x1017, name="Producer heartbeat time", unit="ms", use="written: the heartbeat period"
)
ERROR_CODE = Entry(index=0x603F, name="Error code", use="read for error messages", optional=True)
CONTROLWORD = Entry(index=0x6040, name="Controlword", use="RPDO1")
STATUSWORD = Entry(index=0x6041, name="Statusword", use="TPDO1")
QUICK_STOP = Entry(
    index=0x605A, name="Quick stop option code", use="written: 2 (ramp, then power off)"
)
MODE = Entry(index=0x6060, name="Modes of operation", use="written: 10 (cyclic synchronous torque)")
MODE_DISPLAY = Entry(index=0x6061, name="Modes of operation display", use="compared with 10")
POSITION = Entry(index=0x6064, name="Position actual value", unit="increments", use="TPDO1")
VELOCITY = Entry(index=0x606C, name="Velocity actual value", unit="increments/s", use="TPDO2")
TARGET_TORQUE = Entry(index=0x6071, name="Target torque", unit="0.001 rated torque", use="RPDO1")
MAX_TORQUE = Entry(
    index=0x6072,
    name="Max torque",
    unit="0.001 rated torque",
    use="compared: must be at least the effort limit of the joint",
)
RATED_TORQUE = Entry(
    index=0x6076,
    name="Motor rated torque",
    unit="mN m",
    use="compared with the scenario; used to convert torques",
)
ACTUAL_TORQUE = Entry(
    index=0x6077, name="Torque actual value", unit="0.001 rated torque", use="TPDO1"
)
ENCODER_INCREMENTS = Entry(
    index=0x608F,
    sub=1,
    name="Encoder increments",
    use="compared with the scenario; used to convert positions",
)
ENCODER_TURNS = Entry(
    index=0x608F, sub=2, name="Motor revolutions", use="compared with the scenario"
)
GEAR_MOTOR_TURNS = Entry(
    index=0x6091,
    sub=1,
    name="Motor shaft revolutions",
    use="compared with the scenario; used to convert torques and positions",
)
GEAR_SHAFT_TURNS = Entry(
    index=0x6091, sub=2, name="Driving shaft revolutions", use="compared with the scenario"
)
PERIOD_VALUE = Entry(
    index=0x60C2, sub=1, name="Interpolation time period value", use="written: the cycle"
)
PERIOD_INDEX = Entry(
    index=0x60C2,
    sub=2,
    name="Interpolation time index",
    use="written: the power of ten of 60C2h:01",
)
SUPPORTED_MODES = Entry(
    index=0x6502, name="Supported drive modes", use="compared: bit 9 must be 1", optional=True
)

ENTRIES: Sequence[Entry] = (
    DEVICE_TYPE, SYNC_PERIOD, CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT, ERROR_CODE, CONTROLWORD, STATUSWORD, QUICK_STOP, MODE,
    MODE_DISPLAY, POSITION, VELOCITY, TARGET_TORQUE, MAX_TORQUE, RATED_TORQUE, ACTUAL_TORQUE, ENCODER_INCREMENTS, ENCODER_TURNS,
    GEAR_MOTOR_TURNS, GEAR_SHAFT_TURNS, PERIOD_VALUE, PERIOD_INDEX, SUPPORTED_MODES,
)  # fmt: skip

SYNC_LOST, HEARTBEAT_LOST, RPDO_LOST = 0x8700, 0x8130, 0x8250
ERRORS: Mapping[int, str] = {
    0x1000: "generic error",
    0x2310: "continuous overcurrent",
    0x3210: "overvoltage of the supply",
    0x4310: "drive temperature too high",
    0x7305: "incremental encoder",
    HEARTBEAT_LOST: "the host's heartbeat is missing",
    RPDO_LOST: "no target between two SYNCs",
    SYNC_LOST: "no SYNC",
}
"""Error codes (603Fh, EMCY) of the virtual drive, and common error codes of real drives."""


def error_text(code: int) -> str:
    """Return a text with the error code and its meaning.

    If the meaning of a code is unknown, the text contains the error class of CiA 301.
    """
    known = ERRORS.get(code) or canopen.emcy.EmcyError(code, 0, b"", 0.0).get_desc().lower()
    return f"0x{code:04X}" + (f" ({known})" if known else "")


def dictionary(path: Path, node_id: int) -> Any:
    """Return canopen's ObjectDictionary of an EDS or DCF file.

    Raises DeviceError if the file cannot be used, or if a required object is missing.
    """
    try:
        if path.suffix.lower() not in (".eds", ".dcf"):
            raise DeviceError(f"EDS {path}: a file whose name ends in .eds or .dcf is expected")
        found = import_eds(
            io.StringIO(content(path, LARGEST_EDS).decode(errors="replace")), node_id
        )  # type: ignore[no-untyped-call]
    except DeviceError:
        raise
    except OSError as error:
        raise DeviceError(f"EDS {path} cannot be read: {error.strerror or error}") from error
    except Exception as error:  # canopen and its parser raise several exception types
        raise DeviceError(f"EDS {path} cannot be used: {one_line(error, 300)}") from error
    for entry in ENTRIES:
        if not entry.optional and found.get_variable(entry.index, entry.sub) is None:
            raise DeviceError(
                f"EDS {path} has no object {entry} ({entry.name}), which a drive in cyclic synchronous torque mode needs"
            )
    return found


def table() -> list[str]:
    """Return the Markdown table of objects in docs/cia402.md."""
    rows = ["| object | name | unit | use |", "|---|---|---|---|"]
    return rows + [
        f"| {e} | {e.name} | {e.unit} | {e.use}{' (if the drive has it)' if e.optional else ''} |"
        for e in ENTRIES
    ]
