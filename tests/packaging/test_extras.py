"""Extras of the distribution: their packages, and the error if an extra is not installed."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from wheels import ROOT

import freeflyer
import freeflyer_adapters
import freeflyer_fmus
from freeflyer.foundation.errors import CosimError
from freeflyer.foundation.extras import EXTRAS, MissingExtra, needed_by, require
from freeflyer_fmus.export import compiler

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
IMPORTED_AS = {
    "autosar-e2e": "e2e",
    "eclipse-zenoh": "zenoh",
    "pin": "pinocchio",
    "python-can": "can",
}
"""Import names of distributions, if they differ from the name of the distribution."""
BROUGHT_ALONG = {"coal": "pinocchio", "dask": "distributed"}
"""Packages that another distribution of the same extra installs in the version that it needs."""
USES = {
    "freeflyer": (),
    "freeflyer.analysis.sweep": ("sweep",),
    "freeflyer.master.record": ("analysis",),
    "freeflyer_adapters": ("hil",),
    "freeflyer_fmus": ("export",),
}
"""Extras that the modules of a package may import, in addition to the core."""
PROGRAMS = {"ziglang"}
"""Packages that are executed (python -m ziglang) and not imported."""
HIDE = """\
import sys

class Hiding:
    def __init__(self, finders, hidden):
        self.finders, self.hidden = finders, hidden

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in self.hidden:
            return None
        found = (finder.find_spec(name, path, target) for finder in self.finders)
        return next((spec for spec in found if spec is not None), None)

    def find_distributions(self, *context):
        for finder in self.finders:
            if hasattr(finder, "find_distributions"):
                yield from finder.find_distributions(*context)

sys.meta_path[:] = [Hiding(sys.meta_path[:], {hidden!r})]
"""
PACKAGES = (freeflyer, freeflyer_adapters, freeflyer_fmus)
PLACES = os.pathsep.join(str(Path(str(package.__file__)).parents[1]) for package in PACKAGES)
"""Import path of the packages that are tested here, for interpreters in other folders."""
EVERYTHING = tuple(package for packages in EXTRAS.values() for package in packages)


def sentence(subject: str, extra: str) -> str:
    return f"{subject} needs the extra {extra}: pip install 'freeflyer-cosim[{extra}]'"


def without(
    packages: tuple[str, ...], code: str, folder: Path, *arguments: str
) -> subprocess.CompletedProcess[str]:
    """Run code in a separate interpreter that does not find these packages."""
    lines = HIDE.replace("{hidden!r}", repr(packages)) + code
    return subprocess.run(
        [sys.executable, "-P", "-c", lines, *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": PLACES},
        capture_output=True,
        text=True,
        check=False,
    )


def command(
    packages: tuple[str, ...], folder: Path, *arguments: str
) -> subprocess.CompletedProcess[str]:
    code = "from freeflyer.cli.main import call\nsys.exit(call(sys.argv[1:]))"
    return without(packages, code, folder, *arguments)


# The declarations.


def packages_of(requirements: list[str]) -> set[str]:
    """Return the import names of the requirements."""
    names = [re.split(r"[<>=\[ ]", requirement)[0] for requirement in requirements]
    return {IMPORTED_AS.get(name, name.replace("-", "_")) for name in names}


CORE = packages_of(PROJECT["dependencies"])


def test_the_extras_are_those_of_the_distribution() -> None:
    declared = PROJECT["optional-dependencies"]
    for extra, packages in EXTRAS.items():
        own = {package for package in packages if package not in BROUGHT_ALONG}
        assert packages_of(declared[extra]) == own, extra
        assert not CORE & set(packages), extra
    assert len(set(EVERYTHING)) == len(EVERYTHING)
    assert declared["all"] == [f"freeflyer-cosim[{','.join(sorted(EXTRAS))}]"]
    assert "freeflyer-cosim[all]" in declared["test"]


def modules() -> Iterator[tuple[str, ast.Module]]:
    for root in ("cosim", "fmu_src", "adapters"):
        (package,) = (path for path in (ROOT / root).iterdir() if (path / "__init__.pyi").is_file())
        for path in package.rglob("*.py"):
            name = ".".join(path.relative_to(ROOT / root).with_suffix("").parts)
            yield name, ast.parse(path.read_text(encoding="utf-8"))


def third_party(tree: ast.Module) -> set[str]:
    """Return the top-level names of the third-party packages that a module imports."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.add(node.module.partition(".")[0])
    ours = {"freeflyer", "freeflyer_adapters", "freeflyer_fmus"}
    return found - ours - sys.stdlib_module_names


