"""A connection between two components."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Connection:
    """A connection from the output `source` to the input `target`.

    Both names have the form COMPONENT.VARIABLE. If `delayed` is True, the connection transfers the
    value that the source had before the present instant.

    If `of_terminals` is True, both names have the form COMPONENT.TERMINAL. A terminal is a named
    group of variables. These variables are its members. All matching members of the two terminals
    are connected.
    """

    source: str
    target: str
    delayed: bool = False
    of_terminals: bool = False
    optional: bool = False
    """If True, the connection is omitted when its source does not exist."""

    def __str__(self) -> str:
        return f"{self.source} {'<->' if self.of_terminals else '->'} {self.target}"
