"""The reason of a stop is written first, even if disk, terminal or system log fail."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_disk import fill, mounted

from freeflyer.foundation.errors import OutputError
from freeflyer.foundation.exit_codes import BAD_INPUT
from freeflyer_adapters.foundation.errors import DeviceError
from freeflyer_adapters.loop.stop_notice import (
    LONGEST,
    LONGEST_MESSAGE,
    SIZE,
    StopNotice,
    check_log_to,
    printable_line,
)

REASON, LEFT = "arm_drive: too many lost cycles", "all devices were brought to rest"
SENTENCE = f"Stop: {REASON}; {LEFT}"
CHILD = """
import sys, time
from pathlib import Path
from freeflyer_adapters.loop.stop_notice import StopNotice
notice = StopNotice(directory=Path(sys.argv[1]), log_to=None, scenario="child", show=print)
"""
GIVES = f"notice.give({REASON!r}, {LEFT!r}, orderly=False)\n"


def made(
    directory: Path | None = None, log_to: str | None = None, printed: list[str] | None = None
) -> StopNotice:
    return StopNotice(
        directory=directory,
        log_to=log_to,
        scenario="facility",
        show=([] if printed is None else printed).append,
    )


def read(directory: Path) -> dict[str, Any]:
    document = (directory / "stop.json").read_bytes()
    assert len(document) == SIZE
    assert document.endswith(b"\n")
    return dict(json.loads(document))


def child(directory: Path, text: str, **options: Any) -> subprocess.Popen[bytes]:
    buffered = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    command = [sys.executable, "-c", CHILD + text, str(directory)]
    return subprocess.Popen(command, stderr=subprocess.PIPE, env=buffered, **options)


def wait_until_stopped(directory: Path) -> None:
    """Wait until stop.json contains a reason; at most 30 s."""
    end = time.monotonic() + 30.0
    while not ((directory / "stop.json").exists() and read(directory)["stopped"]):
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 64 KiB."""
    with mounted(tmp_path / "disk", "64k") as place:
        yield place


