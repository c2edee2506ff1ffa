"""A block in a loop of one's own: values, states, outputs, derivatives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import freeflyer as ff
from freeflyer_fmus import InProcessBlock, export_fmus, load_robot


@pytest.fixture(scope="module")
def plant() -> InProcessBlock:
    block = InProcessBlock("free_flyer")
    block.start()
    return block


def test_the_outputs_follow_an_assigned_state(plant: InProcessBlock) -> None:
    other = InProcessBlock("free_flyer")
    posture = [0.1, 0.5, -0.3, 1.0, 0.2, 0.4]
    other.start({"joint_position": posture})
    plant.x = other.x
    for name in ("end_effector_position", "joint_position"):
        np.testing.assert_array_equal(plant.value(name), other.value(name))


def test_an_option_is_set_by_its_name() -> None:
    block = InProcessBlock("base_controller")
    block.start({"discretisation": "matched"})
    named = block.value("discretisation").copy()
    block.set("discretisation", "emulated")
    assert named != block.value("discretisation")


def test_the_linearisation_of_a_sampled_block_is_that_of_its_samples() -> None:
    block = InProcessBlock("base_controller")
    block.start({"period": 0.1})
    outputs = block.block.having("output")
    D, columns = block.linearise().D, []
    size, place = 1e-6, 0
    for variable in block.block.having("input"):
        for i in range(variable.size):
            answers = []
            for sign in (1.0, -1.0):
                again = InProcessBlock(block.block)
                again.start({"period": 0.1})
                again.value(variable.name)[i] += sign * size
                again.step(0.0, 0.1)
                answers.append(np.concatenate([again.value(v.name).copy() for v in outputs]))
            columns.append((answers[0] - answers[1]) / (2.0 * size))
            place += 1
    np.testing.assert_allclose(D, np.array(columns).T, atol=1e-6)


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (lambda b: b.set("joint_torque", "a"), "a number or a vector of numbers is expected"),
        (lambda b: b.set("joint_torque", 1j), "a number or a vector of numbers is expected"),
        (lambda b: b.set("joint_torque", np.ones((6, 1))), "a vector of numbers is expected"),
        (lambda b: b.set("joint_torque", [1.0, 2.0]), "2 numbers; 6 are expected"),
        (lambda b: b.set("end_effector_position", 1.0), "is an output"),
        (lambda b: setattr(b, "x", np.ones(3)), "3 numbers; 25 are expected"),
        (lambda b: b.derivatives(0.0, np.ones(3)), "3 numbers; 25 are expected"),
        (lambda b: InProcessBlock(3), "the block is 3 of type int"),  # type: ignore[arg-type]
        (lambda b: InProcessBlock("base_controller").rates(), "has no derivatives"),
        (lambda b: InProcessBlock("base_controller").set("discretisation", "x"), "emulated or matched"),
        (lambda b: InProcessBlock("base_controller").step(0.0, 99.0), "passes over a sample"),
        (lambda b: load_robot(None), "the robot is None"),  # type: ignore[arg-type]
        (lambda b: export_fmus("fmus", platforms=["riscv"]), "'riscv' is not one of"),
    ],
)  # fmt: skip
def test_a_wrong_argument_is_one_sentence(
    plant: InProcessBlock, call: Callable[[InProcessBlock], object], expected: str
) -> None:
    with pytest.raises(ff.CosimError) as caught:
        call(plant)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)
