"""Third-party FMUs together with ours: PythonFMU (FMI 2.0), PythonFMU3 (FMI 3.0), reference FMUs.

Unusable files are rejected.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from commands import run_command

from freeflyer.fmi.fmu_description import describe_fmu
from freeflyer.foundation.errors import ComponentError
from freeflyer.scenario import experiment, scenario
from freeflyer.scenario.experiment import Result

pytest.importorskip("pythonfmu3")
builder = pytest.importorskip("pythonfmu.builder")
needs_binary = pytest.mark.skipif(
    not builder.FmuBuilder.has_binary(), reason="PythonFMU has no binary for this machine"
)

TESTS = Path(__file__).parents[1]
TUTORIAL = (TESTS.parent / "docs" / "foreign_fmus.md").read_text(encoding="utf-8")
CONTROLLER, SCENARIO = (
    re.findall(rf"```{language}\n(.*?)```", TUTORIAL, re.DOTALL)[0]
    for language in ("python", "toml")
)
REFERENCE_FMUS = os.environ.get("FREEFLYER_REFERENCE_FMUS", "")


def build(script: Path) -> None:
    """Build an FMU with PythonFMU's command in a separate process, as a user does."""
    tool = "pythonfmu3" if "pythonfmu3" in script.read_text() else "pythonfmu"
    subprocess.run(
        [sys.executable, "-m", tool, "build", "-f", script.name],
        cwd=script.parent,
        check=True,
        capture_output=True,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the tutorial's FMU, the same controller for FMI 3.0, and a model-exchange lag."""
    folder = tmp_path_factory.mktemp("foreign")
    (folder / "pd_base_controller.py").write_text(CONTROLLER)
    for name in ("pd_base_controller_3.py", "thruster_lag_me.py"):
        (folder / name).write_text((TESTS / "data" / name).read_text())
    for script in folder.glob("*.py"):
        build(script)
    return folder


def closed_loop(folder: Path, *changes: str, text: str = SCENARIO, name: str = "pd") -> Result:
    path = folder / f"{name}.toml"
    path.write_text(text)
    result = experiment.run(scenario.load(str(path), changes))
    assert result.outcome.cause is None
    return result


def same(one: Result, other: Result, tolerance: float) -> None:
    records = one.outcome.record, other.outcome.record
    for name in records[0].signals:
        if name in records[1]:
            assert np.abs(records[0][name] - records[1][name]).max() <= tolerance, name


@pytest.fixture(scope="module")
def loop(folder: Path) -> Result:
    return closed_loop(folder)


@needs_binary
def test_the_users_controller_holds_the_base_and_the_end_effector_tracks(loop: Result) -> None:
    greatest = {name: loop.summary[name]["max"] for name in loop.errors}
    assert loop.outcome.simulated == 20.0
    assert greatest["end_effector_position_error_m"] < 1e-5
    assert greatest["end_effector_orientation_error_deg"] < 1e-3
    assert greatest["base_position_error_m"] < 1e-3
    assert greatest["base_orientation_error_deg"] < 0.1
    assert np.abs(loop.outcome.record["pd.base_wrench"]).max() > 0.1, "the controller had no effect"


@needs_binary
def test_fmi_3_gives_an_equal_closed_loop(folder: Path, loop: Result) -> None:
    same(
        loop,
        closed_loop(folder, text=SCENARIO.replace("PdBaseController", "PdBaseController3")),
        1e-9,
    )


@needs_binary
def test_our_fmi_3_plant_works_with_a_third_party_fmi_2_controller(
    folder: Path, loop: Result
) -> None:
    mixed = SCENARIO + "[components.free_flyer]\nfmi = 3\n"
    same(loop, closed_loop(folder, text=mixed), 0.0)


@needs_binary
def test_a_third_party_model_exchange_fmu_works_between_ours_and_a_third_party_controller(
    folder: Path,
) -> None:
    lagging = SCENARIO.replace(
        '"pd.base_wrench -> free_flyer.base_wrench"',
        '"pd.base_wrench -> lag.command", "lag.wrench -> free_flyer.base_wrench"',
    )
    lagging += '[components.lag]\nkind = "model_exchange"\nfmu = "ThrusterLagMe.fmu"\nstep_s = 0.004\nsamples = false\n'
    record = closed_loop(
        folder, "stop_s=1", "record.every_s=0.004", text=lagging, name="lag"
    ).outcome.record
    command, acting = record["pd.base_wrench"], record["lag.wrench"]
    decay = np.exp(-0.004 / 0.02)
    assert acting[1:-1] == pytest.approx(decay * acting[:-2] + (1 - decay) * command[:-2], abs=1e-9)
    assert np.abs(acting).max() > 0.1


@needs_binary
def test_parameters_and_units_of_a_third_party_fmu_are_used(folder: Path) -> None:
    weak = closed_loop(folder, "stop_s=2", "pd.stiffness=20", "pd.damping=[9, 9, 9, 3, 3, 3]")
    strong = closed_loop(folder, "stop_s=2")
    error = "base_orientation_error_deg"
    assert weak.summary[error]["max"] > 2 * strong.summary[error]["max"]
    wrong = SCENARIO.replace("free_flyer.base_position -> pd", "free_flyer.linear_momentum -> pd")
    # PythonFMU declares no units, and a port without units matches any unit.
    closed_loop(folder, "stop_s=0.1", text=wrong)
    with pytest.raises(
        Exception,
        match=r"linear_momentum -> pd.base_position: units differ at element 1: kg.m/s and m",
    ):
        closed_loop(folder, text=wrong.replace("PdBaseController", "PdBaseController3"))


TEMPLATE_2 = """
from pythonfmu import Boolean, Fmi2Causality as C, Fmi2Slave, Fmi2Variability as V, Integer, Real
class {name}(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u, self.y, self.n, self.b = 1.0, 0.0, 3, True
        self.register_variable(Real("u", causality=C.input, variability=V.continuous))
        self.register_variable(Real("y", causality=C.output, variability=V.discrete))
        self.register_variable(Integer("n", causality=C.parameter, variability=V.tunable))
        self.register_variable(Boolean("b", causality=C.parameter, variability=V.tunable))
    def exit_initialization_mode(self):
        {start}
    def do_step(self, t, h):
        {step}
"""
TEMPLATE_3 = (
    TEMPLATE_2.replace("pythonfmu", "pythonfmu3")
    .replace("Fmi2", "Fmi3")
    .replace("Real", "Float64")
    .replace("Integer", "Int32")
    .replace(
        "= 1.0, 0.0, 3, True",
        '= 1.0, 0.0, 3, True\n        self.time = 0.0\n        self.register_variable(Float64("time", causality=C.independent))',
    )
)
TEMPLATES = pytest.mark.parametrize("template", [TEMPLATE_2, TEMPLATE_3], ids=["fmi2", "fmi3"])


def small(
    folder: Path,
    template: str,
    *,
    name: str = "Small",
    start: str = "pass",
    step: str = "self.y = 2 * self.u; return True",
) -> Path:
    """Write a scenario with one small FMU that is connected to the plant, from slave.py."""
    folder.mkdir(exist_ok=True)
    (folder / "slave.py").write_text(template.format(name=name, start=start, step=step))
    build(folder / "slave.py")
    path = folder / "small.toml"
    path.write_text(
        'stop_s = 0.1\nconnections = ["free_flyer.kinetic_energy -> x.u"]\n[components.free_flyer]\nstep_s = 0.001\n'
        f'[components.x]\nfmu = "{name}.fmu"\nstep_s = 0.01\n'
    )
    return path


@needs_binary
@TEMPLATES
@pytest.mark.parametrize(
    ("start", "step", "code", "message"),
    [
        (
            "pass",
            "assert t < 0.05, 'the tank is empty'; return True",
            3,
            r"stopped at 0\.05 s: x: .*the tank is empty",
        ),
        (
            "raise OSError('no calibration')",
            "return True",
            2,
            r"component x cannot be initialised: .*no calibration",
        ),
        ("pass", "return t < 0.05", 3, r"stopped at 0\.05 s: x: .*(\(discard\)|requests the end)"),
    ],
)
def test_an_exception_in_the_users_python_is_one_line_with_component_and_cause(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    template: str,
    start: str,
    step: str,
    code: int,
    message: str,
) -> None:
    path = small(tmp_path, template, start=start, step=step)
    got, error = run_command(capsys, "run", str(path), "--out", str(tmp_path / "out"))
    assert re.search(message, error), error
    assert got == code
    assert (
        run_command(capsys, "run", str(small(tmp_path, template)), "--out", str(tmp_path / "out"))[
            0
        ]
        == 0
    ), "a valid FMU still works after the failure"


@needs_binary
@TEMPLATES
def test_two_fmus_with_the_same_script_name_use_their_own_code_and_are_removed_completely(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, template: str
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "unpacked"))
    (tmp_path / "unpacked").mkdir()
    small(
        tmp_path / "triple",
        template,
        step="self.log('100% %s %d'); self.y = 3 * self.u; return True",
    )
    path = small(tmp_path / "double", template)
    component = '[components.{name}]\nfmu = "{fmu}"\nstep_s = 0.01\n'
    text = 'stop_s = 0.1\nconnections = ["one.y -> two.u", "two.y -> three.u"]\n'
    text += "".join(
        component.format(name=name, fmu=fmu)
        for name, fmu in (
            ("one", "Small.fmu"),
            ("two", "../triple/Small.fmu"),
            ("three", "Small.fmu"),
        )
    )
    path.write_text(text + "[components.one.parameters]\nn = 5\nb = false\nu = 7\n")
    record = experiment.run(scenario.load(str(path))).outcome.record
    assert [record[f"{name}.y"][0] for name in ("one", "two", "three")] == [14.0, 42.0, 84.0]
    assert not list((tmp_path / "unpacked").iterdir())
    assert not [entry for entry in sys.path if "freeflyer-" in entry]
    assert not [
        name
        for name, module in sys.modules.items()
        if "freeflyer-" in str(getattr(module, "__file__", ""))
    ]


