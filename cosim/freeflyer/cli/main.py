"""The command `freeflyer`. It finds the subcommand and loads only this subcommand.

Large packages are imported after the subcommand is known. Therefore `freeflyer --help` is fast, and
Ctrl-C during these imports ends the command with a message instead of a traceback.
"""

from __future__ import annotations

import argparse
import io
import os
import re
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any, NoReturn, Protocol

from freeflyer.foundation.errors import CosimError, report_error
from freeflyer.foundation.exit_codes import BAD_INPUT, STOPPED
from freeflyer.foundation.extras import needed_by
from freeflyer.foundation.home import give_matplotlib_a_folder
from freeflyer.foundation.interrupts import ENDING, end_at_signals
from freeflyer.foundation.plugins import described, load, plugins

if TYPE_CHECKING:
    from rich.console import Console

GROUP = "freeflyer.commands"
"""Group of the entry points for commands of other packages.

The callable of an entry point NAME = "MODULE:CALLABLE" returns a `Command`. The attribute `help` of
this command is its line in `freeflyer --help`.
"""
COMMANDS: Mapping[str, tuple[str, str]] = {
    "audit": (
        "freeflyer.cli.audit:AuditCommand",
        "compute the energy audit of a recorded run: energy sources and sinks, observed and true energy",
    ),
    "certificates": (
        "freeflyer_adapters.cli.certificates:CertificatesCommand",
        "create a certificate authority, and a certificate with key for each peer of the base robot's link",
    ),
    "check": (
        "freeflyer.cli.check:CheckCommand",
        "check a scenario or a sweep with its components, without a run; print the JSON Schema of such files",
    ),
    "export": (
        "freeflyer.cli.export:ExportCommand",
        "write a scenario's system, with its FMUs, as one SSP file for other tools",
    ),
    "facility": (
        "freeflyer_adapters.cli.hil:FacilityCommand",
        "simulate the facility of a scenario: models of arm and base robot that use the real protocols",
    ),
    "fmus": (
        "freeflyer_fmus.cli:FmusCommand",
        "build FMI 2.0 and FMI 3.0 FMUs for a robot, or for a block of your own",
    ),
    "hil": (
        "freeflyer_adapters.cli.hil:HilCommand",
        "run the controllers of a scenario in real time on the real or the virtual facility",
    ),
    "predict": (
        "freeflyer.cli.predict:PredictCommand",
        "compute the largest stable period of the base controller from the loop that is linearised at the set point",
    ),
    "recover": (
        "freeflyer_adapters.cli.recover:RecoverCommand",
        "restore files from an unfinished or damaged recording or CAN log, or from the memory of a killed loop",
    ),
    "reproduce": (
        "freeflyer.paper.command:ReproduceCommand",
        "run every experiment of the paper; write figures, a comparison with the paper's statements, a report page and summary.json",
    ),
    "run": (
        "freeflyer.cli.run:RunCommand",
        "run one scenario, or repeat a run; write its record and summary.json",
    ),
    "runs": (
        "freeflyer.cli.runs:RunsCommand",
        "list, filter and compare runs in a folder",
    ),
    "sweep": (
        "freeflyer.cli.sweep:SweepCommand",
        "run one scenario on Dask with many values of its parameters (a grid or random values); write one table",
    ),
    "view": (
        "freeflyer.cli.view:ViewCommand",
        "write one HTML file that shows a run, two runs, a recording or a robot in 3D with plots",
    ),
}
"""Commands of this distribution: name -> (class, line in `freeflyer --help`)."""


class Command(Protocol):
    """A subcommand.

    `configure` adds the arguments of the subcommand to a parser. `execute` runs the subcommand and
    returns the exit code.
    """

    def configure(self, parser: argparse.ArgumentParser) -> None: ...

    def execute(self, arguments: argparse.Namespace, console: Console) -> int: ...


