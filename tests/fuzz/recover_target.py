"""Untrusted inputs of `freeflyer recover`: damaged or forged recordings, CAN logs and rings.

An input is one letter for its kind and the file. The result is read with the reference reader of
its format. All its messages must be among the written ones. A forged input (`FORGED`) has valid
checksums; its messages must be among those that an independent search for chunks finds.
"""

from __future__ import annotations

import atexit
import io
import logging
import os
import re
import struct
import tempfile
import zlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from random import Random

import can
import lz4.frame
import mutation
import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from target import Target

from freeflyer.foundation.errors import CosimError
from freeflyer.master.record import Signal
from freeflyer_adapters.recording.mcap_file import RecordingFile, write_rows
from freeflyer_adapters.recording.recover import copy_whole
from freeflyer_adapters.recording.ring import RingReader, RingWriter, Rows
from freeflyer_adapters.recording.ring_header import RecordingHeader

DAMAGED, FORGED, LOG, FORGED_LOG, RING = b"M", b"F", b"B", b"C", b"R"
HEAD, CHUNK, MESSAGE = struct.Struct("<BQ"), struct.Struct("<QQQII"), struct.Struct("<HIQQ")
OBJECT, CONTAINER = struct.Struct("<4sHHLL"), struct.Struct("<H6xL4x")
LOG_HEAD, FRAMES = 144, 16
TICK, START = 200_000_000, 1_800_000_000_000_000_000
MOST_UNPACKED = 24 * 2**20
"""Decompression limit of the independent search; larger than the limit of the reader [bytes]."""
Key = tuple[int, int, bytes]
# python-can logs every unknown object.
logging.getLogger("can.io.blf").setLevel(logging.CRITICAL)


class _Kept(io.BytesIO):
    """A stream that is still readable after python-can has closed it."""

    def close(self) -> None:
        pass


def _run_head(directory: str = "/nowhere") -> RecordingHeader:
    signals = [
        Signal(name="arm.joint_position", first=0, size=2, units=("rad",) * 2),
        Signal(name="base.force", first=2, size=1, units=(None,)),
    ]
    return RecordingHeader(
        scenario="made", title="Made", tick=TICK, started=START, directory=directory, signals=signals,
        chosen=frozenset(s.name for s in signals), loop=["arm: state"], origin={"parameters": {}}, versions={"python": "3"},
    )  # fmt: skip


def _rows(count: int) -> Rows:
    k = np.arange(count)
    return Rows(
        np.stack([START + k * TICK, k * TICK, k], axis=1), np.arange(4.0 * count).reshape(count, 4)
    )


@cache
def _recordings() -> list[bytes]:
    """Return recordings of this project's writer, finished or not, and of the mcap writer."""
    found = []
    for finished in (True, False):
        stream, head = io.BytesIO(), _run_head()
        file = RecordingFile(stream, head, head.signals, 2 * TICK * 1e-9)
        file.add(_rows(6))
        if finished:
            file.finish({"reason": "it was enough"})
        found.append(stream.getvalue())
    for options in ({"compression": CompressionType.LZ4}, {"compression": CompressionType.NONE}):
        stream = io.BytesIO()
        writer = Writer(stream, chunk_size=100, **options)
        writer.start()
        schema = writer.register_schema("a/msg/B", "ros2msg", b"float64 x")
        channel = writer.register_channel("/b", "cdr", schema)
        for i in range(8):
            writer.add_message(channel, START + i, struct.pack("<4xd", i), START + i, i)
        writer.finish()  # type: ignore[no-untyped-call]
        found.append(stream.getvalue())
    return found


@cache
def _written() -> frozenset[Key]:
    return frozenset().union(*(_messages(data) for data in _recordings()))


def _messages(data: bytes) -> list[Key]:
    """Return the messages found by the mcap reader; in an unfinished file, by the search."""
    if data.endswith(b"\x89MCAP0\r\n"):
        found = make_reader(io.BytesIO(data), validate_crcs=True).iter_messages(
            log_time_order=False
        )
        return [(m.log_time, m.sequence, m.data) for _, _, m in found]
    return [key for key, _ in _independent_search(data)]


