"""Runs whose files were edited, cut or replaced: one sentence, in bounded time and memory."""

from __future__ import annotations

import copy
import json
import os
import random
import resource
import shutil
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from families import family
from run_processes import SCENARIO, SHORT, WHOLE, incomplete, names

import freeflyer as ff
from freeflyer.foundation.errors import CosimError
from freeflyer.scenario import saved_run, scenario
from freeflyer.scenario.run_state import DEAD, DESCRIPTION, RECORD, ROWS, SUMMARY

SECONDS, BYTES = 5.0, 400 << 20
"""Limits for one damaged run."""


def deep(depth: int, key: str | None = None) -> Any:
    found: Any = 1
    for _ in range(depth):
        found = [found] if key is None else {key: found}
    return found


VALUES: list[Callable[[], Any]] = [
    lambda: None, lambda: True, lambda: -1, lambda: 10**400, lambda: -(10**4000), lambda: 1e308,
    lambda: float("nan"), lambda: float("inf"), lambda: "", lambda: "x" * 100_000, lambda: "\ud800",
    lambda: "\x1b[31m\n\0", lambda: [], lambda: {}, lambda: deep(400), lambda: deep(900), lambda: deep(400, "a"),
    lambda: [float("nan")], lambda: {"a": {"b": None}}, lambda: {"max": [1], "last_10_s": "x"}, lambda: "../../../etc", lambda: [[1, 2], ["a"]],
]  # fmt: skip


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the paths of all members of a JSON value."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()  # fmt: skip
    for key, member in items:
        yield (*path, key)
        yield from places(member, (*path, key))


def edited(value: Any, draw: random.Random) -> Any:
    """Return a JSON value with some members replaced, removed or added."""
    found = copy.deepcopy(value)
    for _ in range(draw.choice([1, 1, 2])):
        *above, last = draw.choice([path for path in places(found) if len(path) < 3] if draw.random() < 0.6 else list(places(found)))  # fmt: skip
        owner = found
        for key in above:
            owner = owner[key]
        if draw.random() < 0.15:
            del owner[last]
        elif draw.random() < 0.1 and isinstance(owner, dict):
            owner[draw.choice(["a_error_m", "\ud800", "", "x" * 1000])] = draw.choice(VALUES)()
        else:
            owner[last] = draw.choice(VALUES)()
    return found