def main() -> int:
    """Run the process. SIGTERM and SIGHUP end a command in the same way as Ctrl-C."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is not None and stream.isatty():
            raw = _Terminal(stream.fileno(), "w", closefd=False)
            buffer = io.BufferedWriter(raw)
            setattr(sys, name, io.TextIOWrapper(buffer, stream.encoding, line_buffering=True))
    try:
        end_at_signals()
        with suppress(CosimError):  # Matplotlib, if it is used, then warns itself
            give_matplotlib_a_folder()
        return call(sys.argv[1:])
    except KeyboardInterrupt:
        return report_error("interrupted; the files written so far are complete", STOPPED)
    finally:
        for number in ENDING:  # a second signal does not interrupt the end
            signal.signal(number, signal.SIG_IGN)


class _Terminal(io.FileIO):
    """A stream to a terminal. If the terminal was closed, the output is discarded."""

    def write(self, data: Any, /) -> int:
        try:
            return super().write(data)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())
            return super().write(data)


def call(arguments: Sequence[str]) -> int:
    """Run one command line. Return the exit code: 0 (done), 2 (bad input), 3 (the run stopped)."""
    # A path may contain invalid UTF-8. A message with this path must still be printed.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    # Create the general parser, without the arguments of the subcommands.
    parser = Parser(
        prog="freeflyer", description="Multi-rate co-simulation of a free-flying space robot."
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    # Import the subcommand and create its parser.
    name = arguments[0] if arguments else ""
    try:
        command = _loaded(name) if name in COMMANDS or name in plugins(GROUP) else None
        if command is None:
            for listed, text in _listing(with_help=name.startswith(("-h", "--h"))):
                subparsers.add_parser(listed, help=text)
            parser.parse_args(arguments)  # exits with the help, the version or an error
            parser.error("a command is expected first")
        subparser = subparsers.add_parser(name, description=_help(name, command))
        with _one_sentence(name):
            command.configure(subparser)
    except CosimError as error:
        return report_error(str(error), error.exit_code)
    parsed = parser.parse_args(arguments)

    from freeflyer.cli.console import PlainConsole

    try:
        with needed_by(f"freeflyer {name}"):
            return command.execute(parsed, PlainConsole(highlight=False, markup=False))
    except CosimError as error:
        return report_error(str(error), error.exit_code)
    except OSError as error:
        return report_error(f"the output cannot be written: {error.strerror or error}", STOPPED)


NEGATIVE = re.compile(
    r"-(?:(?:\d[\d_]*\.?[\d_]*|\.\d[\d_]*)(?:e[-+]?\d+)?|inf(?:inity)?|nan)$", re.I
)
"""Negative numbers, which are values and not options: -5, -1e-05, -.5e3, -inf."""


class Parser(argparse.ArgumentParser):
    """An argument parser. Its error message is one line and does not contain the usage."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        # The pattern of argparse has no numbers with an exponent.
        self._negative_number_matcher = NEGATIVE

    def error(self, message: str) -> NoReturn:
        message = re.sub("invalid int value: (.*)", r"\1 is not a whole number", message)
        message = re.sub("invalid float value: (.*)", r"\1 is not a number", message)
        self.exit(BAD_INPUT, f"freeflyer: {message}; see `{self.prog} --help`\n")


class _Version(argparse.Action):
    """The option `--version`. The version is read only if the option is given."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        parser.exit(message=f"freeflyer-cosim {version('freeflyer-cosim')}\n")


def _loaded(name: str) -> Command:
    """Load one subcommand. Raises CosimError if a third-party command raises any exception.

    Raises MissingExtra if the command needs an extra that is not installed.
    """
    with _one_sentence(name):
        if name not in COMMANDS:
            command: Command = load(plugins(GROUP)[name])()
            return command
        module, _, attribute = COMMANDS[name][0].partition(":")
        own: Command = getattr(import_module(module), attribute)()
        return own


def _help(name: str, command: Command) -> str:
    return COMMANDS[name][1] if name in COMMANDS else str(getattr(command, "help", ""))


def _listing(*, with_help: bool) -> Iterator[tuple[str, str]]:
    """Yield the name and the help line of every subcommand.

    Without `with_help`, the help lines are empty. If a third-party command cannot be loaded, its
    help line is the error message.
    """
    others = plugins(GROUP)
    for name in sorted({*COMMANDS, *others}):
        text = ""
        if with_help:
            try:
                text = COMMANDS[name][1] if name in COMMANDS else _help(name, _loaded(name))
            except CosimError as error:
                text = str(error)
        yield name, text.replace("%", "%%")


@contextmanager
def _one_sentence(name: str) -> Iterator[None]:
    """Convert any exception of a third-party command to a CosimError.

    Exceptions of our own commands are not converted, except for an extra that is not installed.
    """
    try:
        with needed_by(f"freeflyer {name}"):
            yield
    except Exception as error:
        if name in COMMANDS or isinstance(error, CosimError):
            raise
        raise CosimError(
            f"command {name} of {plugins(GROUP)[name].value} failed: {described(error)}"
        ) from error


if __name__ == "__main__":
    sys.exit(main())
