"""Skip all tests of this folder, with the reason, if a peer is missing."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from pathlib import Path

import pytest


def missing() -> str:
    """Return why a peer cannot be used, or an empty string."""
    for name in ("libcosimpy", "ecospy", "fmu_manipulation_toolbox"):
        try:
            import_module(name)
        except ImportError:
            return f"{name} is not installed (pip install '.[peers]')"
        except OSError as error:  # ecospy needs the system's libtbb.so.12
            return f"{name} cannot be loaded: {error} (Debian: libtbb12)"
    return ""


REASON = missing()


class Skipped(pytest.Module):
    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        pytest.skip(REASON, allow_module_level=True)


def pytest_pycollect_makemodule(
    module_path: Path, parent: pytest.Collector
) -> pytest.Module | None:
    return Skipped.from_parent(parent, path=module_path) if REASON else None
