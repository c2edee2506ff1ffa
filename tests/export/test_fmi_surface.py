"""Capabilities of the FMUs through FMPy.

Saved states, changes during a run, variable steps, intermediate updates, model exchange.
"""

from __future__ import annotations

import ctypes
import gc
import resource
import shutil
import threading
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import fmpy
import numpy as np
import pytest
from families import alternating, family
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import FMU3Slave
from fmpy.model_description import read_model_description
from hypothesis import given
from hypothesis import strategies as st
from instances import Instance
from scipy.integrate import DOP853

from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.robot.robot import Array, Robot

VERSIONS = (2, 3)
EVERY = [(version, name) for version in VERSIONS for name in BLOCKS]
MS = 1e-3


def path_of(fmus: Path, version: int, name: str) -> Path:
    return fmus / f"fmi{version}" / f"{name}.fmu"


def driven(instance: Instance, robot: Robot, random: np.random.Generator) -> Callable[[], None]:
    """Return a function that sets the inputs to random values near their start values."""
    block = BLOCKS[instance.description.modelName](robot)
    starts = {name: block.start_of(name) for name in instance.inputs}

    def drive() -> None:
        for name, start in starts.items():
            instance.set(
                name, start + 0.01 * random.uniform(-1.0, 1.0, start.shape) * (1.0 + np.abs(start))
            )

    return drive


# Saved states


@pytest.mark.parametrize(("version", "name"), family(EVERY, alternating(VERSIONS, BLOCKS)))
def test_a_state_saved_at_any_instant_resumes_bit_for_bit(
    fmus: Path, robot: Robot, version: int, name: str
) -> None:
    """The state is restored in the same instance, and from its bytes in another instance."""
    random = np.random.default_rng(version)
    one = Instance(path_of(fmus, version, name)).initialise()
    instant = int(random.integers(1, 40))

    def run(instance: Instance, first: int, last: int) -> Array:
        drive = driven(instance, robot, np.random.default_rng(100 + first))
        found = []
        for k in range(first, last):
            drive()
            instance.step(k * MS, MS)
            found.append(instance.all_outputs())
        return np.array(found)

    run(one, 0, instant)
    saved = one.save()
    expected = run(one, instant, 60)
    one.restore(saved)
    assert run(one, instant, 60).tobytes() == expected.tobytes()
    other = Instance(path_of(fmus, version, name)).initialise()
    other.restore(saved)
    assert run(other, instant, 60).tobytes() == expected.tobytes()
    one.close()
    other.close()


@pytest.mark.parametrize("version", family(VERSIONS))
@given(data=st.data())
def test_damaged_saved_states_are_rejected(fmus: Path, version: int, data: st.DataObject) -> None:
    instance = Instance(path_of(fmus, version, "manipulator_controller")).initialise()
    try:
        saved = bytearray(instance.save())
        before = bytes(saved)
        place, bit = data.draw(st.integers(0, len(saved) - 1)), data.draw(st.integers(0, 7))
        saved[place] ^= 1 << bit
        with pytest.raises(FMICallException):
            instance.restore(bytes(saved))
        assert instance.save() == before
        instance.restore(before)
        instance.step(0.0, MS)
        with pytest.raises(FMICallException):
            instance.restore(bytes(before[:-8]))
    finally:
        instance.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_state_of_another_fmu_is_rejected(fmus: Path, version: int) -> None:
    one = Instance(path_of(fmus, version, "reference_trajectory")).initialise()
    other = Instance(path_of(fmus, version, "free_flyer")).initialise()
    model = Instance(path_of(fmus, version, "free_flyer"), model_exchange=True).initialise()
    for foreign in (one, model):
        with pytest.raises(FMICallException):
            other.restore(foreign.save())
    for instance in (one, other, model):
        instance.close()


# Initialization mode


@pytest.mark.parametrize("version", VERSIONS)
def test_outputs_may_be_read_before_a_required_connection_has_a_value(
    fmus: Path, version: int
) -> None:
    """Masters that iterate in initialization mode read outputs before they set connected inputs."""
    controller = Instance(path_of(fmus, version, "base_controller"))
    controller.switch("preview", True)
    controller.enter()
    assert np.isfinite(controller.get("base_wrench")).all()
    with pytest.raises(FMICallException):
        controller.fmu.exitInitializationMode()
    controller.set("preview_time", 0.15)
    controller.fmu.exitInitializationMode()
    controller.set("preview_time", 0.0)
    with pytest.raises(FMICallException):
        controller.step(0.0, 0.3)
    controller.close()


