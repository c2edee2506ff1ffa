"""Exceptions. The attribute `exit_code` is the exit code of a command that raises the exception.

A message for the user contains, in this order: the subject, the value that was found, the expected
value, and the remedy.
"""

import sys

from freeflyer.foundation.exit_codes import BAD_INPUT, STOPPED


class CosimError(Exception):
    """The input is invalid. The command ends with exit code 2."""

    exit_code = BAD_INPUT


class ScenarioError(CosimError):
    """A scenario file or an override is invalid."""


class GraphError(CosimError):
    """Components, connections or periods are inconsistent."""


class ComponentError(CosimError):
    """An FMU or component cannot be loaded or initialised, or it rejects a value."""


class RecordError(CosimError):
    """A record cannot be read, or required data are missing in the record."""


class UnknownSignal(RecordError, KeyError):
    """A record does not contain a signal."""

    __str__ = Exception.__str__


class OutputError(CosimError):
    """Results cannot be written."""

    exit_code = STOPPED


class UnusableOutput(OutputError):
    """Results can never be written to this place. A command finds it before the run."""

    exit_code = BAD_INPUT


class StepFailed(CosimError):
    """A component failed in a step. A run stops and keeps the results up to this step.

    `reason` is the message without the name of the component.

    `left_validity` is True if the equations left their range of validity. Examples are a singular
    Jacobian and a state that is not finite. Such a run counts as diverged. If `left_validity` is
    False, the run counts as failed.
    """

    def __init__(self, component: str, message: str, *, left_validity: bool = False) -> None:
        self.reason = one_line(message)
        super().__init__(f"{component}: {self.reason}")
        self.left_validity = left_validity


def one_line(error: BaseException | str, longest: int | None = None) -> str:
    """Return a message on one line of at most `longest` characters.

    The message of an exception without a message is the name of its type.
    """
    text = " ".join(str(error).split())[:longest]
    return text or ("" if isinstance(error, str) else type(error).__name__)


def report_error(sentence: str, code: int) -> int:
    """Print the error message `sentence` to stderr. Return `code`, the command's exit code."""
    print(f"freeflyer: {sentence}", file=sys.stderr)
    return code
