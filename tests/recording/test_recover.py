"""`freeflyer recover`: the result is a complete file that contains only recorded messages."""

from __future__ import annotations

import struct
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path

import can
import lz4.frame
import numpy as np
import pytest
import zstandard
from commands import run_command
from hypothesis import given, settings
from hypothesis import strategies as st
from loops import head, recording
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from freeflyer.cli import main as command
from freeflyer.foundation.errors import CosimError, RecordError
from freeflyer_adapters import read_recording
from freeflyer_adapters.recording.damaged_mcap import (
    LARGEST,
    UNPACKED,
    UNPACKED_A_BYTE,
    DamagedMcap,
    WholeMessage,
)
from freeflyer_adapters.recording.recover import recover
from freeflyer_adapters.recording.ring import RingWriter

WHOLE = recording(120)
UNFINISHED = recording(120, finished=False)
MAGIC = WHOLE[:8]
Key = tuple[str, int, bytes]


def keys(data: bytes) -> Counter[Key]:
    """Return the messages that the mcap reader finds."""
    return Counter(
        (c.topic, m.log_time, m.data)
        for _, c, m in make_reader(BytesIO(data), validate_crcs=True).iter_messages()
    )


WRITTEN = keys(WHOLE)


def ends_of_chunks(data: bytes) -> list[tuple[int, int]]:
    """Return the end of each chunk of an undamaged file, and the number of messages before it.

    Only the lengths of records are used.
    """
    found, place, count = [], 8, 0
    while place + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, place)
        if place + 9 + length > len(data):
            break
        if opcode == Opcode.CHUNK:
            chunk = data[place : place + 9 + length]
            (record,) = (
                r
                for r in StreamReader(
                    BytesIO(chunk + FOOTER), skip_magic=True, emit_chunks=True
                ).records
                if isinstance(r, Chunk)
            )
            inside = zstandard.decompress(record.data, record.uncompressed_size)
            at = 0
            while at < len(inside):
                kind, size = struct.unpack_from("<BQ", inside, at)
                count += kind == Opcode.MESSAGE
                at += 9 + size
            found.append((place + 9 + length, count))
        place += 9 + length
        if opcode == Opcode.FOOTER:
            break
    return found


