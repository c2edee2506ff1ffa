"""Make the pictures of the viewer for README and docs/view.md, with Chromium.

    python docs/viewer_pictures.py [DIRECTORY]

DIRECTORY is docs/figures by default. The animation shows one scenario with and without passivity
controllers side by side.
"""

from __future__ import annotations

import io
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import Page, sync_playwright

import freeflyer as ff

CHROMIUM = "/usr/bin/chromium"
ARGUMENTS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
STOP, FRAMES, PLAYED = 60.0, 61, 9.0
"""Simulated time [s], number of frames of the animation, and its duration [s]."""
PLOTS = ("position error", "observed energy, base")
LARGEST = 1_000_000
"""Largest size of the animation [bytes]."""


@contextmanager
def opened(path: Path, width: int, height: int, scheme: str = "light") -> Iterator[Page]:
    """Open a page of the viewer in Chromium, and wait until it is drawn."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        size: Any = {"width": width, "height": height}
        page = browser.new_page(viewport=size, color_scheme=scheme)  # type: ignore[arg-type]
        page.goto(path.absolute().as_uri())
        page.evaluate("window.freeflyerView.ready")
        yield page
        browser.close()


def picture(page: Page, time: float) -> Image.Image:
    page.evaluate("time => window.freeflyerView.setTime(time)", time)
    page.wait_for_timeout(120)
    return Image.open(io.BytesIO(page.screenshot())).convert("RGB")


def boxes(page: Page) -> list[tuple[float, ...]]:
    """Return the places of the 3D picture, and of the plots of position errors and energies."""
    page.evaluate(
        """titles => {
            document.querySelector('details.legend').open = false;
            for (const plot of document.querySelectorAll('.plot'))
                if (!titles.some(title => plot.textContent.startsWith(title))) plot.style.display = 'none';
        }""",
        list(PLOTS),
    )
    page.wait_for_timeout(300)
    elements = page.locator(".frame").all() + [
        page.locator(".plot", has_text=title).first for title in PLOTS
    ]
    found = []
    for element in elements:
        box = element.bounding_box()
        assert box is not None
        found.append((box["x"], box["y"], box["x"] + box["width"], box["y"] + box["height"]))
    return found


def composed(whole: Image.Image, places: list[tuple[float, ...]]) -> Image.Image:
    """Return the 3D picture with the plots below it."""
    scene, *plots = (whole.crop(tuple(map(round, place))) for place in places)
    width = scene.width // len(plots)
    small = [
        plot.resize((width, round(plot.height * width / plot.width)), Image.Resampling.LANCZOS)
        for plot in plots
    ]
    frame = Image.new(
        "RGB", (scene.width, scene.height + max(plot.height for plot in small)), "white"
    )
    frame.paste(scene, (0, 0))
    for k, plot in enumerate(small):
        frame.paste(plot, (k * width, scene.height))
    return frame


def animation(page: Page, target: Path) -> None:
    """Write the animation with the best quality that is not too large."""
    places = boxes(page)
    frames = [composed(picture(page, STOP * k / (FRAMES - 1)), places) for k in range(FRAMES)]
    for quality in (70, 55, 40, 25):
        frames[0].save(
            target,
            save_all=True,
            append_images=frames[1:],
            duration=round(1000 * PLAYED / FRAMES),
            loop=0,
            quality=quality,
            method=4,
        )
        if target.stat().st_size <= LARGEST:
            return
    raise SystemExit(f"{target} has {target.stat().st_size} bytes; at most {LARGEST} are expected")


def main() -> None:
    directory = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parent / "figures")
    without, passive = (
        ff.run(name, {"stop_s": STOP}) for name in ("multirate_unstable", "multirate_passive")
    )
    with tempfile.TemporaryDirectory() as folder:
        one, two = Path(folder, "one.html"), Path(folder, "two.html")
        passive.view().write(one)
        without.view(passive).write(two)
        with opened(two, 1240, 760) as page:
            animation(page, directory / "viewer.webp")
        for name, path, size, scheme in (
            ("viewer", one, (1400, 900), "light"),
            ("viewer_two_runs", two, (1400, 900), "light"),
            ("viewer_dark", two, (1400, 900), "dark"),
            ("viewer_narrow", one, (390, 844), "light"),
        ):
            with opened(path, *size, scheme) as page:
                picture(page, 31.0).save(directory / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
