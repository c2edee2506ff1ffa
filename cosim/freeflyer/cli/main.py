"""The command `freeflyer`: finds the subcommand, and loads that one alone.

Nothing heavy is imported before a subcommand is known, so that `freeflyer --help` answers at once and an interrupt during the
imports is an orderly end too.
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

from freeflyer.foundation.errors import BAD_INPUT, STOPPED, CosimError, complain
from freeflyer.foundation.interrupts import ENDING
from freeflyer.foundation.plugins import load, plugins

if TYPE_CHECKING:
    from rich.console import Console

GROUP = "freeflyer.commands"
"""Entry points of other packages' commands: NAME = "MODULE:CALLABLE" gives a `Command`, whose line of help is its `help`."""
COMMANDS: Mapping[str, tuple[str, str]] = {
    "audit": (
        "freeflyer.cli.audit:AuditCommand",
        "where the energy of a recorded run entered and went, and what the observers believed",
    ),
    "certificates": (
        "freeflyer_adapters.cli.certificates:CertificatesCommand",
        "make an authority, and a certificate and key for each end of the base robot's link",
    ),
    "export": (
        "freeflyer.cli.export:ExportCommand",
        "write a scenario's system, with its FMUs, as one SSP file for other tools",
    ),
    "facility": (
        "freeflyer_adapters.cli.hil:FacilityCommand",
        "play a scenario's facility: its arm and base robot as models behind their real protocols",
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
        "make whole files of an unfinished or damaged recording, CAN log, or of what a killed loop has left in memory",
    ),
    "reproduce": (
        "freeflyer.paper.command:ReproduceCommand",
        "every experiment of the paper: figures, a table beside the paper's statements, a report page, summary.json",
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
"""This distribution's commands by name: where the class is, and its line in `freeflyer --help`."""


class Command(Protocol):
    def configure(self, parser: argparse.ArgumentParser) -> None: ...

    def execute(self, arguments: argparse.Namespace, console: Console) -> int: ...


def main() -> int:
    """The process's entry point. SIGTERM, and the end of its terminal, end a command as Ctrl-C does."""
    try:
        for number in ENDING:
            if number != signal.SIGINT and signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, _interrupt)
        return call(sys.argv[1:])
    except KeyboardInterrupt:
        print("freeflyer: interrupted; what was written until now is whole", file=sys.stderr)
        return STOPPED


def call(arguments: Sequence[str]) -> int:
    """Run one command line. Exit codes: 0 done, 2 bad input, 3 the run stopped."""
    # A path may hold bytes that are no text; a message about it must not fail for that.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    parser = Parser(
        prog="freeflyer", description="Multi-rate co-simulation of a free-flying space robot."
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    name = arguments[0] if arguments else ""
    try:
        command = _loaded(name) if name in COMMANDS or name in plugins(GROUP) else None
        if command is None:
            for listed, text in _listing(with_help=name.startswith(("-h", "--h"))):
                subparsers.add_parser(listed, help=text)
            parser.parse_args(arguments)  # exits: with the help, the version, or one sentence
            parser.error("a command is expected first")
        subparser = subparsers.add_parser(name, description=_help(name, command))
        with _one_sentence(name):
            command.configure(subparser)
    except CosimError as error:
        return complain(str(error), error.exit_code)
    parsed = parser.parse_args(arguments)

    from freeflyer.cli.console import PlainConsole

    try:
        return command.execute(parsed, PlainConsole(highlight=False, markup=False))
    except CosimError as error:
        return complain(str(error), error.exit_code)
    except OSError as error:
        return complain(f"the output cannot be written: {error.strerror or error}", STOPPED)


class Parser(argparse.ArgumentParser):
    """Reports a mistake in the arguments in one sentence."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"freeflyer: {message}; `{self.prog} --help` tells what is expected\n")


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        parser.exit(message=f"freeflyer-cosim {version('freeflyer-cosim')}\n")


def _loaded(name: str) -> Command:
    """Load one subcommand. Raises CosimError for one of another package that cannot be loaded, whatever it raises."""
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
    """Yield every subcommand and its line of help. For that line, commands of other packages are loaded; the line of one that cannot
    be loaded is the reason.
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
    """Turn whatever another package's command raises into a CosimError; errors of our own commands pass."""
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
