"""The page of the viewer in a browser: what it draws, with which data, and how it is operated."""

from __future__ import annotations

import base64
import copy
import csv
import io
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sample_page as sample
from families import family

WEB = sample.PAGE.parent / "web"
AXE = WEB / "node_modules" / "axe-core" / "axe.min.js"
CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
SOFTWARE_GL = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
NO_GL = ["--disable-gpu", "--disable-3d-apis"]
HOSTILE = "</script><img src=x onerror=\"alert('1')\"><style>*{display:none}</style>\"'`${1}"

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
REQUIRED = os.environ.get("FREEFLYER_BROWSER") == "required"
"""In CI, the tests fail without Chromium or axe-core."""
pytestmark = pytest.mark.skipif(
    CHROMIUM is None and not REQUIRED, reason="Chromium is not installed"
)


class Opened:
    """A page that is open, with what it logged and requested."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.errors: list[str] = []
        self.requests: list[str] = []
        page.on("console", lambda m: m.type in ("error", "warning") and self.errors.append(m.text))
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("dialog", lambda dialog: (self.errors.append("dialog"), dialog.dismiss()))
        page.on("request", lambda request: self.requests.append(request.url))

    def __call__(self, script: str, *values: Any) -> Any:
        return self.page.evaluate(script, *values)

    def until(self, condition: str) -> None:
        """Wait for a condition; Playwright's own wait needs eval, which the page forbids."""
        for _ in range(200):
            if self(condition):
                return
            self.page.wait_for_timeout(50)
        raise AssertionError(f"not after 10 s: {condition}")

    def pose(self, run: int, frame: int) -> np.ndarray:
        return np.array(self(f"freeflyerView.pose({run}, {frame})"), float).reshape(4, 4).T


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    with playwright.sync_playwright() as started:
        yield started


@pytest.fixture(scope="module")
def browsers(driver: Any) -> Iterator[dict[bool, Any]]:
    made = {
        drawn: driver.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", *(SOFTWARE_GL if drawn else NO_GL)]
        )
        for drawn in (True, False)
    }
    yield made
    for browser in made.values():
        browser.close()


@pytest.fixture(scope="module")
def opener(
    browsers: dict[bool, Any], tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., Opened]:
    def opened(data: dict[str, Any], drawn: bool = True, hash_: str = "", **options: Any) -> Opened:
        path = sample.write(tmp_path_factory.mktemp("page") / "page.html", data)
        options = {"viewport": {"width": 900, "height": 620}, **options}
        page = browsers[drawn].new_context(**options).new_page()
        result = Opened(page)
        page.goto(path.as_uri() + hash_)
        page.evaluate("freeflyerView.ready")
        return result

    return opened


@pytest.fixture
def open_page(opener: Callable[..., Opened]) -> Iterator[Callable[..., Opened]]:
    """Open pages, and close them after the test: one that plays takes time from the next."""
    made: list[Opened] = []

    def opened(*args: Any, **options: Any) -> Opened:
        made.append(opener(*args, **options))
        return made[-1]

    yield opened
    for each in made:
        each.page.context.close()


@pytest.fixture(scope="module")
def run() -> dict[str, Any]:
    return sample.run(duration=6.0, rate=50.0)


@pytest.fixture(scope="module")
def two(run: dict[str, Any]) -> dict[str, Any]:
    other = sample.run("without PC", 0.3, duration=4.0, rate=50.0)
    return sample.document(run, sample.cut(other, 4.0, "the arm is singular"))


@pytest.fixture(scope="module")
def shown(opener: Callable[..., Opened], two: dict[str, Any]) -> Iterator[Opened]:
    """Two runs; tests that change more than the time open their own page."""
    opened = opener(two)
    yield opened
    opened.page.context.close()


def ink(opened: Opened, plot: int = 0) -> np.ndarray:
    """Return the heights (0 top, 1 bottom) of a plot at which the first line's colour is found."""
    opened.page.wait_for_selector(f".plot:nth-of-type({plot + 1}) canvas")
    opened.page.wait_for_timeout(100)
    text = opened(
        """(plot) => { const c = document.querySelectorAll('.plot')[plot].querySelector('canvas');
        const d = c.getContext('2d').getImageData(0, 0, c.width, c.height);
        return [c.width, c.height, btoa(Array.from(d.data, (v) => String.fromCharCode(v)).join(''))]; }""",
        plot,
    )
    pixels = np.frombuffer(base64.b64decode(text[2]), np.uint8).reshape(text[1], text[0], 4)
    blue = (np.abs(pixels[:, :, :3].astype(int) - [0, 0x72, 0xB2]).sum(axis=2) < 90) & (
        pixels[:, :, 3] > 128
    )
    return np.flatnonzero(blue.any(axis=1)) / text[1]


