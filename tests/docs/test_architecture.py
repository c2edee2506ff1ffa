"""The packages, their layers, and the page that explains them."""

from __future__ import annotations

import re
import sys
import tomllib
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs"))

import architecture_figure  # noqa: E402

PACKAGES = tuple(architecture_figure.SOURCES)


@pytest.fixture(scope="module")
def imports() -> grimp.ImportGraph:
    return grimp.build_graph(*PACKAGES, cache_dir=None)


def test_the_figure_is_up_to_date() -> None:
    written = (ROOT / "docs" / "figures" / "architecture.svg").read_text(encoding="utf-8")
    assert written == architecture_figure.figure() + "\n", (
        "run: python docs/architecture_figure.py > docs/figures/architecture.svg"
    )


@pytest.mark.parametrize("package", PACKAGES)
def test_every_module_of_a_package_is_in_one_of_six_layers(package: str) -> None:
    layers = architecture_figure.layers(package)
    assert len(layers) <= 6
    folder = ROOT / architecture_figure.SOURCES[package] / package
    found = [path for path in folder.iterdir() if path.suffix == ".py" or any(path.glob("*.py"))]
    names = {path.stem for path in found} - {"__init__", "__main__"}
    assert names == {name for layer in layers for name in layer}


def test_the_contracts_are_short() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    contracts = text[text.index("[[tool.importlinter.contracts]]") :].strip().splitlines()
    assert len(contracts) <= 25
    assert len(tomllib.loads(text)["tool"]["importlinter"]["contracts"]) == 5


@pytest.mark.parametrize("package", PACKAGES)
def test_no_modules_import_each_other(package: str, imports: grimp.ImportGraph) -> None:
    """A cycle raises graphlib.CycleError, which names it."""
    modules = [m for m in imports.modules if m == package or m.startswith(f"{package}.")]
    order = TopologicalSorter({m: imports.find_modules_directly_imported_by(m) for m in modules})
    assert set(modules) <= set(order.static_order())


def test_the_files_on_the_page_exist() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    paths = re.findall(r"`((?:cosim|adapters|fmu_src|docs)/[\w/.]+\.\w+)`", text)
    assert len(paths) > 20
    for path in paths:
        assert (ROOT / path).is_file(), path
