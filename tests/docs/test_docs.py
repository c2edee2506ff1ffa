"""Check that the documents match the code: generated pages, links, names and versions."""

from __future__ import annotations

import importlib
import importlib.metadata
import re
from pathlib import Path

import key_tables
import pytest

import freeflyer
import freeflyer_adapters
import freeflyer_fmus
from freeflyer.scenario import scenario
from freeflyer_adapters.cli.interface_document import document
from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.export.documentation import page
from freeflyer_fmus.robot.robot import Robot

ROOT = Path(__file__).parents[2]


def test_the_table_of_fmu_variables_is_up_to_date(robot: Robot) -> None:
    made = page(make(robot) for make in BLOCKS.values())
    written = (ROOT / "docs" / "fmu_variables.md").read_text(encoding="utf-8")
    assert made == written, (
        "run: python -m freeflyer_fmus.export.documentation > docs/fmu_variables.md"
    )


def test_the_interface_control_document_is_up_to_date() -> None:
    written = (ROOT / "docs" / "interface_control_document.md").read_text(encoding="utf-8")
    assert document() == written, (
        "run: python -m freeflyer_adapters.cli.interface_document > docs/interface_control_document.md"
    )


@pytest.mark.parametrize("name", key_tables.TABLES)
def test_the_tables_of_keys_are_up_to_date(name: str) -> None:
    written = (ROOT / "docs" / name).read_text(encoding="utf-8")
    assert key_tables.page(name) == written, "run: python tests/docs/key_tables.py"


PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
PUBLIC = {
    package.__name__: package.__all__ for package in (freeflyer, freeflyer_adapters, freeflyer_fmus)
}


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_links_and_commands_in_the_documents_exist(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#:]+)\)", text):
        assert (path.parent / target).exists(), target
    for name in re.findall(r"freeflyer (?:run|hil|facility) ([a-z_0-9]+)", text):
        assert name in scenario.shipped(), name


def test_every_page_is_in_the_index() -> None:
    linked = set(
        re.findall(
            r"\]\(([a-z0-9_]+\.md)\)", (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
        )
    )
    assert linked == {path.name for path in (ROOT / "docs").glob("*.md")} - {"index.md"}


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_names_that_the_documents_show_are_public(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    shown = re.findall(r"^from (freeflyer[\w.]*) import ([\w, ]+)$", text, re.MULTILINE)
    shown += re.findall(r"`(freeflyer(?:_\w+)?)\.([A-Z]\w+|[a-z_]+\()", text)
    for package, names in shown:
        for name in names.rstrip("(").split(", "):
            assert name in PUBLIC[package], f"{package}.{name}"


def test_every_public_name_exists_and_has_a_docstring() -> None:
    for package, names in PUBLIC.items():
        for name in names:
            assert getattr(importlib.import_module(package), name).__doc__, name


def test_package_citation_and_changelog_have_the_same_version() -> None:
    version = re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert version is not None
    assert version[1] == importlib.metadata.version("freeflyer-cosim")
    assert f"## {version[1]}" in (ROOT / "CHANGELOG.md").read_text()
