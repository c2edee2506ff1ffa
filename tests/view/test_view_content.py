"""The page of a run: encoding, geometry, sources, and hostile content."""

from __future__ import annotations

import base64
import json
import re
import zlib
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from robots import FOREIGN
from robots import example as example_robot

import freeflyer as ff
from freeflyer.cli import main as command
from freeflyer.foundation.errors import CosimError
from freeflyer.viewer import kinematics, scene
from freeflyer.viewer.series import encoded, reduced
from freeflyer.viewer.view import view
from freeflyer_fmus import fmu_path, robot_scene

Series = dict[str, Any]


def decoded(series: Series) -> np.ndarray:
    """Return the values of a series. This decoder shares no code with the encoder."""
    values = np.full(series["n"], float(series["offset"]))
    if series["data"]:
        data, total, number, shift, integers = base64.b64decode(series["data"]), 0, 0, 0, []
        for octet in zlib.decompress(data, -15):
            number |= (octet & 127) << shift
            shift += 7
            if octet < 128:
                total += (number >> 1) ^ -(number & 1)
                integers.append(total)
                number = shift = 0
        values += series["scale"] * np.array(integers, dtype=float)
    for first, last in series.get("nan", []):
        values[first:last] = np.nan
    return values


def content(page: str) -> dict[str, Any]:
    """Return the data of a page."""
    found: dict[str, Any] = json.loads(re.search(r'id="data">(.*?)</script>', page, re.DOTALL)[1])  # type: ignore[index]
    return found


@given(
    st.lists(st.floats(-1e12, 1e12) | st.sampled_from([np.nan, np.inf]), max_size=40),
    st.sampled_from([1e-9, 1e-3, 1.0]),
)
@example([1e308, -1e308], 1e-3)
@example([0.0, 1e-320], 1e-9)
def test_a_decoded_series_has_the_values_within_the_resolution(
    values: list[float], quantum: float
) -> None:
    array = np.array(values)
    series = json.loads(json.dumps(encoded(array, quantum), allow_nan=False))
    found = decoded(series)
    finite = np.isfinite(array)
    assert np.array_equal(np.isfinite(found), finite)
    bound = 0.51 * max(quantum, series["scale"]) + 1e-12 * np.abs(array[finite]).max(initial=0.0)
    assert np.abs(found[finite] - array[finite]).max(initial=0.0) <= bound


@given(st.integers(0, 4999), st.sampled_from([1.0, -1.0]))
def test_a_spike_of_one_sample_stays_in_a_reduced_series(place: int, height: float) -> None:
    values = np.zeros(5000)
    values[place] = height
    time, kept = reduced(np.arange(5000.0), values, 100)
    assert kept.size <= 102
    assert height in kept
    assert time[kept == height] == place
    assert np.all(np.diff(time) > 0)


@pytest.fixture(scope="module")
def runs() -> list[ff.Result]:
    return [ff.run(name, {"stop_s": 3.0}) for name in ("multirate_passive", "facility")]


@pytest.mark.parametrize("number", [0, 1], ids=["free-flyer", "facility"])
def test_the_drawn_end_effector_is_the_recorded_one(runs: list[ff.Result], number: int) -> None:
    run = content(view(runs[number]).text)["runs"][0]
    position, orientation, joints = (
        np.column_stack([decoded(series) for series in columns])
        for columns in (run["base"]["position"], run["base"]["orientation"], run["joints"])
    )
    drawn = kinematics.frames(run["scene"], position, orientation, joints)[-1][1]
    measure = runs[number].scenario.errors["end_effector_position"]
    limit = 1e-6 if number == 0 else 5e-3  # the facility measures with delays
    assert np.abs(drawn - runs[number].record[measure.actual]).max() < limit
    assert run["notes"] == []


def test_the_content_has_ports_marks_and_the_set_point(runs: list[ff.Result]) -> None:
    page = content(view(*runs).text)
    assert page["format"] == 1
    first, second = page["runs"]
    assert (first["label"], second["label"]) == ("multirate_passive", "facility")
    assert [w["name"] for w in first["wrenches"]][:2] == ["port B", "port M"]
    samples = [mark["time"] for mark in first["marks"] if mark["kind"] == "base sample"]
    assert samples == pytest.approx([0.3 * k for k in range(11)])
    assert first["set_point"]["orientation"] == [0, 0, 0, 1]
    assert {plot["title"] for plot in first["plots"]} >= {"position error", "observed energy, base"}


def test_the_centre_of_mass_moves_by_the_recorded_momentum(runs: list[ff.Result]) -> None:
    run, record = content(view(runs[0]).text)["runs"][0], runs[0].record
    centre = np.column_stack([decoded(series) for series in run["center_of_mass"]])
    mass = sum(body["mass"] for body in run["scene"]["bodies"])
    velocity = record["free_flyer.linear_momentum"] / mass
    moved = 0.5 * np.diff(record.time)[:, None] * (velocity[1:] + velocity[:-1])
    assert np.abs(centre[1:] - centre[0] - np.cumsum(moved, axis=0)).max() < 1e-6
    assert np.ptp(centre, axis=0).max() > 1e-3


def test_two_runs_of_a_scenario_have_labels_with_their_changes() -> None:
    loop = ff.load("multirate_passive", {"stop_s": 0.1})
    page = content(view(ff.run(loop), ff.run(loop, {"base_controller.period": 0.1})).text)
    assert [run["label"] for run in page["runs"]] == [
        "multirate_passive (stop_s=0.1)",
        "multirate_passive (stop_s=0.1, base_controller.period=0.1)",
    ]


