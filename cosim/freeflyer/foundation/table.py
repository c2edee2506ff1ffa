"""A table of text: as plain text, as HTML for notebooks, and as input of the console."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape


@dataclass(frozen=True, kw_only=True)
class Table:
    """Texts in rows. The first column is left-aligned, the other columns are right-aligned.

    `breaks` are the numbers of the rows that start a new section.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    breaks: Sequence[int] = ()

    def __str__(self) -> str:
        lines = [tuple(self.header), *map(tuple, self.rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        text = [
            "  ".join(
                cell.rjust(width) if place else cell.ljust(width)
                for place, (cell, width) in enumerate(zip(line, widths, strict=True))
            ).rstrip()
            for line in lines
        ]
        return "\n".join([self.title, *text])

    def _repr_html_(self) -> str:
        def line(tag: str, cells: Sequence[str]) -> str:
            return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"

        body = "".join(line("td", row) for row in self.rows)
        return (
            f"<table><caption>{escape(self.title)}</caption>"
            f"<thead>{line('th', self.header)}</thead><tbody>{body}</tbody></table>"
        )


class Shown:
    """Base of results. The representation is the text of `table`, in notebooks as HTML."""

    @property
    def table(self) -> Table:
        raise NotImplementedError

    def __repr__(self) -> str:
        return str(self.table)

    def _repr_html_(self) -> str:
        return self.table._repr_html_()
