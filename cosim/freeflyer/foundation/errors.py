"""What can go wrong, as one small tree. Every message is one sentence for the user: subject, got, expected, remedy."""

import sys

DONE, BAD_INPUT, STOPPED = 0, 2, 3
"""Exit codes of every command."""


class CosimError(Exception):
    """Bad input; the command ends with exit code 2."""

    exit_code = BAD_INPUT


class ScenarioError(CosimError):
    """A scenario file or an override that cannot be used."""


class GraphError(CosimError):
    """Components, connections or periods that do not fit each other."""


class ComponentError(CosimError):
    """An FMU or component that cannot be loaded or initialised, or refuses a value."""


class RecordError(CosimError):
    """A record that cannot be read, or that lacks what is asked of it."""


class OutputError(CosimError):
    """Results that cannot be written."""

    exit_code = STOPPED


class StepFailed(Exception):
    """A component could not make its step; the run stops there and keeps what it has.

    `left_validity`: the equations' own limits were passed (a singular Jacobian, a state that is not finite), which makes the
    run a diverged one; else something is wrong with the system or the call.
    """

    def __init__(self, component: str, message: str, *, left_validity: bool = False) -> None:
        super().__init__(f"{component}: {' '.join(message.split())}")
        self.left_validity = left_validity


def complain(sentence: str, code: int) -> int:
    """Print the one sentence that a command fails with; return its exit code."""
    print(f"freeflyer: {sentence}", file=sys.stderr)
    return code
