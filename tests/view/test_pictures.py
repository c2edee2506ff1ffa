"""The command that makes the pictures of the viewer in README and docs/view.md."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "docs" / "viewer_pictures.py"
BROWSER = shutil.which("chromium") or os.environ.get("FREEFLYER_BROWSER") == "required"


@pytest.mark.slow
@pytest.mark.skipif(not BROWSER, reason="Chromium is not installed")
def test_the_command_makes_all_pictures(tmp_path: Path) -> None:
    Image = pytest.importorskip("PIL.Image")
    subprocess.run([sys.executable, SCRIPT, tmp_path], check=True, timeout=600)
    made = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    assert made.keys() == {path.name for path in (SCRIPT.parent / "figures").glob("viewer*")}
    assert made["viewer.webp"] <= 1_000_000
    with Image.open(tmp_path / "viewer.webp") as image:
        assert image.n_frames > 50
    for name in made:
        with Image.open(tmp_path / name) as image:
            colors = image.convert("RGB").getcolors(1 << 24)
            assert len(colors) > 1000, name  # a robot, not an empty page
