"""What a loop in real time leaves behind: its recording, its CAN log, and its last seconds before a stop.

`freeflyer_adapters.recording.read("run.mcap")` gives a pandas table (loaded when it is asked for).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from freeflyer_adapters.recording.frame import read

__all__ = ["read"]


def __getattr__(name: str) -> Any:
    if name != "read":
        raise AttributeError(name)
    from freeflyer_adapters.recording.frame import read

    return read