FOOTER = struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0) + MAGIC
CHUNKS = ends_of_chunks(WHOLE)
UNFINISHED_COUNT = ends_of_chunks(UNFINISHED)[-1][1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    return tmp_path_factory.mktemp("damaged")


def recovered(folder: Path, data: bytes) -> tuple[Counter[Key], int]:
    """Return the kept messages and their number; check the new file with the mcap reader."""
    path, out = folder / "damaged.mcap", folder / "out.mcap"
    path.write_bytes(data)
    out.unlink(missing_ok=True)
    done = recover(path, out)
    assert path.read_bytes() == data
    with out.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == done.kept
    return keys(out.read_bytes()), done.kept


def test_a_complete_file_is_not_changed(folder: Path) -> None:
    assert recovered(folder, WHOLE) == (WRITTEN, len(WRITTEN))
    path = folder / "whole.mcap"
    path.write_bytes(WHOLE)
    done = recover(path)
    assert done.path is None
    assert "is complete" in done.sentence
    assert not (folder / "whole_recovered.mcap").exists()


@given(cut=st.integers(0, len(WHOLE)))
@settings(max_examples=60)
def test_a_file_cut_anywhere_keeps_every_chunk_before_the_cut(cut: int, folder: Path) -> None:
    expected = max((count for end, count in CHUNKS if end <= cut), default=0)
    if cut < 8:
        with pytest.raises(CosimError, match="is not an MCAP recording"):
            recovered(folder, WHOLE[:cut])
        return
    kept, count = recovered(folder, WHOLE[:cut])
    assert count == expected
    assert kept <= WRITTEN


@pytest.mark.parametrize("offset", range(-2, 12))
def test_a_file_cut_near_the_end_of_a_record_keeps_what_is_before(
    offset: int, folder: Path
) -> None:
    end, count = CHUNKS[2]
    before = CHUNKS[1][1]
    kept, _ = recovered(folder, WHOLE[: end + offset])
    assert sum(kept.values()) == (count if offset >= 0 else before)
    assert kept <= WRITTEN


@given(place=st.integers(0, len(WHOLE) - 1), flip=st.integers(1, 255), finished=st.booleans())
@settings(max_examples=80)
def test_a_changed_byte_loses_at_most_one_chunk_and_adds_no_message(
    place: int, flip: int, finished: bool, folder: Path
) -> None:
    data = bytearray(WHOLE if finished else UNFINISHED)
    place %= len(data)
    data[place] ^= flip
    kept, count = recovered(folder, bytes(data))
    assert kept <= WRITTEN
    largest = max(
        after - before for (_, after), (_, before) in zip(CHUNKS, [(0, 0), *CHUNKS], strict=False)
    )
    begin = CHUNKS[0][0]
    # Definitions at the end of a finished file replace damaged ones at the start.
    total = len(WRITTEN) if finished else UNFINISHED_COUNT
    assert count >= total - largest or (place < begin and not finished)


@given(
    begin=st.integers(8, len(WHOLE)),
    size=st.integers(0, 20_000),
    garbage=st.binary(max_size=300),
    finished=st.booleans(),
)
def test_garbage_in_the_middle_loses_only_the_chunks_that_it_overlaps(
    begin: int, size: int, garbage: bytes, finished: bool, folder: Path
) -> None:
    data = WHOLE if finished else UNFINISHED
    kept, count = recovered(folder, data[:begin] + garbage + data[begin + size :])
    assert kept <= WRITTEN
    assert count >= max((number for end, number in CHUNKS if end <= begin), default=0)


def test_chunks_after_a_damaged_place_are_kept(folder: Path) -> None:
    (first, _), (second, count) = CHUNKS[1:3]
    middle = (first + second) // 2
    data = UNFINISHED[:middle] + b"\xff" * 500 + UNFINISHED[middle + 300 :]
    kept, found = recovered(folder, data)
    assert kept <= WRITTEN
    assert found == UNFINISHED_COUNT - (count - CHUNKS[1][1])


def refusal(call: Callable[[], object]) -> str | None:
    """Return the message of a CosimError, None without an error; other errors are not caught."""
    try:
        call()
    except CosimError as error:
        return str(error)
    return None


@given(
    data=st.one_of(st.binary(max_size=400), st.binary(max_size=400).map(lambda tail: MAGIC + tail))
)
@settings(max_examples=120)
def test_any_bytes_give_a_complete_file_or_an_error_of_one_line(data: bytes, folder: Path) -> None:
    for suffix in (".mcap", ".blf", ".ring", ".txt"):
        path = folder / f"any{suffix}"
        path.write_bytes(data if suffix != ".blf" else b"LOGG" + data)
        for call in (lambda path=path: recover(path, None), lambda path=path: read_recording(path)):
            sentence = refusal(call)
            assert sentence is None or len(sentence.splitlines()) == 1


def chunk(data: bytes, compression: str, size: int, checksum: int = 0) -> bytes:
    body = (
        struct.pack("<QQQI", 0, 0, size, checksum)
        + struct.pack("<I", len(compression))
        + compression.encode()
    )
    body += struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", Opcode.CHUNK, len(body)) + body


def zeros(size: int) -> bytes:
    packer = zstandard.ZstdCompressor(level=1, write_content_size=False).compressobj()
    parts = [packer.compress(bytes(2**20)) for _ in range(size // 2**20)]
    return b"".join([*parts, packer.flush()])


@pytest.mark.parametrize(
    "data",
    [
        lambda: MAGIC + chunk(zeros(2**30), "zstd", 2**30),
        lambda: MAGIC + chunk(zeros(2**30), "zstd", LARGEST),
        lambda: MAGIC + chunk(lz4.frame.compress(bytes(2**28)), "lz4", 2**28) * 5,
        lambda: MAGIC + struct.pack("<BQ", Opcode.CHUNK, 2**62) + bytes(1000),
        lambda: MAGIC + struct.pack("<BQ", Opcode.ATTACHMENT, 2**40) + bytes(1000),
        lambda: MAGIC + struct.pack("<BQ", Opcode.ATTACHMENT, 40) + bytes(24) + b"\xff" * 16,
        lambda: MAGIC + chunk(zstandard.compress(struct.pack("<BQ", 5, 2**60) * 1000), "zstd", 9000) * 100,
        lambda: MAGIC + chunk(b"", "", 0) * 20_000,
        lambda: MAGIC + b"".join(chunk(b"x" * 5, "zstd", 100) for _ in range(20_000)),
        lambda: MAGIC + struct.pack("<BQ", Opcode.SCHEMA, 14) + struct.pack("<HIII", 1, 2**32 - 1, 0, 0),
        lambda: bytes(5 * 2**20),
        lambda: (b"\x06" + bytes(8)) * 100_000,
    ],
    ids=["1 GiB of zeros", "more than its stated size", "lz4", "long chunk", "long attachment", "attachment of all bytes", "lengths inside", "empty chunks",
         "damaged chunks", "long text", "zeros", "starts of chunks"],
)  # fmt: skip
def test_files_that_need_too_much_memory_or_time_are_not_read(
    data: Callable[[], bytes], folder: Path
) -> None:
    kept = list[int]()
    path = folder / "hostile.mcap"
    path.write_bytes(data())
    begin = time.process_time()
    sentence = refusal(lambda: kept.append(recover(path, folder / "hostile_out.mcap").kept))
    assert kept == [0] or (sentence is not None and "is not an MCAP recording" in sentence)
    assert time.process_time() - begin < 10.0


def test_the_decompressed_size_is_limited_by_the_file_size(folder: Path) -> None:
    """The file has many chunks; each chunk is below the limit for a chunk."""
    one = chunk(zeros(LARGEST), "zstd", LARGEST)
    reader = DamagedMcap(BytesIO(MAGIC + one * 100))
    assert list(reader.records()) == []
    assert reader.damage.exhausted
    assert UNPACKED + UNPACKED_A_BYTE * len(MAGIC + one * 100) < 100 * LARGEST


def test_third_party_files_are_recovered(folder: Path) -> None:
    """One file without chunks, one with small chunks."""
    for options in ({"use_chunking": False}, {"chunk_size": 200}):
        stream = BytesIO()
        writer = Writer(stream, **options)
        writer.start()
        schema = writer.register_schema("T", "jsonschema", b"{}")
        channel = writer.register_channel("t", "json", schema)
        for i in range(50):
            writer.add_message(channel, i, b"%d" % i, i)
        cut = stream.getvalue()
        path = folder / "foreign.mcap"
        path.write_bytes(cut)
        assert recover(path, folder / "foreign_out.mcap").kept >= 40


def test_a_recovered_recording_is_readable_by_rosbags_and_pandas(folder: Path) -> None:
    path = folder / "cut.mcap"
    path.write_bytes(UNFINISHED[:-4000])
    done = recover(path)
    assert done.path is not None
    with AnyReader([done.path]) as reader:
        assert (
            sum(1 for c, _, raw in reader.messages() if reader.deserialize(raw, c.msgtype))
            == done.kept
        )
    frame = read_recording(done.path)
    assert frame["instant"].tolist() == list(range(len(frame)))
    assert frame.equals(read_recording(path))


def test_the_command_reports_the_kept_messages_and_rejects_invalid_arguments(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(WHOLE[: CHUNKS[3][0] + 50])
    assert command.call(["recover", str(cut)]) == 0
    output = capsys.readouterr().out
    assert f"kept {CHUNKS[3][1]} messages" in output
    assert "50 bytes in 1 place could not be read" in output
    for path, sentence in (
        (tmp_path / "absent.mcap", "No such file"),
        (tmp_path, "--out"),
        (Path(__file__), "the name of a recording (.mcap)"),
        (cut, "is the damaged file itself"),
    ):
        code, error = run_command(capsys, "recover", str(path), "--out", str(cut))
        assert code == 2, path
        assert sentence in error
    (tmp_path / "empty.mcap").write_bytes(b"")
    code, error = run_command(capsys, "recover", str(tmp_path / "empty.mcap"))
    assert code == 2
    assert "is not an MCAP recording" in error
    code, error = run_command(capsys, "recover", str(cut), "--out", str(tmp_path / "no" / "\0"))
    assert code == 2
    (tmp_path / "file").write_text("")
    code, error = run_command(
        capsys, "recover", str(cut), "--out", str(tmp_path / "file" / "out.mcap")
    )
    assert code == 2
    assert "cannot be written" in error


# CAN logs

FRAMES = 300


def blf(folder: Path) -> bytes:
    path = folder / "made.blf"
    with can.BLFWriter(path, max_container_size=2000) as writer:
        for i in range(FRAMES):
            data = i.to_bytes(8, "little") * 8
            writer.on_message_received(
                can.Message(
                    timestamp=1.8e9 + i * 1e-3,
                    arbitration_id=0x181,
                    is_extended_id=False,
                    is_fd=True,
                    data=data,
                    dlc=64,
                )
            )
    return path.read_bytes()


@given(cut=st.integers(144, 20_000), place=st.integers(0, 20_000), flip=st.integers(0, 255))
def test_a_damaged_can_log_keeps_intact_containers_and_adds_no_frame(
    cut: int, place: int, flip: int, folder: Path
) -> None:
    data = bytearray(blf(folder)[:cut])
    place = 144 + place % max(1, len(data) - 144)
    if place < len(data):
        data[place] ^= flip
    path, out = folder / "damaged.blf", folder / "out.blf"
    path.write_bytes(data)
    done = recover(path, out)
    frames = list(can.BLFReader(out))
    assert len(frames) == done.kept
    numbers = [int.from_bytes(frame.data[:8], "little") for frame in frames]
    assert all(
        frame.data == number.to_bytes(8, "little") * 8
        for frame, number in zip(frames, numbers, strict=True)
    )
    assert numbers == sorted(set(numbers))
    for frame, number in zip(frames, numbers, strict=True):
        assert frame.timestamp == pytest.approx(1.8e9 + number * 1e-3, abs=1e-6)


@pytest.mark.parametrize("size", [0, 1, 15])
def test_an_object_of_size_zero_ends_its_section(size: int, folder: Path) -> None:
    """The reader of python-can would loop without end."""
    content = struct.pack("<4sHHLL", b"LOBJ", 16, 1, size, 100) + bytes(40)
    container = struct.pack("<4sHHLL", b"LOBJ", 16, 1, 32 + len(content), 10) + struct.pack(
        "<H6xL4x", 0, len(content)
    )
    path = folder / "endless.blf"
    path.write_bytes(blf(folder)[:144] + container + content)
    done = recover(path, folder / "out.blf")
    assert done.kept == 0
    assert "could not be decoded" in done.lost


def test_a_ring_with_an_impossible_number_of_rows_is_rejected(
    tmp_path: Path, runtime: Path
) -> None:
    ring = RingWriter(head(tmp_path))
    ring.write(0, np.zeros(ring.width))
    ring.close()
    data = bytearray(ring.path.read_bytes())
    data[64:72] = b"\xff" * 8
    ring.path.write_bytes(data)
    with pytest.raises(CosimError, match="is not a possible number of written rows"):
        recover(ring.path)


def test_an_undamaged_file_gives_the_messages_of_the_mcap_reader_in_the_same_order() -> None:
    ours = [
        (m.channel.topic, m.log_time, m.data)
        for m in DamagedMcap(BytesIO(WHOLE)).records()
        if isinstance(m, WholeMessage)
    ]
    theirs = make_reader(BytesIO(WHOLE)).iter_messages(log_time_order=False)
    assert ours == [(c.topic, m.log_time, m.data) for _, c, m in theirs]
    assert zlib.crc32(WHOLE) == zlib.crc32(recording(120))


def test_a_ring_from_another_directory_is_rejected_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("runtime", "elsewhere", "target"):
        (tmp_path / name).mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "runtime"))
    writer = RingWriter(head(tmp_path / "target"))
    writer.write(0, np.zeros(writer.width))
    writer.close()
    foreign = writer.path.rename(tmp_path / "elsewhere" / writer.path.name)
    with pytest.raises(RecordError, match="but the ring is neither in this directory nor in"):
        recover(foreign)
    assert not list((tmp_path / "target").iterdir())
