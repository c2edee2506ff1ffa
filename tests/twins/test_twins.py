"""Forms of a block that agree to 1e-12: symbolic, C (two compilers), FMI 2.0, 3.0, in-process."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from families import family
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import ROBOTS

from freeflyer.fmi.fmu import FmuComponent
from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.equations.passivity import Bookkeeping, Observer
from freeflyer_fmus.export.archive import build
from freeflyer_fmus.export.prebuilt import directory
from freeflyer_fmus.in_process_block import InProcessBlock
from freeflyer_fmus.robot.urdf import load_robot_file

STEP = 1e-3
REFERENCE = {"discretisation": 2.0, "observer": 4.0, "manipulator_initial_energy": 0.0}

COUPLED = {"damper_inertia": 2.0, "manipulator_initial_energy": 0.0}
SOFT = {"discretisation": 2.0, "stiffness": 1e-9, "damping": 1e-9}


@cache
def declared(name: str) -> Block:
    return BLOCKS[name](load_robot_file())


def agree(one: np.ndarray, other: np.ndarray, what: str) -> None:
    scale = np.maximum(1.0, np.abs(other))
    assert (np.abs(one - other) / scale).max() <= 1e-12, what


def disturbed(name: str, random: np.random.Generator, start: np.ndarray) -> np.ndarray:
    """Return random inputs near the start values: quaternions stay valid and J_m regular."""
    return start + random.normal(size=start.size) * 0.03


def outputs_of(
    component: object,
    steps: int,
    seed: int,
    period: float,
    values: dict[str, np.ndarray] | None = None,
) -> np.ndarray:
    """Return the outputs after every step, under random inputs that depend only on the seed."""
    ports = component.ports  # type: ignore[attr-defined]
    names = [name for name, port in ports.items() if port.causality == "input"]
    results = [name for name, port in ports.items() if port.causality == "output"]
    u = np.concatenate([np.array(ports[name].start) for name in names] or [np.zeros(0)])
    y = np.zeros(sum(ports[name].size for name in results))
    start = u.copy()
    random = np.random.default_rng(seed)
    component.enter_initialization(0.0, values or {})  # type: ignore[attr-defined]
    write = component.bind_inputs(names, u) if names else None  # type: ignore[attr-defined]
    read = component.bind_outputs(results, y)  # type: ignore[attr-defined]
    component.exit_initialization()  # type: ignore[attr-defined]
    read()
    history = [y.copy()]
    for k in range(steps):
        u[:] = disturbed(component.name, random, start)  # type: ignore[attr-defined]
        if write:
            write()
        component.step(k * period, period)  # type: ignore[attr-defined]
        read()
        history.append(y.copy())
    component.close()  # type: ignore[attr-defined]
    return np.array(history)


@pytest.mark.parametrize("name", BLOCKS)
@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1))
def test_in_process_block_and_both_fmus_give_the_same_results(name: str, seed: int) -> None:
    block = declared(name)
    period = block.default_step
    in_process = outputs_of(InProcessBlock(block), 40, seed, period)
    two, three = (
        outputs_of(FmuComponent(name, directory() / f"fmi{v}" / f"{name}.fmu"), 40, seed, period)
        for v in (2, 3)
    )
    assert np.abs(in_process).max() > 0.0
    assert np.array_equal(two, three), (
        "the same binary must give the same bits through both interfaces"
    )
    agree(in_process, two, name)


@pytest.mark.parametrize("bookkeeping", [1, 2, 3, 4])
@pytest.mark.parametrize(
    ("name", "choice", "options"),
    [("manipulator_controller", "observer", 4), ("base_controller", "discretisation", 2)],
)
def test_in_process_block_and_fmu_agree_in_every_mode(
    name: str, choice: str, options: int, bookkeeping: int
) -> None:
    for option in range(1, options + 1):
        if option == Observer.reference and bookkeeping != Bookkeeping.applied:
            continue  # rejected
        values = {choice: np.array([float(option)]), "bookkeeping": np.array([float(bookkeeping)])}
        if name == "manipulator_controller":
            values["manipulator_initial_energy"] = np.zeros(6)  # so that both dampers are active
        period = declared(name).default_step
        in_process = outputs_of(InProcessBlock(declared(name)), 30, 5, period, values)
        fmu = outputs_of(
            FmuComponent(name, directory() / "fmi2" / f"{name}.fmu"), 30, 5, period, values
        )
        agree(in_process, fmu, f"{name} {option} {bookkeeping}")


@pytest.mark.parametrize(
    ("name", "values"),
    [
        *(("reference_trajectory", {"shape": shape}) for shape in (2.0, 3.0, 4.0)),
        ("reference_trajectory", {"fade_out_start": 0.01, "fade_out_time": 0.02}),
        ("reference_trajectory", {"drift": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], "start_offset": 0.2}),
        ("waypoint_trajectory", {"waypoint_t": [0.0, 0.01, 0.03, *[-1.0] * 29], "waypoint_y": 0.1}),
        ("waypoint_trajectory", {"waypoint_t": [0.0, 0.02, *[-1.0] * 30], "waypoint_qx": -0.3}),
        ("free_flyer", {"integration_step": 1.5e-4}),
        ("base_controller", {"discretisation": 2.0, "theta": 0.7}),
        ("manipulator_controller", {"discretisation": 2.0, "theta": 0.7}),
        ("manipulator_controller", {"filter_time": 0.004, "position_setpoint": 0.1}),
        ("manipulator_controller", REFERENCE | {"angular_velocity_weight": 0.2}),
        ("manipulator_controller", REFERENCE | {"filter_time": 0.004}),
        ("manipulator_controller", {"filter_time": 0.004, "filter_without_lag": 1.0}),
        ("manipulator_controller", COUPLED),
        ("manipulator_controller", COUPLED | {"discretisation": 2.0, "theta": 0.7}),
        ("base_controller", {"damper_inertia": 2.0, "damper_bound": 1e-5, "damping": 0.0}),
        ("base_controller", SOFT | {"damper_inertia": 2.0, "damper_bound": 1e-5}),
        ("base_controller", {"discretisation": 2.0, "command_delay": 0.3}),
        ("base_controller", {"discretisation": 2.0, "command_delay": 0.002}),
        ("free_flyer", {"arm_mass_factor": 1.2}),
        ("base_controller", {"arm_mass_factor": 0.8}),
        ("reference_trajectory", {"preview_period": 0.3, "preview_delay": 0.1}),
        ("disturbance", {"pulse_start": 0.01, "pulse_base_wrench": 3.0, "sine_joint_torque": 1.0}),
        ("measurement_noise", {"orientation_noise": 0.01, "joint_position_noise": 0.02, "seed": 7}),
        ("base_command_delay", {"delay": 0.01, "command_period": 0.01}),
        ("arm_command_delay", {"delay": 0.002, "command_period": 0.002}),
        ("base_actuators", {"limit": 0.02}),
        ("base_actuators", {"on_off": 1.0, "base_period": 0.01, "minimum_on_time": 0.002}),
    ],
    ids=str,
)
def test_in_process_block_and_both_fmus_agree_with_every_option(
    name: str, values: dict[str, object]
) -> None:
    block = declared(name)
    given = {key: np.resize(value, block.variables[key].size) for key, value in values.items()}
    plain, in_process = (
        outputs_of(InProcessBlock(block), 40, 3, block.default_step, settings)
        for settings in ({}, given)
    )
    assert not np.array_equal(plain, in_process)
    for version in (2, 3):
        fmu = FmuComponent(name, directory() / f"fmi{version}" / f"{name}.fmu")
        agree(in_process, outputs_of(fmu, 40, 3, block.default_step, given), f"{name} {values}")


@pytest.mark.parametrize("mixed", [3, 4])
def test_each_port_has_its_own_bookkeeping(mixed: int) -> None:
    """Without dampers, the observed energies do not depend on each other."""
    block = declared("manipulator_controller")
    energies = ("manipulator_observed_energy", "base_observed_energy")
    names = [
        name for name, port in InProcessBlock(block).ports.items() if port.causality == "output"
    ]
    starts = np.cumsum([0, *(block.variables[name].size for name in names)])

    def observed(bookkeeping: int) -> list[np.ndarray]:
        off = dict.fromkeys(
            ("manipulator_passivity_control", "base_passivity_control"), np.zeros(1)
        )
        values = off | {"bookkeeping": np.array([float(bookkeeping)])}
        history = outputs_of(InProcessBlock(block), 30, 5, block.default_step, values)
        places = [names.index(name) for name in energies]
        return [history[:, starts[place] : starts[place + 1]] for place in places]

    printed, applied, both = observed(1), observed(2), observed(mixed)
    expected = (applied[0], printed[1]) if mixed == 3 else (printed[0], applied[1])
    assert all(np.array_equal(found, wanted) for found, wanted in zip(both, expected, strict=True))
    assert not np.array_equal(printed[0], applied[0])
    assert not np.array_equal(printed[1], applied[1])


def test_ports_of_in_process_block_and_fmus_are_the_same(fmus: Path) -> None:
    for name in BLOCKS:
        block = declared(name)
        expected = InProcessBlock(block).ports
        for version in (2, 3):
            component = FmuComponent(name, fmus / f"fmi{version}" / f"{name}.fmu")
            ports = component.ports
            for variable, port in expected.items():
                assert ports[variable].size == port.size
                assert ports[variable].causality == port.causality
                assert port.causality != "output" or ports[variable].direct == port.direct, (
                    name,
                    variable,
                )
                assert ports[variable].start == port.start or port.start is None
                assert ports[variable].choices == port.choices
            component.close()


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", BLOCKS)
def test_two_instances_in_one_process_are_independent(fmus: Path, name: str, version: int) -> None:
    """Stepped alternately with different inputs, each gives the same outputs as alone."""
    path = fmus / f"fmi{version}" / f"{name}.fmu"
    period = declared(name).default_step
    alone = [outputs_of(FmuComponent(name, path), 12, seed, period) for seed in (1, 2)]
    pair = [FmuComponent(name, path) for _ in range(2)]
    ports = pair[0].ports
    inputs = [port.name for port in ports.values() if port.causality == "input"]
    results = [port.name for port in ports.values() if port.causality == "output"]
    start = np.concatenate([np.zeros(0), *(np.array(ports[name].start) for name in inputs)])
    u = [start.copy(), start.copy()]
    y = [np.zeros(alone[0].shape[1]) for _ in range(2)]
    random = [np.random.default_rng(seed) for seed in (1, 2)]
    write, read = [], []
    for i, component in enumerate(pair):
        component.enter_initialization(0.0, {})
        write.append(component.bind_inputs(inputs, u[i]) if inputs else lambda: None)
        read.append(component.bind_outputs(results, y[i]))
        component.exit_initialization()
    for k in range(12):
        for i, component in enumerate(pair):
            u[i][:] = disturbed(name, random[i], start)
            write[i]()
            component.step(k * period, period)
            read[i]()
            assert np.array_equal(y[i], alone[i][k + 1])
    assert not inputs or not np.array_equal(y[0], y[1])
    for component in pair:
        component.close()


@pytest.mark.parametrize(
    "name",
    family(
        [
            "hand_kinematics",
            "free_flyer",
            "manipulator_controller",
            "base_controller",
            "reference_trajectory",
        ]
    ),
)
@pytest.mark.parametrize("robot_name", family(["gantry", "ur5"]))
def test_other_robots_can_be_exported_and_agree(robot_name: str, name: str, tmp_path: Path) -> None:
    block = BLOCKS[name](ROBOTS[robot_name]())
    path = build(block, tmp_path)[2]
    in_process = outputs_of(InProcessBlock(block), 5, 3, block.default_step)
    agree(in_process, outputs_of(FmuComponent(name, path), 5, 3, block.default_step), name)