class Elements(HTMLParser):
    """Counter of the elements of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.found.append(tag)


def test_hostile_names_stay_text() -> None:
    name = "</script><script>alert(1)</script><!-- \u2028 ' \" &"
    result = ff.run("multirate_passive", {"stop_s": 0.01})
    hostile = type(result)(
        scenario=result.scenario.changed({}),
        outcome=result.outcome,
        errors={f"{name}_error_m": result.errors["base_position_error_m"]},
        summary=result.summary,
    )
    object.__setattr__(hostile.scenario, "title", name)
    page = view(hostile).text
    parser = Elements()
    parser.feed(page)
    assert parser.found.count("script") == 2
    assert content(page)["runs"][0]["title"] == name
    assert "default-src 'none'" in page


def test_runs_without_geometry_or_with_another_robot_are_shown_with_a_note(
    runs: list[ff.Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene, "of_fmu", lambda path: None)
    shown = view(runs[0])
    assert content(shown.text)["runs"][0]["scene"] is None
    assert any("no geometry" in note for note in shown.notes)
    monkeypatch.undo()
    other = scene.of_fmu(fmu_path("free_flyer"))
    assert other is not None
    other["end_effector"]["position"][2] += 0.5
    monkeypatch.setattr(scene, "of_fmu", lambda path: other)
    assert any("another robot" in note for note in view(runs[0]).notes)
    other["joints"].pop()
    assert any("the robot is not drawn" in note for note in view(runs[0]).notes)


def test_the_command_writes_a_page_beside_the_run_and_for_every_kind_of_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    ff.run("multirate_passive", {"stop_s": 0.1}, directory="run")
    assert command.call(["view", "run"]) == 0
    assert (tmp_path / "run" / "view.html").stat().st_size > 500_000
    fmu = str(fmu_path("free_flyer", fmi=3))
    for source in ("multirate_passive", fmu, "lwr4.urdf"):
        if source == "lwr4.urdf":
            from freeflyer_fmus.robot.urdf import DEFAULT_ROBOT

            source = str(DEFAULT_ROBOT)
        assert command.call(["view", source, "--out", "page.html", "--no-open"]) == 0, source
        run = content((tmp_path / "page.html").read_text())["runs"][0]
        assert len(run["scene"]["joints"]) == len(run["joints"]) == 6
    capsys.readouterr()


@pytest.mark.parametrize(
    ("sources", "options", "expected"),
    [
        (["nothing"], {}, "there is no scenario 'nothing'"),
        (["nothing.mcap"], {}, "nothing.mcap cannot be read"),
        (["nothing.fmu"], {}, "nothing.fmu"),
        (["nothing.xyz"], {}, "nothing.xyz cannot be viewed"),
        ([], {}, "0 sources are given"),
        (["multirate_passive"] * 3, {}, "3 sources are given"),
        (["multirate_passive"], {"signals": ["no.signal"]}, "no recorded signal matches"),
        (["multirate_passive"], {"robot": "nothing.urdf"}, "nothing.urdf"),
        (["multirate_passive"], {"robot": "robot.step"}, "no reader for the suffix '.step'"),
    ],
)
def test_a_source_that_cannot_be_viewed_is_one_sentence(
    sources: list[str], options: dict[str, Any], expected: str
) -> None:
    with pytest.raises(CosimError, match=re.escape(expected)) as caught:
        view(*sources, **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["run/record.parquet", "", ".", "page.txt"])
def test_a_page_never_replaces_another_file(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    ff.run("multirate_passive", {"stop_s": 0.01}, directory="run")
    before = (tmp_path / "run" / "record.parquet").read_bytes()
    assert command.call(["view", "run", "--out", name]) == 2
    assert "is not a file name that ends in .html" in capsys.readouterr().err
    assert (tmp_path / "run" / "record.parquet").read_bytes() == before


def test_the_page_has_the_time_at_which_a_run_diverged() -> None:
    result = ff.run("multirate_unstable", {"record.every_s": 0.5})
    end = content(view(result).text)["runs"][0]["end"]
    assert (end["kind"], end["time"]) == ("diverged", result.outcome.simulated)


def test_a_run_of_an_ssp_file_has_the_geometry_in_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ff.write_ssp(ff.load("multirate_passive"), "loop.ssp")
    ff.run(ff.load_ssp("loop.ssp", {"stop_s": 0.01}), directory="run")
    assert view("run").notes == []
    (tmp_path / "loop.ssp").unlink()
    assert any("no geometry" in note for note in view("run").notes)


def test_pages_of_100_s_are_small(monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = (ff.run(name) for name in ("multirate_passive", "multirate_matched"))
    assert one.record.rows == other.record.rows == 10_001
    assert len(view(one, other).text.encode()) <= 3_000_000
    file, options = FOREIGN["ur5"]
    meshes = robot_scene(example_robot(file), **options)
    monkeypatch.setattr(scene, "of_fmu", lambda path: meshes)
    assert any(shape["shape"] == "mesh" for shape in meshes["visuals"])
    assert len(view(one, other).text.encode()) <= 5_000_000


@pytest.mark.slow
def test_the_page_of_an_hour_is_small_and_keeps_the_largest_error() -> None:
    result = ff.run("multirate_passive", {"stop_s": 3600})
    shown = view(result)
    assert len(shown.text.encode()) <= 8_000_000
    assert any("poses" in note for note in shown.notes)
    (plot,) = [p for p in content(shown.text)["runs"][0]["plots"] if p["title"] == "position error"]
    largest = max(decoded(line["value"]).max() for line in plot["signals"])
    assert largest == pytest.approx(result.summary["base_position_error_m"]["max"], rel=1e-4)
