"""All FMUs: validity, simulation with start values, reproducibility, sampling, errors, states."""

from __future__ import annotations

import ctypes
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path

import fmpy
import numpy as np
import pytest
from families import alternating, family
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from freeflyer.fmi.fmu import FmuComponent
from freeflyer.foundation.errors import ComponentError, StepFailed
from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.export.archive import build
from freeflyer_fmus.robot.robot import Robot

VERSIONS = ("fmi2", "fmi3")
EVERY = [(version, name) for version in VERSIONS for name in BLOCKS]


@pytest.mark.parametrize(("version", "name"), family(EVERY, alternating(VERSIONS, BLOCKS)))
def test_fmpy_validation_has_no_findings(fmus: Path, version: str, name: str) -> None:
    assert validate_fmu(str(fmus / version / f"{name}.fmu")) == []


@pytest.mark.parametrize(("version", "name"), EVERY)
def test_fmpy_simulates_each_fmu_with_its_defaults(fmus: Path, version: str, name: str) -> None:
    result = fmpy.simulate_fmu(str(fmus / version / f"{name}.fmu"))
    assert len(result) == 101
    for column in result.dtype.names:
        assert np.isfinite(result[column]).all(), column


def test_model_exchange_and_co_simulation_of_the_plant_agree(fmus: Path) -> None:
    options = {
        "start_values": {"joint_velocity[2]": 0.3, "base_velocity[4]": 0.1},
        "stop_time": 1.0,
        "output_interval": 0.1,
    }
    path = str(fmus / "fmi2" / "free_flyer.fmu")
    stepped = fmpy.simulate_fmu(path, fmi_type="CoSimulation", **options)
    solved = fmpy.simulate_fmu(path, fmi_type="ModelExchange", relative_tolerance=1e-10, **options)
    for column in ("base_position[1]", "joint_position[3]", "end_effector_position[2]"):
        assert np.interp(1.0, stepped["time"], stepped[column]) == pytest.approx(
            np.interp(1.0, solved["time"], solved[column]), abs=1e-7
        )


@pytest.fixture(scope="module")
def fresh_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """An empty compiler cache, without results of the build at installation."""
    directory = tmp_path_factory.mktemp("zig")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ZIG_GLOBAL_CACHE_DIR", str(directory / "global"))
        patch.setenv("ZIG_LOCAL_CACHE_DIR", str(directory / "local"))
        yield


@pytest.mark.parametrize(
    "name",
    family(["reference_trajectory", "free_flyer", "manipulator_controller", "base_controller"]),
)
def test_two_builds_of_the_same_source_are_the_same_files(
    robot: Robot, fmus: Path, tmp_path: Path, fresh_cache: None, name: str
) -> None:
    for version, path in build(BLOCKS[name](robot), tmp_path).items():
        assert path.read_bytes() == (fmus / f"fmi{version}" / path.name).read_bytes(), path


