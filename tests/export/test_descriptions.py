"""Content of the descriptions: capabilities, units, terminals; size of the FMU files."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree
from zipfile import ZipFile

import fmpy
import numpy as np
import pytest
from fmpy.model_description import read_model_description

from freeflyer.foundation.errors import CosimError
from freeflyer.scenario import scenario
from freeflyer.scenario.assemble import assembled
from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.robot.robot import Robot

VERSIONS = (2, 3)
EVERY = [(version, name) for version in VERSIONS for name in BLOCKS]


def path_of(fmus: Path, version: int, name: str) -> Path:
    return fmus / f"fmi{version}" / f"{name}.fmu"


@pytest.mark.parametrize(("version", "name"), EVERY)
def test_an_fmu_is_small(fmus: Path, version: int, name: str) -> None:
    assert path_of(fmus, version, name).stat().st_size < 400_000


@pytest.mark.parametrize(("version", "name"), EVERY)
def test_declared_capabilities_match_the_block(
    fmus: Path, robot: Robot, version: int, name: str
) -> None:
    with ZipFile(path_of(fmus, version, name)) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    slave, model = root.find("CoSimulation"), root.find("ModelExchange")
    sampled = BLOCKS[name](robot).is_sampled
    assert slave is not None
    assert (model is None) == sampled
    state = (
        ["canGetAndSetFMUstate", "canSerializeFMUstate"]
        if version == 2
        else ["canGetAndSetFMUState", "canSerializeFMUState"]
    )
    derivatives = {
        2: ["providesDirectionalDerivative"],
        3: ["providesDirectionalDerivatives", "providesAdjointDerivatives"],
    }
    inner = (
        []
        if version == 2 or sampled
        else ["providesIntermediateUpdate", "canReturnEarlyAfterIntermediateUpdate"]
    )
    memory = ["canNotUseMemoryManagementFunctions"] if version == 2 else []
    common = {*state, *derivatives[version], *memory}
    declared = {key for key, value in slave.attrib.items() if value == "true"}
    assert declared == {*common, *inner, "canHandleVariableCommunicationStepSize"}
    if model is not None:
        assert {key for key, value in model.attrib.items() if value == "true"} - common <= {
            "completedIntegratorStepNotNeeded"
        }


@pytest.mark.parametrize("version", VERSIONS)
def test_angles_are_displayed_in_degrees_and_units_are_products_of_si_units(
    fmus: Path, version: int
) -> None:
    description = read_model_description(str(path_of(fmus, version, "free_flyer")))
    units = {unit.name: unit for unit in description.unitDefinitions}
    assert units["rad"].displayUnits[0].name == "deg"
    assert float(units["rad"].displayUnits[0].factor) == pytest.approx(180.0 / np.pi)
    newton_metre = units["N.m"].baseUnit
    assert (newton_metre.kg, newton_metre.m, newton_metre.s) == (1, 2, -2)
    names = {variable.name: variable for variable in description.modelVariables}
    element = "der(joint_velocity[1])" if version == 2 else "der(joint_velocity)"
    assert names[element].unit == "rad/s2"


TERMINAL_CONNECTIONS = (
    "free_flyer.base <-> manipulator_controller.base",
    "free_flyer.base <-> base_controller.base",
    "free_flyer.arm <-> manipulator_controller.arm",
    "free_flyer.arm <-> base_controller.arm",
    "free_flyer.hand <-> manipulator_controller.hand",
    "reference_trajectory.reference <-> manipulator_controller.reference",
    "reference_trajectory.reference <-> base_controller.reference",
    "manipulator_controller.ports <-> base_controller.ports",
)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_terminals_connect_the_loop_with_nine_lines(tmp_path: Path, fmi: int) -> None:
    """Connections and results are the same as with single connections."""
    written = scenario.load("multirate_passive", ["stop_s=0.6"])
    text = written.source.partition("connections = [")[
        0
    ] + f"connections = {list(TERMINAL_CONNECTIONS)}\n".replace("'", '"')
    text += 'delayed = ["base_controller.applied <-> manipulator_controller.applied"]\n'
    text += "[record]" + written.source.partition("[record]")[2]
    (tmp_path / "by_terminals.toml").write_text(text)
    records = []
    for chosen in (written, scenario.load(str(tmp_path / "by_terminals.toml"))):
        with assembled(chosen, fmi) as (master, _):
            wires = {(str(c), c.delayed) for c in master.graph.connections}
            records.append((wires, master.run().record["free_flyer.joint_position"].tobytes()))
    assert len(records[0][0]) == 25
    assert records[0] == records[1]


def test_invalid_terminals_are_reported_by_name(tmp_path: Path) -> None:
    (tmp_path / "same.toml").write_text(
        'extends = "multirate_passive"\nconnections = ["free_flyer.arm <-> manipulator_controller.arm"]\n'
    )
    with assembled(scenario.load(str(tmp_path / "same.toml"))) as (master, _):
        assert len(master.graph.connections) == 25  # the same as with single connections
    for wrong, sentence in (
        (
            "free_flyer.bas <-> base_controller.base",
            "component 'free_flyer' has no terminal 'bas'; did you mean 'base'",
        ),
        ("free_flier.base <-> base_controller.base", "there is no component 'free_flier'"),
        (
            "free_flyer.hand <-> base_controller.base",
            "no output of one terminal is an input of the other",
        ),
    ):
        (tmp_path / "a.toml").write_text(
            f'extends = "multirate_passive"\nconnections = ["{wrong}"]\n'
        )
        with (
            pytest.raises(CosimError, match=sentence),
            assembled(scenario.load(str(tmp_path / "a.toml"))),
        ):
            pass


def test_terminals_conform_to_the_standards_schema(fmus: Path) -> None:
    from lxml import etree

    schema = etree.XMLSchema(
        file=str(Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd")
    )
    for name in ("free_flyer", "manipulator_controller", "base_controller", "reference_trajectory"):
        with ZipFile(path_of(fmus, 3, name)) as archive:
            data = archive.read("terminalsAndIcons/terminalsAndIcons.xml")
            names = {
                variable.name
                for variable in read_model_description(str(path_of(fmus, 3, name))).modelVariables
            }
        schema.assertValid(etree.fromstring(data))
        members = ElementTree.fromstring(data).iter("TerminalMemberVariable")
        assert {member.get("variableName") for member in members} <= names