@pytest.fixture
def receiver(tmp_path: Path) -> Iterator[socket.socket]:
    """The Unix socket of a system log."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        one.bind(str(tmp_path / "log"))
        one.settimeout(5.0)
        yield one


def test_the_reason_goes_to_standard_output_and_stop_json(tmp_path: Path) -> None:
    printed: list[str] = []
    with closing(made(tmp_path, printed=printed)) as notice:
        before = read(tmp_path)
        notice.give(REASON, LEFT, orderly=False)
    after = read(tmp_path)
    assert printed == [SENTENCE]
    assert notice.problems == []
    assert list(before) == list(after)
    assert (before["stopped"], before["orderly"], before["reason"]) == (False, None, None)
    assert (after["stopped"], after["orderly"], after["reason"], after["left"]) == (
        True,
        False,
        REASON,
        LEFT,
    )
    assert before["scenario"] == after["scenario"] == "facility"
    assert before["started_ns"] == after["started_ns"] <= after["stopped_ns"] <= time.time_ns()
    assert 0.0 < after["after_s"] < 60.0
    assert os.listdir(tmp_path) == ["stop.json"]


def test_the_reason_is_written_to_a_full_disk(small_disk: Path) -> None:
    notice = made(small_disk)
    fill(small_disk)
    notice.give(REASON + " ä" * 4000, LEFT, orderly=False)
    notice.close()
    assert notice.problems == []
    assert read(small_disk)["stopped"] is True
    assert read(small_disk)["reason"].startswith(REASON)
    with pytest.raises(OSError, match="No space left"):
        (small_disk / "later").write_bytes(b"0" * 4096)


def test_a_disk_that_is_full_at_the_start_is_rejected_and_an_earlier_stop_json_is_kept(
    small_disk: Path,
) -> None:
    with closing(made(small_disk)) as notice:
        notice.give("earlier", LEFT, orderly=True)
    fill(small_disk)
    with pytest.raises(
        OutputError,
        match=r"stop\.json cannot be reserved .*: No space left on device; a directory with",
    ) as caught:
        made(small_disk)
    assert caught.value.exit_code == BAD_INPUT
    assert read(small_disk)["reason"] == "earlier"
    assert sorted(os.listdir(small_disk)) == ["filling", "stop.json"]


def test_a_read_only_disk_is_rejected(small_disk: Path) -> None:
    subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)
    with pytest.raises(OutputError, match="Read-only file system"):
        made(small_disk)


def test_a_path_of_another_type_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "stop.json").mkdir()
    for directory in (tmp_path / "file", tmp_path):
        with pytest.raises(OutputError, match="cannot be reserved") as caught:
            made(directory)
        assert caught.value.exit_code == BAD_INPUT
    assert sorted(os.listdir(tmp_path)) == ["file", "stop.json"]


def test_a_disk_that_fails_at_the_stop_is_reported_as_a_problem(
    tmp_path: Path, receiver: socket.socket
) -> None:
    printed: list[str] = []
    notice = made(tmp_path, f"syslog:{tmp_path}/log", printed)
    descriptor = notice._file
    notice._file = os.open("/dev/full", os.O_WRONLY)
    notice.give(REASON, LEFT, orderly=False)
    notice.close()
    assert descriptor is not None
    os.close(descriptor)
    assert printed == [SENTENCE]
    assert REASON in receiver.recv(SIZE).decode()
    (problem,) = notice.problems
    assert problem.startswith(
        f"the reason of the stop could not be written to {tmp_path}/stop.json: "
    )


@pytest.mark.parametrize("orderly", [False, True])
def test_a_unix_socket_gets_priority_and_text(
    tmp_path: Path, receiver: socket.socket, orderly: bool
) -> None:
    with closing(made(log_to=f"syslog:{tmp_path}/log")) as notice:
        notice.give("two\nlines\x1b[31m", LEFT, orderly=orderly)
    assert (
        receiver.recv(SIZE).decode()
        == f"<{29 if orderly else 28}>freeflyer: Stop: two lines [31m; {LEFT}"
    )  # daemon.notice, .warning
    assert notice.problems == []


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]"])
def test_a_udp_socket_gets_priority_and_text(host: str) -> None:
    try:
        family, _, _, _, (number, *_) = socket.getaddrinfo(
            host.strip("[]"), 514, type=socket.SOCK_DGRAM
        )[0]
        one = socket.socket(family, socket.SOCK_DGRAM)
        one.bind((number, 0))
    except OSError as error:
        pytest.skip(f"no {host} here: {error}")
    with one, closing(made(log_to=f"syslog:{host}:{one.getsockname()[1]}")) as notice:
        one.settimeout(5.0)
        notice.give(REASON, LEFT, orderly=False)
        assert one.recv(SIZE).decode() == f"<28>freeflyer: {SENTENCE}"
    assert notice.problems == []


def test_a_long_reason_is_one_datagram_of_whole_characters(
    tmp_path: Path, receiver: socket.socket
) -> None:
    with closing(made(log_to=f"syslog:{tmp_path}/log")) as notice:
        notice.give("€" * 5000, LEFT, orderly=False)
    message = receiver.recv(10 * SIZE)
    assert LONGEST_MESSAGE - 3 < len(message) <= LONGEST_MESSAGE
    assert message.decode().endswith("€")


def test_a_restarted_daemon_receives_the_reason(tmp_path: Path, receiver: socket.socket) -> None:
    notice = made(log_to=f"syslog:{tmp_path}/log")
    receiver.close()
    (tmp_path / "log").unlink()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as another:
        another.bind(str(tmp_path / "log"))
        notice.give(REASON, LEFT, orderly=False)
        assert SENTENCE in another.recv(SIZE).decode()
    notice.close()
    assert notice.problems == []


def test_a_hung_system_log_does_not_block(tmp_path: Path, receiver: socket.socket) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as filling, suppress(BlockingIOError):
        filling.setblocking(False)
        while True:
            filling.sendto(b"0", receiver.getsockname())
    printed: list[str] = []
    with closing(made(tmp_path, f"syslog:{tmp_path}/log", printed)) as notice:
        begin = time.monotonic()
        notice.give(REASON, LEFT, orderly=False)
        assert time.monotonic() - begin < 1.0
    assert printed == [SENTENCE]
    assert read(tmp_path)["reason"] == REASON
    assert notice.problems == [
        f"the reason of the stop could not be written to the system log at '{tmp_path}/log': Resource temporarily unavailable"
    ]


def test_a_stopped_daemon_is_reported_as_a_problem(
    tmp_path: Path, receiver: socket.socket, capfd: pytest.CaptureFixture[str]
) -> None:
    with closing(made(tmp_path, f"syslog:{tmp_path}/log")) as notice:
        receiver.close()
        notice.give(REASON, LEFT, orderly=False)
    (problem,) = notice.problems
    assert problem.endswith("Connection refused")
    assert read(tmp_path)["reason"] == REASON
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sysloog", "no log 'sysloog'; .* is expected; did you mean 'syslog'"),
        ("", "no log ''; 'syslog', 'syslog:PATH' or 'syslog:HOST:PORT' is expected$"),
        ("syslog:", "nor HOST:PORT"),
        ("syslog:localhost", "nor HOST:PORT"),
        ("syslog:localhost:", "nor HOST:PORT"),
        ("syslog::514", "nor HOST:PORT"),
        ("syslog:localhost:0", "port of 1 to 65535"),
        ("syslog:localhost:65536", "port of 1 to 65535"),
        ("syslog:localhost:" + "9" * 5000, "port of 1 to 65535"),
        ("syslog:localhost:³", "port of 1 to 65535"),
        ("syslog:a..b:514", "no system log receives datagrams at 'a..b:514'"),
        ("syslog:" + "/long" * 50, "path too long"),
        (
            "syslog:/",
            "no system log receives datagrams at '/': Connection refused; start a system log there, or give another",
        ),
        ("syslog:/no\nsuch/log", "No such file"),
    ],
)
def test_an_invalid_log_is_rejected_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    for rejected in (lambda: check_log_to(text), lambda: made(tmp_path, text)):
        with pytest.raises(DeviceError, match=message) as caught:
            rejected()
        assert caught.value.exit_code == BAD_INPUT
        assert "\n" not in str(caught.value)
    assert os.listdir(tmp_path) == []


def test_a_missing_system_log_is_rejected() -> None:
    if os.path.exists("/dev/log"):
        pytest.skip("there is a /dev/log")
    with pytest.raises(DeviceError, match="'/dev/log': No such file or directory"):
        check_log_to("syslog")


def test_a_log_with_a_stream_socket_is_rejected(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as one:
        one.bind(str(tmp_path / "log"))
        one.listen()
        with pytest.raises(DeviceError, match="Protocol wrong type"):
            check_log_to(f"syslog:{tmp_path}/log")


def test_the_reason_is_written_to_a_full_pipe_after_stop_json(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    filled = 0
    with suppress(BlockingIOError):
        while True:
            filled += os.write(writing, b"x" * 512)
    os.set_blocking(writing, True)
    process = child(tmp_path, GIVES, stdout=writing)
    os.close(writing)
    wait_until_stopped(tmp_path)
    assert process.poll() is None
    assert read(tmp_path)["reason"] == REASON
    with os.fdopen(reading, "rb") as pipe:
        assert pipe.read()[filled:].decode() == SENTENCE + "\n"
    assert process.communicate()[1] == b""
    assert process.returncode == 0


def test_a_reason_longer_than_the_pipe_buffer_is_written_after_stop_json(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    process = child(tmp_path, "notice.give('x' * 100_000, '', orderly=False)", stdout=writing)
    os.close(writing)
    wait_until_stopped(tmp_path)
    assert process.poll() is None
    with os.fdopen(reading, "rb") as pipe:
        assert len(pipe.read()) > 100_000
    assert process.wait() == 0
    process.communicate()


def test_the_reason_is_not_buffered(tmp_path: Path) -> None:
    process = child(tmp_path, GIVES + "time.sleep(60)", stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline().decode() == SENTENCE + "\n"
    wait_until_stopped(tmp_path)
    process.kill()
    process.communicate()


def test_a_pipe_without_a_reader_is_reported_as_a_problem(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    # The console of rich ends the process in this case.
    text = (
        "from rich.console import Console\nnotice._show = Console().print\n"
        + GIVES
        + "print(*notice.problems, file=sys.stderr)"
    )
    process = child(tmp_path, text, stdout=writing)
    os.close(writing)
    error = process.communicate()[1].decode()
    assert error == "the reason of the stop could not be written to standard output: 1\n"
    assert read(tmp_path)["reason"] == REASON


def broken_pipe(text: str) -> None:
    raise BrokenPipeError(32, "Broken pipe")


def unknown_character(text: str) -> None:
    "ä".encode("ascii")


@pytest.mark.parametrize(
    ("write", "message"), [(broken_pipe, "Broken pipe"), (unknown_character, "'ascii' codec")]
)
def test_a_failed_terminal_is_reported_as_a_problem(
    tmp_path: Path, write: Any, message: str
) -> None:
    notice = StopNotice(directory=tmp_path, log_to=None, scenario="facility", show=write)
    notice.give(REASON, LEFT, orderly=False)
    notice.close()
    (problem,) = notice.problems
    assert problem.startswith(
        f"the reason of the stop could not be written to standard output: {message}"
    )
    assert read(tmp_path)["reason"] == REASON


@pytest.mark.parametrize(
    ("redirection", "message"), [(">&-", ""), ("> /dev/full", "No space left on device")]
)
def test_stop_json_is_written_without_or_with_a_full_standard_output(
    tmp_path: Path, redirection: str, message: str
) -> None:
    text = CHILD + GIVES + "print(*notice.problems, file=sys.stderr)"
    command = [
        "sh",
        "-c",
        f'exec "$@" {redirection}',
        "sh",
        sys.executable,
        "-c",
        text,
        str(tmp_path),
    ]
    error = subprocess.run(command, capture_output=True, text=True, check=False).stderr
    assert message in error.splitlines()[0]
    assert bool(error.splitlines()[0]) == bool(message)
    assert read(tmp_path)["reason"] == REASON


def test_stop_json_of_a_killed_process_has_no_reason(tmp_path: Path) -> None:
    process = child(tmp_path, "print('made', flush=True)\ntime.sleep(60)", stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"made\n"
    process.send_signal(signal.SIGKILL)
    process.communicate()
    left = read(tmp_path)
    assert (left["scenario"], left["stopped"], left["reason"]) == ("child", False, None)


def test_links_and_fifos_with_the_names_of_stop_files_are_replaced_and_not_opened(
    tmp_path: Path,
) -> None:
    other, out = tmp_path / "other", tmp_path / "out"
    other.write_text("untouched")
    out.mkdir()
    for name in ("stop.json", "stop.json.partial"):
        (out / name).symlink_to(other)
    with closing(made(out)) as notice:
        notice.give(REASON, LEFT, orderly=False)
    assert not (out / "stop.json").is_symlink()
    assert read(out)["reason"] == REASON
    for name in ("stop.json", "stop.json.partial"):
        (out / name).unlink(missing_ok=True)
        os.mkfifo(out / name)
    made(out).close()
    assert read(out)["stopped"] is False
    assert other.read_text() == "untouched"
    assert os.listdir(out) == ["stop.json"]


def test_an_earlier_run_does_not_write_into_the_stop_json_of_a_later_run(tmp_path: Path) -> None:
    with closing(made(tmp_path)) as earlier, closing(made(tmp_path)):
        earlier.give("earlier", LEFT, orderly=True)
        assert read(tmp_path)["stopped"] is False


def test_a_second_reason_changes_nothing(tmp_path: Path, receiver: socket.socket) -> None:
    printed: list[str] = []
    with closing(made(tmp_path, f"syslog:{tmp_path}/log", printed)) as notice:
        notice.give(REASON, LEFT, orderly=False)
        before = (tmp_path / "stop.json").read_bytes()
        notice.give("second", "", orderly=True)
    notice.give("third", "", orderly=True)
    assert (tmp_path / "stop.json").read_bytes() == before
    assert printed == [SENTENCE]
    assert SENTENCE in receiver.recv(SIZE).decode()
    receiver.setblocking(False)
    with pytest.raises(BlockingIOError):
        receiver.recv(SIZE)


@pytest.mark.parametrize("text", ["x", "ä", "€", "😀", '"', "\\", "\udc80", "a\n", "😀x"])
def test_long_texts_are_cut_between_characters(tmp_path: Path, text: str) -> None:
    long = text * 20_000
    notice = StopNotice(directory=tmp_path, log_to=None, scenario=long, show=lambda text: None)
    notice.give(long, long, orderly=False)
    notice.close()
    assert notice.problems == []
    document = read(tmp_path)
    for name in ("scenario", "reason", "left"):
        whole, cut = printable_line(long), document[name]
        assert cut.endswith("...")
        assert whole.startswith(cut[:-3])
        assert (
            0 <= LONGEST[name] - len(json.dumps(cut, ensure_ascii=False).encode()) < 8
        )  # the text is as long as possible


@given(
    reason=st.text(st.characters(codec=None, exclude_categories=()), max_size=3000),
    left=st.text(max_size=400),
    orderly=st.booleans(),
)
def test_any_text_is_printed_in_one_line_and_stored(
    tmp_path: Path, reason: str, left: str, orderly: bool
) -> None:
    printed: list[str] = []
    with closing(made(tmp_path, printed=printed)) as notice:
        notice.give(reason, left, orderly=orderly)
    assert notice.problems == []
    (sentence,) = printed
    assert sentence.isprintable()
    document = read(tmp_path)
    for name, text in (("reason", printable_line(reason)), ("left", printable_line(left))):
        assert document[name] == text or text.startswith(document[name].removesuffix("..."))
    if reason.isprintable() and reason.split(" ") == reason.split() and len(reason) < 500:
        assert document["reason"] == reason


def test_without_directory_and_log_the_reason_is_only_printed() -> None:
    printed: list[str] = []
    with closing(made(printed=printed)) as notice:
        notice.give(REASON, "", orderly=True)
    assert printed == [f"Stop: {REASON}; "]
    assert notice.problems == []