def test_an_archive_contains_no_paths_of_this_machine(fmus: Path) -> None:
    for path in fmus.glob("*/*.fmu"):
        with zipfile.ZipFile(path) as archive:
            for entry in archive.infolist():
                assert entry.date_time == (1980, 1, 1, 0, 0, 0)
                data = archive.read(entry)
                assert b"/home/" not in data
                assert b"/tmp/" not in data
                assert str(Path.home()).encode() + b"/" not in data


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("step", [0.001, 0.01, 0.05, 0.3])
def test_a_controller_computes_the_same_at_any_step_that_divides_its_period(
    fmus: Path, version: str, step: float
) -> None:
    controller = FmuComponent("base_controller", fmus / version / "base_controller.fmu")
    controller.enter_initialization(0.0, {})
    controller.exit_initialization()
    u, y = np.zeros(3), np.zeros(6)
    write = controller.bind_inputs(["base_position"], u)
    read = controller.bind_outputs(["base_wrench"], y)
    per_period = round(0.3 / step)
    for k in range(per_period * 4):
        u[:] = [0.01 * k * step, 0.0, 0.0]
        write()
        controller.step(k * step, step)
        read()
        sampled_at = (k // per_period) * 0.3
        assert y[0] == pytest.approx(-150.0 * 0.01 * sampled_at, abs=1e-9)
    controller.close()


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("step", [0.4, 0.2])
def test_a_step_over_a_sample_is_rejected_with_step_and_period(
    fmus: Path, version: str, step: float
) -> None:
    controller = FmuComponent("base_controller", fmus / version / "base_controller.fmu")
    controller.enter_initialization(0.0, {})
    controller.exit_initialization()
    first_over = int(0.3 / step)
    for k in range(first_over):
        controller.step(k * step, step)
    with pytest.raises(
        StepFailed,
        match=f"step of {step:g} s passes over a sample of this block, whose period is 0.3 s",
    ):
        controller.step(first_over * step, step)
    controller.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_last_step_of_almost_zero_size_is_accepted(fmus: Path, version: str) -> None:
    for name in BLOCKS:
        component = FmuComponent(name, fmus / version / f"{name}.fmu")
        component.enter_initialization(0.0, {})
        component.exit_initialization()
        component.step(0.0, 0.001)
        component.step(0.001, 1e-13)
        component.step(0.001, 0.0)
        component.step(0.001, 0.001)
        component.close()


def rejection(fmus: Path, name: str, values: dict[str, object], version: str = "fmi2") -> str:
    """Return the error message of an initialisation with these values."""
    component = FmuComponent(name, fmus / version / f"{name}.fmu")
    try:
        component.enter_initialization(
            0.0, {key: np.atleast_1d(np.array(value, dtype=float)) for key, value in values.items()}
        )
        component.exit_initialization()
    except ComponentError as error:
        return str(error)
    finally:
        component.close()
    return "nothing was rejected"


@pytest.mark.parametrize("version", VERSIONS)
def test_invalid_parameters_are_rejected_with_name_and_value(fmus: Path, version: str) -> None:
    def message(name: str, **values: object) -> str:
        return rejection(fmus, name, values, version)

    assert "base_mass is -1; more than 0 is expected" in message("free_flyer", base_mass=-1.0)
    assert "base_mass cannot be set to NaN" in message("free_flyer", base_mass=np.nan)
    assert "base_inertia[2] cannot be set to infinity" in message(
        "free_flyer", base_inertia=[1, np.inf, 1, 0, 0, 0]
    )
    assert "triangle inequality" in message("free_flyer", base_inertia=[1, 1, 5, 0, 0, 0])
    assert "positive definite" in message("free_flyer", base_inertia=[1, 1, 1, 2, 0, 0])
    assert "squared norm of base_orientation is 0" in message(
        "free_flyer", base_orientation=[0, 0, 0, 0]
    )
    assert "period is 0; more than 0 is expected" in message("base_controller", period=0.0)
    assert "it is not an item of the enumeration" in message("manipulator_controller", observer=9)
    singular = message("manipulator_controller", joint_position=[0, 0, 0, 0, 0, 0])
    assert re.search(
        r"smallest singular value of J_m is \d\S*; at least 0.02 is expected", singular
    ), singular
    assert "is computed" in message("manipulator_controller", manipulator_observed_energy=[5.0] * 6)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_diverging_step_is_rejected_and_the_next_valid_one_succeeds(
    fmus: Path, version: str
) -> None:
    plant = FmuComponent("free_flyer", fmus / version / "free_flyer.fmu")
    plant.enter_initialization(0.0, {})
    plant.exit_initialization()
    u, y = np.zeros(12), np.zeros(6)
    write = plant.bind_inputs(["base_wrench", "joint_torque"], u)
    read = plant.bind_outputs(["joint_position"], y)
    read()
    before = y.copy()
    u[6:] = 1e200
    write()
    with pytest.raises(StepFailed, match="is not finite after this step; the step was rejected"):
        plant.step(0.0, 0.001)
    read()
    assert np.array_equal(y, before)
    u[:] = np.nan
    with pytest.raises(StepFailed, match=r"base_wrench\[1\] cannot be set to NaN"):
        write()
    u[:] = 0.0
    write()
    plant.step(0.0, 0.001)
    plant.close()


def test_a_saved_state_resumes_bit_for_bit(fmus: Path) -> None:
    from fmpy.fmi2 import FMU2Slave
    from fmpy.model_description import read_model_description

    path = str(fmus / "fmi2" / "free_flyer.fmu")
    description = read_model_description(path)
    slave = FMU2Slave(
        guid=description.guid,
        unzipDirectory=fmpy.extract(path),
        modelIdentifier="free_flyer",
        instanceName="x",
    )
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    outputs = [v.valueReference for v in description.modelVariables if v.causality == "output"]
    torque = [
        v.valueReference for v in description.modelVariables if v.name.startswith("joint_torque")
    ]
    slave.setReal(torque, [0.1, -0.2, 0.3, 0.1, 0.05, -0.02])
    for k in range(50):
        slave.doStep(k * 1e-3, 1e-3)
    saved = slave.getFMUstate()
    packed = slave.serializeFMUstate(saved)
    for k in range(50, 80):
        slave.doStep(k * 1e-3, 1e-3)
    once = slave.getReal(outputs)
    slave.setFMUstate(slave.deSerializeFMUstate(packed))
    for k in range(50, 80):
        slave.doStep(k * 1e-3, 1e-3)
    assert slave.getReal(outputs) == once
    with pytest.raises(FMICallException):
        slave.enterInitializationMode()
    slave.freeFMUstate(saved)
    slave.terminate()
    slave.freeInstance()


def test_enumerations_and_booleans_are_read_back_as_set(fmus: Path) -> None:
    from fmpy.fmi3 import FMU3Slave
    from fmpy.model_description import read_model_description

    path = str(fmus / "fmi3" / "manipulator_controller.fmu")
    description = read_model_description(path)
    reference = {v.name: v.valueReference for v in description.modelVariables}
    slave = FMU3Slave(
        guid=description.guid,
        unzipDirectory=fmpy.extract(path),
        modelIdentifier="manipulator_controller",
        instanceName="x",
    )
    slave.instantiate()
    slave.setInt64([reference["observer"]], [3])
    slave.setBoolean([reference["base_passivity_control"]], [False])
    slave.enterInitializationMode()
    assert slave.getInt64([reference["observer"]]) == [3]
    assert slave.getBoolean([reference["base_passivity_control"]]) == [False]
    assert slave.getFloat64([reference["stiffness"]], nValues=6) == [500.0] * 3 + [50.0] * 3
    slave.exitInitializationMode()
    with pytest.raises(FMICallException):
        slave.setFloat64([reference["period"]], [0.5])
    slave.setFloat64([reference["stiffness"]], [400.0] * 6)
    with pytest.raises(FMICallException):
        slave.setFloat64([reference["stiffness"]], [400.0] * 5)
    slave.terminate()
    slave.freeInstance()


def test_only_fmi_functions_are_exported(fmus: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(fmus / "fmi2" / "free_flyer.fmu") as archive:
        library = next(name for name in archive.namelist() if name.startswith("binaries/"))
        archive.extract(library, tmp_path)
    loaded = ctypes.CDLL(str(tmp_path / library))
    assert hasattr(loaded, "fmi2DoStep")
    assert hasattr(loaded, "fmi3DoStep")
    for hidden in ("block", "instance_step", "integrate_runge_kutta", "step"):
        with pytest.raises(AttributeError):
            loaded[hidden]
