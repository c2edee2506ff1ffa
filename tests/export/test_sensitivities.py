"""Directional and adjoint derivatives and declared dependencies, against finite differences."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from instances import Instance

from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.robot.robot import Array, Robot

EVERY = [(version, name) for version in (2, 3) for name in BLOCKS]
RANDOM = np.random.default_rng


@pytest.fixture
def instance(fmus: Path, request: pytest.FixtureRequest) -> Iterator[Instance]:
    version, name = request.param
    opened = Instance(fmus / f"fmi{version}" / f"{name}.fmu")
    yield opened
    opened.close()


def disturb(instance: Instance, block: Block, random: np.random.Generator) -> dict[str, Array]:
    """Set all inputs to random values near their start values. No input stays zero."""
    values = {}
    for name in instance.inputs:
        start = block.start_of(name)
        values[name] = start + 0.05 * random.uniform(0.2, 1.0, start.shape) * (1.0 + np.abs(start))
        instance.set(name, values[name])
    return values


def outputs_after(
    instance: Instance, block: Block, saved: bytes, values: dict[str, Array]
) -> Array:
    """Return all outputs for these inputs: now (continuous block) or at the next sample."""
    instance.restore(saved)
    for name, value in values.items():
        instance.set(name, value)
    if block.is_sampled:
        instance.step(0.0, block.default_step)
    return instance.all_outputs()


@pytest.mark.parametrize(
    "instance", [(v, n) for v, n in EVERY if not n.endswith(("trajectory", "loop"))], indirect=True
)
def test_the_directional_derivative_is_the_limit_of_differences(
    robot: Robot, instance: Instance
) -> None:
    block = BLOCKS[instance.description.modelName](robot)
    random = RANDOM(3)
    instance.initialise()
    values = disturb(instance, block, random)
    saved = instance.save()
    seed = {name: random.uniform(-1.0, 1.0, value.shape) for name, value in values.items()}
    given = np.concatenate([seed[name] for name in instance.inputs])
    exact = instance.directional(instance.outputs, instance.inputs, given)
    h = 1e-5
    sides = [
        outputs_after(
            instance,
            block,
            saved,
            {name: value + sign * h * seed[name] for name, value in values.items()},
        )
        for sign in (1, -1)
    ]
    difference = (sides[0] - sides[1]) / (2.0 * h)
    scale = 1.0 + np.abs(exact).max()
    if block.name == "arm_drive":  # quantised positions have zero slope
        unquantised = np.concatenate(
            [np.full(instance.sizes[name], name != "joint_position") for name in instance.outputs]
        )
        exact, difference = exact[unquantised], difference[unquantised]
    assert np.abs(exact - difference).max() < 1e-6 * scale


@pytest.mark.parametrize("instance", [(3, name) for name in BLOCKS], indirect=True)
def test_the_adjoint_is_the_transpose(robot: Robot, instance: Instance) -> None:
    """w . (J v) = (J' w) . v for all kinds of knowns and unknowns, in both modes."""
    block = BLOCKS[instance.description.modelName](robot)
    random = RANDOM(5)
    states = [variable.name for variable in block.having("state")]
    parameters = [v.name for v in block.having("parameter") if v.kind == "real"]
    knowns = ["time", *parameters, *instance.inputs, *states]
    unknowns = [*dict.fromkeys([*instance.outputs, *states])]
    if not block.is_sampled:
        unknowns += [f"der({name})" for name in states]
    instance.enter()
    disturb(instance, block, random)
    for mode in ("initialization", "step"):
        v, w = (
            random.normal(size=instance.width(knowns)),
            random.normal(size=instance.width(unknowns)),
        )
        forward = instance.directional(unknowns, knowns, v)
        backward = instance.adjoint(unknowns, knowns, w)
        assert np.abs(forward).max() > 0.0
        assert w @ forward == pytest.approx(
            backward @ v, rel=1e-9, abs=1e-9 * np.abs(backward).max()
        ), mode
        if mode == "initialization":
            instance.fmu.exitInitializationMode()


@pytest.mark.parametrize("instance", EVERY, indirect=True)
def test_in_initialization_mode_derivatives_by_parameters_and_start_values_are_exact(
    robot: Robot, instance: Instance
) -> None:
    block = BLOCKS[instance.description.modelName](robot)
    random = RANDOM(7)
    knowns = [
        v.name
        for v in block.having("parameter", "state", "input")
        if v.kind == "real" and block.has_start(v)
    ]
    knowns = [
        name
        for name in knowns
        if not name.endswith(("inertia", "period", "seed", "velocity_floor"))
        and name not in ("delay", "command_delay")  # at 0 they select another branch
    ]
    instance.enter()
    # Some joints start in the middle of their range. There, the distance to the nearer limit has no
    # derivative. Therefore the joint positions are moved by 0.01.
    values = {
        name: block.start_of(name) + (0.01 if name == "joint_position" else 0.0) for name in knowns
    }
    if "preview_share" in values:  # without preview, its time is at a kink of the motion
        values["preview_delay"] = np.array([0.2])
    if "waypoint_t" in values:  # without waypoints, the times are at a kink
        values["waypoint_t"] = np.arange(values["waypoint_t"].size) - 0.4
    seed = {
        name: random.uniform(0.0, 1.0, value.shape) * (1.0 + np.abs(value))
        for name, value in values.items()
    }
    for name, value in values.items():
        instance.set(name, value)
    exact = instance.directional(
        instance.outputs, knowns, np.concatenate([seed[name] for name in knowns])
    )
    h, sides = 1e-6, []
    for factor in (0.0, 1.0, 2.0):  # one-sided: some parameters start at their bounds
        for name, value in values.items():
            instance.set(name, value + factor * h * seed[name])
        sides.append(instance.all_outputs())
    difference = (-3.0 * sides[0] + 4.0 * sides[1] - sides[2]) / (2.0 * h)
    if block.name == "arm_drive":
        smooth = np.concatenate(
            [np.full(instance.sizes[name], name != "joint_position") for name in instance.outputs]
        )
        exact, difference = exact[smooth], difference[smooth]
    assert np.abs(exact - difference).max() < 1e-4 * (1.0 + np.abs(exact).max())


BRANCHES = {
    "manipulator_controller": {
        "manipulator_observed_energy",
        "base_observed_energy",
        "end_effector_damping",
        "base_damping",
    }
    | {"passivity_wrench"},
    "base_controller": {"passivity_wrench"},
    "base_command_delay": {"base_wrench"},
    "arm_command_delay": {"joint_torque"},
    "base_actuators": {"base_wrench"},
    "arm_drive": {
        "true_joint_position",
        "true_joint_velocity",
        "joint_position",
        "joint_velocity",
        "joint_torque",
    },
    "base_robot": {"base_acceleration"},
}
"""Outputs with dependencies that exist only if a part of the block is active.

Such a part is a damper, a brake, a quantiser, or a delay. In actuators and command delays, the time
only selects a branch.
"""


@pytest.mark.parametrize("instance", EVERY, indirect=True)
def test_declared_dependencies_are_correct(robot: Robot, instance: Instance) -> None:
    """Listed knowns have an influence at some random point. Other knowns have no influence."""
    block = BLOCKS[instance.description.modelName](robot)
    random = RANDOM(11)
    description = instance.description
    # Declared dependencies by value reference.
    listed = {
        unknown.variable.valueReference: {known.valueReference for known in unknown.dependencies}
        for unknown in [*description.outputs, *description.derivatives]
    }
    names = {
        reference: name
        for name, references in instance.references.items()
        for reference in references
    }
    states = [variable for variable in block.having("state") if not block.is_sampled]
    knowns = [
        r
        for name in ["time", *instance.inputs, *(v.name for v in states)]
        for r in instance.references[name]
    ]
    # Start with motion along every axis.
    for variable in states:
        start = block.start_of(variable.name)
        instance.set(variable.name, start + 0.1 * random.uniform(0.2, 1.0, start.shape))
    amplitudes = ("translation_amplitude", "rotation_amplitude", "displacement")
    for name in (*amplitudes, "sine_joint_torque", "sine_base_wrench"):  # along every axis
        if name in instance.references:
            instance.set(name, random.uniform(0.1, 0.2, instance.sizes[name]))
    if "waypoint_t" in instance.references:  # a motion through four waypoints
        times = np.full(instance.sizes["waypoint_t"], -1.0)
        times[:4] = [0.0, 0.2, 0.5, 0.9]
        instance.set("waypoint_t", times)
        for column in ("x", "y", "z", "qx", "qy", "qz"):
            instance.set(f"waypoint_{column}", random.uniform(0.1, 0.2, times.size))
    if "filter_time" in instance.references:  # the switch `filter_without_lag` needs a filter
        instance.set("filter_time", 0.01)
    instance.initialise(0.37)
    if "filter_time" in instance.references:  # and it acts from the second sample on
        instance.step(0.37, 1e-3)
    choices = [v for v in block.having("parameter") if v.kind == "enumeration" and v.tunable]
    switches = [v for v in block.having("parameter") if v.kind == "boolean" and v.tunable]
    # Largest influence of each known on each unknown over random points, enumerations and switches.
    influence: dict[tuple[int, int], float] = {}
    for repetition in range(4):
        disturb(instance, block, random)
        for variable in switches:
            instance.switch(variable.name, repetition >= 2)
        for variable in choices:
            instance.choose(variable.name, 1 + repetition % len(variable.choices))
        for known in knowns:
            width = instance.sizes[names[known]] // len(instance.references[names[known]])
            seed = list(random.normal(size=width))
            for unknown in listed:
                size = instance.sizes[names[unknown]] // len(instance.references[names[unknown]])
                more = () if instance.version == 2 else (size,)
                found = np.abs(
                    instance.fmu.getDirectionalDerivative([unknown], [known], seed, *more)
                ).max()
                influence[unknown, known] = max(influence.get((unknown, known), 0.0), found)
    for (unknown, known), size in influence.items():
        pair = f"{names[unknown]} to {names[known]}"
        if known not in listed[unknown]:
            assert size == 0.0, f"unlisted influence: {pair}"
        elif names[unknown] not in BRANCHES.get(block.name, ()):
            # By symmetry, a single element may have no influence. At least one listed element of
            # the array has an influence.
            others = [k for k in instance.references[names[known]] if k in listed[unknown]]
            assert max(influence[unknown, k] for k in others) > 0.0, (
                f"listed without influence: {pair}"
            )


@pytest.mark.parametrize("version", [2, 3])
def test_a_wrong_reference_or_size_is_rejected_with_a_message(
    fmus: Path, version: int, capfd: pytest.CaptureFixture[str]
) -> None:
    instance = Instance(fmus / f"fmi{version}" / "free_flyer.fmu").initialise()
    with pytest.raises(FMICallException):
        instance.directional(["base_mass"], ["joint_torque"], np.zeros(6))
    with pytest.raises(FMICallException):
        instance.directional(["kinetic_energy"], ["kinetic_energy"], np.zeros(1))
    if version == 3:
        with pytest.raises(FMICallException):
            instance.directional(["kinetic_energy"], ["joint_torque"], np.zeros(5))
        assert "is not an output, state or derivative of this FMU" in instance.messages[0]
        assert (
            "is not the time, a real parameter, an input or a state of this FMU"
            in instance.messages[1]
        )
        assert (
            "the lengths of seed and sensitivity differ from these numbers" in instance.messages[2]
        )
    instance.close()