# Changes during a run


@pytest.mark.parametrize("version", VERSIONS)
def test_tunable_parameters_take_effect_at_the_next_sample(fmus: Path, version: int) -> None:
    controller = Instance(path_of(fmus, version, "base_controller")).initialise()
    controller.set("base_position", [0.01, 0.0, 0.0])
    controller.step(0.0, 0.3)
    assert controller.get("base_wrench")[0] == pytest.approx(-1.5)
    controller.set("stiffness", [300.0] * 3 + [40.0] * 3)
    assert controller.get("base_wrench")[0] == pytest.approx(-1.5)  # held until the next sample
    controller.step(0.3, 0.3)
    assert controller.get("base_wrench")[0] == pytest.approx(-3.0)
    controller.set("stiffness", [-1.0] * 6)
    with pytest.raises(FMICallException):
        controller.step(0.6, 0.3)
    controller.set("stiffness", [100.0] * 6)
    controller.step(0.6, 0.3)
    assert controller.get("base_wrench")[0] == pytest.approx(-1.0)
    controller.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_passivity_control_and_observer_can_change_during_a_run(fmus: Path, version: int) -> None:
    controller = Instance(path_of(fmus, version, "manipulator_controller"))
    controller.set("manipulator_initial_energy", [0.0] * 6)
    controller.initialise()
    velocity = np.array([0.01, 0.0, 0.0, 0.0, 0.0, 0.0])
    controller.set("end_effector_velocity", velocity)
    controller.set(
        "desired_velocity", 5.0 * velocity
    )  # accelerated by the reference: an active port
    for k in range(5):
        controller.step(k * MS, MS)
    assert controller.get("end_effector_damping")[0] > 0.0
    controller.switch("manipulator_passivity_control", False)
    controller.step(5 * MS, MS)
    assert not controller.get("end_effector_damping").any()
    controller.switch("manipulator_passivity_control", True)
    before = controller.get("manipulator_observed_energy")
    controller.choose("observer", 3)
    controller.step(6 * MS, MS)
    assert controller.get("manipulator_observed_energy")[0] != before[0]
    with pytest.raises(FMICallException):
        controller.choose("observer", 5)
    controller.close()


# Steps of any size


