"""The reason of a stop, before any other file work: on standard output, in a file whose space was reserved, in the system log."""

from __future__ import annotations

import errno
import json
import os
import select
import socket
import sys
from collections.abc import Callable
from contextlib import suppress
from logging.handlers import SysLogHandler
from pathlib import Path
from typing import Any

from freeflyer.foundation.errors import BAD_INPUT, OutputError
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer_adapters.device.device import DeviceError
from freeflyer_adapters.foundation import environment

NAME = "stop.json"
SIZE = 4096
"""[bytes] of stop.json, whatever it says: overwriting it needs no room."""
LONGEST = {"scenario": 256, "reason": 2400, "left": 1000}
"""[bytes] of JSON; the other members need less than 300."""
LONGEST_MESSAGE = 2048
"""[bytes] that every receiver of a system log should take (RFC 5424, 6.1)."""
PATIENCE = 1.0
"""After so long [s], a terminal or pipe that takes nothing comes last."""


class StopNotice:
    """Where the reason of a stop goes first: standard output, DIR/stop.json, and the system log if asked for."""

    problems: list[str]
    """One sentence for each place that did not take it, to be printed afterwards."""

    def __init__(
        self,
        *,
        directory: Path | None,
        log_to: str | None,
        scenario: str,
        say: Callable[[str], None],
    ) -> None:
        """Open every place. Raises DeviceError for `log_to`, OutputError where stop.json cannot be reserved (exit code 2)."""
        self.problems = []
        self._environment, self._say, self._given = environment.present(), say, False
        self._started = self._environment.monotonic_ns()
        self._fields: dict[str, Any] = {
            "scenario": _cut(one_line(scenario), LONGEST["scenario"]),
            "stopped": False,
            "orderly": None,
            "reason": None,
            "left": None,
            "started_ns": self._environment.time_ns(),
            "stopped_ns": None,
            "after_s": None,
        }
        self._path = None if directory is None else directory / NAME
        self._file: int | None = None
        self._log = None if log_to is None else _SystemLog(log_to)
        try:
            self._file = (
                None if self._path is None else _reserved(self._path, _document(self._fields))
            )
        except OutputError:
            self.close()
            raise

    def give(self, reason: str, left: str, *, orderly: bool, quiet: bool = False) -> None:
        """Put it everywhere, once (`quiet`: not on standard output); nothing that a disk, a terminal or a socket does raises or keeps it from the other places.

        A terminal or pipe that takes nothing comes last, and may block then.
        """
        if self._given:
            return
        self._given = True
        stopped_ns, after_s = (
            self._environment.time_ns(),
            (self._environment.monotonic_ns() - self._started) * 1e-9,
        )
        reason, left = one_line(reason), one_line(left)
        sentence = f"Stop: {reason}; {left}"
        texts = {
            name: _cut(text, LONGEST[name]) for name, text in (("reason", reason), ("left", left))
        }
        self._fields |= {
            "stopped": True,
            "orderly": orderly,
            **texts,
            "stopped_ns": stopped_ns,
            "after_s": after_s,
        }
        at_once = quiet or _takes(sentence)
        if at_once and not quiet:
            self._put("standard output", lambda: self._print(sentence))
        # The log before the file: it never blocks, but a dying disk may.
        if (log := self._log) is not None:
            priority = SysLogHandler.LOG_NOTICE if orderly else SysLogHandler.LOG_WARNING
            self._put(f"the system log at {log.name!r}", lambda: log.send(sentence, priority))
        if (file := self._file) is not None:
            self._put(str(self._path), lambda: _overwrite(file, _document(self._fields)))
        if not at_once:
            self._put("standard output", lambda: self._print(sentence))

    def close(self) -> None:
        """Close what is open; it may be called again."""
        if self._log is not None:
            self._log.close()
        if self._file is not None:
            with suppress(OSError):
                os.close(self._file)
            self._file = None

    def _put(self, place: str, put: Callable[[], None]) -> None:
        try:
            put()
        except (
            Exception,
            SystemExit,
        ) as error:  # a console may make anything of a terminal that is gone
            self.problems.append(f"{place} did not take the reason of the stop: {_told(error)}")

    def _print(self, sentence: str) -> None:
        self._say(sentence)
        print(end="", flush=True)  # a pipe's buffer would keep it until the end


