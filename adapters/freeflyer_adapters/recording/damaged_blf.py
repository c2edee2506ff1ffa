"""Reads CAN logs in BLF that end anywhere, or are damaged or hostile: whole containers go to python-can's reader, and nothing else."""

from __future__ import annotations

import struct
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import can
from can.io.blf import (
    FILE_HEADER_SIZE,
    FILE_HEADER_STRUCT,
    LOG_CONTAINER,
    LOG_CONTAINER_STRUCT,
    NO_COMPRESSION,
    OBJ_HEADER_BASE_STRUCT,
    ZLIB_DEFLATE,
)

from freeflyer.foundation.errors import RecordError

SIGNATURE, OBJECT = b"LOGG", b"LOBJ"
LARGEST = 16 * 2**20
"""Bytes of a container, packed or not; writers use 128 KiB."""
UNPACKED, UNPACKED_A_BYTE = 4 * 2**20, 200
WINDOW = 2**20
TRIES = 100
LATEST = 253_402_300_799.0
"""The end of the year 9999 [s since 1970]."""


def copy_frames(
    path: Path, file: BinaryIO, output: BinaryIO | None
) -> tuple[int, int | None, int | None, str, bool]:
    """Every frame of whole containers into a new log; without `output`, only looked at.

    Gives how many, the first and last time [ns since the epoch], what was lost, and whether the file was whole.
    """
    file.seek(0)
    head = file.read(FILE_HEADER_SIZE)
    if len(head) < FILE_HEADER_SIZE or head[:4] != SIGNATURE:
        raise RecordError(
            f"{path} is no CAN log in BLF: it begins with {head[:4]!r}, {SIGNATURE!r} and a whole head are expected"
        )
    size = FILE_HEADER_STRUCT.unpack_from(head)[10]
    head = head[:4] + struct.pack("<L", FILE_HEADER_SIZE) + head[8:]
    log = _Log(file)
    kept, begin, end, broken = 0, None, None, 0
    writer = None if output is None else can.BLFWriter(output)
    try:
        for stretch in log.stretches(head):
            frames = _frames(stretch)
            try:
                for message in frames:
                    if not 0.0 <= message.timestamp < LATEST:
                        raise BlfError("a time that is no date")  # python-can could not write it
                    if writer is not None:
                        writer.on_message_received(message)
                    stamp = round(message.timestamp * 1e9)
                    kept += 1
                    begin = stamp if begin is None else min(begin, stamp)
                    end = stamp if end is None else max(end, stamp)
            except (BlfError, ValueError, struct.error, OverflowError):
                broken += 1
    finally:
        if writer is not None:
            writer.stop()
    parts = []
    if log.skipped:
        parts.append(
            f"{log.skipped} bytes in {log.places} place{'s' * (log.places > 1)} could not be read"
        )
    if broken:
        parts.append(f"what followed in {broken} place{'s' * (broken > 1)} could not be understood")
    if size != log.length and not parts:
        parts.append("the end was missing")
    return kept, begin, end, ", ".join(parts), not parts


class BlfError(Exception):
    """What is inside a whole container may still be nonsense, which python-can's reader believes, and fails in its own ways."""


