"""Reader for truncated, damaged or untrusted MCAP files. It returns only intact records.

Messages are read from chunks with a correct checksum. A message outside a chunk has no checksum.
Such messages are read only if the file has no intact chunk. After a damaged place, the reader
searches for the next chunk. The reader keeps only one chunk at a time in memory, and the size of a
chunk is limited. Two sums are limited, too: the bytes that are read, and the bytes after
decompression. These two limits depend on the size of the file. Therefore an untrusted file cannot
block the reader.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, BinaryIO, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema, Statistics

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
CHUNK = struct.Struct("<QQQII")
"""First and last message time, decompressed size, checksum, length of the compression name."""
MESSAGE = struct.Struct("<HIQQ")
FOOTER_SIZE = 20
LARGEST = 16 * 2**20
"""Maximum size of a record, and maximum size of a chunk after decompression [bytes]."""
UNPACKED, UNPACKED_A_BYTE = 4 * 2**20, 200
"""Limit of the decompressed data of all chunks [bytes].

The limit is `UNPACKED`, plus `UNPACKED_A_BYTE` for each byte of the file."""
MOST_DEFINITIONS = 2**16 - 1
"""Maximum number of schemas, and maximum number of channels.

Their IDs have two bytes and start at one."""
MOST_OTHERS = 100_000
"""Maximum number of metadata records and attachments.