def test_page_logs_no_error_and_requests_only_itself(shown: Opened) -> None:
    shown("freeflyerView.setTime(3)")
    shown.page.wait_for_timeout(300)
    assert shown.errors == []
    assert len(shown.requests) == 1


def test_pose_of_every_frame_is_the_forward_kinematics_of_the_data(shown: Opened) -> None:
    for number, (duration, growth) in enumerate(((6.0, -0.02), (4.0, 0.3))):
        motion = sample.motion(duration, 50.0, growth)
        for k in (0, 17, 111, len(motion["time"]) - 1):
            shown(f"freeflyerView.setTime({float(motion['time'][k])!r})")
            base = sample.transform(motion["position"][k], motion["orientation"][k])
            expected = sample.forward_kinematics(sample.scene(), base, motion["joints"][k])
            assert shown(f"freeflyerView.frames({number})") == len(expected) == 8
            for frame, matrix in enumerate(expected):
                np.testing.assert_allclose(shown.pose(number, frame), matrix, rtol=0, atol=1e-6)


def test_magnified_deviation_is_stated_and_does_not_change_the_pose(shown: Opened) -> None:
    shown("freeflyerView.setTime(2)")
    shown.page.get_by_role("button", name="×1", exact=True).click()
    true = shown.pose(0, 7)
    shown.page.get_by_role("button", name="×1000", exact=True).click()
    shown.until("document.querySelector('.chip').textContent.includes('×1000, display only')")
    assert shown("freeflyerView.factor()") == 1000
    np.testing.assert_array_equal(shown.pose(0, 7), true)
    shown.page.get_by_role("button", name="auto", exact=True).click()


def test_run_that_ended_is_grey_with_its_reason_while_the_other_goes_on(shown: Opened) -> None:
    for time, ended in ((3.0, 0), (5.0, 1)):
        shown(f"freeflyerView.setTime({time})")
        shown.until(f"document.querySelectorAll('.panel.ended').length === {ended}")
    assert "diverged at 4.0" in shown.page.inner_text(".panel.ended .end")
    assert "the arm is singular" in shown.page.inner_text(".panel.ended .end")


def test_picture_shows_the_robot(shown: Opened) -> None:
    shown("freeflyerView.setTime(1)")
    colors = shown(
        """async () => { const image = new Image(); image.src = freeflyerView.picture(); await image.decode();
        const c = document.createElement('canvas'); c.width = image.width; c.height = image.height;
        const x = c.getContext('2d'); x.drawImage(image, 0, 0);
        const d = x.getImageData(0, 90, c.width / 3, 200).data, found = new Set();
        for (let i = 0; i < d.length; i += 4) found.add(d[i] >> 4 << 8 | d[i + 1] >> 4 << 4 | d[i + 2] >> 4);
        return found.size; }"""
    )
    assert colors > 40


def test_playing_moves_the_time_and_draws_no_plot_again(
    open_page: Callable[..., Opened], run: dict[str, Any]
) -> None:
    opened = open_page(sample.document(run))
    opened.page.wait_for_selector(".plot canvas")
    opened.page.wait_for_timeout(500)
    opened(
        """() => { window.cleared = 0; const original = CanvasRenderingContext2D.prototype.clearRect;
        CanvasRenderingContext2D.prototype.clearRect = function (...a) { window.cleared++; original.apply(this, a); } }"""
    )
    before = opened.page.locator(".now").first.evaluate("(e) => e.style.transform")
    opened.page.keyboard.press("Space")
    assert opened("freeflyerView.playing()")
    opened.until("freeflyerView.time() > 0.3")
    opened.page.keyboard.press("Space")
    assert not opened("freeflyerView.playing()")
    opened.page.wait_for_timeout(100)
    assert opened("window.cleared") == 0
    assert opened.page.locator(".now").first.evaluate("(e) => e.style.transform") != before
    assert opened("freeflyerView.scriptTimePerFrame()") > 0


