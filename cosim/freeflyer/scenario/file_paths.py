"""Paths of files in a scenario: the options of components and devices whose values are paths.

A relative path in a file is relative to the folder of this file. A relative path in a change
(`--set`) is relative to the working directory.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from freeflyer.foundation.errors import CosimError
from freeflyer.foundation.keys import Keys, declared_by
from freeflyer.foundation.plugins import load, plugins


def keys_of_kind(kind: object) -> Keys | None:
    """Return the keys of a kind of components. None: they are unknown, and any key is possible."""
    points = plugins("freeflyer.components")
    try:
        return declared_by(load(points[kind])) if isinstance(kind, str) and kind in points else None
    except CosimError:  # its package is not complete
        return None


def locate(raw: dict[str, Any], folder: Path) -> None:
    """Make the paths among the options of all components and devices in `raw` absolute."""
    for key in ("components", "devices"):
        tables = raw.get(key)
        for table in tables.values() if isinstance(tables, dict) else ():
            if isinstance(table, dict):
                table.update({name: located(table, name, folder) for name in table})


def located(table: dict[str, Any], name: str, folder: Path) -> Any:
    """Return the option `name` in the table of a component or device.

    If its value is a relative path, the absolute path in `folder` is returned.
    """
    value = table[name]
    if not (isinstance(value, str) and value) or name in ("kind", "step_s"):
        return value  # an empty text is no path: the option is not set
    keys = keys_of_kind(table.get("kind", "fmu")) or {}
    endings = keys[name].type.paths if name in keys else ()
    # The object NAME in FILE.py:NAME is not a part of the path.
    if not any(value.endswith(ending) or f"{ending}:" in value for ending in endings):
        return value
    return os.path.abspath(folder / os.path.expanduser(value))
