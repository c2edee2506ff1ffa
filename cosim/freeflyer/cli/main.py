"""The command `freeflyer`: finds the subcommand and loads only that one.

Large packages are imported after the subcommand is known. `freeflyer --help` is then fast, and an
interrupt during the imports ends the command in order.
"""

from __future__ import annotations

import argparse
import io
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, NoReturn, Protocol

from freeflyer.foundation.errors import BAD_INPUT, STOPPED, CosimError, report_error
from freeflyer.foundation.interrupts import ENDING
from freeflyer.foundation.plugins import load, plugins

if TYPE_CHECKING:
    from rich.console import Console

GROUP = "freeflyer.commands"
"""Entry points of other packages' commands.

NAME = "MODULE:CALLABLE" returns a `Command`. Its attribute `help` is its line in the general help.
"""
COMMANDS: Mapping[str, tuple[str, str]] = {
    "audit": (
        "freeflyer.cli.audit:AuditCommand",
        "energy audit of a recorded run: sources, sinks, and observed against true energy",
    ),
    "certificates": (
        "freeflyer_adapters.cli.certificates:CertificatesCommand",
        "create a certificate authority, and a certificate and key for each end of the base robot's link",
    ),
    "export": (
        "freeflyer.cli.export:ExportCommand",
        "write a scenario's system, with its FMUs, as one SSP file for other tools",
    ),
    "facility": (
        "freeflyer_adapters.cli.hil:FacilityCommand",
        "simulate a scenario's facility: models of arm and base robot behind their real protocols",
    ),
    "fmus": (
        "freeflyer_fmus.cli:FmusCommand",
        "build FMI 2.0 and FMI 3.0 FMUs for a robot, or for a block of your own",
    ),
    "hil": (
        "freeflyer_adapters.cli.hil:HilCommand",
        "run a scenario's controllers on its facility, real or virtual, in real time",
    ),
    "predict": (
        "freeflyer.cli.predict:PredictCommand",
        "the largest stable period of the base's controller, from the linear loop at the set point",
    ),
    "recover": (
        "freeflyer_adapters.cli.recover:RecoverCommand",
        "restore files from an unfinished or damaged recording or CAN log, or from the memory of a killed loop",
    ),
    "reproduce": (
        "freeflyer.paper.command:ReproduceCommand",
        "every experiment of the paper: figures, comparison with the paper's statements, report page, summary.json",
    ),
    "run": (
        "freeflyer.cli.run:RunCommand",
        "run one scenario; write its record and summary.json",
    ),
    "sweep": (
        "freeflyer.cli.sweep:SweepCommand",
        "many runs of one scenario on Dask: grids and random designs, as one table",
    ),
}
"""Commands of this distribution: class, and line in `freeflyer --help`."""


class Command(Protocol):
    """A subcommand: it adds its arguments to a parser, and returns its exit code after a run."""

    def configure(self, parser: argparse.ArgumentParser) -> None: ...

    def execute(self, arguments: argparse.Namespace, console: Console) -> int: ...


def main() -> int:
    """Run the process. SIGTERM, and SIGHUP from the terminal, end a command like Ctrl-C."""
    try:
        for number in ENDING:
            if number != signal.SIGINT and signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, _interrupt)
        return call(sys.argv[1:])
    except KeyboardInterrupt:
        print("freeflyer: interrupted; the files written so far are complete", file=sys.stderr)
        return STOPPED


def call(arguments: Sequence[str]) -> int:
    """Run one command line. Return the exit code: 0 done, 2 bad input, 3 the run stopped."""
    # A path may contain invalid UTF-8; a message about it must not fail.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    # The general parser, without the arguments of the subcommands.
    parser = Parser(
        prog="freeflyer", description="Multi-rate co-simulation of a free-flying space robot."
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    # The subcommand, which is imported here.
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
        return command.execute(parsed, PlainConsole(highlight=False, markup=False))
    except CosimError as error:
        return report_error(str(error), error.exit_code)
    except OSError as error:
        return report_error(f"the output cannot be written: {error.strerror or error}", STOPPED)


class Parser(argparse.ArgumentParser):
    """An argument parser whose error is one line, without the usage."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"freeflyer: {message}; see `{self.prog} --help`\n")


class _Version(argparse.Action):
    """The option `--version`: the version is read only if the option is given."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        parser.exit(message=f"freeflyer-cosim {version('freeflyer-cosim')}\n")


def _loaded(name: str) -> Command:
    """Load one subcommand. Raises CosimError for any exception of another package."""
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
    """Yield the name of every subcommand and, `with_help`, its line of help.

    The line of a third-party command that cannot be loaded is the reason.
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
    """Convert any exception of a third-party command to a CosimError; our own exceptions pass."""
    try:
        yield
    except Exception as error:
        if name in COMMANDS or isinstance(error, CosimError):
            raise
        raise CosimError(
            f"command {name} of {plugins(GROUP)[name].value} failed: {type(error).__name__}: {error}"
        ) from error


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())
