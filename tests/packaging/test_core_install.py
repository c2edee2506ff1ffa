"""Installation of the built wheel: the core alone, and with all extras.

`pytest -n 0 -m slow tests/packaging/test_core_install.py` prints the size and the time of both
installations. pip downloads the dependencies.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from wheels import built, run, sdist_unpacked

from freeflyer.foundation.extras import EXTRAS

pytestmark = pytest.mark.slow
ENVIRONMENT = {
    name: value
    for name, value in os.environ.items()
    if not name.startswith("PYTHON") and name != "VIRTUAL_ENV"
}
"""Without PYTHONPATH: the interpreters of the new environments import only what is installed."""
NEEDS = {
    "hil": ["hil facility --accelerated", "facility facility", "certificates new", "recover ."],
    "export": ["fmus --out new"],
    "sweep": ["sweep stability_map --out new"],
}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("built")
    return built("wheel", sdist_unpacked(folder), folder / "wheel", fmus=True)


@pytest.fixture
def environment(tmp_path: Path) -> Iterator[Path]:
    """Yield a new virtual environment. It is removed afterwards: two of them have several GB."""
    folder = tmp_path / "venv"
    run(sys.executable, "-P", "-m", "venv", "--without-pip", str(folder), folder=tmp_path)
    yield folder
    shutil.rmtree(folder)


def pip(environment: Path, *arguments: str) -> str:
    command = [sys.executable, "-P", "-m", "pip", "--python", str(environment / "bin/python")]
    return run(*command, "--disable-pip-version-check", *arguments, folder=environment.parent, timeout=1800.0)  # fmt: skip


def installed(environment: Path, requirement: str) -> str:
    """Install a requirement. Return the time of the installation, and the size on the disk."""
    start = time.monotonic()
    pip(environment, "install", "--quiet", requirement)
    seconds = time.monotonic() - start
    paths = [path for path in environment.rglob("*") if not path.is_symlink()]
    megabytes = sum(512 * path.stat().st_blocks for path in paths) / 1e6
    return f"{megabytes:.0f} MB, {seconds:.0f} s"


def freeflyer(environment: Path, arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(environment / "bin/freeflyer"), *arguments.split()],
        cwd=environment.parent,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )


def test_the_core_alone_runs_audits_predicts_and_reproduces(
    wheel: Path, environment: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = installed(environment, str(wheel))
    with capsys.disabled():
        print(f"\npip install of the core: {figures}")
    for arguments in (
        "run multirate_passive --set stop_s=2 --out run",
        "run continuous --fmi 3 --set stop_s=1 --out me",
        "audit run",
        "predict multirate_unstable",
        "check robust",
        "export multirate_passive --out loop.ssp",
        "run loop.ssp --out ssp",
        "reproduce --out reproduce",
    ):
        done = freeflyer(environment, arguments)
        assert done.returncode == 0, (arguments, done.stderr)
    assert (environment.parent / "reproduce" / "report.html").is_file()
    read = "import pandas; print(pandas.read_parquet('run/record.parquet').attrs['units']['time'])"
    found = run(str(environment / "bin/python"), "-I", "-c", read, folder=environment.parent)
    assert found == "s\n"
    example = Path(__file__).parents[2] / "examples" / "two_periods.py"
    run(str(environment / "bin/python"), "-I", str(example), folder=environment.parent)
    assert (environment.parent / "two_periods.png").stat().st_size > 10_000
    # Other commands report the extra that they need.
    for extra, commands in NEEDS.items():
        for arguments in commands:
            name = arguments.partition(" ")[0]
            done = freeflyer(environment, arguments)
            sentence = (
                f"freeflyer {name} needs the extra {extra}: pip install 'freeflyer-cosim[{extra}]'"
            )
            assert (done.returncode, done.stderr) == (2, f"freeflyer: {sentence}\n")
    assert not (environment.parent / "new").exists()
    # The command in the message installs the extra beside the installed wheel.
    pip(environment, "install", "--quiet", "freeflyer-cosim[sweep]")
    assert freeflyer(environment, "sweep --help").returncode == 0


def test_the_extra_all_installs_every_extra(
    wheel: Path, environment: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = installed(environment, f"{wheel}[all]")
    with capsys.disabled():
        print(f"\npip install of all extras: {figures}")
    pip(environment, "check")
    found = "from importlib.util import find_spec\nimport sys\nprint(*(n for n in sys.argv[1:] if find_spec(n)))"
    packages = [package for extra in EXTRAS.values() for package in extra]
    shown = run(
        str(environment / "bin/python"), "-I", "-c", found, *packages, folder=environment.parent
    )
    assert shown.split() == packages
    done = freeflyer(environment, "hil facility --accelerated --set stop_s=1 --out hil")
    assert done.returncode == 0, done.stderr
