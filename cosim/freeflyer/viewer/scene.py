"""Geometry of the robot of a run: the file scene.json in the FMU of its plant."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from freeflyer.fmi import archive, fmu_description
from freeflyer.fmi.archive import ArchiveError
from freeflyer.foundation.equal_inertia_box import equal_inertia_box
from freeflyer.foundation.errors import CosimError, RecordError, one_line
from freeflyer.foundation.temporary_folder import TemporaryFolder
from freeflyer.scenario.assemble import OF_FMUS, find_fmu
from freeflyer.scenario.scenario import Scenario

ENTRY = "extra/org.freeflyer/scene.json"
FORMAT = 1
LARGEST = 64 << 20
"""Largest accepted size [bytes] of a scene."""
Scene = dict[str, Any]


def of_fmu(path: Path) -> Scene | None:
    """Return the scene in an FMU, or None if it has none.

    Raises RecordError if the scene is damaged. Raises ComponentError or OSError if the FMU cannot
    be read.
    """
    with fmu_description.opened(path) as content:
        if ENTRY not in content.names:
            return None
        try:
            return checked(json.loads(content.read(ENTRY, LARGEST)), str(path))
        except (ArchiveError, ValueError, RecursionError) as error:
            raise RecordError(f"the scene in {path} cannot be read: {one_line(error)}") from error


def checked(found: Any, where: str) -> Scene:
    """Return a scene, if it has the expected structure. Raises RecordError otherwise."""
    try:
        if found["format"] != FORMAT:
            raise RecordError(f"the scene in {where} has format {found['format']!r}; format {FORMAT} is expected")  # fmt: skip
        for joint in found["joints"]:
            _ = [*map(float, (*joint["position"], *joint["orientation"]))], joint["name"]
            if joint["kind"] not in ("revolute", "prismatic"):
                raise ValueError(f"a joint of kind {joint['kind']!r}")
        frames = range(len(found["joints"]) + 2)
        for part in (*found["visuals"], *found["bodies"]):
            if part["frame"] not in frames:
                raise ValueError(f"a body in frame {part['frame']!r}")
    except (LookupError, TypeError, ValueError) as error:
        raise RecordError(f"the scene in {where} is damaged: {one_line(error)}") from error
    result: Scene = found
    return result


def of_scenario(
    scenario: Scenario,
    parameters: Mapping[str, Mapping[str, Any]],
    tokens: Mapping[str, str] | None = None,
) -> tuple[Scene | None, list[str]]:
    """Return the scene of the first component with a scene, and notes about what is missing.

    `parameters` are those of the run. The masses of the scene are replaced by them. `tokens` are
    the instantiation tokens of the FMUs of the run, if they are known.
    """
    notes = []
    with TemporaryFolder() as folder, suppress(CosimError, OSError, ArchiveError):
        if scenario.ssp is not None:
            _unpack_fmus(Path(scenario.ssp["path"]), folder)
        for spec in scenario.components:
            if spec.kind not in OF_FMUS:
                continue
            try:
                path = find_fmu(spec.name, spec.options, scenario.directory)
                # The FMUs of an SSP file were unpacked during the run only.
                path = path if scenario.ssp is None else folder / path.name
                scene = of_fmu(path)
            except (CosimError, OSError) as error:
                notes.append(f"no geometry from component {spec.name}: {one_line(error)}")
                continue
            if scene is not None:
                token = (tokens or {}).get(spec.name)
                changed = token is not None and token != fmu_description.describe_fmu(path).guid
                notes = [f"the geometry is that of {path}, which is not the FMU of the run"] if changed else []  # fmt: skip
                return with_parameters(scene, parameters.get(spec.name, {})), notes
    return None, [*notes, "the run has no geometry: no FMU of the scenario contains a scene; give the robot with --robot FILE"]  # fmt: skip


def _unpack_fmus(path: Path, folder: Path) -> None:
    """Write the FMUs in an SSP file into a folder. Raises OSError or ArchiveError."""
    with archive.opened(path) as package:
        for name in package.names:
            if name.lower().endswith(".fmu"):
                package.extract(name, folder / name.rpartition("/")[2])


def with_parameters(scene: Scene, parameters: Mapping[str, Any]) -> Scene:
    """Return a scene with the masses, centres of mass and inertias of a run [kg, m, kg m2].

    If the base is drawn as a box of equal inertia, the box has the values of the run.
    """
    result = copy.deepcopy(scene)
    factor = parameters.get("arm_mass_factor", 1.0)
    for body in result["bodies"]:
        name = body.get("name")
        if name in ("base", "tool"):
            for key in ("mass", "centre_of_mass", "inertia"):
                body[key] = parameters.get(f"{name}_{key}", body[key])
        else:
            body["mass"] *= factor
            body["inertia"] = [factor * value for value in body["inertia"]]
    base = next((body for body in result["bodies"] if body.get("name") == "base"), None)
    if result.get("drawn") == "inertia" and base is not None:
        shapes = [shape for shape in result["visuals"] if shape.get("name") == "base"]
        for shape in shapes[:1]:
            size, orientation = equal_inertia_box(base["mass"], base["inertia"])
            shape.update(size=list(size), orientation=list(orientation))
    return result
