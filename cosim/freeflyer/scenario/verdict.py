"""Verdict of a run.

The verdict states whether the run ended as the scenario expects. The exit code of the command
follows from the verdict.
"""

from __future__ import annotations

from freeflyer.foundation.errors import report_error
from freeflyer.foundation.exit_codes import DONE, STOPPED
from freeflyer.master.master import Outcome
from freeflyer.scenario.scenario import Scenario


def as_expected(scenario: Scenario, outcome: Outcome) -> bool:
    """Return whether the run ended in the way that the scenario expects: completed or diverged."""
    if outcome.interrupted or outcome.failed:
        return False
    return outcome.diverged == (scenario.expect == "diverges")


def verdict(scenario: Scenario, outcome: Outcome) -> int:
    """Return the exit code of a run. Report the outcome, unless the run completed as expected."""
    expected = as_expected(scenario, outcome)
    if outcome.interrupted:
        return report_error(
            f"interrupted at {outcome.simulated:g} s; the results up to then are saved", STOPPED
        )
    if outcome.failed:
        return report_error(
            f"the run stopped at {outcome.simulated:g} s: {outcome.cause}; the results up to then are saved",
            STOPPED,
        )
    if outcome.diverged and expected:
        print(f"Diverged at {outcome.simulated:g} s, as this scenario expects ({outcome.cause})")
    elif outcome.diverged:
        return report_error(
            f"the run diverged at {outcome.simulated:g} s and stopped: {outcome.cause}; the results up to then are saved",
            STOPPED,
        )
    elif not expected:
        return report_error("this scenario expects to diverge, but the run completed", STOPPED)
    return DONE
