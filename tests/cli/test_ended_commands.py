"""A signal ends every command in an orderly way: one sentence, exit code 3, no temporary folder."""

from __future__ import annotations

import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from families import family

RECORD = "record"
BLOCK = """
from freeflyer_fmus import Block
def block(robot):
    block = Block("lag", "A lag")
    u = block.input("u", 0.0, "1", "In")
    x = block.state("x", 0.0, "1", "Out")
    block.derivative("x", u - x)
    return block
"""
# The signal arrives in code that is compiled by `exec`, like that of a dataclass.
IMPORT = """
class Finder:
    def find_spec(self, name, *_):
        if name == "numpy":
            exec("signal.raise_signal({number})")
sys.meta_path.insert(0, Finder())
"""
LOADING = """
from freeflyer.fmi.fmu import FmuComponent
before = FmuComponent._instantiate
def instantiate(*arguments):
    made = before(*arguments)
    signal.raise_signal({number})
    return made
FmuComponent._instantiate = instantiate
"""
COMPILING = """
import subprocess
from freeflyer_fmus.export import fmus
def show(*_):
    signal.raise_signal({number})
before = fmus.build_all
fmus.build_all = lambda *a, **k: before(*a, **{{**k, "progress": show}})
"""
DISCARDED = """
from freeflyer.fmi.fmu import FmuComponent
before = FmuComponent._instantiate
def instantiate(*arguments):
    made = before(*arguments)
    class Discarding:
        def __del__(self):
            signal.raise_signal({number})
    Discarding()
    return made
FmuComponent._instantiate = instantiate
"""
MAIN = """
import signal, sys
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
from freeflyer.cli.main import main
{moment}
sys.exit(main())
"""
COMMANDS = {
    "run": ("run", "multirate_passive", "--set", "stop_s=3000"),
    "predict": ("predict", "multirate_unstable", "--out", "out"),
    "sweep": ("sweep", "base_period", "--workers", "1", "--out", "out"),
    "reproduce": ("reproduce", "--out", "out"),
    "export": ("export", "multirate_passive", "--out", "out.ssp"),
    "hil": ("hil", "facility", "--simulated", "--out", "out"),
    "facility": ("facility", "facility", "--out", "out"),
    "audit": ("audit", RECORD),
    "fmus": ("fmus", "--block", "block.py", "--out", "out"),
}
MOMENTS = [(name, IMPORT) for name in COMMANDS] + [
    (name, LOADING) for name in COMMANDS if name not in ("audit", "fmus", "sweep")
]
MOMENTS.append(("fmus", COMPILING))


def check(tmp_path: Path, name: str, moment: str, number: signal.Signals, sentence: str) -> None:
    """Run a command that gets a signal at a moment. It prints only `sentence`, and leaves nothing.

    `reproduce` prints the sentence to standard output.
    """
    (tmp_path / "block.py").write_text(BLOCK)
    code = MAIN.format(moment=moment.format(number=int(number)))
    with tempfile.TemporaryDirectory() as place:  # a short name, because it contains sockets
        done = subprocess.run(
            [sys.executable, "-c", code, *COMMANDS[name]],
            cwd=tmp_path,
            env={**os.environ, "TMPDIR": place},
            capture_output=True,
            text=True,
            check=False,
        )
        left = {path.name for path in Path(place).iterdir()}
    assert done.returncode == 3, done.stderr
    assert sentence in (done.stdout + done.stderr if name == "reproduce" else done.stderr)
    assert len(done.stderr.splitlines()) <= 1, done.stderr
    assert {name for name in left if not name.startswith("freeflyer-can-")} == set()


@pytest.mark.parametrize(
    ("name", "moment"),
    family(MOMENTS, [("run", LOADING), ("predict", LOADING), ("sweep", IMPORT), ("fmus", COMPILING)]),
    ids=lambda value: value if value in COMMANDS else None,
)  # fmt: skip
def test_a_closed_terminal_ends_every_command(tmp_path: Path, name: str, moment: str) -> None:
    check(tmp_path, name, moment, signal.SIGHUP, "nterrupted")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_other_signals_end_a_command_in_the_same_way(
    tmp_path: Path, number: signal.Signals
) -> None:
    sentence = "freeflyer: interrupted; the files written so far are complete\n"
    check(tmp_path, "run", IMPORT, number, sentence)


def test_a_signal_that_a_library_discards_ends_the_run_at_its_first_instant(tmp_path: Path) -> None:
    sentence = "freeflyer: interrupted at 0 s; the results up to then are saved\n"
    check(tmp_path, "run", DISCARDED, signal.SIGHUP, sentence)


def test_a_run_whose_terminal_has_disappeared_keeps_its_record(tmp_path: Path) -> None:
    """The terminal is a pseudo terminal. After its other end is closed, every write to it fails."""
    process, terminal = pty.fork()
    if process == 0:
        os.environ["TERM"] = "xterm"
        command = [*COMMANDS["run"], "--out", str(tmp_path / "out")]
        os.execv(sys.executable, [sys.executable, "-c", MAIN.format(moment=""), *command])
    shown, end = b"", time.monotonic() + 60.0
    while not re.search(rb"[1-9]\d* of 3000 s", shown) and time.monotonic() < end:
        if select.select([terminal], [], [], 0.1)[0]:
            shown += os.read(terminal, 65536)
    os.close(terminal)
    _, status = os.waitpid(process, 0)
    assert os.waitstatus_to_exitcode(status) == 3
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["interrupted"]
    assert (tmp_path / "out" / "record.parquet").stat().st_size > 1000