class _Log:
    """`stretches` once; what was skipped is known afterwards."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.length = file.seek(0, 2)
        self.skipped = self.places = 0
        self._allowance = UNPACKED + UNPACKED_A_BYTE * self.length
        self._work = UNPACKED + 8 * self.length

    def stretches(self, head: bytes) -> Iterator[BinaryIO]:
        """Whole containers that follow each other without a damaged place, each time as a log of its own: an object may go on in
        the next container, but not beyond a gap.
        """
        place, stretch, after_gap = FILE_HEADER_SIZE, _begun(head), False
        while place < self.length:
            container = self._container(place)
            if container is not None:
                base, data, content = container
                if after_gap:
                    begin = _first_object(content)
                    content = content[begin:]
                    stretch.write(_plain(content))
                else:
                    stretch.write(base + data + bytes(len(base + data) % 4))
                after_gap = False
                place += len(base + data) + len(base + data) % 4
                continue
            following = (
                self._next(place + 1) if self._allowance > 0 and self._work > 0 else self.length
            )
            self.skipped, self.places, place = (
                self.skipped + following - place,
                self.places + 1,
                following,
            )
            if not after_gap:
                stretch.seek(0)
                yield stretch
                stretch, after_gap = _begun(head), True
        stretch.seek(0)
        yield stretch

    def _container(self, place: int) -> tuple[bytes, bytes, bytes] | None:
        """Head, packed and unpacked contents; None if there is no whole one."""
        self._file.seek(place)
        base = self._file.read(OBJ_HEADER_BASE_STRUCT.size)
        if len(base) < OBJ_HEADER_BASE_STRUCT.size:
            return None
        signature, _, _, size, kind = OBJ_HEADER_BASE_STRUCT.unpack(base)
        fits = len(base) + LOG_CONTAINER_STRUCT.size <= size <= min(LARGEST, self.length - place)
        if signature != OBJECT or kind != LOG_CONTAINER or not fits or self._work <= 0:
            return None
        self._work -= size
        data = self._file.read(size - len(base))
        content = _unpacked(data, self._allowance)
        if content is None:
            return None
        self._allowance -= len(content)
        return base, data, content

    def _next(self, place: int) -> int:
        while place < self.length:
            self._file.seek(place)
            window = self._file.read(WINDOW + len(OBJECT) - 1)
            found = window.find(OBJECT)
            if found >= 0:
                return place + found
            place += WINDOW
        return self.length


def _begun(head: bytes) -> BinaryIO:
    stretch = tempfile.SpooledTemporaryFile(WINDOW)  # noqa: SIM115 (who reads it closes it)
    stretch.write(head)
    return stretch  # type: ignore[return-value]


def _plain(content: bytes) -> bytes:
    """A container around unpacked contents."""
    size = OBJ_HEADER_BASE_STRUCT.size + LOG_CONTAINER_STRUCT.size + len(content)
    base = OBJ_HEADER_BASE_STRUCT.pack(OBJECT, OBJ_HEADER_BASE_STRUCT.size, 1, size, LOG_CONTAINER)
    return (
        base + LOG_CONTAINER_STRUCT.pack(NO_COMPRESSION, len(content)) + content + bytes(size % 4)
    )


def _first_object(content: bytes) -> int:
    """Where the first object begins from which one follows the other up to the end: before it is the rest of one that is lost."""
    begin = content.find(OBJECT)
    for _ in range(TRIES):
        if begin < 0:
            break
        place = begin
        while place + OBJ_HEADER_BASE_STRUCT.size <= len(content):
            signature, head_size, _, size, _ = OBJ_HEADER_BASE_STRUCT.unpack_from(content, place)
            if signature != OBJECT or not OBJ_HEADER_BASE_STRUCT.size <= head_size <= size:
                break
            place += size
            following = content.find(OBJECT, place, place + 8)
            place = following if following >= 0 else place + size % 4
        else:
            return begin
        begin = content.find(OBJECT, begin + 1)
    return len(content)


def _unpacked(data: bytes, allowance: int) -> bytes | None:
    """What a container has inside; None if it is not whole."""
    method, size = LOG_CONTAINER_STRUCT.unpack_from(data)
    packed = data[LOG_CONTAINER_STRUCT.size :]
    if size > min(LARGEST, allowance):
        return None
    if method == NO_COMPRESSION:
        return packed if len(packed) == size else None
    if method != ZLIB_DEFLATE:
        return None
    unpacker = zlib.decompressobj()
    try:
        found = unpacker.decompress(packed, size + 1)
    except zlib.error:
        return None
    # At the end of the stream zlib has compared its checksum.
    return found if len(found) == size and unpacker.eof else None


class _Reader(can.BLFReader):
    """python-can goes from object to object by their sizes, and on the spot for ever where one claims to have none."""

    def _parse_container(self, data: bytes) -> Iterator[can.Message]:
        whole, place = self._tail + data, 0
        while (
            place := whole.find(OBJECT, place, place + 8)
        ) >= 0 and place + OBJ_HEADER_BASE_STRUCT.size <= len(whole):
            size = OBJ_HEADER_BASE_STRUCT.unpack_from(whole, place)[3]
            if size < OBJ_HEADER_BASE_STRUCT.size:
                raise BlfError(f"an object of {size} bytes")
            place += size
        yield from super()._parse_container(data)


def _frames(stretch: BinaryIO) -> Iterator[can.Message]:
    with stretch:
        try:
            yield from _Reader(stretch)
        except GeneratorExit:
            raise
        except Exception as error:
            raise BlfError from error
