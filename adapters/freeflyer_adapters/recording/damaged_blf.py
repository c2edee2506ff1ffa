"""Reader for truncated, damaged or untrusted CAN logs in BLF.

A BLF file consists of containers. A container holds objects. Most objects
are frames. Only intact containers are passed to the reader of python-can.
"""

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
"""Maximum size of a container [bytes], compressed or decompressed. Writers use 128 KiB."""
UNPACKED, UNPACKED_A_BYTE = 4 * 2**20, 200
"""Limit of the decompressed data of a file [bytes].

The limit is `UNPACKED`, plus `UNPACKED_A_BYTE` for each byte of the file."""
WINDOW = 2**20
TRIES = 100
LATEST = 253_402_300_799.0
"""End of the year 9999 [s since 1970]."""


def copy_frames(
    path: Path, file: BinaryIO, output: BinaryIO | None
) -> tuple[int, int | None, int | None, str]:
    """Copy all frames of intact containers to a new log. If `output` is None, only check the file.

    Return the number of frames, the earliest time and the latest time [ns since the epoch], and a
    message about lost data. The message is empty if the file is complete. Raises RecordError if the
    file is not a BLF file.
    """
    # The reader needs the true size of the file header. Some versions of BLF store another size
    # in the header, so this size is corrected.
    file.seek(0)
    head = file.read(FILE_HEADER_SIZE)
    if len(head) < FILE_HEADER_SIZE or head[:4] != SIGNATURE:
        raise RecordError(
            f"{path} is not a CAN log in BLF: it starts with {head[:4]!r}; {SIGNATURE!r} and a complete header are expected"
        )
    size = FILE_HEADER_STRUCT.unpack_from(head)[10]
    head = head[:4] + struct.pack("<L", FILE_HEADER_SIZE) + head[8:]
    log = _Log(file)
    # Copy frame by frame. A section is a sequence of intact containers, without a damaged place
    # between them. If an object is invalid, the rest of its section is lost.
    kept, begin, end, broken = 0, None, None, 0
    writer = None if output is None else can.BLFWriter(output)
    try:
        for section in log.sections(head):
            frames = _frames(section)
            try:
                for message in frames:
                    if not 0.0 <= message.timestamp < LATEST:
                        raise BlfError("time out of range")  # python-can cannot write it
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
    # Describe the lost data.
    parts = []
    if log.skipped:
        parts.append(unread(log.skipped, log.places))
    if broken:
        parts.append(
            f"the data after {broken} invalid object{'s' * (broken > 1)} could not be decoded"
        )
    if size != log.length and not parts:
        parts.append("the end of the file was missing")
    return kept, begin, end, ", ".join(parts)


def unread(skipped: int, places: int) -> str:
    """Return the message about `skipped` bytes."""
    return f"{skipped} bytes in {places} place{'s' * (places > 1)} could not be read"


class BlfError(Exception):
    """Invalid content of an intact container. python-can does not check this content."""


class _Log:
    """The containers of a file.

    Call `sections` once. Afterwards `skipped` is the number of skipped bytes, and `places` is the
    number of damaged places.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.length = file.seek(0, 2)
        self.skipped = self.places = 0
        self._allowance = UNPACKED + UNPACKED_A_BYTE * self.length
        self._work = UNPACKED + 8 * self.length

    def sections(self, head: bytes) -> Iterator[BinaryIO]:
        """Yield each sequence of intact containers as a separate log with the header `head`.

        An object may continue in the next container. Therefore the containers of a section stay
        together. An object cannot continue after a damaged place.
        """
        place, section, after_gap = FILE_HEADER_SIZE, _new_section(head), False
        while place < self.length:
            container = self._container(place)
            if container is not None:
                whole, content = container
                whole += bytes(len(whole) % 4)
                if after_gap:
                    content = content[_first_object(content) :]
                section.write(_uncompressed_container(content) if after_gap else whole)
                after_gap = False
                place += len(whole)
                continue
            is_allowed = self._allowance > 0 and self._work > 0
            following = self._next(place + 1) if is_allowed else self.length
            self.skipped += following - place
            self.places += 1
            place = following
            if not after_gap:
                section.seek(0)
                yield section
                section, after_gap = _new_section(head), True
        section.seek(0)
        yield section

    def _container(self, place: int) -> tuple[bytes, bytes] | None:
        """Return a container and its decompressed content.

        Return None if there is no intact container at `place`.
        """
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
        return base + data, content

    def _next(self, place: int) -> int:
        while place < self.length:
            self._file.seek(place)
            window = self._file.read(WINDOW + len(OBJECT) - 1)
            found = window.find(OBJECT)
            if found >= 0:
                return place + found
            place += WINDOW
        return self.length


def _new_section(head: bytes) -> BinaryIO:
    section = tempfile.SpooledTemporaryFile(WINDOW)  # noqa: SIM115 (`_frames` closes it)
    section.write(head)
    return section  # type: ignore[return-value]


def _uncompressed_container(content: bytes) -> bytes:
    size = OBJ_HEADER_BASE_STRUCT.size + LOG_CONTAINER_STRUCT.size + len(content)
    base = OBJ_HEADER_BASE_STRUCT.pack(OBJECT, OBJ_HEADER_BASE_STRUCT.size, 1, size, LOG_CONTAINER)
    return (
        base + LOG_CONTAINER_STRUCT.pack(NO_COMPRESSION, len(content)) + content + bytes(size % 4)
    )


def _first_object(content: bytes) -> int:
    """Return the offset in `content` at which the first object starts.

    From this offset to the end of `content`, each object is followed by the next object. The bytes
    before this offset belong to an object whose start is lost. If there is no such offset, return
    the length of `content`.
    """
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
    """Return the decompressed content, or None if the container is damaged or too large."""
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
    # `eof`: zlib has reached the end of the stream and has found a correct checksum there.
    return found if len(found) == size and unpacker.eof else None


class _Reader(can.BLFReader):
    """The reader of python-can with a further check: no object is smaller than its header.

    Without this check, the reader would loop without end at an object of size 0.
    """

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


def _frames(section: BinaryIO) -> Iterator[can.Message]:
    with section:
        try:
            yield from _Reader(section)
        except GeneratorExit:
            raise
        except Exception as error:
            raise BlfError from error