def _independent_search(data: bytes) -> Iterator[tuple[Key, bool]]:
    """Yield the messages of all possible chunks at any offset, and whether they have a checksum.

    Chunks with a wrong checksum are skipped.
    """
    for place in (found.start() for found in re.finditer(b"\x06", data)):
        # Check the lengths of a possible chunk and decompress it.
        try:
            _, length = HEAD.unpack_from(data, place)
            body = data[place + HEAD.size : place + HEAD.size + length]
            *_, size, checksum, name = CHUNK.unpack_from(body)
            (packed,) = struct.unpack_from("<Q", body, CHUNK.size + name)
            if (
                len(body) != length
                or length != CHUNK.size + name + 8 + packed
                or size > MOST_UNPACKED
            ):
                continue
            kind, inside = body[CHUNK.size : CHUNK.size + name], body[CHUNK.size + name + 8 :]
            if kind == b"zstd":
                inside = (
                    zstandard.ZstdDecompressor()
                    .stream_reader(io.BytesIO(inside))
                    .read(MOST_UNPACKED)
                )
            elif kind == b"lz4":
                inside = lz4.frame.LZ4FrameDecompressor().decompress(
                    inside, max_length=MOST_UNPACKED
                )
        except (struct.error, zstandard.ZstdError, RuntimeError, OverflowError, MemoryError):
            continue
        if checksum and zlib.crc32(inside) != checksum:
            continue
        # Yield its messages.
        at = 0
        while at + HEAD.size <= len(inside):
            kind_of_record, length = HEAD.unpack_from(inside, at)
            at += HEAD.size
            if (
                kind_of_record == Opcode.MESSAGE
                and length >= MESSAGE.size
                and at + length <= len(inside)
            ):
                _, sequence, log_time, _ = MESSAGE.unpack_from(inside, at)
                yield (log_time, sequence, inside[at + MESSAGE.size : at + length]), bool(checksum)
            at += length


@cache
def _log() -> bytes:
    stream = _Kept()
    writer = can.BLFWriter(stream, max_container_size=300)
    for i in range(FRAMES):
        data = i.to_bytes(8, "little") * 2
        writer.on_message_received(
            can.Message(
                timestamp=1.8e9 + i * 1e-3,
                arbitration_id=0x181,
                is_extended_id=False,
                is_fd=True,
                data=data,
                dlc=16,
            )
        )
    writer.stop()
    return stream.getvalue()


@cache
def _folder() -> Path:
    kept = tempfile.TemporaryDirectory(
        prefix="freeflyer-fuzz-", dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    )
    atexit.register(kept.cleanup)
    return Path(kept.name)


@cache
def _ring() -> bytes:
    ring = RingWriter(_run_head(), _folder())
    for k, line in enumerate(_rows(100).values):
        ring.write(k, line)
    ring.set_reason("it was enough")
    ring.close()
    data = ring.path.read_bytes()
    ring.path.unlink()
    return data


# Forged files: mutations with valid lengths and checksums


def _records(data: bytes) -> list[bytes]:
    """Return the records of an undamaged file, without its magic bytes."""
    found, place = [], 8
    while place + HEAD.size <= len(data):
        end = place + HEAD.size + HEAD.unpack_from(data, place)[1]
        if end > len(data):
            break
        found.append(data[place:end])
        place = end
        if found[-1][0] == Opcode.FOOTER:
            break
    return found


def _inside(chunk: bytes) -> bytes:
    name = CHUNK.unpack_from(chunk, HEAD.size)[4]
    kind, packed = (
        chunk[HEAD.size + CHUNK.size :][:name],
        chunk[HEAD.size + CHUNK.size + name + 8 :],
    )
    unpack = {b"zstd": zstandard.decompress, b"lz4": lz4.frame.decompress, b"": bytes}[kind]
    return unpack(packed)


