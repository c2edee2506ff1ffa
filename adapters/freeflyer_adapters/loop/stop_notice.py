"""Write the reason of a stop to standard output, a preallocated file and the system log.

The reason is written before all other files of the run.
"""

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

from freeflyer.foundation.errors import OutputError, UnusableOutput
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.errors import DeviceError

NAME = "stop.json"
SIZE = 4096
"""Constant size of stop.json [bytes]. So overwriting the file does not need more disk space."""
LONGEST = {"scenario": 256, "reason": 2400, "left": 1000}
"""Limits of these members of the JSON document [bytes].

All other members together need less than 300 bytes.
"""
LONGEST_MESSAGE = 2048
"""Message size that every receiver of a system log should accept [bytes] (RFC 5424, 6.1)."""
PATIENCE = 1.0
"""Time to wait for a blocked terminal or pipe [s].

If standard output is still blocked after this time, it is written after the other outputs.
"""


class StopNotice:
    """Writer of the reason of a stop to standard output, DIR/stop.json and the system log."""

    problems: list[str]
    """One sentence for each output that failed. The caller prints the sentences after the stop."""

    def __init__(
        self,
        *,
        directory: Path | None,
        log_to: str | None,
        scenario: str,
        show: Callable[[str], None],
    ) -> None:
        """Open all outputs, and reserve the disk space of stop.json.

        `directory`: the directory of stop.json, or None for no file. `log_to`: the value of the
        option `--log-to`, or None for no system log. `scenario`: name of the scenario. `show`
        prints a line on standard output.

        Raises DeviceError if `log_to` is not valid, or if the system log is not available. Raises
        OutputError (exit code 2) if stop.json cannot be created.
        """
        self.problems = []
        self._environment, self._show, self._given = environment.present(), show, False
        self._started = self._environment.monotonic_ns()
        self._fields: dict[str, Any] = {
            "scenario": _cut(printable_line(scenario), LONGEST["scenario"]),
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
        """Write the reason to all outputs. Only the first call has an effect.

        `left` describes the state of the devices after the stop. `orderly` is True if nothing has
        failed: the scenario has finished, or the user has interrupted the run. With `quiet`,
        nothing is written to standard output.

        If an output fails, no exception is raised, and the other outputs are still written. If
        standard output is a blocked terminal or pipe, it is written last. This last write may block
        the call.
        """
        if self._given:
            return
        self._given = True
        # Complete the document.
        stopped_ns, after_s = (
            self._environment.time_ns(),
            (self._environment.monotonic_ns() - self._started) * 1e-9,
        )
        reason, left = printable_line(reason), printable_line(left)
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
        # If standard output would block, it is written last. Otherwise it is written first.
        is_writable = quiet or _is_writable(sentence)
        if is_writable and not quiet:
            self._put("standard output", lambda: self._print(sentence))
        # The system log is written before the file, because a write to the log never blocks, but a
        # write to a failing disk may block.
        if (log := self._log) is not None:
            priority = SysLogHandler.LOG_NOTICE if orderly else SysLogHandler.LOG_WARNING
            self._put(f"the system log at {log.name!r}", lambda: log.send(sentence, priority))
        if (file := self._file) is not None:
            self._put(str(self._path), lambda: _overwrite(file, _document(self._fields)))
        if not is_writable:
            self._put("standard output", lambda: self._print(sentence))

    def close(self) -> None:
        """Close all outputs. May be called repeatedly."""
        if self._log is not None:
            self._log.close()
        if self._file is not None:
            with suppress(OSError):
                os.close(self._file)
            self._file = None

    def _put(self, place: str, put: Callable[[], None]) -> None:
        try:
            put()
        # If standard output is closed, the console behind `show` may raise SystemExit.
        except (Exception, SystemExit) as error:
            self.problems.append(
                f"the reason of the stop could not be written to {place}: {_message(error)}"
            )

    def _print(self, sentence: str) -> None:
        self._show(sentence)
        print(end="", flush=True)  # without a flush, a pipe is buffered until the process ends


class _SystemLog:
    """A client that sends datagrams to a system log.

    Python's SysLogHandler is unsuitable: it reconnects with a blocking socket, and it resolves the
    host name for each message.
    """

    def __init__(self, log_to: str) -> None:
        """Find the address of the log. Raises DeviceError if the log is not available."""
        # Parse the option.
        expected = "'syslog', 'syslog:PATH' or 'syslog:HOST:PORT' is expected"
        log, colon, self.name = log_to.partition(":")
        if log != "syslog":
            raise DeviceError(
                f"--log-to {log_to!r}: there is no log {log!r}; {expected}{did_you_mean(log, ['syslog'])}"
            )
        if not colon:
            self.name = "/dev/log"
        host, _, port = self.name.rpartition(":")
        is_path = "/" in self.name
        if not is_path and not (
            host and port.isascii() and port.isdecimal() and len(port) < 6 and 0 < int(port) < 65536
        ):
            raise DeviceError(
                f"--log-to {log_to!r}: the text after 'syslog:' is neither a path nor HOST:PORT with a port of 1 to 65535; {expected}"
            )
        # Check the address: a Unix socket must exist, and a host name must resolve.
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
        except (OSError, ValueError) as error:  # ValueError: not a valid host name
            raise DeviceError(
                f"--log-to {log_to!r}: no system log receives datagrams at {self.name!r}: {_message(error)}; start a system log there, or give "
                "another 'syslog:PATH' or 'syslog:HOST:PORT'"
            ) from error
        self._socket.setblocking(False)

    def send(self, sentence: str, priority: int) -> None:
        """Send a message without blocking. Raises OSError if the message cannot be sent."""
        message = f"<{SysLogHandler.LOG_DAEMON << 3 | priority}>freeflyer: {sentence}".encode()[
            :LONGEST_MESSAGE
        ]
        # The socket is not connected, because a restarted daemon has a new socket of the same name.
        self._socket.sendto(message.decode(errors="ignore").encode(), self._address)

    def close(self) -> None:
        self._socket.close()


def check_log_to(text: str) -> None:
    """Raise DeviceError if the option `--log-to` is not valid, or if the log is not available."""
    _SystemLog(text).close()


def printable_line(text: str) -> str:
    """Return `text` without line ends and control characters. Invalid UTF-8 is escaped."""
    visible = text.encode(errors="backslashreplace").decode()
    return " ".join("".join(c if c.isprintable() else " " for c in visible).split())


def _cut(text: str, size: int) -> str:
    """Return `text`, shortened to at most `size` [bytes] of JSON."""
    whole, text = text, text[:size]
    while (
        excess := len(json.dumps(text + "..." * (text != whole), ensure_ascii=False).encode())
        - size
    ) > 0:
        text = text[: -(excess // 4 or 1)]  # a character has 4 bytes at most
    return text + "..." * (text != whole)


def _document(fields: dict[str, Any]) -> bytes:
    """Return `fields` as JSON, padded to SIZE bytes."""
    return json.dumps(fields, ensure_ascii=False, indent=2).encode().ljust(SIZE - 1) + b"\n"


def _reserved(path: Path, document: bytes) -> int:
    """Write and sync a new file. Return its descriptor. Raises OutputError if this fails."""
    partial = path.with_name(path.name + ".partial")
    file = -1
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Write the file under another name, then rename the file. In this way an existing link or
        # FIFO with the final name is replaced, and is never opened.
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
        raise UnusableOutput(
            f"{path} cannot be reserved for the reason of a stop: {_message(error)}; a directory with {SIZE} bytes of free space is "
            "expected: free some space, or give another directory"
        ) from error


def _overwrite(file: int, document: bytes) -> None:
    """Overwrite and sync the file. Raises OSError if this fails."""
    if os.pwrite(file, document, 0) != len(document):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    os.fsync(file)


def _sync_directory(path: Path) -> None:
    """Sync the directory entries, if the file system supports it."""
    with suppress(OSError):
        folder = os.open(path, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _is_writable(sentence: str) -> bool:
    """Return True if standard output can probably be written within PATIENCE."""
    try:
        writable = select.select([], [sys.stdout.fileno()], [], PATIENCE)[1]
    except (AttributeError, OSError, ValueError):
        # Standard output is missing, or has no file descriptor.
        return True
    # A writable pipe is only guaranteed to have space for PIPE_BUF bytes. A longer text may block.
    return bool(writable) and len(sentence.encode()) < select.PIPE_BUF


def _message(error: BaseException) -> str:
    return printable_line(getattr(error, "strerror", None) or str(error) or type(error).__name__)