def test_picture_returns_after_the_graphics_card_was_lost(
    open_page: Callable[..., Opened], run: dict[str, Any]
) -> None:
    opened = open_page(sample.document(run))
    opened(
        """() => { window.lose = document.querySelector('.stage > canvas').getContext('webgl2')
        .getExtension('WEBGL_lose_context'); window.lose.loseContext(); }"""
    )
    opened.until("document.querySelector('.said').textContent.includes('stopped drawing')")
    opened("freeflyerView.setTime(2)")
    opened("window.lose.restoreContext()")
    opened.page.wait_for_timeout(500)
    opened("freeflyerView.setTime(3)")
    assert len(opened("freeflyerView.picture()")) > 20_000
    assert [text for text in opened.errors if "Context Lost" not in text] == []


def test_hostile_names_are_text(open_page: Callable[..., Opened], run: dict[str, Any]) -> None:
    bad = copy.deepcopy(run)
    bad.update(label=HOSTILE, title=HOSTILE, notes=[HOSTILE])
    bad["end"] = {"kind": "failed", "time": 6.0, "cause": HOSTILE}
    for name in (*bad["scene"]["joints"], *bad["wrenches"], *bad["scene"]["visuals"]):
        name["name"] = HOSTILE
    for plot in bad["plots"]:
        plot.update(title=HOSTILE, unit=HOSTILE)
        for signal in plot["signals"]:
            signal["label"] = HOSTILE
    bad["marks"] = [{"kind": "fault", "time": 1.0, "until": None, "text": HOSTILE}]
    opened = open_page(sample.document(bad, title=HOSTILE, notes=(HOSTILE,)))
    opened("freeflyerView.setTime(6)")
    for key in "mj":
        opened.page.keyboard.press(key)
    opened.page.wait_for_selector(".plot canvas")
    opened.page.wait_for_timeout(300)
    assert opened.errors == []
    assert len(opened.requests) == 1
    assert opened.page.locator("img, body style").count() == 0
    assert HOSTILE[:40] in opened.page.inner_text("h1")
    assert HOSTILE[:40] in opened.page.inner_text(".end")


def test_ten_thousand_signals_and_plots_open(
    open_page: Callable[..., Opened], run: dict[str, Any]
) -> None:
    signal = run["plots"][0]["signals"][0]
    many = {
        "title": "many",
        "unit": "m",
        "signals": [{**signal, "label": f"s{k}"} for k in range(10_000)],
    }
    bad = {
        **run,
        "plots": [many, *({**many, "title": f"p{k}", "signals": [signal]} for k in range(10_000))],
    }
    for each in many["signals"]:
        each["time"] = each["value"] = {**signal["value"], "data": "", "scale": 0.0}
    opened = open_page(sample.document(bad), drawn=False)
    opened.page.wait_for_selector(".plot canvas")
    assert "9988 more signals" in opened.page.inner_text(".plot")
    assert "9977 left" in opened.page.inner_text(".more")
    assert opened.errors == []


@pytest.mark.parametrize(
    "change",
    [
        {"base": None, "joints": None},
        {"scene": None},
        {
            "scene": None,
            "base": None,
            "joints": None,
            "desired": None,
            "set_point": None,
            "time": sample.series([]),
        },
        {"time": sample.series([0.0]), "plots": [], "marks": [], "wrenches": [], "momentum": None},
        {"time": sample.series([1.0, np.nan, 0.5])},
    ],
    ids=["no poses", "no scene", "nothing", "one sample", "damaged times"],
)
def test_incomplete_run_opens(
    open_page: Callable[..., Opened], run: dict[str, Any], change: dict[str, Any]
) -> None:
    opened = open_page(sample.document({**run, **change}))
    opened("freeflyerView.setTime(0.5)")
    opened.page.keyboard.press("m")
    opened.page.wait_for_timeout(100)
    assert opened.errors == []


