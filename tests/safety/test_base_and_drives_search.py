"""No power after a stop, for the base robot and CiA 402 drives: search of all states and guards.

The modules of the models (`NOT_GUARANTEED`) and docs/safety.md list the assumptions, and what these
devices cannot reject.
"""

from __future__ import annotations

from types import ModuleType

import pytest
import whole_base
import whole_drives
from search import explore

MODULES = {"base": whole_base, "drives": whole_drives}


QUICK = {
    "one run, a link that becomes slow",
    "drives: two runs",
    "a late set point is not accepted",
    "every step responds to the previous statusword",
}
"""Searches of the default test run; the others are marked as slow."""


def of_all(what: str) -> list[object]:
    """Return all entries of a table of both modules as parameters (module, name)."""
    return [
        pytest.param(
            module,
            name,
            marks=[] if {name, f"{module}: {name}"} & QUICK else pytest.mark.slow,
            id=f"{module}: {name}",
        )
        for module, worlds in MODULES.items()
        for name in sorted(getattr(worlds, what))
    ]


def module_of(name: str) -> ModuleType:
    return MODULES[name]


@pytest.mark.parametrize(("module", "name"), of_all("WORLDS"))
def test_only_a_requested_activation_leads_to_power(module: str, name: str) -> None:
    worlds = module_of(module)
    found = explore(worlds.WORLDS[name](), worlds.IGNORED)
    print(f"\n{module}, {name}: {found.states} states, {found.transitions} transitions")
    assert found.violation is None, f"{found.violation}: {' > '.join(found.path)}"
    assert "a run starts" in found.reached or "alone" in name


@pytest.mark.parametrize(("module", "name"), of_all("GUARDS"))
def test_without_this_guard_the_search_finds_a_path_to_power(
    module: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    worlds = module_of(module)
    world, patch = worlds.GUARDS[name]
    patch(monkeypatch)
    found = explore(world(), worlds.IGNORED)
    assert found.violation is not None, f"{found.states} states without a violation"


@pytest.mark.slow
@pytest.mark.parametrize(("module", "name"), of_all("NOT_GUARANTEED"))
def test_every_limit_of_the_guarantee_has_a_path_to_power(module: str, name: str) -> None:
    """The limits in docs/safety.md are real: a violation exists."""
    worlds = module_of(module)
    assert explore(worlds.NOT_GUARANTEED[name](), worlds.IGNORED).violation is not None
