"""Modules that a command imports at its start, and commands of other packages."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from freeflyer import foundation

HEAVY = {
    "can", "casadi", "cryptography", "dask", "fmpy", "matplotlib", "numpy", "pandas", "pint", "pyarrow", "rich", "scipy", "zenoh",
}  # fmt: skip
PLUGIN = """\
class Hello:
    help = "greet the world: 100 % friendly"

    def configure(self, parser):
        parser.add_argument("--loud", action="store_true")

    def execute(self, arguments, console):
        console.print("HELLO" if arguments.loud else "hello")
        return 0
"""


def python(code: str, *path: Path) -> str:
    """Run code in a separate interpreter; return its output."""
    lines = [f"import sys; sys.path[:0] = {[str(folder) for folder in path]!r}", code]
    done = subprocess.run(
        [sys.executable, "-P", "-c", "\n".join(lines)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def loaded_by(code: str) -> set[str]:
    return set(python(f"{code}\nprint(*sys.modules)").split())


@pytest.mark.parametrize(
    "code",
    [
        "import freeflyer, freeflyer_fmus, freeflyer_adapters",
        "from freeflyer.cli.main import call\ntry:\n    call(['--help'])\nexcept SystemExit:\n    pass",
        "from freeflyer.cli.main import call\ntry:\n    call(['--version'])\nexcept SystemExit:\n    pass",
        "from freeflyer.cli.main import call\ntry:\n    call(['no-such-command'])\nexcept SystemExit:\n    pass",
    ],
)
def test_no_large_package_is_imported_before_the_command_is_known(code: str) -> None:
    assert not HEAVY & loaded_by(code)


def test_the_foundation_needs_only_the_standard_library() -> None:
    folder = Path(foundation.__path__[0])
    modules = [f"freeflyer.foundation.{path.stem}" for path in folder.glob("[a-z]*.py")]
    loaded = {name.partition(".")[0] for name in loaded_by(f"import {', '.join(modules)}")}
    before = {name.partition(".")[0] for name in loaded_by("import freeflyer")}
    assert loaded - before - sys.stdlib_module_names == set()


def test_a_run_imports_only_the_packages_that_it_uses(tmp_path: Path) -> None:
    """These exclude the packages for figures, export, model exchange, units and Dask."""
    arguments = ["run", "multirate_passive", "--set", "stop_s=0.01", "--out", str(tmp_path)]
    loaded = loaded_by(f"from freeflyer.cli.main import call\nassert call({arguments!r}) == 0")
    assert loaded & HEAVY == {"fmpy", "numpy", "pyarrow", "rich"}


def installed(folder: Path, group: str = "freeflyer.commands", **points: str) -> Path:
    """Write a third-party package with entry points, as an installer does."""
    about = folder / "other-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1.0\n")
    lines = [f"{name} = {place}" for name, place in points.items()]
    (about / "entry_points.txt").write_text("\n".join([f"[{group}]", *lines, ""]))
    (folder / "other.py").write_text(PLUGIN)
    return folder


def called(*arguments: str) -> str:
    return f"from freeflyer.cli.main import call\ntry:\n    print('code', call({list(arguments)!r}))\nexcept SystemExit as end:\n    print('code', end.code)"


def test_a_command_of_another_package_is_listed_and_run(tmp_path: Path) -> None:
    place = installed(tmp_path, hello="other:Hello")
    assert "greet the world: 100 % friendly" in python(called("--help"), place)
    assert python(called("hello", "--loud"), place).split() == ["HELLO", "code", "0"]
    assert "greet the world: 100 % friendly" in python(called("hello", "--help"), place)


def test_a_command_of_another_package_is_loaded_only_if_it_is_called_or_listed(
    tmp_path: Path,
) -> None:
    place = installed(tmp_path, hello="other:Hello")
    assert "other" not in python(f"{called('run', '--help')}\nprint(*sys.modules)", place).split()


ODD = """\
class Late:
    def __init__(self):
        self.help = "its help is created late"

    def configure(self, parser):
        raise OSError("no such library")

def factory():
    return Late()

class Silent:
    def configure(self, parser): ...
    def execute(self, arguments, console):
        return 0

class Bad:
    def __init__(self):
        raise OSError("no such file")
"""


def test_unusual_commands_of_other_packages_are_listed_and_their_errors_are_reported(
    tmp_path: Path,
) -> None:
    place = installed(
        tmp_path,
        late="odd:Late",
        made="odd:factory",
        silent="odd:Silent",
        bad="odd:Bad",
        module="odd",
    )
    (place / "odd.py").write_text(ODD)
    shown = " ".join(python(called("--help"), place).split())
    assert shown.count("its help is created late") == 2
    assert "command bad of odd:Bad failed: OSError: no such file" in shown
    assert "command module of odd failed: TypeError" in shown
    assert python(called("silent"), place).split() == ["code", "0"]
    for name in ("late", "made", "bad", "module"):
        assert python(called(name), place).split() == ["code", "2"]


@pytest.mark.parametrize("argument", ["--version", "no-such-command", "--no-such-option", "--"])
def test_a_command_of_another_package_is_not_loaded_for_other_arguments(
    tmp_path: Path, argument: str
) -> None:
    place = installed(tmp_path, hello="other:Hello")
    shown = python(f"{called(argument)}\nprint(*sys.modules)", place).split()
    assert "code" in shown
    assert "other" not in shown


def test_a_command_that_cannot_be_loaded_does_not_affect_others(tmp_path: Path) -> None:
    place = installed(
        tmp_path, broken="nowhere.to_be:Found", hello="other:Hello", old="adapters.cli:HilCommand"
    )
    shown = " ".join(python(called("--help"), place).split())
    assert "greet the world" in shown
    assert (
        "entry point 'broken' (freeflyer.commands) cannot be loaded from nowhere.to_be:Found: ModuleNotFoundError"
        in shown
    )
    assert "since 0.2.0 adapters is freeflyer_adapters" in shown
    assert python(called("hello"), place).split() == ["hello", "code", "0"]
    assert python(called("broken"), place).split() == ["code", "2"]


def test_a_command_of_another_package_does_not_replace_ours(tmp_path: Path) -> None:
    place = installed(tmp_path, run="other:Hello")
    assert "SCENARIO" in python(called("run", "--help"), place)


def test_broken_fmus_of_another_package_do_not_hide_the_shipped_ones(tmp_path: Path) -> None:
    place = installed(tmp_path, "freeflyer.fmus", aaa="nowhere:directory")
    run = ["run", "multirate_passive", "--set", "stop_s=0.01", "--out", str(tmp_path / "out")]
    assert python(called(*run), place).endswith("code 0\n")
    assert python(called(*run, "--set", 'free_flyer.fmu="none_of_that_name"'), place).endswith(
        "code 2\n"
    )
