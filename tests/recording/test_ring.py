"""Ring: a reader receives intact rows in order, and counts the overwritten ones."""

from __future__ import annotations

import contextlib
import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from loops import head

from freeflyer.foundation.errors import CosimError, RecordError
from freeflyer_adapters.recording.ring import RingReader, RingWriter, is_left_behind, left_behind

FAST_WRITER = """
import sys
import numpy as np
from pathlib import Path
from loops import head
from freeflyer_adapters.recording.ring import RingWriter
ring = RingWriter(head(Path("/")), Path(sys.argv[1]))
print(ring.path, flush=True)
line = np.zeros(ring.width)
sys.stdin.readline()
for k in range(int(sys.argv[2])):
    line[:] = k
    ring.write(k, line)
ring.set_reason("all written")
"""


def test_rows_are_read_as_they_were_written(runtime: Path) -> None:
    ring = RingWriter(head(runtime))
    reader = RingReader(ring.path)
    lines = np.random.default_rng(1).normal(size=(100, ring.width))
    for k, line in enumerate(lines):
        ring.write(7 * k, line)
    first, second = reader.take(60), reader.take(60)
    assert np.array_equal(np.vstack([first.values, second.values]), lines)
    assert [*first.times[:, 2], *second.times[:, 2]] == [7 * k for k in range(100)]
    assert (np.diff(first.times[:, 1]) > 0).all()
    assert len(reader.take(60)) == reader.lost == 0
    assert reader.head == ring_head(ring)
    assert reader.reason is None
    ring.set_reason("a limit: 3 N")
    assert reader.reason == "a limit: 3 N"


def ring_head(ring: RingWriter) -> object:
    again = RingReader(ring.path)
    try:
        return again.head
    finally:
        again.close()


def test_a_delayed_reader_counts_the_overwritten_rows(runtime: Path) -> None:
    ring = RingWriter(head(runtime))
    reader = RingReader(ring.path)
    line = np.zeros(ring.width)
    for k in range(3 * ring.rows):
        ring.write(k, line)
    rows = reader.take(10 * ring.rows)
    assert len(rows) + reader.lost == 3 * ring.rows
    assert rows.times[-1, 2] == 3 * ring.rows - 1
    assert len(rows) == ring.rows - 1  # all except the row that is overwritten next


def test_a_reader_of_a_faster_writer_receives_only_intact_rows(runtime: Path) -> None:
    count = 60_000
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(
            [str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]
        ),
    }
    with subprocess.Popen(
        [sys.executable, "-c", FAST_WRITER, str(runtime), str(count)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment,
    ) as writer:  # fmt: skip
        assert writer.stdout is not None
        assert writer.stdin is not None
        reader = RingReader(Path(writer.stdout.readline().strip()))
        writer.stdin.write("\n")
        writer.stdin.flush()
        taken, last = 0, -1
        while reader.reason is None or reader.next < reader.written:
            rows = reader.take(20_000)
            assert (rows.values == rows.times[:, 2:3]).all()
            assert (np.diff(rows.times[:, 2]) > 0).all()
            if len(rows):
                assert rows.times[0, 2] > last
                last = int(rows.times[-1, 2])
            taken += len(rows)
    assert taken + reader.lost == count
    assert taken > 0


def test_the_last_seconds_are_those_before_the_newest_row(runtime: Path) -> None:
    ring = RingWriter(head(runtime))
    reader = RingReader(ring.path)
    assert len(reader.last(1.0)) == 0
    for k in range(50):
        ring.write(k, np.full(ring.width, float(k)))
    rows = reader.last(3600.0)
    assert rows.times[:, 2].tolist() == list(range(50))
    span = (rows.times[-1, 1] - rows.times[30, 1]) * 1e-9
    assert reader.last(span).times[0, 2] == 30
    assert reader.next == 0


def test_a_ring_is_left_behind_only_after_all_users_have_closed_it(runtime: Path) -> None:
    ring = RingWriter(head(runtime))
    reader = RingReader(ring.path)
    assert not is_left_behind(ring.path)
    ring.close()
    assert list(left_behind()) == []
    reader.close()
    assert list(left_behind()) == [ring.path]


def test_without_enough_memory_no_ring_file_remains(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*arguments: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(RecordError, match="No space left"):
        RingWriter(head(runtime))
    assert list(runtime.rglob("*.ring")) == []


def test_a_directory_that_is_not_private_is_rejected(runtime: Path) -> None:
    RingWriter(head(runtime)).close()
    next(runtime.iterdir()).chmod(0o755)
    with pytest.raises(RecordError, match="not private"):
        RingWriter(head(runtime))


@given(data=st.data())
def test_a_damaged_ring_is_read_or_rejected_with_a_cosim_error(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("rings")
    ring = RingWriter(head(folder), folder)
    for k in range(5):
        ring.write(k, np.zeros(ring.width))
    ring.close()
    raw = bytearray(ring.path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.one_of(st.integers(0, 200), st.integers(4096, 7000)))
        raw[place] = data.draw(st.integers(0, 255))
    cut = data.draw(st.one_of(st.just(len(raw)), st.integers(0, len(raw))))
    path = folder / "damaged.ring"
    path.write_bytes(raw[:cut])
    with contextlib.suppress(CosimError):
        reader = RingReader(path)
        reader.last(2.0)
        reader.close()
    path.unlink()
    ring.path.unlink()