class _SystemLog:
    """Datagrams to a system log.

    Not by SysLogHandler itself: that connects anew with a socket that blocks, and looks up a host's name for each message.
    """

    def __init__(self, log_to: str) -> None:
        """Find the address; raises DeviceError."""
        expected = "'syslog', 'syslog:PATH' or 'syslog:HOST:PORT' is expected"
        word, colon, self.name = log_to.partition(":")
        if word != "syslog":
            raise DeviceError(
                f"--log-to {log_to!r}: there is no log {word!r}; {expected}{did_you_mean(word, ['syslog'])}"
            )
        if not colon:
            self.name = "/dev/log"
        host, _, port = self.name.rpartition(":")
        is_path = "/" in self.name
        if not is_path and not (
            host and port.isascii() and port.isdecimal() and len(port) < 6 and 0 < int(port) < 65536
        ):
            raise DeviceError(
                f"--log-to {log_to!r}: that is no path, and not HOST:PORT with a port of 1 to 65535; {expected}"
            )
        family: int = socket.AF_UNIX
        self._address: Any = self.name
        try:
            if is_path:
                with socket.socket(family, socket.SOCK_DGRAM) as probe:
                    probe.connect(self.name)
            else:
                found = socket.getaddrinfo(
                    host.removeprefix("[").removesuffix("]"), int(port), type=socket.SOCK_DGRAM
                )
                family, *_, self._address = found[0]
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
        except (OSError, ValueError) as error:  # ValueError: no host can have that name
            raise DeviceError(
                f"--log-to {log_to!r}: no system log takes datagrams at {self.name!r}: {_told(error)}; start one there, or give "
                "another 'syslog:PATH' or 'syslog:HOST:PORT'"
            ) from error
        self._socket.setblocking(False)

    def send(self, sentence: str, priority: int) -> None:
        """Send it without waiting. Raises OSError."""
        message = f"<{SysLogHandler.LOG_DAEMON << 3 | priority}>freeflyer: {sentence}".encode()[
            :LONGEST_MESSAGE
        ]
        # Not connected: a daemon that was started anew meanwhile has another socket of the same name.
        self._socket.sendto(message.decode(errors="ignore").encode(), self._address)

    def close(self) -> None:
        self._socket.close()


def check_log_to(text: str) -> None:
    """Raise DeviceError, in one sentence, for an option that names no system log."""
    _SystemLog(text).close()


def one_line(text: str) -> str:
    """Return it without line ends and control characters; what is no UTF-8 is spelled out."""
    visible = text.encode(errors="backslashreplace").decode()
    return " ".join("".join(c if c.isprintable() else " " for c in visible).split())


def _cut(text: str, size: int) -> str:
    """Return as much of its begin as `size` [bytes] of JSON have room for."""
    whole, text = text, text[:size]
    while (
        excess := len(json.dumps(text + "..." * (text != whole), ensure_ascii=False).encode())
        - size
    ) > 0:
        text = text[: -(excess // 4 or 1)]  # a character has 4 bytes at most
    return text + "..." * (text != whole)


def _document(fields: dict[str, Any]) -> bytes:
    """Return SIZE bytes of JSON."""
    return json.dumps(fields, ensure_ascii=False, indent=2).encode().ljust(SIZE - 1) + b"\n"


def _reserved(path: Path, document: bytes) -> int:
    """Write and sync a new file; return its descriptor. Raises OutputError."""
    partial = path.with_name(path.name + ".partial")
    file = -1
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # A new file beside it, moved there: a link or FIFO of either name is replaced, not opened.
        partial.unlink(missing_ok=True)
        file = os.open(partial, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file, 0, SIZE)
        _overwrite(file, document)
        os.replace(partial, path)
        _sync_directory(path.parent)
        return file
    except OSError as error:
        if file >= 0:
            os.close(file)
            with suppress(OSError):
                partial.unlink()
        failure = OutputError(
            f"{path} cannot be reserved for the reason of a stop: {_told(error)}; a directory with {SIZE} bytes of room is "
            "expected: make room, or give another"
        )
        failure.exit_code = BAD_INPUT
        raise failure from error


def _overwrite(file: int, document: bytes) -> None:
    """Put it in the file's place, and on the disk. Raises OSError."""
    if os.pwrite(file, document, 0) != len(document):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    os.fsync(file)


def _sync_directory(path: Path) -> None:
    """Put a file's name on the disk, where the file system can."""
    with suppress(OSError):
        folder = os.open(path, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _takes(sentence: str) -> bool:
    """Whether standard output takes it within PATIENCE, as far as can be known."""
    try:
        writable = select.select([], [sys.stdout.fileno()], [], PATIENCE)[1]
    except (
        AttributeError,
        OSError,
        ValueError,
    ):  # none, or one without a descriptor: it is no pipe
        return True
    # A pipe that is writable has room for so much only.
    return bool(writable) and len(sentence.encode()) < select.PIPE_BUF


def _told(error: BaseException) -> str:
    return one_line(getattr(error, "strerror", None) or str(error) or type(error).__name__)
