"""What the documents say is what the project does."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from freeflyer import scenario
from freeflyer_adapters.interface_document import document
from freeflyer_fmus.export.documentation import page
from freeflyer_fmus.robot import Robot
from freeflyer_fmus.shipped import BLOCKS

ROOT = Path(__file__).parents[2]


def test_the_table_of_fmu_variables_is_up_to_date(robot: Robot) -> None:
    made = page(make(robot) for make in BLOCKS.values())
    written = (ROOT / "docs" / "fmu_variables.md").read_text(encoding="utf-8")
    assert made == written, "run: python -m freeflyer_fmus.export.documentation > docs/fmu_variables.md"


def test_the_interface_control_document_is_up_to_date() -> None:
    written = (ROOT / "docs" / "interface_control_document.md").read_text(encoding="utf-8")
    assert document() == written, "run: python -m freeflyer_adapters.interface_document > docs/interface_control_document.md"


@pytest.mark.parametrize("path", [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))], ids=lambda path: path.name)
def test_links_and_commands_in_the_documents_exist(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#:]+)\)", text):
        assert (path.parent / target).exists(), target
    for name in re.findall(r"freeflyer (?:run|hil|facility) ([a-z_0-9]+)", text):
        assert name in scenario.shipped(), name
