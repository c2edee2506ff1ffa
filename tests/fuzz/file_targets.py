"""Untrusted FMUs, SSP files and DBC files.

FMUs are read up to their description, SSP files up to their scenario.
"""

from __future__ import annotations

import atexit
import io
import os
import re
import shutil
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from random import Random

import link_targets
import mutation
from target import Target

from freeflyer.fmi.fmu_description import DESCRIPTION, MOST_NUMBERS, opened, ports_in, terminals_of
from freeflyer.foundation.errors import ComponentError, CosimError
from freeflyer.ssp import read as ssp_read
from freeflyer_adapters.arm.frames import ArmFrames, FrameMapping
from freeflyer_adapters.foundation.errors import DeviceError
from freeflyer_fmus.export.prebuilt import directory as fmus

SMALL_2 = b"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="some" guid="{0}">
  <CoSimulation modelIdentifier="some"/>
  <UnitDefinitions><Unit name="m"/></UnitDefinitions>
  <TypeDefinitions><SimpleType name="Kind"><Enumeration><Item name="a" value="1"/></Enumeration></SimpleType></TypeDefinitions>
  <ModelVariables>
    <ScalarVariable name="x" valueReference="0" causality="output"><Real unit="m"/></ScalarVariable>
    <ScalarVariable name="y" valueReference="1" causality="output"><Real unit="m"/></ScalarVariable>
    <ScalarVariable name="u" valueReference="2" causality="input"><Real start="1.5"/></ScalarVariable>
    <ScalarVariable name="k" valueReference="3" causality="parameter" variability="fixed"><Enumeration declaredType="Kind" start="1"/></ScalarVariable>
    <ScalarVariable name="b" valueReference="4" causality="parameter" variability="fixed"><Boolean start="true"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure><Outputs><Unknown index="1" dependencies="3"/><Unknown index="2"/></Outputs></ModelStructure>
</fmiModelDescription>"""
SMALL_3 = b"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="some" instantiationToken="{0}">
  <CoSimulation modelIdentifier="some"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Float64 name="x" valueReference="1" causality="output"><Dimension start="3"/><Dimension start="2"/></Float64>
    <Float64 name="u" valueReference="2" causality="input" start="1 2"><Dimension start="2"/></Float64>
    <Boolean name="b" valueReference="4" causality="parameter" variability="fixed" start="true"/>
    <String name="s" valueReference="5" causality="parameter" variability="fixed"><Start value="x"/></String>
  </ModelVariables>
  <ModelStructure><Output valueReference="1" dependencies="2"/></ModelStructure>
</fmiModelDescription>"""
SSD = b"""<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
 xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
 version="1.0" name="s">
 <ssd:System name="root"><ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues><ssv:ParameterSet version="1.0" name="p">
  <ssv:Parameters><ssv:Parameter name="a.u"><ssv:Real value="2.5" unit="m"/></ssv:Parameter></ssv:Parameters></ssv:ParameterSet>
  </ssd:ParameterValues></ssd:ParameterBinding></ssd:ParameterBindings>
  <ssd:Elements>
   <ssd:Component name="a" type="application/x-fmu-sharedlibrary" source="resources/a.fmu"><ssd:Connectors>
    <ssd:Connector name="u" kind="input"/><ssd:Connector name="x" kind="output"/></ssd:Connectors></ssd:Component>
   <ssd:System name="inner"><ssd:Connectors><ssd:Connector name="y" kind="input"/></ssd:Connectors><ssd:Elements>
    <ssd:Component name="b" type="application/x-fmu-sharedlibrary" source="resources/a.fmu"/></ssd:Elements><ssd:Connections>
    <ssd:Connection startConnector="y" endElement="b" endConnector="u"/></ssd:Connections></ssd:System>
  </ssd:Elements>
  <ssd:Connections><ssd:Connection startElement="a" startConnector="x" endElement="inner" endConnector="y"/></ssd:Connections>
 </ssd:System>
 <ssd:DefaultExperiment startTime="0.0" stopTime="0.6"/>
</ssd:SystemStructureDescription>"""