def _chunk(rng: Random, inside: bytes, size: int | None = None, *, bad: bool = False) -> bytes:
    name = rng.choice(("zstd", "lz4", ""))
    pack = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "": bytes}[name]
    packed = pack(inside)
    checksum = (
        rng.randrange(2**32) if bad else rng.choice((zlib.crc32(inside), zlib.crc32(inside), 0))
    )
    body = (
        CHUNK.pack(START, START, len(inside) if size is None else size, checksum, len(name))
        + name.encode()
    )
    body += struct.pack("<Q", len(packed)) + packed
    return HEAD.pack(Opcode.CHUNK, len(body)) + body


@cache
def _bomb(size: int) -> bytes:
    return zstandard.compress(bytes(size))


def _bombed(rng: Random) -> bytes:
    size = rng.choice((2**20, 2**20, 2**20, 5 * 2**20, 17 * 2**20))
    packed = _bomb(size)
    body = (
        CHUNK.pack(0, 0, rng.choice((size, 100, 2**24, 2**63)), rng.choice((0, 1)), 4)
        + b"zstd"
        + struct.pack("<Q", len(packed))
    )
    return HEAD.pack(Opcode.CHUNK, len(body) + len(packed)) + body + packed


def _forged(rng: Random) -> bytes:
    source = rng.choice(_recordings())
    records = _records(source)
    intact = frozenset(records)
    for _ in range(rng.randrange(1, 4)):
        k, kind = rng.randrange(len(records)), rng.random()
        record = records[k]
        opcode, length = HEAD.unpack_from(record)
        # Mutate the content of a chunk, which gets a new checksum.
        if opcode == Opcode.CHUNK and record in intact and kind < 0.6:
            inside = bytearray(_inside(record)) if rng.random() < 0.9 else bytearray()
            if rng.random() < 0.3:  # lengths and opcodes of the records in the chunk
                starts, at = [0], 0
                while at + HEAD.size <= len(inside):
                    at += HEAD.size + HEAD.unpack_from(inside, at)[1]
                    starts.append(at)
                at = rng.choice(starts[:-1] or [0])
                if at + HEAD.size <= len(inside):
                    was = HEAD.unpack_from(inside, at)
                    HEAD.pack_into(
                        inside,
                        at,
                        rng.choice((was[0], 3, 4, 5, 6, 0, 255)),
                        rng.choice((was[1], 0, was[1] + 1, 21, 22, 2**63)),
                    )
            else:
                inside = bytearray(mutation.damaged(rng, [bytes(inside)], most=2))
            records[k] = _chunk(
                rng,
                bytes(inside),
                rng.choice((None, None, None, 0, 2**24, 2**40)),
                bad=rng.random() < 0.1,
            )
        # Mutate, repeat, remove or reorder records.
        elif kind < 0.15:
            records[k] = (
                HEAD.pack(
                    rng.choice((opcode, *range(1, 16), 0, 128)),
                    rng.choice((length, 0, length + 9, 2**62, 2**24)),
                )
                + record[9:]
            )
        elif kind < 0.3:
            body = mutation.damaged(rng, [record[HEAD.size :]], most=2)
            records[k] = HEAD.pack(opcode, len(body)) + body
        elif kind < 0.4:
            records[k:k] = [rng.choice(_records(rng.choice(_recordings())))] * rng.choice((1, 2, 5))
        elif kind < 0.5:
            del records[k]
        elif kind < 0.52:
            records[k] = _bombed(rng)
        else:
            rng.shuffle(records)
        if not records:
            break
    whole = source[:8] + b"".join(records) + source[:8]
    return whole[: rng.randrange(len(whole))] if rng.random() < 0.2 else whole[: mutation.LONGEST]


def _containers(data: bytes) -> list[bytes]:
    found, place = [], LOG_HEAD
    while place + OBJECT.size <= len(data):
        size = OBJECT.unpack_from(data, place)[3]
        found.append(data[place : place + size])
        place += size + size % 4
    return found


@cache
def _log_bomb(size: int) -> bytes:
    return zlib.compress(bytes(size))