def test_robot_without_a_run_has_only_a_picture(
    open_page: Callable[..., Opened], run: dict[str, Any]
) -> None:
    nothing = {key: [] if isinstance(value, list) else None for key, value in run.items()}
    alone = {**nothing, "label": "robot", "scene": sample.scene(), "time": sample.series([0.0])}
    opened = open_page(sample.document({**alone, "joints": None}))
    assert not opened.page.locator(".side, .timeline").first.is_visible()
    expected = sample.forward_kinematics(sample.scene(), np.eye(4), np.zeros(6))
    np.testing.assert_allclose(opened.pose(0, 7), expected[-1], rtol=0, atol=1e-12)
    assert opened.errors == []


def test_page_without_run_states_this(open_page: Callable[..., Opened]) -> None:
    opened = open_page(sample.document())
    assert "This page has no run." in opened.page.inner_text("main")
    assert opened.errors == []


def test_data_that_cannot_be_read_are_one_sentence(
    open_page: Callable[..., Opened], run: dict[str, Any]
) -> None:
    bad = {**run, "time": {**run["time"], "data": "!"}}
    opened = open_page(sample.document(bad), drawn=False)
    assert "The data of this page cannot be shown" in opened.page.inner_text("[role=alert]")


def test_values_that_are_missing_stay_missing(
    open_page: Callable[..., Opened], run: dict[str, Any]
) -> None:
    motion = sample.motion(6.0, 50.0, -0.02)
    position = motion["position"].copy()
    position[100:110] = np.nan
    value = np.where(np.arange(301) % 7 == 3, np.nan, 1.0)
    bad = copy.deepcopy(run)
    bad["base"]["position"] = sample.triple(position)
    bad["plots"][0]["signals"][0]["value"] = sample.series(value)
    opened = open_page(sample.document(bad))
    opened(f"freeflyerView.setTime({float(motion['time'][105])!r})")
    assert np.isnan(opened.pose(0, 0)[:3, 3]).all()
    opened.until("document.querySelector('.signals .value')?.textContent")
    opened(f"freeflyerView.setTime({float(motion['time'][99])!r})")
    np.testing.assert_allclose(opened.pose(0, 0)[:3, 3], position[99], atol=1e-6)
    opened(f"freeflyerView.setTime({float(motion['time'][101])!r})")  # 101 % 7 == 3
    opened.until("document.querySelector('.signals .value').textContent === 'no value'")
    assert opened.errors == []


def test_repeated_time_has_the_values_after_the_event(
    open_page: Callable[..., Opened], run: dict[str, Any]
) -> None:
    jump = {
        **run,
        "time": sample.series([0.0, 1.0, 1.0, 2.0]),
        "base": {
            "position": sample.triple([[0, 0, 0], [1, 0, 0], [5, 0, 0], [6, 0, 0]]),
            "orientation": sample.triple([[0, 0, 0, 1.0]] * 4),
        },
        "joints": sample.triple(np.zeros((4, 6))),
        "desired": None,
        "plots": [],
        "marks": [],
        "end": {"kind": "completed", "time": 2.0, "cause": None},
    }
    opened = open_page(sample.document(jump), drawn=False)
    for time, x in ((0.5, 0.5), (1.0, 5.0), (1.5, 5.5), (2.0, 6.0)):
        opened(f"freeflyerView.setTime({time})")
        assert opened.pose(0, 0)[0, 3] == pytest.approx(x, abs=1e-6)


def test_without_webgl_the_plots_work_and_a_sentence_gives_the_reason(
    open_page: Callable[..., Opened], two: dict[str, Any]
) -> None:
    opened = open_page(two, drawn=False)
    assert "There is no picture: This browser has no WebGL 2" in opened.page.inner_text(".reason")
    assert len(ink(opened)) > 5
    opened("freeflyerView.setTime(2)")
    assert np.isfinite(opened.pose(1, 7)).all()
    assert opened.errors == []


@pytest.mark.parametrize("joined", [False, True], ids=["one signal", "two times"])
def test_spike_of_one_sample_is_visible(
    open_page: Callable[..., Opened], run: dict[str, Any], joined: bool
) -> None:
    time = np.arange(60_000) / 10_000
    value = np.zeros(60_000)
    value[31_234] = 1.0
    signals = [{"label": "spike", "time": sample.series(time), "value": sample.series(value)}]
    if joined:
        flat = {
            "label": "flat",
            "time": sample.series(time + 3e-5),
            "value": sample.series(0 * time),
        }
        signals.append(flat)
    spiky = {**run, "plots": [{"title": "spike", "unit": "m", "signals": signals}]}
    rows = ink(
        open_page(sample.document(spiky), drawn=False, viewport={"width": 600, "height": 600})
    )
    assert rows.min() < 0.25
    assert rows.max() > 0.6


