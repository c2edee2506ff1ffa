"""Parsing of signal names (COMPONENT.VARIABLE) and of connection texts."""

from __future__ import annotations


def split(signal: str) -> tuple[str, str]:
    """Return the component and the variable of a signal name.

    The variable is empty if the name contains no dot.
    """
    component, _, variable = signal.partition(".")
    return component, variable


def component_of(signal: str) -> str:
    return split(signal)[0]


def split_connection(text: str) -> tuple[str, str, list[str]]:
    """Return the source, the arrow and the targets of a connection text.

    The text has the form "SOURCE -> TARGET, ..." or "TERMINAL <-> TERMINAL". In the second form,
    the first terminal is returned as the source. If the text contains no arrow, the returned arrow
    is empty.
    """
    source, arrow, targets = text.partition("<->" if "<->" in text else "->")
    return source.strip(), arrow, [target.strip() for target in targets.split(",")]
