"""Untrusted scenario files and `--set` strings: the reader and the options of devices.

FMUs are not loaded.
"""

from __future__ import annotations

import atexit
import dataclasses
import json
import math
import os
import tempfile
import tomllib
from pathlib import Path
from random import Random

import mutation
import toml_mutation
from target import Target

from freeflyer.foundation.errors import CosimError
from freeflyer.master.connection import Connection
from freeflyer.scenario import scenario
from freeflyer_adapters.arm import options as arm_options
from freeflyer_adapters.base import options as link_options
from freeflyer_adapters.facility import settings as facility_settings

SEEDS = [path.read_bytes() for path in sorted(scenario.SHIPPED.glob("*.toml"))]
TABLES = [tomllib.loads(seed.decode()) for seed in SEEDS]
SEPARATOR = b"\x00--set\x00"
"""Separator of the file and its overrides in an input."""
OVERRIDES = [
    b"base_controller.period=0.1", b"stop_s=2", b"exchange=parallel", b"robot.base_mass=160", b"devices.arm.channel='x'", b"facility.delay=0.1",
    b"record.every_s=0.02", b"base_controller.step_s=300 ms", b"base_controller.gain=[1, 2]", b"devices.arm.parameters.x={value=1, unit='deg'}",
    b"record.signals=[]", b"x=1e400", b"facility..x=1", b"devices.arm.parameters.a.b.c=1", b"a.b", b"=", b"..=1", b"record.every_s=" + b"9" * 5000,
    b"stop_s=" + b"[" * 2000, b"a." * 600 + b"b=1", b"free_flyer.x=\xff", b"robot.x=1 furlong", b"stop_s=0xffffffffffffffffffffff",
]  # fmt: skip
DEVICES = {"can_arm": arm_options.options_from, "zenoh_base": link_options.options_from}


def generate(rng: Random) -> bytes:
    kind = rng.random()
    if kind < 0.01:
        deep = rng.choice((b"[", b"{a=", b"[{a=", b"a.")) * rng.choice(
            (39, 41, 200, 400, 1000, 5000)
        )
        data = rng.choice(SEEDS) + b"\n[deep]\n" + (b"" if deep[:1] == b"a" else b"x = ") + deep
    elif kind < 0.3:
        data = mutation.damaged(rng, SEEDS)
    else:
        table = toml_mutation.copy.deepcopy(rng.choice(TABLES))
        for _ in range(rng.randrange(1, 5)):
            toml_mutation.mutate(rng, table, TABLES)
        data = toml_mutation.emit(table).encode("utf-8", "surrogatepass")
        if kind > 0.9:
            data = mutation.damaged(rng, [data], most=2)
    if rng.random() < 0.25:
        texts = [
            mutation.damaged(rng, OVERRIDES, most=2)
            if rng.random() < 0.5
            else rng.choice(OVERRIDES)
            for _ in range(rng.randrange(1, 3))
        ]
        data = SEPARATOR.join([data, *texts])
    return data


def _folder() -> Path:
    """Return a folder with files that an attacker can refer to.

    It contains a parent, a file that extends the input again, a FIFO and a device.
    """
    kept = tempfile.TemporaryDirectory(
        prefix="freeflyer-fuzz-", dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    )
    atexit.register(kept.cleanup)
    folder = Path(kept.name)
    (folder / "beside.toml").write_text('extends = "multirate_passive"\n')
    (folder / "back.toml").write_text('extends = "fuzz.toml"\n')
    os.mkfifo(folder / "fifo.toml")
    (folder / "zero.toml").symlink_to("/dev/zero")
    return folder


_place: list[Path] = []


def load(data: bytes) -> str:
    if not _place:
        _place.append(_folder())
    text, *overrides = data.split(SEPARATOR)
    path = _place[0] / "fuzz.toml"
    path.write_bytes(text)
    # Decode the overrides as Python decodes a command line.
    found = scenario.load(str(path), [os.fsdecode(override) for override in overrides])
    _check(found)
    outcome = "scenario"
    try:
        for device in found.devices:
            if device.kind in DEVICES:
                DEVICES[device.kind](device.name, device.options, found.directory)
        facility_settings.read(found.facility)
    except CosimError as error:
        outcome = f"scenario, then {type(error).__name__}"
    return outcome


def _check(found: scenario.Scenario) -> None:
    assert found.components
    assert isinstance(found.title, str)
    assert isinstance(found.paper, str)
    for time in (found.stop, found.record_every):
        assert type(time) is int
        assert 0 < time < 2**63
    for component in (*found.components, *found.devices):
        assert component.name.isidentifier()
        assert (type(component.step) is int and 0 < component.step < 2**63) or str(
            component.step
        ).startswith("=")
        assert isinstance(component.parameters, dict)
        assert component.samples in (True, False, None)
    assert {device.name for device in found.devices} <= {
        component.name for component in found.components
    }
    assert all(isinstance(connection, Connection) for connection in found.connections)
    for limit in found.limits:
        assert not math.isnan(limit.bound)
        assert 0 <= limit.lasting < 2**63
        assert limit.elements is None or 1 <= limit.elements[0] <= limit.elements[1]
    again = scenario.from_tables(tomllib.loads(found.source), _place[0] / "fuzz.toml")
    again = dataclasses.replace(again, changes=found.changes)  # the source contains the changes
    assert _plain(again) == _plain(found), "its source gives another scenario"


def _plain(one: scenario.Scenario) -> str:
    """Return the scenario as text with sorted keys, so that NaN equals NaN."""
    return json.dumps(
        dataclasses.asdict(dataclasses.replace(one, source="")), sort_keys=True, default=repr
    )


SCENARIO = Target(name="scenario", generate=generate, call=load, allowed=(CosimError,))