def test_keyboard_reaches_every_control(
    open_page: Callable[..., Opened], two: dict[str, Any]
) -> None:
    opened = open_page(two)
    opened.until("document.querySelectorAll('.plot canvas').length > 1")
    missed = opened(
        """() => [...document.querySelectorAll('button, select, input, summary, .stage, .scroll')]
        .filter((e) => e.checkVisibility() && !e.disabled && (e.tabIndex < 0)).map((e) => e.outerHTML)"""
    )
    assert missed == []
    count = opened(
        "[...document.querySelectorAll('button, select, input, summary, .stage, .scroll')].filter((e) => e.checkVisibility() && !e.disabled).length"
    )
    opened.page.evaluate("document.body.focus()")
    for _ in range(count + 2):
        opened.page.keyboard.press("Tab")
        opened("() => { (window.reached ??= new Set()).add(document.activeElement); }")
    assert opened("window.reached.size") >= count
    # The time, by keys.
    opened.page.locator(".stage").focus()
    opened.page.keyboard.press("Home")
    opened.page.keyboard.press("u")
    first = opened("location.hash")
    opened.page.keyboard.press("ArrowLeft")  # rotates: the picture has the focus
    opened.page.keyboard.press("u")
    assert opened("location.hash") != first
    opened.page.locator("h1").click()
    opened("document.activeElement.blur()")
    opened.page.keyboard.press("ArrowRight")
    assert opened("freeflyerView.time()") == pytest.approx(0.02)
    opened.page.keyboard.press("End")
    assert opened("freeflyerView.time()") == pytest.approx(6.0)
    opened.page.keyboard.press(",")
    assert opened("freeflyerView.time()") < 6.0
    for key in "123456fdgwtlmj[]0":
        opened.page.keyboard.press(key)
    opened.page.wait_for_timeout(200)
    opened.page.keyboard.press("?")
    assert opened.page.locator("dialog").is_visible()
    assert opened.errors == []


def test_link_restores_time_camera_and_options(
    open_page: Callable[..., Opened], two: dict[str, Any]
) -> None:
    wanted = "#t=3.21&camera=1,2,3,0,0,0.5&deviation=10&follow=base"
    opened = open_page(two, hash_=wanted)
    assert opened("freeflyerView.time()") == pytest.approx(3.21)
    opened.page.keyboard.press("u")
    assert opened("location.hash") == wanted
    opened("() => { location.hash = '#t=NaN&camera=1,x&deviation=7&follow=__proto__'; }")
    opened.page.wait_for_timeout(100)
    assert opened("freeflyerView.time()") == pytest.approx(3.21)
    assert opened.errors == []


def test_csv_has_the_values_of_the_visible_window(
    open_page: Callable[..., Opened], run: dict[str, Any]
) -> None:
    named = copy.deepcopy(run)
    named["label"] = "=1+1"
    opened = open_page(sample.document(named), drawn=False)
    opened("freeflyerView.setTime(3)")
    opened.page.keyboard.press("[")  # 1.5 s to 4.5 s
    with opened.page.expect_download() as download:
        opened.page.keyboard.press("c")
    rows = list(csv.DictReader(io.StringIO(Path(download.value.path()).read_text("utf-8"))))
    times = {float(row["time [s]"]) for row in rows}
    assert min(times) == pytest.approx(1.5)
    assert max(times) == pytest.approx(4.5)
    assert {row["run"] for row in rows} == {"'=1+1"}
    errors = [row for row in rows if (row["plot"], row["signal"]) == ("position error", "base")]
    assert len(errors) == 151
    motion = sample.motion(6.0, 50.0, -0.02)
    assert float(errors[0]["value"]) == pytest.approx(
        np.linalg.norm(motion["position"][75]), rel=1e-6
    )


