"""The report: one self-contained HTML page with figures, tables, scenarios and versions."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import jinja2

from freeflyer.foundation.output_file import write_text
from freeflyer.scenario.experiment import Result

Verdict = Literal["as stated", "in part", "differs", "not in the paper"]


@dataclass(frozen=True, kw_only=True)
class Statement:
    """A statement of the paper, the measured result, and the comparison of statement and result."""

    where: str
    paper: str
    measured: str
    verdict: Verdict
    remark: str = ""


@dataclass(frozen=True, kw_only=True)
class Figure:
    number: str
    caption: str
    path: Path


PAPER = (
    "M. De Stefano, R. Balachandran, A. Giordano, C. Ott, C. Secchi: Multi-rate tracking control for a space robot on a "
    "controlled satellite: a passivity-based strategy"
)
ASSUMPTIONS = (
    "The paper does not give the following values: gains, trajectory amplitudes, start posture, mount, tool and arm masses. "
    "Its reference [16] is not public. All these values are assumptions of this project. Therefore the curves can have the same "
    "form as the curves of the paper, but not the same values. "
    "Where the paper gives no number, the table states this and claims no agreement. "
    "PC means passivity controller. T_m and T_b are the periods of the manipulator controller and of the base controller. "
    "E(0) is the initial energy of an observer."
)


def write(
    path: Path,
    statements: Sequence[Statement],
    sections: Mapping[str, Sequence[Statement]],
    remarks: tuple[str, Sequence[str]],
    figures: Sequence[Figure],
    results: Mapping[str, Result],
) -> None:
    """Write the page. Raises OutputError.

    `sections` are further tables of statements, by title. `remarks` state how firmly the
    statements hold, and what cannot be had together.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("report.html.jinja").render(
        sections={"The paper's statements and the measured results": statements, **sections},
        firmness=remarks[0],
        remarks=remarks[1],
        figures=[(figure, *_embedded(figure.path)) for figure in figures],
        results=results,
        versions=next(iter(results.values())).summary["versions"],
        paper=PAPER,
        assumptions=ASSUMPTIONS,
    )
    write_text(path, page)


def _embedded(path: Path) -> tuple[str, int]:
    """Return a PNG file as base64 text, and the width of the figure on the page.

    The width on the page is half the width in pixels. The width in pixels is at byte 16 of the
    file.
    """
    data = path.read_bytes()
    return base64.b64encode(data).decode(), int.from_bytes(data[16:20], "big") // 2
