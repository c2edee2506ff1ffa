"""A stop stays a stop, for the base robot and for CiA 402 drives: the same search, and the same test of every guard.

Premises, and what these devices cannot refuse, are in the worlds' modules (`NOT_PROMISED`) and in docs/safety.md.
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
    "a late set point is not followed",
    "every step answers the statusword before",
}
"""Those of the default set."""


def of_all(what: str) -> list[object]:
    """Every member of both modules, as (module, name)."""
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
def test_no_path_leads_to_power_but_an_activation_that_a_run_has_asked_for(
    module: str, name: str
) -> None:
    worlds = module_of(module)
    found = explore(worlds.WORLDS[name](), worlds.IGNORED)
    print(f"\n{module}, {name}: {found.states} states, {found.transitions} transitions")
    assert found.violation is None, f"{found.violation}: {' > '.join(found.way)}"
    assert "a run starts" in found.reached or "alone" in name


@pytest.mark.parametrize(("module", "name"), of_all("GUARDS"))
def test_without_this_guard_a_path_to_power_is_found(
    module: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    worlds = module_of(module)
    world, patch = worlds.GUARDS[name]
    patch(monkeypatch)
    found = explore(world(), worlds.IGNORED)
    assert found.violation is not None, f"{found.states} states, and it was not missed"


@pytest.mark.slow
@pytest.mark.parametrize(("module", "name"), of_all("NOT_PROMISED"))
def test_what_the_device_cannot_refuse_is_found(module: str, name: str) -> None:
    """What docs/safety.md lists as not promised is no caution: there is a path."""
    worlds = module_of(module)
    assert explore(worlds.NOT_PROMISED[name](), worlds.IGNORED).violation is not None
