"""Run the code of docs/python.md and of examples/, and check that public names are explained."""

from __future__ import annotations

import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import freeflyer
import freeflyer_adapters
import freeflyer_fmus

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
PACKAGES = (freeflyer, freeflyer_fmus, freeflyer_adapters)
NAMES = [(package, name) for package in PACKAGES for name in package.__all__]
UNIT = re.compile(r"\[(s|m|J|N|deg|rad|1/s|us)\b[^\]]*\]|\bSI\b|\bunits?\b|\bin n?s\b")
WITHOUT_QUANTITIES = {
    "Table", "audit", "describe_fmu", "export_fmus", "fmu_path", "memory", "run_loop", "sweep",
    "VirtualDevice", "WRENCH", "write_ssp",
}  # fmt: skip
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
SLOW = ("gain_scan", "own_controller_in_fmpy", "plant_in_scipy")


def test_the_code_blocks_of_the_page_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    scope: dict[str, Any] = {"__name__": "page"}
    for code in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(compile(code, "docs/python.md", "exec"), scope)
    shown = capsys.readouterr().out
    assert "did you mean 'free_flyer.base_position'" in shown
    assert "did you mean 'period'" in shown
    assert "2 of 2" in shown
    assert (tmp_path / "run.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("package", "name"), NAMES, ids=[f"{package.__name__}.{name}" for package, name in NAMES]
)
def test_every_public_name_is_on_the_page_and_has_a_complete_docstring(
    package: ModuleType, name: str
) -> None:
    assert re.search(rf"\b{name}\b", PAGE), f"docs/python.md does not show {name}"
    found = getattr(importlib.import_module(package.__name__), name)
    if isinstance(found, type) and issubclass(found, BaseException):
        return
    problems = incomplete(name, found)
    whole = [found, *(vars(found).values() if inspect.isclass(found) else ())]
    if name not in WITHOUT_QUANTITIES and not UNIT.search(
        " ".join(inspect.getdoc(part) or "" for part in whole)
    ):
        problems.append(f"{name}: no docstring has a unit")
    assert not problems, "; ".join(problems)


def incomplete(name: str, found: object) -> list[str]:
    """Return what the docstring of a function or of a class lacks.

    A function and a constructor explain every argument. A method has a docstring.
    """
    if inspect.isfunction(found):
        return lacking(name, found, inspect.getdoc(found) or "", raises=True)
    if not inspect.isclass(found):
        return []
    whole, problems = inspect.getdoc(found) or "", []
    is_protocol = getattr(found, "_is_protocol", False)
    if "__init__" in vars(found) and not (is_protocol or hasattr(found, "__dataclass_fields__")):
        problems += lacking(name, found.__init__, whole, raises=False)
    return problems + [
        f"{name}.{method} has no docstring"
        for method, value in vars(found).items()
        if not method.startswith("_")
        and (inspect.isfunction(value) or isinstance(value, classmethod | property))
        and not inspect.getdoc(getattr(found, method))
    ]


def lacking(name: str, function: Any, text: str, *, raises: bool) -> list[str]:
    """Return the parameters that a text does not mention, and whether it lacks errors."""
    problems = [
        f"{name}: the docstring does not mention `{parameter}`"
        for parameter in inspect.signature(function).parameters
        if parameter != "self" and not re.search(rf"\b{parameter.rstrip('s')}", text)
    ]
    if raises and "Raises" not in text:
        problems.append(f"{name}: the docstring does not say what it raises")
    return problems


def test_an_incomplete_docstring_is_found() -> None:
    def moved(distance: float) -> None:
        """Move."""

    assert len(incomplete("moved", moved)) == 2


@pytest.mark.parametrize(
    "path",
    [pytest.param(p, id=p.stem, marks=[pytest.mark.slow] * (p.stem in SLOW)) for p in EXAMPLES],
)
def test_an_example_runs_alone(path: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(path)], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    expected = {
        "arm_over_can": "active -> inactive: brakes commanded",
        "gain_scan": "base_controller.stiffness[4:6]",
        "own_controller_in_fmpy": "joints have moved by [0.2 0.2 0.2 0.2 0.2 0.2] rad",
        "plant_in_scipy": "the base has turned by -0.7",
        "two_periods": "completed",
    }[path.stem]
    assert expected in done.stdout
    for figure in re.findall(r'savefig\("(\w+\.png)"', path.read_text(encoding="utf-8")):
        assert (tmp_path / figure).stat().st_size > 10_000


def test_the_readme_shows_the_first_example() -> None:
    example = (ROOT / "examples" / "two_periods.py").read_text(encoding="utf-8")
    code = example[example.index("import") :].strip()
    assert code in (ROOT / "README.md").read_text(encoding="utf-8")
