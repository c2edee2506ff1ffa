"""No command executes a folder of the working directory in the place of a module that it starts as a process of its own."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from processes import PATIENT_FACILITY, PATIENT_LOOP

from freeflyer.paper import real_time
from freeflyer.scenario import scenario

ROOT = Path(__file__).parents[2]
NAMES = (
    "freeflyer",
    "freeflyer_fmus",
    "freeflyer_adapters",
    "ziglang",
    "multiprocessing",
    "cosim",
    "adapters",
)
BLOCK = """\
from freeflyer_fmus import Block


def block(robot):
    b = Block("lag", "First-order lag")
    x = b.state("x", 0.0, "m", "Position")
    b.derivative("x", -x)
    return b
"""
SWEEP = 'scenario = "multirate_passive"\n[grid]\n"base_controller.period" = [0.1, 0.2]\n'


@pytest.fixture
def hostile(tmp_path: Path) -> Iterator[Path]:
    """A working directory with folders that have the names of what the commands start; if one is executed, it leaves a trace."""
    for name in NAMES:
        (tmp_path / name).mkdir()
        code = f"open({str(tmp_path / 'executed')!r}, 'a').write(__name__)\nraise SystemExit(99)\n"
        for module in ("__init__.py", "__main__.py", "command.py"):
            (tmp_path / name / module).write_text(code)
    yield tmp_path
    assert not (tmp_path / "executed").exists(), (tmp_path / "executed").read_text()


def freeflyer(folder: Path, *arguments: str, codes: tuple[int, ...] = (0,)) -> None:
    command = [str(Path(sys.executable).with_name("freeflyer")), *arguments]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, timeout=400
    )
    assert done.returncode in codes, done.stdout + done.stderr


def test_no_folder_of_the_working_directory_is_executed_by_fmus(hostile: Path) -> None:
    (hostile / "lag.py").write_text(BLOCK)
    freeflyer(hostile, "fmus", "--block", "lag.py")
    assert (hostile / "fmus/fmi3/lag.fmu").is_file()


def test_no_folder_of_the_working_directory_is_executed_by_hil(hostile: Path) -> None:
    freeflyer(hostile, "hil", "facility", "--simulated", "--view", "--set", "stop_s=0.3")
    assert (hostile / "freeflyer_out/hil_facility/recording.mcap").is_file()


@pytest.mark.slow
def test_no_folder_of_the_working_directory_is_executed_by_sweep(hostile: Path) -> None:
    (hostile / "two.toml").write_text(SWEEP)
    freeflyer(hostile, "sweep", "./two.toml", "--set", "stop_s=0.1", "--workers", "1")
    assert (hostile / "freeflyer_out/two/results.parquet").is_file()


def test_a_sweep_that_a_script_calls_executes_none_either_and_leaves_the_environment_as_it_was(
    hostile: Path,
) -> None:
    (hostile / "two.toml").write_text(SWEEP)
    code = "import os; from freeflyer.cli.main import call\nif __name__ == '__main__':\n    before = dict(os.environ)\n"
    code += (
        "    assert call(['sweep', './two.toml', '--set', 'stop_s=0.1', '--workers', '1']) == 0\n"
    )
    code += "    assert os.environ.get('PYTHONSAFEPATH') is before.get('PYTHONSAFEPATH') is None\n"
    (hostile / "elsewhere").mkdir()
    (hostile / "elsewhere" / "script.py").write_text(code)
    done = subprocess.run(
        [sys.executable, "elsewhere/script.py"],
        cwd=hostile,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr


def test_no_folder_of_the_working_directory_is_executed_by_the_real_time_part_of_reproduce(
    hostile: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(hostile)
    result = real_time.run(
        scenario.load("facility"), hostile / "out", [*PATIENT_FACILITY, *PATIENT_LOOP, "stop_s=0.2"]
    )
    assert result.outcome.simulated == 0.2


@pytest.mark.slow
def test_no_folder_of_the_working_directory_is_executed_by_reproduce_with_its_real_time_part(
    hostile: Path,
) -> None:
    # 3: a shared machine may hold a loop up until a watchdog stops it, three times; that is not what this test is about.
    freeflyer(hostile, "reproduce", "--real-time", "--out", "out", codes=(0, 3))
    for case in real_time.CASES:
        assert (hostile / "out" / f"{case}_real_time" / "record.parquet").is_file()
    assert (hostile / "out" / "report.html").is_file()


def test_every_python_child_is_started_without_the_working_directory() -> None:
    found = 0
    for path in (
        path for root in ("cosim", "fmu_src", "adapters") for path in (ROOT / root).rglob("*.py")
    ):
        for after in re.findall(r"sys\.executable,?\s*(.{0,4})", path.read_text(encoding="utf-8")):
            assert after == '"-P"', path
            found += 1
    assert found >= 4
