"""Two closed loops in other FMI masters: equal results under the same exchange rule."""

from __future__ import annotations

import closed_loop
import ecos_peer
import libcosim_peer
import numpy as np
import pytest
import reference_loops
from families import family
from masters import PEERS, arguments, before_the_instant, difference, own_master
from reference_loops import Rule

RUNS = [(name, version) for name, peer in PEERS.items() for version in peer.versions]
WITH_A_SLOW_SLAVE = [
    (scenario, name, version)
    for scenario in closed_loop.SCENARIOS
    for name, version in RUNS
    # A nested container initialises the base controller before its sources. Therefore the inputs
    # preview_time and filter_time_constant are 0, and the base controller of `robust` rejects that.
    if not (scenario == "robust" and PEERS[name].nests)
]
ONE_OF_EACH = [("multirate_passive", name, peer.versions[0]) for name, peer in PEERS.items()]


@pytest.mark.parametrize("moving", family([True, False]))
@pytest.mark.parametrize("scenario", closed_loop.SCENARIOS)
@pytest.mark.parametrize(("name", "version"), RUNS)
def test_a_peer_with_equal_steps_gives_our_results(
    name: str, version: int, scenario: str, moving: bool
) -> None:
    """Every step is T_m. With `moving`, the initial exchange affects the result."""
    peer = PEERS[name]
    options = arguments(0.001, 2.0, scenario=scenario, moving=moving)
    theirs = peer.run(peer.fmus(version, 0.001), *options)
    ours = own_master(version, peer.exchange, 0.001, 2.0, scenario=scenario, moving=moving)
    assert difference(before_the_instant(ours) if peer.rule.sequential else ours, theirs) < 1e-9


@pytest.mark.parametrize("version", family([3, 2]))
def test_a_plain_loop_with_fmpys_slaves_gives_our_results(version: int) -> None:
    sequential = reference_loops.run(
        closed_loop.fmus(version), *arguments(0.001, 2.0), Rule(sequential=True)
    )
    assert (
        difference(before_the_instant(own_master(version, "sequential", 0.001, 2.0)), sequential)
        < 1e-9
    )
    parallel = reference_loops.run(
        closed_loop.fmus(version), *arguments(0.001, 2.0), Rule(rounds=4)
    )
    assert difference(own_master(version, "parallel", 0.001, 2.0), parallel) < 1e-9


@pytest.mark.parametrize(("scenario", "name", "version"), family(WITH_A_SLOW_SLAVE, ONE_OF_EACH))
def test_a_peer_with_a_slow_slave_follows_its_documented_exchange_rule(
    scenario: str, name: str, version: int
) -> None:
    """docs/peers.md: with steps of T_b, masters differ by their exchange rules."""
    peer, options = PEERS[name], arguments(0.3, 2.0, scenario=scenario)
    fmus = peer.fmus(version, 0.3)
    assert (
        difference(
            peer.run(fmus, *options), reference_loops.run(fmus, *options, peer.rule_for(fmus))
        )
        < 1e-9
    )


def test_the_exchange_rules_give_different_results() -> None:
    """The agreement with a rule is significant only if the rules differ."""
    fmus = closed_loop.fmus(2)
    records = [
        reference_loops.run(fmus, *arguments(0.3, 2.0), rule)
        for rule in (Rule(sequential=True), Rule(), Rule(late=True))
    ]
    assert difference(records[0], records[1]) > 1e-5
    assert difference(records[1], records[2]) > 1e-3


@pytest.mark.slow
def test_a_base_wrench_delayed_by_a_whole_period_makes_the_loop_unstable() -> None:
    """T_b = 0.15 s without the base's passivity control: unstable with libcosim's rule.

    The loop is stable with ecos, which forwards outputs earlier.
    """
    options = arguments(0.15, 20.0, period=0.15, base_passivity_control=False)
    fmus = closed_loop.fmus(2)
    with pytest.raises(libcosim_peer.LibcosimError, match=r"smallest singular value|not finite"):
        libcosim_peer.run(fmus, *options)
    held = ecos_peer.run(fmus, *options)
    assert np.abs(held["free_flyer.base_position"]).max() < 0.05
