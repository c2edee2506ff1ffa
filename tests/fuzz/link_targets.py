"""Untrusted link data: CAN frames, odometry messages, attachments."""

from __future__ import annotations

import math
import struct
import tempfile
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import can
import mutation
import numpy as np
from target import Target

from freeflyer_adapters.arm.frames import ArmFrames, FrameMapping
from freeflyer_adapters.base import ros_messages
from freeflyer_adapters.base.rmw_zenoh import (
    ATTACHMENT,
    Attachment,
    AttachmentError,
    read_attachment,
)
from freeflyer_adapters.base.ros_messages import MessageError, OdometryWriter
from freeflyer_adapters.can.e2e import Protector
from freeflyer_adapters.can.frame import Frame
from freeflyer_adapters.can.link import Receiver

# DBC of a drive with big-endian signals and an E2E header at the end. Its unmapped signals are
# floats, a multiplexer with undefined values, and named values.
OWN_DBC = """VERSION ""
NS_ :
BS_:
BU_: PC Drive
BO_ 512 TORQUES: 16 PC
 SG_ Mode : 7|8@0+ (1,0) [0|0] "" Drive
 SG_ Tau_A : 15|16@0- (0.01,0) [0|0] "Nm" Drive
 SG_ Tau_B : 31|16@0- (0.01,0) [0|0] "Nm" Drive
 SG_ Answers : 47|8@0+ (1,0) [0|0] "" Drive
 SG_ Run : 55|8@0+ (1,0) [0|0] "" Drive
BO_ 2147484161 STATUS: 32 Drive
 SG_ N : 7|8@0+ (1,0) [0|0] "" PC
 SG_ Q_A : 15|16@0- (0.01,0) [0|0] "deg" PC
 SG_ Q_B : 31|16@0- (0.01,0) [0|0] "deg" PC
 SG_ W_A : 47|16@0- (0.1,3) [0|0] "deg/s" PC
 SG_ W_B : 63|16@0- (0.1,3) [0|0] "deg/s" PC
 SG_ T_A : 79|16@0- (0.01,0) [0|0] "Nm" PC
 SG_ T_B : 95|16@0- (-0.01,0) [0|0] "Nm" PC
 SG_ State : 128|8@1+ (1,0) [0|0] "" PC
 SG_ Selector M : 136|8@1+ (1,0) [0|0] "" PC
 SG_ Heat m1 : 144|32@1- (1,0) [0|0] "" PC
 SG_ Amps m2 : 144|16@1- (1,0) [0|0] "A" PC
 SG_ Volts : 176|32@1- (1,0) [0|0] "V" PC
 SG_ RunEcho : 208|8@1+ (1,0) [0|0] "" PC
 SG_ Held : 216|1@1+ (1,0) [0|0] "" PC
 SG_ Echo : 224|8@1+ (1,0) [0|0] "" PC
SIG_VALTYPE_ 2147484161 Heat : 1;
SIG_VALTYPE_ 2147484161 Volts : 1;
VAL_ 2147484161 State 0 "Off" 1 "On" ;
"""
OWN_MAPPING: dict[str, dict[str, Any]] = {
    "messages": {"command": "TORQUES", "state": "STATUS"},
    "signals": {
        "cycle": "N",
        "life_cycle": "State",
        "mode": "Mode",
        "controller": "Run",
        "obeyed_controller": "RunEcho",
        "answered_cycle": "Answers",
        "echoed_cycle": "Echo",
        "brakes": "Held",
        "joint_torque_command": ["Tau_A", "Tau_B"],
        "joint_position": ["Q_A", "Q_B"],
        "joint_velocity": ["W_A", "W_B"],
        "joint_torque": ["T_A", "T_B"],
    },
    "mode_values": {"activate": 4},
}


def _own(**more: object) -> ArmFrames:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "own.dbc"
        path.write_text(OWN_DBC)
        return ArmFrames(FrameMapping(dbc=path, **OWN_MAPPING, **more), 2)  # type: ignore[arg-type]


@cache
def receivers() -> list[tuple[ArmFrames, Frame]]:
    every = (
        ArmFrames(FrameMapping(), 6),
        _own(),
        _own(data_ids={"state": 7, "command": 8}, e2e_offset=13),
    )
    return [
        (arm, frame)
        for arm in every
        for frame in (arm.command, arm.state, arm.description)
        if frame is not None
    ]


HEAD = struct.Struct("<BBIB")
"""Index into `receivers`, flags (error, remote, extended), identifier, length; the data follows.
An input contains several frames."""
ERROR, REMOTE, EXTENDED = 1, 2, 4


def frames(rng: Random) -> bytes:
    """Return up to eight frames for one receiver.

    Half of the mutated ones have a valid E2E header, so that the receiver reads their signals.
    """
    which = rng.randrange(len(receivers()))
    _, frame = receivers()[which]
    protector = None if frame.data_id is None else Protector(frame.data_id, frame.e2e_offset)
    parts = []
    for _ in range(rng.randrange(1, 9)):
        numbers = {
            role: [rng.uniform(f.least, f.most) for f in fields]
            for role, fields in frame.fields.items()
        }
        data = frame.pack(numbers)
        if protector is not None:
            protector.protect(data)
        kind = rng.random()
        if kind < 0.5:  # random or mutated signals with a valid checksum
            data = bytearray(
                rng.randbytes(len(data)) if kind < 0.25 else mutation.damaged(rng, [bytes(data)])
            )
            if protector is not None and len(data) >= frame.e2e_offset + 3 and len(data) <= 64:
                protector._counter = rng.choice((protector._counter, rng.randrange(256)))
                protector.protect(data)
        elif kind < 0.9:
            data = bytearray(mutation.damaged(rng, [bytes(data)]))
        flags = EXTENDED * frame.extended if rng.random() < 0.95 else rng.randrange(8)
        identifier = frame.identifier if rng.random() < 0.98 else rng.randrange(1 << 29)
        parts.append(HEAD.pack(which, flags, identifier, min(len(data), 64)) + bytes(data[:64]))
    return b"".join(parts)