@needs_binary
def test_an_fmi_3_fmu_without_time_is_rejected(folder: Path, tmp_path: Path) -> None:
    changed = tmp_path / "timeless.fmu"
    with (
        zipfile.ZipFile(folder / "PdBaseController3.fmu") as whole,
        zipfile.ZipFile(changed, "w") as archive,
    ):
        archive.writestr(
            "modelDescription.xml",
            re.sub(
                r"<Float64 name=\"time\"[^>]*/>", "", whole.read("modelDescription.xml").decode()
            ),
        )
    with pytest.raises(ComponentError, match="Exactly one independent variable must be defined"):
        describe_fmu(changed)


FMI_1 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion='1.0' modelName="old" modelIdentifier="old" guid="{0}" numberOfContinuousStates="0" numberOfEventIndicators="0">
  <ModelVariables><ScalarVariable name="x" valueReference="0"><Real/></ScalarVariable></ModelVariables>
</fmiModelDescription>"""
FMI_2 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="some" guid="{0}">
  <KIND modelIdentifier="some"/>
  <ModelVariables><ScalarVariable name="x" valueReference="0" causality="output"><Real/></ScalarVariable></ModelVariables>
  <ModelStructure><Outputs><Unknown index="1"/></Outputs></ModelStructure>
</fmiModelDescription>"""