def cut(data: bytes, draw: random.Random) -> bytes:
    """Return other bytes: cut, changed, repeated or hostile ones."""
    place = draw.randrange(len(data))
    kind = draw.randrange(6)
    if kind == 0:
        return data[:place]
    if kind == 1:
        return data[:place] + bytes(draw.randrange(256) for _ in range(8)) + data[place + 8 :]
    if kind == 2:
        return data[:place] + data[place // 2 :]
    if kind == 3:
        return data[-draw.randrange(1, 200) :]
    if kind == 4:
        return draw.choice([b"", b"\xef\xbb\xbf{}", b"[" * 10**6, b'{"run":' * 10**5, b"9" * 10**6, b"PAR1" * 100, bytes(5000), b"null"])  # fmt: skip
    return data + data[:place]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    ff.run(SCENARIO, {"stop_s": 0.05}, directory=folder / "run")
    return folder / "run"


@pytest.fixture(scope="module")
def unfinished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("unfinished")
    incomplete(folder / "run")
    return folder / "run"


def one_sentence(call: Callable[[], Any]) -> Any:
    """Call a function; an error must be one sentence for the user. Return the result or None."""
    start, before = time.monotonic(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        return call()
    except CosimError as error:
        text = str(error)
        assert len(text.splitlines()) == 1, text
        assert len(text) < 3000, text[:3000]
        for term in ("object has no attribute", "not subscriptable", "NoneType", "unhashable", "indices must"):  # fmt: skip
            assert term not in text, text
        return None
    finally:
        assert time.monotonic() - start < SECONDS
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < BYTES >> 10


def read_everything(run: Path, good: Path) -> None:
    """Use all readers of a finished run."""
    result = one_sentence(lambda: ff.open_run(run))
    if result is not None:
        repr(result), result._repr_html_()
    one_sentence(lambda: ff.audit(run))
    again = one_sentence(lambda: scenario.load(str(run)))
    if again is not None:
        assert again.components
    found = ff.runs([run, good])
    str(found), found._repr_html_(), json.dumps([one.as_json for one in found])
    one_sentence(found.compare)
    one_sentence(lambda: ff.runs([run, good], where={"base_controller.period": 0.3}))
    one_sentence(lambda: ff.runs(run.parent, scenario="x"))
    if result is not None:
        other = ff.open_run(good)
        one_sentence(lambda: other.differences(result))


def check_summary(seeds: range, finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    text = (finished / SUMMARY).read_bytes()
    for seed in seeds:
        draw = random.Random(seed)
        changed = cut(text, draw) if seed % 4 == 0 else json.dumps(edited(json.loads(text), draw)).encode()  # fmt: skip
        (run / SUMMARY).write_bytes(changed)
        try:
            read_everything(run, finished)
        except BaseException:
            print("seed", seed)
            raise
        assert names(run) == WHOLE


def test_an_edited_summary_is_one_sentence_or_a_run(finished: Path, tmp_path: Path) -> None:
    check_summary(range(16), finished, tmp_path)


@pytest.mark.slow
def test_many_edited_summaries(finished: Path, tmp_path: Path) -> None:
    check_summary(range(1000, 1250), finished, tmp_path)


def check_record(seeds: range, finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    data = (finished / RECORD).read_bytes()
    for seed in seeds:
        (run / RECORD).write_bytes(cut(data, random.Random(seed)))
        result = one_sentence(lambda: ff.open_run(run))
        if result is not None:
            assert result.record.digest == ff.open_run(finished).record.digest
        one_sentence(lambda: ff.audit(run))


def test_a_damaged_record_is_one_sentence(finished: Path, tmp_path: Path) -> None:
    check_record(range(16), finished, tmp_path)


@pytest.mark.slow
def test_many_damaged_records(finished: Path, tmp_path: Path) -> None:
    check_record(range(1000, 1400), finished, tmp_path)


def check_rows(seeds: range, unfinished: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    rows, about = unfinished / DEAD / ROWS, unfinished / DEAD / DESCRIPTION
    for seed in seeds:
        draw = random.Random(seed)
        shutil.copytree(unfinished, run)
        if seed % 2:
            (run / DEAD / DESCRIPTION).write_text(json.dumps(edited(json.loads(about.read_text()), draw)))  # fmt: skip
        elif seed % 4:
            rest = rows.read_bytes().partition(b"{")[2]
            header, end = json.JSONDecoder().raw_decode("{" + rest.decode("latin-1"))
            text = json.dumps(edited(header, draw)).encode()
            start = -(-(64 + len(text)) // 4096) * 4096
            old = -(-(64 + end) // 4096) * 4096
            (run / DEAD / ROWS).write_bytes((b"freeflyer-rows 1 %d\n" % len(text)).ljust(64) + text.ljust(start - 64, b"\0") + rows.read_bytes()[old:])  # fmt: skip
        else:
            (run / DEAD / ROWS).write_bytes(cut(rows.read_bytes(), draw))
        before = (run / DEAD / ROWS).read_bytes()
        str(ff.runs([run, unfinished]))
        try:
            completed = one_sentence(lambda: saved_run.complete(run))
        except BaseException:
            print("seed", seed)
            raise
        if completed is None:  # nothing is lost
            assert any((run / name / ROWS).exists() and (run / name / ROWS).read_bytes() == before for name in ("unfinished", DEAD))  # fmt: skip
            assert SUMMARY not in names(run)
        else:
            assert names(run) == WHOLE
            read_everything(run, run)
        shutil.rmtree(run)


def test_damaged_rows_are_one_sentence_and_stay(unfinished: Path, tmp_path: Path) -> None:
    check_rows(range(12), unfinished, tmp_path)


@pytest.mark.slow
def test_many_damaged_rows(unfinished: Path, tmp_path: Path) -> None:
    check_rows(range(1000, 1200), unfinished, tmp_path)


KINDS = ("fifo", "directory", "link to a terminal", "dangling link", "loop", "endless", "unreadable", "sparse")  # fmt: skip


def hostile(path: Path, kind: str) -> None:
    """Replace a file by something else."""
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "directory":
        path.mkdir()
    elif kind == "unreadable":
        path.write_bytes(b"")
        path.chmod(0)
    elif kind == "sparse":
        with path.open("wb") as file:
            file.truncate(1 << 40)
    else:
        targets = {"link to a terminal": "/dev/tty", "dangling link": "nowhere", "loop": path.name, "endless": "/dev/zero"}  # fmt: skip
        path.symlink_to(targets[kind])


@pytest.mark.parametrize("kind", family(KINDS, ("fifo", "sparse", "loop")))
def test_something_else_in_place_of_a_file_is_one_sentence(
    kind: str, finished: Path, unfinished: Path, tmp_path: Path
) -> None:
    for name in (SUMMARY, RECORD):
        run = tmp_path / f"{name} run"
        shutil.copytree(finished, run)
        hostile(run / name, kind)
        read_everything(run, finished)
    for name in (ROWS, DESCRIPTION, "process.json", ""):
        run = tmp_path / f"{name} unfinished"
        shutil.copytree(unfinished, run)
        (run / DEAD).rename(run / "unfinished")
        (run / "unfinished" / "process.json").write_text("{}")
        hostile(run / "unfinished" / name, kind)
        str(ff.runs([run, finished]))
        one_sentence(partial(ff.open_run, run))
        one_sentence(partial(saved_run.complete, run))
        for existing in (None, "keep"):
            one_sentence(partial(ff.run, SCENARIO, SHORT, directory=run, existing=existing))
    str(ff.runs(tmp_path))


def test_the_run_of_a_newer_version_names_that_version(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    summary = json.loads((run / SUMMARY).read_text())
    summary["run"]["format"] = 2
    summary["versions"]["freeflyer-cosim"] = "9.9"
    (run / SUMMARY).write_text(json.dumps(summary))
    for call in (ff.open_run, lambda path: scenario.load(str(path))):
        with pytest.raises(CosimError, match=r"has format 2, but .* reads format 1; use the version that wrote it \(9.9\)"):  # fmt: skip
            call(run)
    (listed,) = ff.runs(run)
    assert listed.state == "unreadable"
    assert "has format 2" in listed.remark


def test_a_record_that_was_changed_after_the_run_is_not_opened_as_its_result(
    finished: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    ff.run(SCENARIO, {"stop_s": 0.06}).record.write(run / RECORD)
    with pytest.raises(CosimError, match="is not the record that the run has written"):
        ff.open_run(run)


def test_a_number_that_was_edited_in_a_summary_is_found(tmp_path: Path) -> None:
    ff.run("multirate_passive", {"stop_s": 0.01}, directory=tmp_path / "run")
    path = tmp_path / "run" / SUMMARY
    text = path.read_text()
    summary = json.loads(text)
    summary["base_position_error_m"]["max"] = 1e-12
    path.write_text(json.dumps(summary))
    with pytest.raises(ff.RecordError, match="does not agree with its hash"):
        ff.open_run(tmp_path / "run")
    assert ff.runs(tmp_path)[0].state == "unreadable"
    path.write_text(json.dumps(json.loads(text), indent=8))  # another layout is no change
    assert ff.open_run(tmp_path / "run").verdict == "completed"