def packed(files: Mapping[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data, method)
    return file.getvalue()


def _descriptions() -> list[bytes]:
    own = []
    for version in (2, 3):
        with zipfile.ZipFile(fmus() / f"fmi{version}" / "base_controller.fmu") as archive:
            own.append(archive.read(DESCRIPTION))
    return [SMALL_2, SMALL_3, *own]


DESCRIPTIONS = _descriptions()
FMU = packed(
    {DESCRIPTION: SMALL_2, "binaries/linux64/some.so": b"no library", "resources/x.txt": b"x" * 500}
)
NUMBERS = (
    b"0",
    b"-1",
    b"1e400",
    b"99999999999999999999",
    b"4294967296",
    b"1000000000000",
    b"nan",
    b"",
    b"x",
    b"1 2 3",
    b"%s",
    b"9**9**9**9",
)


def _attributes(rng: Random, text: bytes) -> bytes:
    """Mutate values of attributes, or remove and repeat elements; the result remains XML."""
    for _ in range(rng.randrange(1, 5)):
        parts = text.split(b'"')
        k = rng.randrange(len(parts) // 2) * 2 + 1 if len(parts) > 2 else 0
        kind = rng.random()
        if kind < 0.6:
            parts[k] = rng.choice((*NUMBERS, rng.choice(parts[1::2] or [b""])))
            text = b'"'.join(parts)
            continue
        lines = text.split(b"\n")
        whole = [i for i, line in enumerate(lines) if _is_whole(line)]
        if whole:
            i = rng.choice(whole)
            lines[i : i + rng.randrange(2)] = [lines[rng.choice(whole)]] * rng.randrange(3)
        text = b"\n".join(lines)
    return text


def _is_whole(line: bytes) -> bool:
    """Return whether a line contains exactly one complete element."""
    line = line.strip()
    return line.endswith(b"/>") and line.startswith(b"<") and line.count(b"<") == 1


def _numbers(rng: Random, text: bytes) -> bytes:
    for _ in range(rng.randrange(1, 4)):
        found = list(re.finditer(rb"-?\d+(\.\d+)?", text))
        if not found:
            break
        k = rng.choice(found)
        text = (
            text[: k.start()]
            + rng.choice((*NUMBERS, *DBC_NUMBERS, b"%d" % rng.randrange(300)))
            + text[k.end() :]
        )
    return text


def _xml(rng: Random, seeds: list[bytes]) -> bytes:
    return (
        _attributes(rng, rng.choice(seeds)) if rng.random() < 0.7 else mutation.damaged(rng, seeds)
    )


def fmu(rng: Random) -> bytes:
    if rng.random() < 0.4:
        return mutation.damaged(rng, [FMU])
    return packed({DESCRIPTION: _xml(rng, DESCRIPTIONS)}, zipfile.ZIP_STORED)


def ssp(rng: Random) -> bytes:
    files = {"SystemStructure.ssd": SSD, "resources/a.fmu": FMU}
    if rng.random() < 0.2:
        return mutation.damaged(rng, [packed(files)])
    return packed(files | {"SystemStructure.ssd": _xml(rng, [SSD])}, zipfile.ZIP_STORED)


_place: list[Path] = []


def _folder() -> Path:
    if not _place:
        kept = tempfile.TemporaryDirectory(
            prefix="freeflyer-fuzz-", dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None
        )
        atexit.register(kept.cleanup)
        _place.append(Path(kept.name))
    return _place[0]


def read_fmu(data: bytes) -> str:
    folder = _folder()
    path, inside = folder / "fuzz.fmu", folder / "inside"
    path.write_bytes(data)
    inside.mkdir()
    try:
        ports, groups = ports_in(path)
        terminals_of(path)
        assert ports.keys() == groups.keys()
        assert sum(port.size for port in ports.values()) <= MOST_NUMBERS
        with opened(path) as archive:
            archive.extract_all(inside)
        return "description"
    finally:
        assert sorted(entry.name for entry in folder.iterdir()) == ["fuzz.fmu", "inside"], (
            "files outside the folder"
        )
        shutil.rmtree(inside)


def read_ssp(data: bytes) -> str:
    folder = _folder()
    path, inside = folder / "fuzz.ssp", folder / "inside"
    path.write_bytes(data)
    inside.mkdir()
    try:
        found = ssp_read.read(path, inside, step=0.01)
        assert found.components
        assert not found.devices
        assert all(component.kind in ("fmu", "model_exchange") for component in found.components), (
            "a component that is not an FMU"
        )
        return "scenario"
    finally:
        assert sorted(entry.name for entry in folder.iterdir() if entry.name != "fuzz.fmu") == [
            "fuzz.ssp",
            "inside",
        ], "files outside the folder"
        shutil.rmtree(inside)
        path.unlink()


DBC_NUMBERS = (
    b"1",
    b"2",
    b"8",
    b"16",
    b"63",
    b"64",
    b"0.5",
    b"-0.0",
    b"1e308",
    b"1e-308",
    b"2147484161",
    b"512",
)
DBCS = [link_targets.OWN_DBC.encode()]


def dbc(rng: Random) -> bytes:
    return _numbers(rng, rng.choice(DBCS)) if rng.random() < 0.7 else mutation.damaged(rng, DBCS)


def read_dbc(data: bytes) -> str:
    path = _folder() / "fuzz.dbc"
    path.write_bytes(data)
    try:
        arm = ArmFrames(FrameMapping(dbc=path, **link_targets.OWN_MAPPING), 2)  # type: ignore[arg-type]
        for frame in (arm.command, arm.state):
            values = frame.unpack(
                frame.pack(
                    {role: [f.most for f in fields] for role, fields in frame.fields.items()}
                )
            )
            link_targets.check_values(arm, frame, values)
        assert (arm.command.identifier, arm.command.extended) != (
            arm.state.identifier,
            arm.state.extended,
        )
        # The mapping has all roles that an activation needs, whatever the numbers are.
        arm.check_activation("arm", implicit=False)
        assert not arm.cannot_refuse(implicit=False)
    finally:
        path.unlink()
    return "frames"


FMU_TARGET = Target(name="fmu", generate=fmu, call=read_fmu, allowed=(ComponentError,))
SSP_TARGET = Target(name="ssp", generate=ssp, call=read_ssp, allowed=(CosimError,))
DBC_TARGET = Target(name="dbc", generate=dbc, call=read_dbc, allowed=(DeviceError,))
