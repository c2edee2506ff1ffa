"""Errors of users: one line with subject, got and expected; exit code 2 or 3; no traceback."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pandas
import pytest
from commands import run_command

from freeflyer.cli import main as command


def scenario_file(directory: Path, text: str, base: str | None = "multirate_passive") -> str:
    path = directory / "mine.toml"
    path.write_text((f'extends = "{base}"\n' if base else "") + text)
    return str(path)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "base_controler.period=0.1",
            "no component 'base_controler'; did you mean 'base_controller'",
        ),
        ("base_controller.perod=0.1", "no parameter 'perod'; did you mean 'period'"),
        (
            "base_controller.period=fast",
            "base_controller.period is 'fast'; a number in s is expected",
        ),
        ("base_controller.period=0.1 parsec", "unit 'parsec' cannot be converted to 's'"),
        ("base_controller.period=0.1 foo_", "unit 'foo_' is not known"),
        ("base_controller.period=nan", "finite numbers are expected"),
        ("robot.base_mass=1e300 Gt", "base_mass is 1e+300 Gt; finite numbers are expected"),
        ("robot.base_mass='=free_flyer'", "is '=free_flyer'; '=COMPONENT.PARAMETER' is expected"),
        ("robot.base_mass={first=1}", "base_mass has 1 in 'first'; a list of 1 to 1 values"),
        ("robot.base_mass={csv=1}", "base_mass is { csv = 1 }; { value = ..., unit = ... }"),
        (
            "manipulator_controller.base_passivity_control=5 ms",
            "base_passivity_control is 5 ms; true or false is expected",
        ),
        ("base_controller.period=inf", "finite numbers are expected"),
        ("base_controller.period=-1", "is -1.0 s; a time greater than zero"),
        (
            "base_controller.period=0.0025",
            "step of 0.0025 s is not a multiple of the smallest step, 0.001 s; 0.002 s or 0.003 s would fit",
        ),
        (
            "base_controller.stiffness=[1,2,3]",
            "base_controller.stiffness has 3 values; 6 are expected",
        ),
        ("base_controller.stiffness=true", "6 numbers"),
        (
            "manipulator_controller.observer=prot",
            "one of paper, port, tracking, reference is expected; did you mean 'port'",
        ),
        (
            "manipulator_controller.observer=7",
            "one of paper, port, tracking, reference is expected",
        ),
        ("manipulator_controller.base_passivity_control=1", "true or false is expected"),
        ("base_controller.base_wrench=1", "cannot be set: it is a computed output"),
        ("free_flyer.base_mass=-3", "base_mass is -3; more than 0 is expected"),
        ("free_flyer.base_orientation=[0,0,0,0]", "squared norm of base_orientation is 0"),
        ("nonsense", "COMPONENT.PARAMETER=VALUE is expected"),
        ("base_controller.period='=base_controller.period'", "refers to itself"),
    ],
)
def test_an_invalid_override_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, override: str, message: str
) -> None:
    code, error = run_command(
        capsys, "run", "multirate_passive", "--set", override, "--out", str(tmp_path / "out")
    )
    assert message in error
    assert code == 2
    assert not list((tmp_path / "out").glob("*.json"))


def test_a_singular_start_posture_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code, error = run_command(
        capsys,
        "run",
        "multirate_passive",
        "--set",
        "free_flyer.joint_position=[0,0,0,0,0,0]",
        "--out",
        str(tmp_path),
    )
    assert code == 2
    assert "manipulator_controller" in error
    assert "smallest singular value of J_m is" in error
    assert "at least 0.02 is expected" in error


def test_a_singular_jacobian_stops_the_run_and_keeps_the_record(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    override = "reference_trajectory.translation_amplitude=[0.9, 0, 0]"
    code, error = run_command(
        capsys, "run", "multirate_passive", "--set", override, "--out", str(tmp_path)
    )
    assert code == 3
    assert "the run diverged at" in error
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["diverged"]
    assert "singular value of J_m" in summary["cause"] or "too fast" in summary["cause"]
    assert len(pandas.read_parquet(tmp_path / "record.parquet")) > 10


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stop = 3\n", "unknown key 'stop' in the scenario; did you mean 'stop_s'"),
        (
            "[componets.x]\nstep_s=1\n",
            "unknown key 'componets' in the scenario; did you mean 'components'",
        ),
        ("stop_s = 'long'\n", "stop_s is 'long'; a number of seconds is expected"),
        ("stop_s = 0.3333333333\n", "0.3333333333 s; a whole number of nanoseconds is expected"),
        ("expect = 'glory'\n", "expect is 'glory'"),
        ("[components.extra]\nfmu='free_flyer'\n", "component extra has no step_s"),
        (
            "[components.extra]\nfmu='free_flier'\nstep_s=0.001\n",
            "no FMU 'free_flier' is shipped for FMI 2; did you mean 'free_flyer'",
        ),
        (
            "[components.extra]\nfmu='free_flyer'\nfmi=1\nstep_s=0.001\n",
            "fmi is 1; 2 or 3 is expected",
        ),
        (
            "[components.extra]\nkind='fnu'\nstep_s=0.001\n",
            "there is no kind 'fnu'; did you mean 'fmu'",
        ),
        (
            "[components.extra]\nfmu='free_flyer'\nstep_s=0.001\nparametres={a=1}\n",
            "unknown key 'parametres'; did you mean 'parameters'",
        ),
        ("[components.extra]\nfmu='there/is/none.fmu'\nstep_s=0.001\n", "does not exist"),
        (
            "[components.extra]\nkind='python'\nobject='none.py:x'\nstep_s=0.001\n",
            "none.py does not exist",
        ),
        (
            "[components.extra]\nkind='twin'\nblock='free_flier'\nstep_s=0.001\n",
            "there is no block 'free_flier'",
        ),
        (
            "delayed = ['base_controller.base_wrench => x.y']\n",
            "'COMPONENT.OUTPUT -> COMPONENT.INPUT, ...' is expected",
        ),
        (
            "[robot]\nbase_mas = 100\n",
            "[robot]: no component has a parameter 'base_mas'; did you mean 'base_mass'",
        ),
        ("[errors]\nhand = ['a', 'b']\n", "errors.hand"),
        (
            "[[limits]]\nsignal = 'free_flyer.base_velocity'\nminimum = 0.1\nnorm = 'euclidean'\n",
            "'norm' applies to a 'maximum'",
        ),
        (
            "[components.free_flyer]\nstep_s = { value = true, unit = 's' }\n",
            "step_s is true s; seconds, a time with a unit such as '20 ms', or '=PARAMETER' is expected",
        ),
        ("[record]\nevery_s = 0.0015\n", "the recording interval of 0.0015 s is not a multiple"),
        ("stop_s = \n", "is not valid TOML"),
        (
            "[[limits]]\nsignal = 'free_flyer.base_speed'\nmaximum = 1.0\n",
            "no variable 'base_speed'; did you mean",
        ),
    ],
)
def test_an_invalid_scenario_file_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, message: str
) -> None:
    code, error = run_command(
        capsys, "run", scenario_file(tmp_path, text), "--out", str(tmp_path / "out")
    )
    assert message in error
    assert code == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[[limits]]\nsignal='free_flyer.base_velocity'\nmaximum=1.0\nelements=['a','b']\n",
            "[first, last], counted from 1, is expected",
        ),
        (
            "[[limits]]\nsignal='free_flyer.base_velocity'\nmaximum=1.0\nelements=[0,3]\n",
            "[first, last], counted from 1, is expected",
        ),
        (
            "[[limits]]\nsignal='free_flyer.base_velocity'\nmaximum=1.0\nelements=[7,9]\n",
            "elements 7 to 9 are watched, but the signal has 6",
        ),
        (
            "[[limits]]\nsignal='free_flyer.base_velocity'\nmaximum=1.0\nminimum=0.0\n",
            "either a 'maximum' or a 'minimum'",
        ),
        (
            "[[limits]]\nsignal='free_flyer.base_velocity'\nminimum=nan\n",
            "nan; a number is expected",
        ),
        (
            "[errors]\nbase_position=['free_flyer.base_positon','base_controller.position_setpoint']\n",
            "no variable 'base_positon'; did you mean",
        ),
        (
            "[errors]\nx_orientation=['free_flyer.base_position','base_controller.position_setpoint']\n",
            "has 3 elements; 4 are expected",
        ),
        (
            "[observed_energy]\nbase='manipulator_controller.base_observed_enrgy'\n",
            "no variable 'base_observed_enrgy'; did you mean",
        ),
        ("stop_s = 1e9\n", "needs "),
        (
            "[components.free_flyer]\nkind='twin'\nblok='free_flyer'\n",
            "unknown key 'blok'; did you mean 'block'",
        ),
        (
            "[components.free_flyer.parameters]\nbase_mass='=base_controller.period'\n",
            "units differ: kg and s",
        ),
        (
            "[components.base_controller.parameters]\nbase_position=[1,0,0]\n",
            "it is driven by the connection from free_flyer.base_position",
        ),
        (
            "[components.'x.y']\nstep_s=0.001\n",
            "a name of letters, digits and underscores is expected",
        ),
        (
            "[components.base_controller]\nstep_s=0.5\n",
            "passes over a sample of this block, whose period is 0.3 s",
        ),
        ("[components.free_flyer]\nsamples='yes'\n", "samples is 'yes'; true or false is expected"),
        (
            "[components.extra]\nkind='python'\nobject='builtins:exit'\nstep_s=0.001\n",
            "cannot be used: SystemExit",
        ),
        (
            "[components.extra]\nkind='python'\nobject='builtins:str'\nstep_s=0.001\n",
            "returned a str; a component is expected",
        ),
    ],
)
def test_a_scenario_file_with_an_error_in_its_contents_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, message: str
) -> None:
    code, error = run_command(
        capsys, "run", scenario_file(tmp_path, text), "--out", str(tmp_path / "out")
    )
    assert message in error
    assert code == 2


def test_a_failure_does_not_count_as_the_expected_divergence(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "failing.py").write_text(
        "from freeflyer.fmi.component import Port, PythonComponent\n"
        "class Failing(PythonComponent):\n"
        "    def __init__(self, name):\n"
        "        super().__init__(name, [Port(name='y', size=1, causality='output', units=('m',))])\n"
        "    def advance(self, time, size):\n"
        "        if time > 1.05:\n"
        "            raise RuntimeError('boom')\n"
    )
    text = "[components.failing]\nkind='python'\nobject='failing.py:Failing'\nstep_s=0.1\n"
    code, error = run_command(
        capsys,
        "run",
        scenario_file(tmp_path, text, "multirate_unstable"),
        "--out",
        str(tmp_path / "out"),
    )
    assert code == 3
    assert "the run stopped at 1.1 s: failing: RuntimeError: boom (" in error
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["failed"], summary["diverged"]) == (True, False)


def test_one_connection_can_be_replaced(tmp_path: Path) -> None:
    from freeflyer.scenario import scenario as scenarios

    mine = scenario_file(
        tmp_path,
        'connections = ["free_flyer.base_position -> base_controller.base_position"]\ndelayed = ["manipulator_controller.base_damping -> base_controller.base_damping"]\n',
    )
    before, after = (
        scenarios.load("multirate_passive").connections,
        scenarios.load(mine).connections,
    )
    assert len(before) == len(after)
    assert [c.delayed for c in after if c.target == "base_controller.base_damping"] == [True]


def test_a_broken_pipe_does_not_stop_the_run(tmp_path: Path) -> None:
    scenario = scenario_file(tmp_path, "stop_s = 1.2\n")
    command = f"{sys.executable} -m freeflyer.cli.main run {scenario} --out {tmp_path / 'out'} | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "out" / "summary.json").is_file()


def test_the_result_table_contains_units(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert (
        command.call(
            [
                "run",
                scenario_file(tmp_path, "stop_s = 1.2\ntitle = '[/bold] odd'\n"),
                "--out",
                str(tmp_path / "out"),
            ]
        )
        == 0
    )
    shown = capsys.readouterr().out
    assert "end effector position error [m]" in shown
    assert "[deg]" in shown
    assert "[/bold] odd" in shown


def test_a_missing_scenario_is_rejected(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert (
        "there is no scenario 'multirate_pasive': neither a shipped one nor a .toml file; did you mean 'multirate_passive'"
        in run_command(capsys, "run", "multirate_pasive")[1]
    )
    assert "does not exist" in run_command(capsys, "run", "nowhere.toml")[1]
    loop = tmp_path / "loop.toml"
    loop.write_text('extends = "loop.toml"\n')
    code, error = run_command(capsys, "run", str(loop))
    assert (code, "extends itself" in error) == (2, True)


def test_a_scenario_with_an_algebraic_loop_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code, error = run_command(
        capsys,
        "run",
        scenario_file(
            tmp_path,
            'delayed = []\nconnections = ["manipulator_controller.base_damping -> base_controller.base_damping", "base_controller.base_wrench -> manipulator_controller.applied_base_wrench"]\n',
        ),
        "--out",
        str(tmp_path / "out"),
    )
    assert code == 2
    assert "algebraic loop: " in error
    assert "manipulator_controller" in error


def fmu_with(tmp_path: Path, fmus: Path, change: object) -> Path:
    """Copy the reference FMU; `change` may rewrite, rename or drop its entries."""
    path = tmp_path / "changed.fmu"
    with (
        zipfile.ZipFile(fmus / "fmi2" / "reference_trajectory.fmu") as old,
        zipfile.ZipFile(path, "w") as new,
    ):
        for name in old.namelist():
            entry = change(name, old.read(name))  # type: ignore[operator]
            if entry is not None:
                new.writestr(*entry)
    return path


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda n, d: None if n.endswith(".xml") else (n, d),
            "is not an FMU: it contains no modelDescription.xml",
        ),
        (
            lambda n, d: None if n.startswith("binaries") else (n, d),
            "has no binary for this platform",
        ),
        (
            lambda n, d: (n.replace("linux64", "win64"), d),
            "has no binary for this platform (linux64); it has binaries for win64",
        ),
        (
            lambda n, d: (n, d.replace(b'fmiVersion="2.0"', b'fmiVersion="1.0"')),
            "is of FMI version 1.0; FMI 2.0 and FMI 3.0 are supported",
        ),
        (
            lambda n, d: (n, d.replace(b"<CoSimulation", b"<CoSimulacrum")),
            "has an invalid modelDescription.xml",
        ),
        (lambda n, d: (n, d.replace(b'guid="{', b'guid="{0')), "cannot be instantiated"),
        (
            lambda n, d: ("../evil.so" if n.startswith("binaries") else n, d),
            "points outside the archive",
        ),
        (
            lambda n, d: (n, b"not a library" if n.startswith("binaries") else d),
            "cannot be instantiated",
        ),
    ],
)
def test_an_unusable_fmu_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, fmus: Path, change: object, message: str
) -> None:
    if sys.platform != "linux":
        pytest.skip("the altered archives are those of Linux")
    path = fmu_with(tmp_path, fmus, change)
    code, error = run_command(
        capsys,
        "run",
        scenario_file(tmp_path, f"[components.extra]\nfmu='{path.name}'\nstep_s=0.001\n"),
        "--out",
        str(tmp_path / "out"),
    )
    assert message in error
    assert code == 2


def test_a_file_that_is_no_archive_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "x.fmu").write_text("hello")
    code, error = run_command(
        capsys, "run", scenario_file(tmp_path, "[components.extra]\nfmu='x.fmu'\nstep_s=0.001\n")
    )
    assert (code, "it is not a zip archive" in error) == (2, True)


def test_an_output_directory_that_cannot_be_created_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    code, error = run_command(
        capsys, "run", "multirate_passive", "--out", str(tmp_path / "file" / "below")
    )
    assert code == 2
    assert f"cannot be used: {tmp_path / 'file'} is not a directory" in error


@pytest.mark.parametrize(
    ("limit", "message"),
    [(900_000, "needs 0.00254 GiB; increase [record]"), (20_000, "cannot be unpacked into")],
)
def test_a_full_disk_before_the_run_is_reported_and_nothing_is_left(
    tmp_path: Path, limit: int, message: str
) -> None:
    """A limit on the file size replaces the full disk: the rows or a library need more."""
    scenario = scenario_file(tmp_path, "stop_s = 20.0\n")

    def small_files() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "freeflyer.cli.main",
            "run",
            scenario,
            "--out",
            str(tmp_path / "out"),
            "--set",
            "free_flyer.base_mass=151",
        ],
        preexec_fn=small_files,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )
    assert done.returncode == 2, done.stderr
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_ctrl_c_saves_and_reports_the_results_up_to_then(tmp_path: Path) -> None:
    scenario = scenario_file(tmp_path, "stop_s = 3000.0\n")
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-m", "freeflyer.cli.main", "run", scenario, "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    for _ in range(600):
        if out.is_dir() and (tmp_path / "out").exists():
            break
        time.sleep(0.05)
    time.sleep(3.0)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 3, error
    assert "interrupted at" in error
    assert "the results up to then are saved" in error
    summary = json.loads((out / "summary.json").read_text())
    assert summary["interrupted"]
    assert not summary["diverged"]
    frame = pandas.read_parquet(out / "record.parquet")
    assert frame["time"].iloc[-1] == pytest.approx(summary["simulated_s"], abs=0.011)
    assert 0.0 < summary["simulated_s"] < 3000.0


def test_an_unexpected_divergence_gives_exit_code_3_and_saves_the_record(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    text = "[components.manipulator_controller.parameters]\nmanipulator_initial_energy = 0\n"
    code, error = run_command(
        capsys, "run", scenario_file(tmp_path, text), "--out", str(tmp_path / "out")
    )
    assert code == 3
    assert "the run diverged at" in error
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["diverged_at_s"] < 3.0


def test_an_expected_divergence_gives_exit_code_0(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code, error = run_command(capsys, "run", "overdamped_base", "--out", str(tmp_path))
    assert (code, error) == (0, "")
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["diverged"]
    assert all(
        value == value
        for key in ("max", "last_10_s")
        for value in [summary["base_position_error_m"][key]]
    )


def test_invalid_arguments_are_reported_by_argparse(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["run"], ["fly"], ["run", "multirate_passive", "--fmi", "4"]):
        with pytest.raises(SystemExit) as caught:
            command.call(arguments)
        assert caught.value.code == 2
        assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("text", ["-1e-05", "-.5e3", "-1_0.", "-5", "-inf", "-Infinity", "-NaN"])
def test_a_negative_number_is_the_value_of_an_option(
    capsys: pytest.CaptureFixture[str], text: str
) -> None:
    code, error = run_command(capsys, "predict", "multirate_passive", "--longest", text)
    assert code == 2
    assert f"--longest {float(text):g}: a time of 0.001 s" in error


@pytest.mark.parametrize("text", ["-e5", "-1e", "-x", "-in", "--5"])
def test_other_texts_with_a_hyphen_are_options(
    capsys: pytest.CaptureFixture[str], text: str
) -> None:
    with pytest.raises(SystemExit):
        command.call(["predict", "multirate_passive", "--longest", text])
    assert "argument --longest: expected one argument" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("run", "multirate_passive", "--step", "fast"), "argument --step: 'fast' is not a number"),
        (("sweep", "base_period", "--workers", "1e3"), "--workers: '1e3' is not a whole number"),
        (("fmus", "--out", ""), "argument --out: a directory is expected, got an empty name"),
    ],
)
def test_an_argument_of_the_wrong_type_is_one_sentence(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], message: str
) -> None:
    with pytest.raises(SystemExit):
        command.call(arguments)
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
