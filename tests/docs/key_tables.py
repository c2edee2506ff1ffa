"""Tables of docs/scenarios.md and docs/sweeps.md with the keys of the files.

Usage: python tests/docs/key_tables.py    (writes the tables into both pages)
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

from freeflyer.analysis.sweep import keys as sweep_keys
from freeflyer.foundation.keys import Keys
from freeflyer.scenario import keys, schema

DOCS = Path(__file__).parents[2] / "docs"
HEAD = "| key | meaning |\n|---|---|"


def rows(form: str, declared: Keys) -> Iterator[str]:
    """Yield one row for each key. `{}` in `form` stands for the name of the key."""
    for name, key in declared.items():
        default = key.default if key.default not in (None, "", {}, [], ()) else None
        text = (
            key.meaning if default is None else f"{key.meaning}. Default: `{json.dumps(default)}`"
        )
        yield f"| `{form.replace('{}', name)}` | {text.replace('|', '&#124;')} |"


def of_scenarios() -> Iterator[str]:
    inner: dict[str, tuple[str, str, Keys]] = {
        "record": ("[record]", "[record] {}", keys.RECORD),
        "components": (
            "[components.NAME]",
            "[components.NAME] {}",
            {**keys.COMPONENT, **keys.COMPONENT_INHERITANCE},
        ),
        "devices": ("[devices.NAME]", "", {}),
        "limits": ("[[limits]]", "[[limits]] {}", keys.LIMIT),
        "roles": ("[roles]", "[roles] {}", keys.ROLES),
        **{
            name: (f"[{name}]", "", {})
            for name in ("robot", "facility", "errors", "observed_energy")
        },
    }
    yield HEAD
    for name, key in {**keys.INHERITANCE, **keys.SCENARIO}.items():
        title, form, declared = inner.get(name, (name, "", {}))
        yield from rows(title, {name: key})
        yield from rows(form, declared)


def of_kinds() -> Iterator[str]:
    """Yield the keys of the kinds. Kinds with equal keys share their rows."""
    shared: dict[tuple[str, str], list[str]] = {}
    for kind, keys_of_kind in schema.of_kinds().items():
        declared = keys_of_kind or {}
        for name, row in zip(declared, rows("{}", declared), strict=True):
            shared.setdefault((name, row), []).append(f'`"{kind}"`')
    yield "| kinds | key | meaning |\n|---|---|---|"
    for (_, row), kinds in shared.items():
        yield f"| {', '.join(kinds)} {row}"


def of_sweeps() -> Iterator[str]:
    yield HEAD
    for name, key in sweep_keys.SWEEP.items():
        named = f"[{name}.NAME]" if name in ("cases", "designs") else f"[{name}]"
        title = named if key.type.schema.get("type") == "object" else name
        yield from rows(title, {name: key})
        inner = {"sample": sweep_keys.SAMPLE, "map": sweep_keys.MAP}.get(name, {})
        yield from rows(f"[{name}] {{}}", inner)


def of_axes() -> Iterator[str]:
    yield HEAD
    yield from rows("{}", {name: sweep_keys.LEVELS[name] for name in ("values",)})
    yield from rows("{}", {**sweep_keys.GRID_INTERVAL, **sweep_keys.SAMPLED_INTERVAL})


TABLES = {
    "scenarios.md": {"scenario": of_scenarios, "kinds": of_kinds},
    "sweeps.md": {"sweep": of_sweeps, "axis": of_axes},
}


def page(name: str) -> str:
    """Return the page with its present tables."""
    text = (DOCS / name).read_text(encoding="utf-8")
    for place, table in TABLES[name].items():
        begin, end = f"<!-- keys: {place} -->\n", "<!-- end of keys -->"
        made = "\n".join(table())
        pattern = re.compile(f"{re.escape(begin)}.*?{end}", re.DOTALL)
        text, count = pattern.subn(lambda _, new=f"{begin}{made}\n{end}": new, text)
        assert count == 1, place
    return text


if __name__ == "__main__":
    for name in TABLES:
        (DOCS / name).write_text(page(name), encoding="utf-8")