def test_every_import_belongs_to_the_core_or_to_the_extra_of_its_module() -> None:
    imported: dict[str, set[str]] = {package: set() for package in USES}
    for name, tree in modules():
        package = max((p for p in USES if f"{name}.".startswith(f"{p}.")), key=len)
        allowed = {module for extra in USES[package] for module in EXTRAS[extra]}
        packages = third_party(tree)
        assert packages <= CORE | allowed, name
        imported[package] |= packages
    # Nothing is declared that its users do not import.
    core = set().union(*(found for p, found in imported.items() if "hil" not in USES[p]))
    assert core >= CORE
    assert set().union(*imported.values()) >= set(EVERYTHING) - PROGRAMS


# The exception.


def test_a_missing_extra_is_an_error_of_this_project_and_an_import_error() -> None:
    message = re.escape(sentence("this", "hil"))
    with pytest.raises(MissingExtra, match=message) as caught, needed_by("this"):
        raise ModuleNotFoundError("No module named 'zenoh'", name="zenoh")
    assert isinstance(caught.value, CosimError)
    assert isinstance(caught.value, ImportError)
    assert caught.value.name == "zenoh"
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("name", ["numpy", "can.io.no_such_format", None])
def test_another_missing_module_is_no_missing_extra(name: str | None) -> None:
    """A module that is missing in an installed package is an error of that package."""
    with pytest.raises(ModuleNotFoundError) as caught, needed_by("this"):
        raise ModuleNotFoundError("not found", name=name)
    assert not isinstance(caught.value, MissingExtra)


def test_installed_packages_are_not_reported_as_missing() -> None:
    require("this", EXTRAS["export"])


def test_the_compiler_is_reported_as_missing_before_it_is_started(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "ziglang", None)
    with pytest.raises(MissingExtra, match="the compiler of FMUs needs the extra export: "):
        compiler.compiler(compiler.host_platform())


# The commands.

LATE_WRENCH = str(ROOT / "tests" / "data" / "late_wrench.py")
COMMANDS = [
    ("export", ("casadi",), "freeflyer fmus", ["fmus"]),
    ("export", ("pinocchio",), "freeflyer fmus --robot", ["fmus", "--robot", "lwr4_redundant"]),
    ("export", ("ziglang",), "freeflyer fmus", ["fmus", "--block", LATE_WRENCH]),
    ("hil", EXTRAS["hil"], "freeflyer hil", ["hil", "facility"]),
    ("hil", EXTRAS["hil"], "freeflyer facility", ["facility", "facility"]),
    ("hil", EXTRAS["hil"], "freeflyer certificates", ["certificates", "certificates"]),
    ("hil", EXTRAS["hil"], "freeflyer recover", ["recover", "."]),
    ("hil", ("zenoh",), "freeflyer hil", ["hil", "facility", "--accelerated"]),
    ("hil", ("mcap",), "freeflyer reproduce --real-time", ["reproduce", "--real-time"]),
    ("sweep", EXTRAS["sweep"], "freeflyer sweep", ["sweep", "stability_map"]),
    ("sweep", ("distributed",), "freeflyer sweep", ["sweep", "battery"]),
]


@pytest.mark.parametrize(
    ("extra", "packages", "subject", "arguments"),
    COMMANDS,
    ids=[f"{subject} without {packages[0]}" for _, packages, subject, _ in COMMANDS],
)
def test_a_command_without_its_extra_ends_with_one_sentence_and_writes_nothing(
    extra: str, packages: tuple[str, ...], subject: str, arguments: list[str], tmp_path: Path
) -> None:
    done = command(packages, tmp_path, *arguments)
    assert done.stderr == f"freeflyer: {sentence(subject, extra)}\n"
    assert done.returncode == 2
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("extra", "component", "kind"),
    [
        ("export", "arm_drive", "twin"),
        ("hil", "arm_drive", "can_arm"),
        ("hil", "arm_drive", "cia402_arm"),
        ("hil", "base_robot", "zenoh_base"),
    ],
)
def test_a_kind_of_component_without_its_extra_is_reported(
    extra: str, component: str, kind: str, tmp_path: Path
) -> None:
    (tmp_path / "own.toml").write_text(
        f'extends = "facility"\n[components.{component}]\nkind = "{kind}"\n'
    )
    done = command(EXTRAS[extra], tmp_path, "run", "own.toml")
    wanted = sentence(f"component {component} of kind {kind!r}", extra)
    assert done.stderr == f"freeflyer: {wanted}\n"
    assert done.returncode == 2


