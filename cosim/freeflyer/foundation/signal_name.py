"""Names of signals, COMPONENT.VARIABLE, and texts that connect them."""

from __future__ import annotations


def split(signal: str) -> tuple[str, str]:
    """Return component and variable; without a dot, the variable is empty."""
    component, _, variable = signal.partition(".")
    return component, variable


def component_of(signal: str) -> str:
    return split(signal)[0]


def split_connection(text: str) -> tuple[str, str, list[str]]:
    """Return source, arrow and targets of "SOURCE -> TARGET, ..." or "TERMINAL <-> TERMINAL".

    The arrow is empty if the text has none.
    """
    source, arrow, targets = text.partition("<->" if "<->" in text else "->")
    return source.strip(), arrow, [target.strip() for target in targets.split(",")]
