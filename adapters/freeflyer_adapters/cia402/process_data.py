"""Cyclic frames in the predefined connection set of CiA 301.

PDO: process data object, the content of a cyclic frame. A drive receives RPDOs and sends TPDOs. The
host sends SYNC and one RPDO for each drive. Each drive sends one or two TPDOs.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from freeflyer_adapters.cia402 import objects
from freeflyer_adapters.cia402.objects import Entry

NMT, SYNC, HEARTBEAT = 0x000, 0x080, 0x700
"""COB-IDs (identifiers of CAN frames).

The COB-ID of an emergency frame (EMCY) is SYNC plus the node number of the drive. The COB-ID of a
heartbeat is HEARTBEAT plus the node number of the sender.
"""
ON_SYNC = 1
"""Transmission type: at every SYNC.

A drive applies a received target at the next SYNC.
"""


@dataclass(frozen=True, kw_only=True)
class ProcessData:
    """One PDO of a drive.

    `number`: number of the PDO; the first PDO is 1. `base`: COB-ID minus the node number.
    `mapping`: objects in the PDO, with their sizes [bits]. `layout`: format of the data bytes.
    """

    name: str
    number: int
    base: int
    mapping: Sequence[tuple[Entry, int]]
    layout: struct.Struct

    def __post_init__(self) -> None:
        assert self.layout.size * 8 == sum(bits for _, bits in self.mapping) <= 64


TARGET = ProcessData(
    name="RPDO1",
    number=1,
    base=0x200,
    mapping=((objects.CONTROLWORD, 16), (objects.TARGET_TORQUE, 16)),
    layout=struct.Struct("<Hh"),
)
ACTUAL = ProcessData(
    name="TPDO1",
    number=1,
    base=0x180,
    mapping=((objects.STATUSWORD, 16), (objects.ACTUAL_TORQUE, 16), (objects.POSITION, 32)),
    layout=struct.Struct("<Hhi"),
)
SPEED = ProcessData(
    name="TPDO2",
    number=2,
    base=0x280,
    mapping=((objects.VELOCITY, 32),),
    layout=struct.Struct("<i"),
)