def test_mouse_on_a_plot_zooms_all_plots_and_sets_the_time(
    open_page: Callable[..., Opened], two: dict[str, Any]
) -> None:
    opened = open_page(two, drawn=False)
    opened.until("document.querySelectorAll('.u-over').length > 1")
    box = opened.page.locator(".u-over").first.bounding_box()
    middle = box["y"] + 60

    def at(share: float) -> float:
        return box["x"] + share * box["width"]

    opened.page.mouse.click(at(0.5), middle)
    assert opened("freeflyerView.time()") == pytest.approx(3.0, abs=0.05)
    opened.page.mouse.move(at(0.25), middle)
    opened.page.mouse.down()
    opened.page.mouse.move(at(0.75), middle, steps=4)
    opened.page.mouse.up()
    opened.page.wait_for_timeout(100)
    assert opened("freeflyerView.time()") == pytest.approx(3.0, abs=0.05)
    window = [float(part) for part in opened.page.inner_text(".window")[:-2].split(" to ")]
    assert window == pytest.approx([1.5, 4.5], abs=0.05)
    opened.page.mouse.click(at(0.0) + 1, middle)
    assert opened("freeflyerView.time()") == pytest.approx(1.5, abs=0.05)
    opened.page.mouse.dblclick(at(0.5), middle)
    opened.page.wait_for_timeout(100)
    assert opened.page.inner_text(".window") == "0.00 to 6.00 s"


def test_page_fits_390_pixels(open_page: Callable[..., Opened], two: dict[str, Any]) -> None:
    opened = open_page(two, viewport={"width": 390, "height": 844})
    assert opened("document.documentElement.scrollWidth") <= 390
    assert opened.page.locator(".stage > canvas").bounding_box()["width"] == 390


@pytest.mark.skipif(
    not AXE.exists() and not REQUIRED, reason="axe-core is not installed (npm ci in viewer/web)"
)
@pytest.mark.parametrize(
    ("width", "scheme"),
    family(
        [(1280, "light"), (390, "dark"), (1280, "dark"), (390, "light")],
        now=[(1280, "light"), (390, "dark")],
    ),
)
def test_axe_finds_nothing_serious(
    open_page: Callable[..., Opened], two: dict[str, Any], scheme: str, width: int
) -> None:
    opened = open_page(
        two, drawn=False, color_scheme=scheme, viewport={"width": width, "height": 800}
    )
    opened("freeflyerView.setTime(5)")
    opened.page.keyboard.press("j")
    opened.page.wait_for_selector(".plot canvas")
    opened.page.wait_for_timeout(300)
    opened(AXE.read_text(encoding="utf-8") + "\n;0")
    found = opened(
        "async () => (await axe.run()).violations.map((v) => [v.impact, v.id, v.nodes.map((n) => n.html + n.failureSummary)])"
    )
    assert [violation for violation in found if violation[0] in ("serious", "critical")] == []


def test_bundle_makes_no_code_and_no_request() -> None:
    script = (sample.PAGE / "viewer.js").read_text(encoding="utf-8")
    assert len(script) <= 900_000
    for word in ("eval(", "new Function(", "innerHTML", "</script", "XMLHttpRequest", "WebSocket("):
        assert word not in script, word
    licenses = (sample.PAGE / "LICENSES.txt").read_text(encoding="utf-8")
    assert licenses.count("MIT") >= 2


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("npm") is None, reason="npm is not installed")
def test_bundle_is_that_of_its_sources(tmp_path: Path) -> None:
    web = shutil.copytree(WEB, tmp_path / "web", ignore=shutil.ignore_patterns("node_modules"))
    (tmp_path / "page").mkdir()
    subprocess.run(["npm", "ci", "--no-audit", "--no-fund"], cwd=web, check=True)
    subprocess.run(["npm", "run", "build"], cwd=web, check=True)
    for name in ("viewer.js", "viewer.css", "LICENSES.txt"):
        assert (tmp_path / "page" / name).read_bytes() == (sample.PAGE / name).read_bytes(), name


@pytest.mark.benchmark
@pytest.mark.parametrize("runs", [1, 2])
def test_script_time_of_a_frame(open_page: Callable[..., Opened], runs: int) -> None:
    data = [sample.run(duration=100.0), sample.run("other", 0.01, duration=100.0)][:runs]
    opened = open_page(sample.document(*data), viewport={"width": 1440, "height": 900})
    opened("freeflyerView.play()")
    opened.page.wait_for_timeout(5000)
    time = opened("freeflyerView.scriptTimePerFrame()")
    print(f"{runs} runs: {time:.1f} ms of script for a frame")
    assert time <= 50