def _forged_log(rng: Random) -> bytes:
    containers = _containers(_log())
    for k in rng.sample(range(len(containers)), rng.randrange(1, 3)):
        inside = zlib.decompress(containers[k][OBJECT.size + CONTAINER.size :])
        if rng.random() < 0.01:
            size = rng.choice((2**20, 17 * 2**20))
            method, packed = 2, _log_bomb(size)
        else:
            inside = mutation.damaged(rng, [inside], most=2)
            size, method = len(inside), rng.choice((0, 2, 2, 2, 3))
            packed = inside if method == 0 else zlib.compress(inside)
        body = CONTAINER.pack(method, rng.choice((size, size, size, 5, 2**31))) + packed
        containers[k] = OBJECT.pack(b"LOBJ", OBJECT.size, 1, OBJECT.size + len(body), 10) + body
    return _log()[:LOG_HEAD] + b"".join(one + bytes(len(one) % 4) for one in containers)


def generate(rng: Random) -> bytes:
    kind = rng.random()
    if kind < 0.4:
        return DAMAGED + mutation.damaged(rng, _recordings())
    if kind < 0.75:
        return FORGED + _forged(rng)
    if kind < 0.85:
        return LOG + mutation.damaged(rng, [_log()])
    if kind < 0.93:
        return FORGED_LOG + _forged_log(rng)
    data = bytearray(_ring())
    for _ in range(rng.randrange(1, 5)):
        place = rng.choice(
            (
                rng.randrange(8 * 9),
                64 + 8 * rng.randrange(2),
                4096 + rng.randrange(1000),
                rng.randrange(len(data)),
            )
        )
        width = rng.choice((1, 8))
        data[place : place + width] = rng.choice(
            (rng.randbytes(width), rng.choice(mutation.BOUNDARIES).to_bytes(8, "little")[:width])
        )
    return RING + bytes(data[: rng.randrange(len(data))] if rng.random() < 0.1 else data)


def recover(data: bytes) -> str:
    kind, data = data[:1], data[1:]
    if kind == RING:
        return _recover_ring(data)
    name = Path("fuzz.blf" if kind in (LOG, FORGED_LOG) else "fuzz.mcap")
    output = _Kept()
    done = copy_whole(name, io.BytesIO(data), output)
    made = output.getvalue()
    if name.suffix == ".blf":
        frames = list(can.BLFReader(io.BytesIO(made)))
        assert len(frames) == done.kept, "the new log has another number of frames than reported"
        if kind == LOG:
            numbers = [int.from_bytes(frame.data[:8], "little") for frame in frames]
            assert all(
                frame.data == n.to_bytes(8, "little") * 2 and n < FRAMES
                for frame, n in zip(frames, numbers, strict=True)
            ), "a frame that was not written"
        return "log" if done.kept else "log without frames"
    kept = _messages(made)
    assert len(kept) == done.kept, "the new file has another number of messages than reported"
    if kept:
        new = set(kept) - _written()
        if new:
            found = {
                key
                for key, has_checksum in _independent_search(data)
                if kind == FORGED or not has_checksum
            }
            # A forged file without chunks has no checksum.
            assert new <= found or (kind == FORGED and not _has_chunk(data)), (
                "a message that was not written"
            )
    return "recording" if done.kept else "recording without messages"


def _has_chunk(data: bytes) -> bool:
    return next(_independent_search(data), None) is not None


def _recover_ring(data: bytes) -> str:
    path = _folder() / "fuzz.ring"
    path.write_bytes(data)
    ring = RingReader(path)
    try:
        rows = ring.last(2.0)
        assert len(rows) <= ring.rows
        output = io.BytesIO()
        write_rows(output, ring, rows, ring.head.signals, "a test")
    finally:
        ring.close()
    # Four topics: signals of arm and base, joint states, loop.
    assert (
        len(_messages(output.getvalue())) == 4 * len(rows)
        or ring.head.signals != _run_head().signals
    ), "rows were lost"
    return "ring" if len(rows) else "ring without rows"


RECOVER = Target(name="recover", generate=generate, call=recover, allowed=(CosimError,), growth=256)
