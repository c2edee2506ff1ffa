"""Tests of `[roles]`: the prediction of a plant with renamed variables."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from freeflyer.analysis.prediction.predict import predict
from freeflyer.foundation.errors import CosimError
from freeflyer.scenario import scenario
from freeflyer_fmus.export.prebuilt import directory

NAMES = {
    "base_position": "r_b",
    "base_orientation": "attitude",
    "base_velocity": "twist",
    "base_wrench": "thrust",
    "end_effector_position": "r_e",
}
ROLES = "\n".join(f'{role} = "chaser.{name}"' for role, name in NAMES.items())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with `chaser.fmu`, the shipped plant with renamed variables."""
    made = tmp_path_factory.mktemp("roles")
    with (
        zipfile.ZipFile(directory() / "fmi2" / "free_flyer.fmu") as plant,
        zipfile.ZipFile(made / "chaser.fmu", "w") as chaser,
    ):
        for name in plant.namelist():
            data = plant.read(name)
            if name == "modelDescription.xml":
                for old, new in NAMES.items():
                    data = data.replace(f'"{old}['.encode(), f'"{new}['.encode())
                    data = data.replace(f'"der({old}['.encode(), f'"der({new}['.encode())
            chaser.writestr(name, data)
    return made


def chosen(folder: Path, roles: str) -> scenario.Scenario:
    """Return the shipped scenario with `chaser` instead of `free_flyer`."""
    text = (scenario.SHIPPED / "_free_flyer_loop.toml").read_text()
    for old, new in NAMES.items():
        text = text.replace(f"free_flyer.{old}", f"chaser.{new}")
    text = text.replace("free_flyer", "chaser").replace(
        "[components.chaser]", '[components.chaser]\nfmu = "chaser.fmu"'
    )
    (folder / "renamed.toml").write_text(f"{text}\n[roles]\n{roles}\n")
    return scenario.load(str(folder / "renamed.toml"))


def test_the_prediction_does_not_depend_on_the_names_of_variables(folder: Path) -> None:
    renamed, shipped = predict(chosen(folder, ROLES)), predict(scenario.load("multirate_unstable"))
    assert renamed.largest_stable_s == shipped.largest_stable_s
    assert renamed.own.growth_rate == shipped.own.growth_rate
    assert renamed.limit is not None
    assert shipped.limit is not None
    assert renamed.limit.description() == shipped.limit.description()


@pytest.mark.parametrize(
    ("left_out", "expected"),
    [
        ("base_orientation", r"attitude has four elements of norm 1; .*orientations = "),
        ("base_velocity", r'no variable \'base_velocity\'; .*base_velocity = "chaser.VARIABLE"'),
    ],
)
def test_the_error_names_a_missing_role(folder: Path, left_out: str, expected: str) -> None:
    roles = "\n".join(line for line in ROLES.splitlines() if not line.startswith(left_out))
    with pytest.raises(CosimError, match=expected):
        predict(chosen(folder, roles))


@pytest.mark.parametrize(
    ("roles", "expected"),
    [
        ('base_positon = "chaser.r_b"', r"unknown key 'base_positon' in \[roles\]; did you mean"),
        ('base_position = "chaser.r_c"', r"roles.base_position: .* no variable 'r_c'"),
        (
            'base_position = "chasr.r_b"',
            r"roles.base_position: there is no component 'chasr'; did you mean 'chaser'",
        ),
        ('base_velocity = "chaser.kinetic_energy"', "has 1 elements; 6 are expected"),
        ('orientations = ["chaser.r_b"]', "has 3 elements; 4 are expected"),
        ('end_effector_velocity = "chaser.twist"\nbase_velocity = "chaser.twist"', "has two roles"),
        ('base_wrench = "chaser.end_effector_velocity"', "has two roles"),
        (
            'base_position = "reference_trajectory.position"',
            "is reference_trajectory.position; a variable of chaser is expected",
        ),
        (
            'passivity_control = ["base_controller.stiffness"]',
            "base_controller.stiffness is not a Boolean parameter",
        ),
        ("base_position = 1", r"roles.base_position is 1; COMPONENT.VARIABLE is expected"),
        ('orientations = ["a", 1]', r"a list of COMPONENT.VARIABLE is expected"),
    ],
)
def test_invalid_roles_are_rejected(folder: Path, roles: str, expected: str) -> None:
    with pytest.raises(CosimError, match=expected):
        predict(chosen(folder, roles))
