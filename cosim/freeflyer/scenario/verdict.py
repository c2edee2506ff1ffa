"""Verdict of a run.

The verdict states whether the run ended as the scenario expects. The exit code of the command
follows from the verdict.
"""

from __future__ import annotations

from typing import Literal

from freeflyer.foundation.errors import report_error
from freeflyer.foundation.exit_codes import DONE, STOPPED
from freeflyer.master.master import Outcome
from freeflyer.scenario.scenario import Scenario

End = Literal["completed", "diverged", "failed", "interrupted"]


def as_expected(scenario: Scenario, outcome: Outcome) -> bool:
    """Return whether the run ended in the way that the scenario expects: completed or diverged."""
    if outcome.interrupted or outcome.failed:
        return False
    return outcome.diverged == (scenario.expect == "diverges")


def end_of(outcome: Outcome) -> End:
    """Return how a run ended."""
    if outcome.interrupted:
        return "interrupted"
    if outcome.failed:
        return "failed"
    return "diverged" if outcome.diverged else "completed"


def sentence(scenario: Scenario, outcome: Outcome) -> str:
    """Return the end of a run, its time and its cause. It is empty for a run as expected."""
    at, cause = f"{outcome.simulated:g} s", outcome.cause
    if outcome.interrupted:
        return f"interrupted at {at}"
    if outcome.failed:
        return f"the run stopped at {at}: {cause}"
    if outcome.diverged and as_expected(scenario, outcome):
        return f"Diverged at {at}, as this scenario expects ({cause})"
    if outcome.diverged:
        return f"the run diverged at {at} and stopped: {cause}"
    if not as_expected(scenario, outcome):
        return "this scenario expects to diverge, but the run completed"
    return ""


def verdict(scenario: Scenario, outcome: Outcome) -> int:
    """Return the exit code of a run. Report the outcome, unless the run completed as expected."""
    text = sentence(scenario, outcome)
    if not as_expected(scenario, outcome):
        saved = "" if end_of(outcome) == "completed" else "; the results up to then are saved"
        return report_error(text + saved, STOPPED)
    if text:
        print(text)
    return DONE
