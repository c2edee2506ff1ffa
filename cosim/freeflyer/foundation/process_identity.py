"""Identity of a process, in files that other processes read.

The identity is written to a directory that a process uses. Another process, possibly on another
machine, then finds out whether this process still runs. A number of a process alone is not enough:
it is used again after a process has ended.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def present() -> dict[str, Any]:
    """Return the identity of this process, as JSON types."""
    return {"host": _host(), "pid": os.getpid(), "started": _started(os.getpid())}


def is_running(identity: Mapping[str, Any]) -> bool | None:
    """Return whether a process runs. None: it belongs to another host, or is not readable."""
    pid = identity.get("pid")
    if identity.get("host") != _host() or not isinstance(pid, int) or not 0 < pid < 1 << 31:
        return None
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass  # a process of another user
    started = _started(pid)
    return started is None or started == identity.get("started")


def _host() -> str:
    """Return a name that two systems share only if they share the numbers of processes.

    Containers on one machine have namespaces of their own. After a restart, numbers start again.
    """
    parts = [platform.node()]
    try:
        parts.append(os.readlink("/proc/self/ns/pid"))
        parts.append(Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip())
    except OSError:
        pass  # not Linux
    return " ".join(parts)


def _started(pid: int) -> str | None:
    """Return the start time of a process [clock ticks since the start of the system], or None."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    # The name of the program is in parentheses, and may contain spaces and parentheses.
    fields = stat.rpartition(")")[2].split()
    state, started = fields[0], fields[19]
    return "ended" if state in "ZX" else started
