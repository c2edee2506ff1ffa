"""Provenance of a record: metadata that describe the simulated system and its scenario."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

KEY = b"freeflyer.origin"
"""Key of the provenance in the schema metadata of the Parquet file. Its value is a JSON text."""


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Metadata of a record. With these metadata, no scenario file is needed to evaluate the record.

    `scenario`: name of the scenario.
    `exchange`: coupling scheme, see `freeflyer.master.graph.Exchange`.
    """

    scenario: str
    exchange: str
    steps: Mapping[str, int]
    """Communication step of every component [ns]."""
    parameters: Mapping[str, Mapping[str, Any]]
    """Start values of every component [SI]: numbers, lists, Booleans or enumeration items."""
    sources: Mapping[str, str]
    """For each connected input COMPONENT.VARIABLE: the name COMPONENT.OUTPUT of the source."""
    sampled_at_end: bool = False
    """Whether the last row has a sample of each controller that is due at its time.

    It has none if the run ended at its stop time, or if the user interrupted it (`Master.finish`).
    """

    def to_json(self) -> str:
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: bytes | str) -> Provenance:
        """Parse a text that `to_json` has written. Raises ValueError if the text is invalid."""
        try:
            raw = json.loads(text)
        except RecursionError as error:
            raise ValueError("the JSON text of its provenance is nested too deeply") from error
        kinds: dict[str, type] = {
            "scenario": str,
            "exchange": str,
            "steps": dict,
            "parameters": dict,
            "sources": dict,
        }
        optional: dict[str, type] = {"sampled_at_end": bool}
        if not isinstance(raw, dict) or raw.keys() - optional.keys() != kinds.keys():
            raise ValueError(f"its provenance does not have exactly the keys {', '.join(kinds)}")
        kinds |= {key: kind for key, kind in optional.items() if key in raw}
        for key, kind in kinds.items():
            if not isinstance(raw[key], kind):
                raise ValueError(
                    f"the key {key} in its provenance is {raw[key]!r}; the type {kind.__name__} is expected"
                )
        inner: dict[str, type] = {"steps": int, "parameters": dict, "sources": str}
        for key, kind in inner.items():
            if not all(isinstance(value, kind) for value in raw[key].values()):
                raise ValueError(
                    f"the key {key} in its provenance has a value of a wrong type; {kind.__name__} is expected"
                )
        if not are_parameters(raw["parameters"]):
            raise ValueError("the key 'parameters' in its provenance has a value that is no number, text, or list of these")  # fmt: skip
        if not all(0 < step < 1 << 63 for step in raw["steps"].values()):
            raise ValueError(
                "the key 'steps' in its provenance has a value outside the range from 1 to 2^63 - 1"
            )
        return cls(**raw)


def are_parameters(found: Mapping[str, Any]) -> bool:
    """Return whether the members of a JSON value are parameters of components."""
    return all(
        isinstance(one, int | float | str)
        for own in found.values()
        for value in (own.values() if isinstance(own, dict) else [None])
        for one in (value if isinstance(value, list) else [value])
    )