The program that writes a repaired file keeps one index entry for each metadata record and for each
attachment in memory."""
WORK, WORK_A_BYTE = 4 * 2**20, 8
"""Limit of the bytes that are read: `WORK`, plus `WORK_A_BYTE` for each byte of the file."""
DEFINITIONS = 64 * 2**20
"""Maximum size of all schemas and channels [bytes]."""
SKIPPED = (
    Opcode.CHUNK_INDEX,
    Opcode.SUMMARY_OFFSET,
    Opcode.METADATA_INDEX,
    Opcode.ATTACHMENT_INDEX,
)
"""Records whose content is not needed. Private records (0x80 and above) are skipped, too."""
KINDS: Mapping[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.ATTACHMENT: Attachment,
}
NEXT_CHUNK = re.compile(rb"\x06[\s\S]{4}\x00{4}")
FIRST_WINDOW, WINDOW = 2**12, 2**20
BROKEN = (
    McapError,
    struct.error,
    ValueError,
    OverflowError,
    EOFError,
    RuntimeError,
    MemoryError,
    zstandard.ZstdError,
)

R = TypeVar("R", Schema, Channel, Metadata, Attachment, Statistics)


@dataclass(frozen=True)
class WholeMessage:
    """An intact message with its channel and schema. Times are in ns since the epoch."""

    channel: Channel
    schema: Schema | None
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


Whole = WholeMessage | Metadata | Attachment


@dataclass(kw_only=True)
class Damage:
    """Damage of a file.

    `is_whole`: the file has a correct start and a correct end, and nothing was skipped. `places`:
    number of damaged places. `expected`: number of messages according to the statistics record of
    the file. None if the file has no such record.
    """

    is_whole: bool = False
    places: int = 0
    skipped: int = 0
    """Number of skipped bytes."""
    undefined: int = 0
    """Number of messages whose channel or schema is missing in the file."""
    expected: int | None = None
    exhausted: bool = False
    """Whether reading was aborted because the file exceeds a limit."""


@dataclass
class DamagedMcap:
    """A damaged file. Call `records` once. Afterwards `damage` is complete."""

    file: BinaryIO
    damage: Damage = field(default_factory=Damage)

    def __post_init__(self) -> None:
        self.size = self.file.seek(0, 2)
        self.has_magic = self._read(0, len(MAGIC)) == MAGIC
        self._unpack_left = UNPACKED + UNPACKED_A_BYTE * self.size
        self._work_left = WORK + WORK_A_BYTE * self.size
        self._defined: dict[int, dict[int, Any]] = {Opcode.SCHEMA: {}, Opcode.CHANNEL: {}}
        self._checked: set[tuple[int, int]] = set()
        self._definition_bytes = 0
        self._ended = False
        self._others = 0
        self._chunks = 0

    def records(self, tail: int | None = None) -> Iterator[Whole]:
        """Yield all intact records.

        If `tail` is given, skip the chunks before the last `tail` bytes of the file. In this case,
        `damage` is not meaningful.
        """
        # A definition is a schema or a channel. A complete file repeats its definitions at its end.
        # First read these repeated definitions, because the definitions at the start of the file
        # may be damaged.
        self._take_summary()
        place = len(MAGIC) if self.has_magic else self._skip(0, None)
        # Read record by record, and skip damaged places.
        first_record = place
        while place < self.size and not self._ended:
            head = self._head(place)
            if tail is not None and head is not None and head[0] == Opcode.CHUNK:
                begin, tail = self.size - tail, None
                if place < begin:
                    place = self._next_chunk(begin)
                    continue
            taken = None if head is None else self._taken(place, *head)
            if head is None or taken is None:
                place = self._skip(place, head)
                continue
            yield from taken
            place += HEAD.size + head[1]
        damage = self.damage
        damage.is_whole = (
            self.has_magic and self._ended and not self.damage.places and not self.damage.undefined
        )
        if not self._chunks:
            yield from self._outside_chunks(first_record)

    # One record

    def _read(self, place: int, size: int) -> bytes:
        self.file.seek(place)
        return self.file.read(size)

    def _head(self, place: int) -> tuple[int, int] | None:
        """Return the opcode and the length of the record at `place`.

        Return None if no record can start at `place`.
        """
        head = self._read(place, HEAD.size)
        if len(head) < HEAD.size:
            return None
        opcode, length = HEAD.unpack(head)
        if opcode == 0 or length > min(self.size - place - HEAD.size, LARGEST):
            return None
        if opcode == Opcode.CHUNK and not self._is_chunk(place, length):
            return None
        return None if Opcode.DATA_END < opcode < 0x80 else (opcode, length)

    def _heads(self, place: int) -> Iterator[tuple[int, int, int]]:
        """Yield the place of the body, the opcode and the length of each record.

        Stop at the first damaged place.
        """
        while place < self.size and (head := self._head(place)) is not None:
            yield place + HEAD.size, *head
            place += HEAD.size + head[1]

    def _is_chunk(self, place: int, length: int) -> bool:
        """Return whether the lengths in the chunk header match the length of the record."""
        body = self._read(place + HEAD.size, CHUNK.size + 12)
        if len(body) < CHUNK.size + 8:
            return False
        name = CHUNK.unpack_from(body)[4]
        if name not in (0, 3, 4) or len(body) < CHUNK.size + name + 8:
            return False
        (data,) = struct.unpack_from("<Q", body, CHUNK.size + name)
        return bool(length == CHUNK.size + name + 8 + data)

    def _taken(self, place: int, opcode: int, length: int) -> Iterable[Whole] | None:
        """Read the record at `place` and return the records to yield.

        Return None if the record at `place` is damaged.
        """
        # The limit `WORK` applies to the sum of all records that are read.
        self._work_left -= length
        self._others += opcode in (Opcode.METADATA, Opcode.ATTACHMENT)
        if self._work_left < 0 or self._others > MOST_OTHERS:
            self.damage.exhausted = True
            return None
        if opcode in SKIPPED or opcode >= 0x80:
            return ()
        if opcode == Opcode.FOOTER:
            self._ended = self._footer(place, length)
            return () if self._ended else None
        # The content of the following records is parsed.
        body = self._read(place + HEAD.size, length)
        is_valid = True  # header, end of data
        match opcode:
            case Opcode.CHUNK:
                return self._chunk(body)
            case Opcode.METADATA | Opcode.ATTACHMENT:
                record = _parsed(KINDS[opcode], body)
                return None if record is None else [record]
            case Opcode.SCHEMA | Opcode.CHANNEL:
                is_valid = self._define(opcode, body)
            case Opcode.MESSAGE:
                is_valid = length >= MESSAGE.size
            case Opcode.STATISTICS:
                statistics = _parsed(Statistics, body)
                is_valid = statistics is not None
                if statistics is not None:
                    self.damage.expected = statistics.message_count
            case Opcode.MESSAGE_INDEX:
                is_valid = length >= 6 and struct.unpack_from("<I", body, 2)[0] == length - 6
        return () if is_valid else None

    def _footer(self, place: int, length: int) -> bool:
        end = place + HEAD.size + length
        return (
            length == FOOTER_SIZE
            and end + len(MAGIC) == self.size
            and self._read(end, len(MAGIC)) == MAGIC
        )

    def _define(self, opcode: int, body: bytes, *, checked: bool = False) -> bool:
        """Store a schema or channel. Return whether the record is valid.

        If an ID has several definitions, the first definition is kept. There is one exception: a
        definition from a chunk (`checked`) has a checksum. Such a definition replaces a definition
        without a checksum.
        """
        record, known = _parsed(KINDS[opcode], body), self._defined[opcode]
        if record is None:
            return False
        key = (opcode, record.id)
        if record.id not in known or (checked and key not in self._checked):
            self._definition_bytes += len(body)
            if self._definition_bytes > DEFINITIONS or len(known) >= MOST_DEFINITIONS:
                self.damage.exhausted = True
                return False
            known[record.id] = record
            if checked:
                self._checked.add(key)
        return opcode == Opcode.CHANNEL or record.id != 0

    # Chunks

    def _chunk(self, body: bytes) -> Iterator[Whole] | None:
        _, _, size, checksum, name = CHUNK.unpack_from(body)
        compression, packed = body[CHUNK.size : CHUNK.size + name], body[CHUNK.size + name + 8 :]
        if size > LARGEST or size > self._unpack_left:
            self.damage.exhausted = self.damage.exhausted or size <= LARGEST
            return None
        self._unpack_left -= size
        try:
            data = _unpacked(compression, packed, size)
        except BROKEN:
            return None
        if len(data) != size or (checksum and zlib.crc32(data) != checksum):
            return None
        end = 0
        for opcode, first, end in _inside(data):
            is_message = opcode == Opcode.MESSAGE and end - first >= MESSAGE.size
            if not is_message and opcode not in self._defined:
                return None
        if end != len(data):
            return None
        self._chunks += 1
        return self._of_chunk(data)

    def _of_chunk(self, data: bytes) -> Iterator[Whole]:
        for opcode, first, last in _inside(data):
            if opcode == Opcode.MESSAGE:
                message = self._message(data[first:last])
                if message is not None:
                    yield message
            else:
                self._define(opcode, data[first:last], checked=True)

    def _message(self, body: bytes) -> WholeMessage | None:
        number, sequence, log_time, publish_time = MESSAGE.unpack_from(body)
        channel = self._defined[Opcode.CHANNEL].get(number)
        schema = channel and self._defined[Opcode.SCHEMA].get(channel.schema_id)
        if channel is None or (schema is None and channel.schema_id):
            self.damage.undefined += 1
            return None
        return WholeMessage(channel, schema, sequence, log_time, publish_time, body[MESSAGE.size :])

    def _outside_chunks(self, place: int) -> Iterator[Whole]:
        """Yield the messages of a file without chunks, up to the first damaged place."""
        for body, opcode, length in self._heads(place):
            if opcode == Opcode.MESSAGE and length >= MESSAGE.size:
                message = self._message(self._read(body, length))
                if message is not None:
                    yield message

    # Damaged places

    def _skip(self, place: int, head: tuple[int, int] | None) -> int:
        """Return the place at which reading continues after a damaged place.

        If `head`, the head of the damaged record, is correct, reading continues at the next record.
        Otherwise reading continues at the next chunk, or at the end if there is no further chunk.
        """
        self.damage.places += 1
        following = self.size
        if not self.damage.exhausted:
            behind = self.size if head is None else place + HEAD.size + head[1]
            is_next = behind < self.size and self._head(behind) is not None
            following = behind if is_next else self._next_chunk(place + 1)
        self.damage.skipped += following - place
        return following

    def _next_chunk(self, place: int) -> int:
        # Start with a small window, because the next chunk may be near. If a file has many damaged
        # places, a large window at each of them would take too long.
        size = FIRST_WINDOW
        while place < self.size:
            window = self._read(place, size + HEAD.size - 1)
            for found in NEXT_CHUNK.finditer(window):
                start = place + found.start()
                if self._head(start) is not None:
                    return start
            place, size = place + size, min(2 * size, WINDOW)
        return self.size

    def _take_summary(self) -> None:
        """Store the schemas and channels that a complete file repeats at its end."""
        footer = self._read(
            max(0, self.size - len(MAGIC) - FOOTER_SIZE - HEAD.size), HEAD.size + FOOTER_SIZE
        )
        if len(footer) < HEAD.size + FOOTER_SIZE or footer[0] != Opcode.FOOTER:
            return
        (place,) = struct.unpack_from("<Q", footer, HEAD.size)
        for body, opcode, length in self._heads(place) if place >= len(MAGIC) else ():
            if opcode not in self._defined or not self._define(opcode, self._read(body, length)):
                return


def _inside(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start of body and end of body of each record. Stop at an incomplete record."""
    place, size = 0, len(data)
    while place + HEAD.size <= size:
        opcode, length = HEAD.unpack_from(data, place)
        place += HEAD.size
        if length > size - place:
            return
        yield opcode, place, place + length
        place += length


def _unpacked(compression: bytes, packed: bytes, size: int) -> bytes:
    """Decompress a chunk. Stop after `size` + 1 bytes, even if there is more data."""
    if compression == b"":
        return packed
    if compression == b"lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1))
    if compression == b"zstd":
        unpacker = zstandard.ZstdDecompressor(max_window_size=2 * LARGEST)
        with unpacker.stream_reader(BytesIO(packed)) as stream:
            return stream.read(size + 1)
    raise ValueError("an unknown compression")


def _parsed(kind: type[R], body: bytes) -> R | None:
    """Parse a record with the mcap library. Return None if the record is invalid.

    To check the record, the library writes the parsed record again. The bytes must be the same.
    Further bytes at the end are permitted, because later versions of MCAP may add fields.
    """
    try:
        record: R = kind.read(ReadDataStream(BytesIO(body)))
        builder = RecordBuilder()
        record.write(builder)
        data: bytes = builder.end()[HEAD.size :]  # type: ignore[no-untyped-call]
    except BROKEN:
        return None
    return record if body[: len(data)] == data else None