def take_frames(data: bytes) -> str:
    place, outcome, receiver, arm = 0, "nothing", None, receivers()[0][0]
    while place + HEAD.size <= len(data):
        which, flags, identifier, length = HEAD.unpack_from(data, place)
        if receiver is None:
            arm, frame = receivers()[which]
            receiver = Receiver(frame)
        payload = bytearray(data[place + HEAD.size : place + HEAD.size + length])
        place += HEAD.size + length
        message = can.Message(
            arbitration_id=identifier, is_extended_id=bool(flags & EXTENDED), is_error_frame=bool(flags & ERROR),
            is_remote_frame=bool(flags & REMOTE), is_fd=not flags & REMOTE, data=payload, check=False,
        )  # fmt: skip
        before = receiver.accepted, receiver.refused
        values = receiver.take(message)
        after = receiver.accepted, receiver.refused
        if values is None:
            assert after[0] == before[0], "counted as accepted, but not returned"
            outcome = max(
                receiver.rejected,
                key=lambda name: receiver.rejected[name],
                default="other identifier",
            )
            continue
        assert after == (before[0] + 1, before[1]), "returned, but not counted as accepted"
        outcome = "values"
        check_values(arm, receiver.frame, values)
    return outcome


def check_values(arm: ArmFrames, frame: Frame, values: dict[str, list[float]]) -> None:
    assert values.keys() == frame.fields.keys()
    for role, numbers in values.items():
        fields = frame.fields[role]
        assert len(numbers) == len(fields)
        for f, number in zip(fields, numbers, strict=True):
            assert math.isfinite(number)
            assert f.least - f.resolution <= number <= f.most + f.resolution
    for role, meaning in (("mode", arm.mode), ("life_cycle", arm.life_cycle)):
        if role in values:
            meaning(values[role][0])  # a state or None


def _odometry() -> list[bytes]:
    rng = np.random.default_rng(1)
    seeds = [
        OdometryWriter(frame, child).write(
            stamp, rng.normal(size=3), rng.normal(size=4), rng.normal(size=6)
        )
        for frame, child, stamp in (
            ("inertial", "base", 1_700_000_000_123_456_789),
            ("", "b", 0),
            ("ö" * 99, "x/y_z", 2**31 * 10**9 - 1),
        )
    ]
    big = bytearray(seeds[0])  # the same message, big-endian
    big[1] = 0
    big[4:12] = struct.pack(">iI", *struct.unpack_from("<iI", big, 4))
    place = 12
    for _ in range(2):
        place += -(place - 4) % 4
        (length,) = struct.unpack_from("<I", big, place)
        struct.pack_into(">I", big, place, length)
        place += 4 + length
    place += -(place - 4) % 8
    big[place:] = np.frombuffer(bytes(big[place:]), "<f8").astype(">f8").tobytes()
    return [*seeds, bytes(big)]


ODOMETRY = _odometry()


def read_odometry(data: bytes) -> str:
    message = ros_messages.read(data)
    assert -(2**31) * 10**9 <= message.stamp < 2**31 * 10**9
    for name in (message.frame, message.child_frame):
        assert len(name.encode()) < ros_messages.LONGEST_NAME
        assert "\0" not in name
    assert [v.shape for v in (message.position, message.orientation, message.velocity)] == [
        (3,),
        (4,),
        (6,),
    ]
    assert all(
        v.dtype == np.float64 and v.dtype.isnative
        for v in (message.position, message.orientation, message.velocity)
    )
    finite = all(
        np.isfinite(v).all() for v in (message.position, message.orientation, message.velocity)
    )
    return "finite message" if finite else "message with numbers that are not finite"


ATTACHMENTS = [
    Attachment(1, 1_700_000_000_000_000_000, bytes(range(16))).pack(),
    Attachment(-1, -(2**63), b"\xff" * 16).pack(),
]


def read_one_attachment(data: bytes) -> str:
    found = read_attachment(data)
    assert len(data) == ATTACHMENT.size
    assert -(2**63) <= found.sequence < 2**63
    assert -(2**63) <= found.stamp < 2**63
    assert found.pack() == data
    return "attachment"


CAN = Target(name="can", generate=frames, call=take_frames, allowed=())
CDR = Target(
    name="cdr",
    generate=lambda rng: mutation.damaged(rng, ODOMETRY),
    call=read_odometry,
    allowed=(MessageError,),
)
ATTACHMENT_TARGET = Target(
    name="attachment",
    generate=lambda rng: mutation.damaged(rng, ATTACHMENTS, most=2),
    call=read_one_attachment,
    allowed=(AttachmentError,),
)
