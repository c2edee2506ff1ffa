"""The pages of real runs, recordings and robots in the browser."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robots import FOREIGN, example
from test_view_content import content, decoded

import freeflyer as ff
from freeflyer.cli import main as command
from freeflyer.viewer import kinematics
from freeflyer.viewer.content import Run
from freeflyer.viewer.content import content as content_of
from freeflyer.viewer.page import page
from freeflyer.viewer.view import _at_rest
from freeflyer_adapters.recording import view_reader
from freeflyer_fmus import robot_scene

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = shutil.which("chromium")
needs_browser = pytest.mark.skipif(
    CHROMIUM is None and os.environ.get("FREEFLYER_BROWSER") != "required",
    reason="Chromium is not installed",
)
Open = Callable[[str], Any]


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Open]:
    """Open a page, and collect its errors in the attribute `errors`."""
    with playwright.sync_playwright() as driver:
        arguments = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]  # fmt: skip
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=arguments)

        def open_text(text: str) -> Any:
            path = tmp_path_factory.mktemp("page") / "page.html"
            path.write_text(text, encoding="utf-8")
            tab = browser.new_page()
            errors: list[str] = []
            tab.on("pageerror", lambda error: errors.append(str(error)))
            tab.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
            tab.goto(path.as_uri())
            tab.evaluate("freeflyerView.ready")
            assert errors == []
            return tab

        yield open_text
        browser.close()


def pose(tab: Any, frame: int, time: float) -> np.ndarray:
    tab.evaluate(f"freeflyerView.setTime({time})")
    return np.array(tab.evaluate(f"freeflyerView.pose(0, {frame})")).reshape(4, 4).T


@needs_browser
def test_the_page_draws_the_recorded_end_effector(opened: Open) -> None:
    result = ff.run("multirate_passive", {"stop_s": 4.0})
    tab, record = opened(result.view().text), result.record
    for row in (0, 137, 250, record.rows - 1):
        found = pose(tab, 7, float(record.time[row]))[:3, 3]
        assert np.abs(found - record["free_flyer.end_effector_position"][row]).max() < 1e-6


@needs_browser
@pytest.mark.parametrize("name", FOREIGN)
def test_the_page_draws_foreign_robots_as_their_scene(name: str, opened: Open) -> None:
    file, options = FOREIGN[name]
    scene = robot_scene(example(file), **options)
    joints = np.linspace(0.2, -0.9, len(scene["joints"]))
    shown = Run(record=_at_rest(joints.tolist()), scenario=None, label=name, title=name, errors={}, end="completed", cause=None)  # fmt: skip
    tab = opened(page(name, [content_of(shown, scene, [])]))
    expected = kinematics.frames(scene, np.zeros((1, 3)), np.array([[0.0, 0, 0, 1]]), joints[None])
    for frame, (rotation, position) in enumerate(expected):
        found = pose(tab, frame, 0.0)
        assert np.abs(found[:3, 3] - position[0]).max() < 1e-6
        assert np.abs(found[:3, :3] - rotation.as_matrix()[0]).max() < 1e-6


def test_a_recording_is_shown_with_the_run_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = ["hil", "facility", "--accelerated", "--set", "stop_s=0.5", "--out", "run"]
    assert command.call(arguments) == 0
    assert command.call(["view", "run/recording.mcap", "--no-open"]) == 0
    assert "Note" not in capsys.readouterr().out
    run = content((tmp_path / "run" / "view.html").read_text())["runs"][0]
    assert run["scene"]["name"] == "lwr4_free_flyer"
    assert decoded(run["time"]).size > 400  # every instant, not only the rows of the record
    assert run["end"]["kind"] == "completed"
    # A damaged recording alone: what is left is shown, with a note.
    data = (tmp_path / "run" / "recording.mcap").read_bytes()
    (tmp_path / "half.mcap").write_bytes(data[: len(data) * 2 // 3])
    assert command.call(["view", "half.mcap", "--no-open", "--out", "half.html"]) == 0
    shown = capsys.readouterr().out
    assert re.search("Note: the recording is shown without errors and geometry", shown)
    assert re.search("Note: half.mcap: the end of the recording is missing", shown)


def test_a_recording_that_is_too_large_for_the_memory_is_not_read_as_a_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "recording.mcap").write_bytes(bytes(2000))
    monkeypatch.setattr(view_reader, "LARGEST", 1000)
    with pytest.raises(ff.RecordError, match="at most 1000 bytes are read at once"):
        view_reader.record_of(tmp_path, ff.load("facility"))