def test_a_users_file_that_needs_an_extra_is_named(tmp_path: Path) -> None:
    (tmp_path / "push.py").write_text("import casadi\n")
    (tmp_path / "own.toml").write_text(
        'extends = "facility"\n[components.arm_drive]\nkind = "python"\nobject = "push.py:push"\n'
    )
    done = command(("casadi",), tmp_path, "run", "own.toml")
    assert done.stderr == f"freeflyer: component arm_drive: {sentence('push.py:push', 'export')}\n"
    assert done.returncode == 2


def test_the_core_alone_runs_scenarios_and_loads_the_other_commands(tmp_path: Path) -> None:
    """`test_core_install` runs all commands of the core in an environment without extras."""
    code = """\
from freeflyer.cli.main import call
assert call(["run", "continuous", "--set", "stop_s=0.01", "--out", "run"]) == 0
assert call(["export", "multirate_passive", "--out", "loop.ssp"]) == 0
import freeflyer.analysis.audit.figure, freeflyer.cli.predict, freeflyer.paper.reproduce
from freeflyer_adapters.device import simulated
"""
    done = without(EVERYTHING, code, tmp_path)
    assert done.returncode == 0, done.stderr


# The public names.

NAMES = """\
from importlib import import_module
from freeflyer.foundation.errors import CosimError
for name in sys.argv[1:]:
    package, _, attribute = name.partition(".")
    try:
        getattr(import_module(package), attribute)
    except ImportError as error:
        assert isinstance(error, CosimError), error
        print(error)
    else:
        print("loaded")
"""


def test_a_public_name_without_its_extra_is_an_import_error_of_one_sentence(tmp_path: Path) -> None:
    names = [f"{package.__name__}.{name}" for package in PACKAGES for name in package.__all__]
    done = without(EVERYTHING, NAMES, tmp_path, *names)
    assert done.returncode == 0, done.stderr
    shown = dict(zip(names, done.stdout.splitlines(), strict=True))
    for name, line in shown.items():
        assert line in {"loaded", *(sentence(name, extra) for extra in EXTRAS)}
    assert shown["freeflyer.load"] == shown["freeflyer_adapters.Device"] == "loaded"
    assert shown["freeflyer.sweep"] == sentence("freeflyer.sweep", "sweep")
    assert shown["freeflyer_fmus.Block"] == sentence("freeflyer_fmus.Block", "export")
    assert shown["freeflyer_adapters.read_recording"] == sentence(
        "freeflyer_adapters.read_recording", "hil"
    )


METHODS = """\
import freeflyer as ff
from freeflyer_adapters import VirtualFacility
from freeflyer.foundation.extras import MissingExtra
result = ff.run("multirate_passive", {"stop_s": 0.01})
for call in (lambda: result.record.to_xarray(), lambda: VirtualFacility().__enter__()):
    try:
        call()
    except MissingExtra as error:
        print(error)
"""


def test_a_method_without_its_extra_raises_the_sentence(tmp_path: Path) -> None:
    done = without(EVERYTHING, METHODS, tmp_path)
    assert done.stdout.splitlines() == [
        sentence("Record.to_xarray", "analysis"),
        sentence("VirtualFacility", "hil"),
    ], done.stderr


def test_import_from_a_package_without_its_extra_raises_the_sentence(tmp_path: Path) -> None:
    done = without(EXTRAS["export"], "from freeflyer_fmus import Block", tmp_path)
    assert done.stderr.splitlines()[-1] == (
        f"freeflyer.foundation.extras.MissingExtra: {sentence('freeflyer_fmus.Block', 'export')}"
    )
