"""No command executes code of the working directory in place of an installed module."""

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
    """A working directory with folders named like modules. Each writes a file if executed."""
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


def test_fmus_executes_no_folder_of_the_working_directory(hostile: Path) -> None:
    (hostile / "lag.py").write_text(BLOCK)
    freeflyer(hostile, "fmus", "--block", "lag.py")
    assert (hostile / "fmus/fmi3/lag.fmu").is_file()


def test_hil_executes_no_folder_of_the_working_directory(hostile: Path) -> None:
    freeflyer(hostile, "hil", "facility", "--simulated", "--view", "--set", "stop_s=0.3")
    assert (hostile / "freeflyer_out/hil_facility/recording.mcap").is_file()


@pytest.mark.slow
def test_sweep_executes_no_folder_of_the_working_directory(hostile: Path) -> None:
    (hostile / "two.toml").write_text(SWEEP)
    freeflyer(hostile, "sweep", "./two.toml", "--set", "stop_s=0.1", "--workers", "1")
    assert (hostile / "freeflyer_out/two/results.parquet").is_file()


def test_a_sweep_called_by_a_script_executes_no_folder_and_restores_the_environment(
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


def test_the_real_time_part_of_reproduce_executes_no_folder_of_the_working_directory(
    hostile: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(hostile)
    result = real_time.run(
        scenario.load("facility"), hostile / "out", [*PATIENT_FACILITY, *PATIENT_LOOP, "stop_s=0.2"]
    )
    assert result.outcome.simulated == 0.2


@pytest.mark.slow
def test_reproduce_with_its_real_time_part_executes_no_folder_of_the_working_directory(
    hostile: Path,
) -> None:
    # 3: a shared machine may suspend a loop until a watchdog stops it. This test does not check it.
    freeflyer(hostile, "reproduce", "--real-time", "--out", "out", codes=(0, 3))
    for case in real_time.CASES:
        assert (hostile / "out" / f"{case}_real_time" / "record.parquet").is_file()
    assert (hostile / "out" / "report.html").is_file()


def test_every_python_child_process_starts_without_the_working_directory() -> None:
    found = 0
    for path in (
        path for root in ("cosim", "fmu_src", "adapters") for path in (ROOT / root).rglob("*.py")
    ):
        for after in re.findall(r"sys\.executable,?\s*(.{0,4})", path.read_text(encoding="utf-8")):
            assert after == '"-P"', path
            found += 1
    assert found >= 4