@pytest.mark.parametrize(
    ("description", "binaries", "message"),
    [
        (FMI_1, (), "is of FMI version 1.0; FMI 2.0 and FMI 3.0 are supported"),
        (
            FMI_1.replace("'1.0'", "'4.0'"),
            (),
            "is of FMI version 4.0; FMI 2.0 and FMI 3.0 are supported",
        ),
        (
            FMI_1.replace("fmiVersion='1.0'", ""),
            (),
            "is of FMI version unknown; FMI 2.0 and FMI 3.0 are supported",
        ),
        (FMI_2[:200], (), "its modelDescription.xml is not well-formed XML"),
        (
            FMI_2.replace("KIND", "ModelExchange"),
            (),
            "of component x offers no co-simulation; an FMU with co-simulation is expected",
        ),
        (
            FMI_2.replace("KIND", "CoSimulation"),
            ("amiga/some.so",),
            r"has no binary for this platform \(.*\); it has binaries for amiga; build the FMU",
        ),
        (
            FMI_2.replace("KIND", "CoSimulation").replace('"2.0"', "'2.0'"),
            (),
            "has no binary for this platform",
        ),
    ],
)
def test_an_unusable_fmu_is_rejected_with_its_reason(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    description: str,
    binaries: tuple[str, ...],
    message: str,
) -> None:
    with zipfile.ZipFile(tmp_path / "some.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", description)
        for name in binaries:
            archive.writestr(f"binaries/{name}", "")
    path = tmp_path / "some.toml"
    path.write_text('stop_s = 0.1\n[components.x]\nfmu = "some.fmu"\nstep_s = 0.01\n')
    code, error = run_command(capsys, "run", str(path), "--out", str(tmp_path / "out"))
    assert re.search(message, error), error
    assert code == 2


@pytest.mark.skipif(
    not REFERENCE_FMUS, reason="FREEFLYER_REFERENCE_FMUS names no directory with fmi2/ and fmi3/"
)
@pytest.mark.parametrize("fmi", [2, 3])
def test_the_modelica_associations_reference_fmus_give_their_known_results(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], fmi: int
) -> None:
    def text(name: str, kind: str = "fmu", stop: float = 2.0) -> str:
        fmu = Path(REFERENCE_FMUS).resolve() / f"fmi{fmi}" / f"{name}.fmu"
        path = tmp_path / "reference.toml"
        head = f"stop_s = {stop}\n[record]\nevery_s = 0.1\n"
        path.write_text(f'{head}[components.x]\nkind = "{kind}"\nfmu = "{fmu}"\nstep_s = 0.1\n')
        return str(path)

    def last(signal: str, *arguments: str) -> float:
        return float(experiment.run(scenario.load(text(*arguments))).outcome.record[signal][-1])

    assert last("x.x", "Dahlquist") == pytest.approx(0.9**20)  # internal Euler steps of 0.1 s
    assert last("x.x", "Dahlquist", "model_exchange") == pytest.approx(np.exp(-2), abs=1e-9)
    assert last("x.x0", "VanDerPol", "model_exchange") == pytest.approx(0.3233166672, abs=1e-6)
    assert last("x.h", "BouncingBall") >= 0.0
    for name, kind, stop, sentence in (
        (
            "BouncingBall",
            "model_exchange",
            2.0,
            "has event indicators; only model exchange without events is supported",
        ),
        (
            "Stair",
            "model_exchange",
            2.0,
            "has a time event at 1 s; only model exchange without events is supported",
        ),
        ("Stair", "fmu", 12.0, "the FMU requests the end of the simulation"),
    ):
        assert (
            sentence
            in run_command(capsys, "run", text(name, kind, stop), "--out", str(tmp_path / "out"))[1]
        )
