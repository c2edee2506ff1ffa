"""Without the peers there is nothing to compare with: the whole folder is left out, and says so."""

from __future__ import annotations

from importlib.util import find_spec

MISSING = [name for name in ("libcosimpy", "ecospy", "fmu_manipulation_toolbox") if find_spec(name) is None]
collect_ignore_glob = ["test_*.py"] if MISSING else []


def pytest_report_header() -> str | None:
    return f"tests/peers left out: {', '.join(MISSING)} missing (pip install '.[peers]')" if MISSING else None