@pytest.mark.parametrize("version", VERSIONS)
def test_variable_communication_steps_change_only_rounding_errors(fmus: Path, version: int) -> None:
    random = np.random.default_rng(4)
    cuts = np.sort(np.concatenate([[0.0, 0.5], np.round(random.uniform(0.0, 0.5, 60), 3)]))
    results = []
    for times in (np.unique(cuts), np.linspace(0.0, 0.5, 501)):
        plant = Instance(path_of(fmus, version, "free_flyer"))
        plant.set("joint_velocity", [0.3, -0.2, 0.1, 0.2, 0.3, -0.1])
        plant.initialise()
        plant.set("joint_torque", [0.2, -0.1, 0.3, 0.05, 0.0, 0.1])
        for begin, end in pairwise(times):
            plant.step(begin, end - begin)
        results.append(plant.all_outputs())
        plant.close()
    np.testing.assert_allclose(results[0], results[1], rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_run_may_start_at_any_time(fmus: Path, version: int) -> None:
    for start in (-3.0, 0.0, 1e6, 1.7e9):
        controller = Instance(path_of(fmus, version, "base_controller")).initialise(start)
        for k in range(7):
            controller.set("base_position", [0.01 * (k + 1), 0.0, 0.0])
            controller.step(start + k * 0.1, 0.1)
            assert controller.get("base_wrench")[0] == pytest.approx(-1.5 * (1 + 3 * (k // 3)))
        controller.close()


# Intermediate updates (FMI 3.0)


def test_an_importer_may_read_and_set_values_during_a_communication_step(fmus: Path) -> None:
    """Torques changed at intermediate updates have the same effect as in steps of 1 ms."""
    seen: list[float] = []
    positions = []

    def update(
        _: object, time: float, settable: bool, gettable: bool, finished: bool, *rest: object
    ) -> None:
        assert settable
        assert gettable
        assert finished
        seen.append(time)
        positions.append(inner.get("joint_position")[1])
        inner.set("joint_torque", [0.0, 0.1 * len(seen), 0.0, 0.0, 0.0, 0.0])
        with pytest.raises(FMICallException):
            inner.step(time, MS)

    path = path_of(fmus, 3, "free_flyer")
    inner, outer = (
        Instance(path, intermediateUpdate=update).initialise(),
        Instance(path).initialise(),
    )
    for instance in (inner, outer):
        instance.set("joint_torque", [0.0] * 6)
    assert inner.step(0.0, 5 * MS)[2:] == (False, 5 * MS)
    for k in range(5):
        outer.set("joint_torque", [0.0, 0.1 * k, 0.0, 0.0, 0.0, 0.0])
        outer.step(k * MS, MS)
        assert k == 4 or outer.get("joint_position")[1] == pytest.approx(positions[k], abs=1e-13)
    assert seen == pytest.approx([MS, 2 * MS, 3 * MS, 4 * MS])
    np.testing.assert_allclose(inner.all_outputs(), outer.all_outputs(), rtol=0.0, atol=1e-13)
    assert "fmi3DoStep is not allowed in the state intermediate update mode" in inner.messages[0]
    inner.close()
    outer.close()


@pytest.mark.parametrize("allowed", [False, True])
def test_an_importer_may_end_a_communication_step_early(fmus: Path, allowed: bool) -> None:
    def update(_: object, time: float, *rest: object) -> None:
        early: ctypes._Pointer[ctypes.c_bool] = rest[4]  # type: ignore[assignment]
        assert bool(rest[3]) is allowed
        early[0] = time > 2.5 * MS

    plant = Instance(
        path_of(fmus, 3, "free_flyer"), intermediateUpdate=update, earlyReturnAllowed=allowed
    ).initialise()
    *_, early, last = plant.step(0.0, 10 * MS)
    assert (early, last) == ((True, pytest.approx(3 * MS)) if allowed else (False, 10 * MS))
    plant.step(last, 10 * MS - last if allowed else MS)
    plant.close()


# Model exchange


@pytest.mark.parametrize("version", VERSIONS)
def test_an_importers_solver_reproduces_the_co_simulation_result(fmus: Path, version: int) -> None:
    """DOP853 integrates the FMI derivatives. The Jacobian agrees with finite differences."""
    path = path_of(fmus, version, "free_flyer")
    torque, velocity = [0.3, -0.2, 0.25, 0.1, 0.05, -0.1], [0.2, -0.3, 0.1, 0.2, -0.1, 0.3]
    model, slave = Instance(path, model_exchange=True), Instance(path)
    for instance in (model, slave):
        instance.set("joint_velocity", velocity)
        instance.initialise()
        instance.set("joint_torque", torque)
    fmu = model.fmu
    (fmu.newDiscreteStates if version == 2 else fmu.updateDiscreteStates)()
    fmu.enterContinuousTimeMode()
    states = [
        "base_position",
        "base_orientation",
        "base_velocity",
        "joint_position",
        "joint_velocity",
    ]
    x0 = np.concatenate([model.get(name) for name in states])

    def rates(t: float, x: Array) -> Array:
        dx, x = np.empty_like(x), np.ascontiguousarray(x)
        fmu.setTime(t)
        fmu.setContinuousStates(pointer(x), x.size)
        (fmu.getDerivatives if version == 2 else fmu.getContinuousStateDerivatives)(
            pointer(dx), dx.size
        )
        return dx

    nominals = np.empty_like(x0)
    (fmu.getNominalsOfContinuousStates)(pointer(nominals), nominals.size)
    declared = {
        v.name.partition("[")[0]: float(v.nominal or 1.0) for v in model.description.modelVariables
    }
    expected = [declared[name] for name in states for _ in range(model.sizes[name])]
    assert nominals.tolist() == expected
    # Simulate one second with the importer's solver, and with communication steps.
    solver = DOP853(rates, 0.0, x0, 1.0, rtol=1e-11, atol=1e-12 * nominals)
    while solver.status == "running":
        solver.step()
    for k in range(1000):
        slave.step(k * MS, MS)
    expected = np.concatenate([slave.get(name) for name in states])
    np.testing.assert_allclose(solver.y, expected, rtol=0.0, atol=2e-9)
    # Directional derivatives, column by column.
    rates(1.0, solver.y)
    derivatives = [f"der({name})" for name in states]
    for column in range(x0.size):
        e = np.eye(x0.size)[column]
        difference = (rates(1.0, solver.y + 1e-6 * e) - rates(1.0, solver.y - 1e-6 * e)) / 2e-6
        rates(1.0, solver.y)
        np.testing.assert_allclose(
            model.directional(derivatives, states, e), difference, rtol=1e-5, atol=1e-5
        )
    model.close()
    slave.close()


def pointer(array: Array) -> object:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


# Invalid values


@pytest.mark.parametrize(("version", "name"), EVERY)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300, -1e200])
def test_an_invalid_input_leaves_the_instance_unchanged(
    fmus: Path, version: int, name: str, value: float, capfd: object
) -> None:
    """The set call or the step rejects the input if the result would not be finite."""
    instance = Instance(path_of(fmus, version, name)).initialise()
    instance.step(0.0, MS)
    for wrong in instance.inputs:
        good = {name: instance.get(name) for name in instance.inputs}
        # Read the outputs before saving, because reading computes the outputs.
        outputs, saved = instance.all_outputs(), instance.save()
        numbers = good[wrong].copy()
        numbers[-1] = value
        rejected = False
        try:
            instance.set(wrong, numbers)
            instance.step(MS, MS)
        except FMICallException:
            rejected = True
        assert rejected or abs(value) < np.inf
        if rejected:
            for key, numbers in good.items():
                instance.set(key, numbers)
            assert instance.all_outputs().tobytes() == outputs.tobytes()
            assert instance.save() == saved, wrong
        else:
            instance.restore(saved)
        instance.step(MS, MS)
        instance.restore(saved)
    instance.close()


# Many instances


def test_a_hundred_instances_on_eight_threads_agree_and_release_their_memory(
    fmus: Path,
) -> None:
    path = path_of(fmus, 3, "free_flyer")
    description, folder = read_model_description(str(path)), fmpy.extract(str(path))
    names = {variable.name: variable.valueReference for variable in description.modelVariables}

    def once() -> bytes:
        made = [
            FMU3Slave(
                guid=description.guid,
                unzipDirectory=folder,
                modelIdentifier=path.stem,
                instanceName=f"number {i}",
            )
            for i in range(100)
        ]
        results = [b""] * len(made)

        def work(which: int) -> None:
            for i in range(which, len(made), 8):
                made[i].instantiate()
                made[i].enterInitializationMode(startTime=0.0)
                made[i].exitInitializationMode()
                made[i].setFloat64([names["joint_torque"]], [0.1, -0.2, 0.3, 0.1, 0.0, 0.05])
                for k in range(100):
                    made[i].doStep(k * MS, MS)
                results[i] = np.array(
                    made[i].getFloat64([names["end_effector_velocity"]], nValues=6)
                ).tobytes()

        threads = [threading.Thread(target=work, args=(which,)) for which in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for instance in made:
            instance.terminate()
            instance.freeInstance()
        assert len(set(results)) == 1
        return results[0]

    assert once() == once()
    # FMPy leaks 4 kB per instance. An FMU instance has 9 kB. After 4000 repetitions, a leak of FMU
    # instances differs clearly from FMPy's leak.
    slave = FMU3Slave(
        guid=description.guid,
        unzipDirectory=folder,
        modelIdentifier=path.stem,
        instanceName="again",
    )

    def again(times: int) -> None:
        for _ in range(times):
            slave.instantiate()
            slave.fmi3FreeInstance(slave.component)
        gc.collect()

    again(200)
    before = resident()
    again(4000)
    assert resident() - before < 10e6  # 36e6 if instances were leaked
    shutil.rmtree(folder)


def resident() -> float:
    """Return the resident memory of this process [bytes]."""
    pages = (
        int(Path("/proc/self/statm").read_text().split()[1])
        if Path("/proc/self/statm").exists()
        else 0
    )
    return float(pages * resource.getpagesize())
