"""Draw docs/figures/architecture.svg from the sources: packages, layers and modules.

Usage: python docs/architecture_figure.py > docs/figures/architecture.svg
"""

from __future__ import annotations

import textwrap
import tomllib
from collections.abc import Iterator
from html import escape
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCES = {"freeflyer_adapters": "adapters", "freeflyer": "cosim", "freeflyer_fmus": "fmu_src"}
TITLES = {
    "freeflyer_adapters": "adapters/freeflyer_adapters: hardware in the loop",
    "freeflyer": "cosim/freeflyer: scenarios, master, analysis, paper",
    "freeflyer_fmus": "fmu_src/freeflyer_fmus: robot, equations, blocks",
}
WIDTH, GAP, LINE, CHARACTERS = 420, 30, 15, 62


def layers(package: str) -> list[list[str]]:
    """Return the layers of an import package, top first, as import-linter checks them."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    found = next(c["layers"] for c in contracts if c.get("containers") == [package])
    return [layer.split(" | ") for layer in found]


def modules(package: str, name: str) -> list[str]:
    """Return the modules of a subpackage; `inner.module` for modules of an inner package."""
    folder = ROOT / SOURCES[package] / package / name
    if not folder.is_dir():
        return []
    found = (path.relative_to(folder).with_suffix("") for path in folder.rglob("*.py"))
    return sorted(".".join(path.parts) for path in found if path.name != "__init__")


def boxes(package: str) -> Iterator[tuple[int, str, list[str]]]:
    """Yield (layer, name of the subpackage, lines with its modules)."""
    for level, names in enumerate(layers(package)):
        for name in names:
            text = ", ".join(modules(package, name))
            yield level, name, textwrap.wrap(text, CHARACTERS, break_long_words=False)


def column(package: str, left: int, top: int) -> tuple[list[str], int]:
    """Return the SVG elements of a package and the y coordinate of their end."""
    shapes = [f'<text x="{left}" y="{top}" class="title">{escape(TITLES[package])}</text>']
    y, before = top + 12, -1
    for level, name, lines in boxes(package):
        y += 14 if level != before else 4  # a gap between two layers
        before = level
        height = 24 + LINE * len(lines)
        shapes.append(
            f'<rect x="{left}" y="{y}" width="{WIDTH}" height="{height}" class="layer{level}"/>'
        )
        shapes.append(f'<text x="{left + 8}" y="{y + 16}" class="name">{name}</text>')
        for i, line in enumerate(lines):
            shapes.append(
                f'<text x="{left + 8}" y="{y + 16 + LINE * (i + 1)}">{escape(line)}</text>'
            )
        y += height
    return shapes, y


def figure() -> str:
    """Return the figure as SVG text."""
    shapes, bottom = [], 0
    for i, package in enumerate(SOURCES):
        drawn, end = column(package, GAP + i * (WIDTH + GAP), 34)
        shapes += drawn
        bottom = max(bottom, end)
    width, height = GAP + len(SOURCES) * (WIDTH + GAP), bottom + 44
    note = (
        "A subpackage imports only subpackages below it in its column. Adapters also import freeflyer; "
        "freeflyer_fmus imports freeflyer.foundation only."
    )
    shapes.append(f'<text x="{GAP}" y="{bottom + 26}">{note}</text>')
    shades = ("#dbe9f6", "#e3f1e3", "#fdf1d8", "#fbe3d6", "#ecdff2", "#eeeeee")
    style = "".join(f".layer{i}{{fill:{shade};stroke:#999}}" for i, shade in enumerate(shades))
    return "\n".join([
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'font-family="DejaVu Sans, sans-serif" font-size="11">',
        f"<style>{style}.name{{font-weight:bold;font-size:13px}}"
        f".title{{font-weight:bold;font-size:14px}}</style>",
        '<rect width="100%" height="100%" fill="white"/>',
        *shapes,
        "</svg>",
    ])  # fmt: skip


if __name__ == "__main__":
    print(figure())
