"""Commands without a home directory, as in a service or a container: no warning and no error."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from freeflyer.foundation import home

BLOCK = """
from freeflyer_fmus import Block
def block(robot):
    block = Block("lag", "A first-order lag")
    u = block.input("u", 0.0, "1", "In")
    x = block.state("x", 0.0, "1", "Out")
    block.derivative("x", u - x)
    return block
"""
VARIABLES = ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "ZIG_GLOBAL_CACHE_DIR", "MPLCONFIGDIR")


@pytest.fixture
def environment(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    for variable in VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    return monkeypatch


@pytest.mark.parametrize("place", ["/proc", "/nonexistent/home", __file__])
def test_without_a_home_the_caches_are_temporary(
    environment: pytest.MonkeyPatch, place: str
) -> None:
    environment.setenv("HOME", place)
    home.give_matplotlib_a_folder()
    assert home.cache_of_zig() == os.environ["MPLCONFIGDIR"] == home._kept()
    assert Path(home._kept()).is_dir()
    assert not Path("/nonexistent").exists()


def test_with_a_home_the_caches_are_the_usual_ones(
    environment: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    environment.setenv("HOME", str(tmp_path))
    home.give_matplotlib_a_folder()
    assert "MPLCONFIGDIR" not in os.environ
    assert home.cache_of_zig() == str(tmp_path / ".cache" / "zig")
    assert not list(tmp_path.iterdir())  # nothing is made in advance


def test_given_caches_are_used(environment: pytest.MonkeyPatch, tmp_path: Path) -> None:
    environment.setenv("HOME", "/proc")
    environment.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert home.cache_of_zig() == str(tmp_path / "cache" / "zig")
    environment.setenv("ZIG_GLOBAL_CACHE_DIR", "own")
    assert home.cache_of_zig() == "own"
    environment.setenv("MPLCONFIGDIR", "own")
    home.give_matplotlib_a_folder()
    assert os.environ["MPLCONFIGDIR"] == "own"


def run_alone(tmp_path: Path, *arguments: str, **variables: str) -> None:
    (tmp_path / "block.py").write_text(BLOCK)
    done = subprocess.run(
        [sys.executable, "-m", "freeflyer.cli.main", *arguments],
        cwd=tmp_path,
        env={key: value for key, value in os.environ.items() if key not in VARIABLES} | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_a_run_and_an_export_need_no_home(tmp_path: Path) -> None:
    run_alone(tmp_path, "run", "multirate_passive", "--set", "stop_s=0.1", HOME="/proc")
    run_alone(tmp_path, "export", "multirate_passive", "--out", "system.ssp")


@pytest.mark.slow
@pytest.mark.parametrize("variables", [{}, {"HOME": "/proc"}, {"HOME": "/nonexistent"}], ids=str)
def test_a_build_and_figures_need_no_home(tmp_path: Path, variables: dict[str, str]) -> None:
    run_alone(tmp_path, "fmus", "--block", "block.py", "--out", "fmus", **variables)
    assert (tmp_path / "fmus" / "fmi2" / "lag.fmu").is_file()
    run_alone(tmp_path, "predict", "multirate_unstable", "--out", "prediction", **variables)
    assert (tmp_path / "prediction" / "prediction.png").is_file()
