"""Provenance of a record: the system's parameters, steps and connections."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

KEY = b"freeflyer.origin"
"""Key in the Parquet file's schema metadata; the value is JSON."""


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Contents of a record's metadata that make the record self-contained."""

    scenario: str
    exchange: str
    steps: Mapping[str, int]
    """Communication step of every component [ns]."""
    parameters: Mapping[str, Mapping[str, Any]]
    """Start values of every component [SI]: number, list, Boolean, or enumeration item."""
    sources: Mapping[str, str]
    """Source COMPONENT.OUTPUT of each connected input COMPONENT.VARIABLE."""

    def to_json(self) -> str:
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: bytes | str) -> Provenance:
        """Parse the output of `to_json`. Raises ValueError if the text is something else."""
        try:
            raw = json.loads(text)
        except RecursionError as error:
            raise ValueError("its JSON is nested too deeply") from error
        kinds: dict[str, type] = {
            "scenario": str,
            "exchange": str,
            "steps": dict,
            "parameters": dict,
            "sources": dict,
        }
        if not isinstance(raw, dict) or raw.keys() != kinds.keys():
            raise ValueError(f"{', '.join(kinds)} are expected in it")
        for key, kind in kinds.items():
            if not isinstance(raw[key], kind):
                raise ValueError(f"{key} is {raw[key]!r}")
        inner: dict[str, type] = {"steps": int, "parameters": dict, "sources": str}
        for key, kind in inner.items():
            if not all(isinstance(value, kind) for value in raw[key].values()):
                raise ValueError(f"{key} does not fit")
        if not all(0 < step < 1 << 63 for step in raw["steps"].values()):
            raise ValueError("steps are not all above zero")
        return cls(**raw)
