"""SSP files follow the standard and are read back without loss; errors are reported in one line."""

from __future__ import annotations

import struct
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest
from commands import run_command
from families import family
from lxml import etree

from freeflyer.cli import main as command
from freeflyer.fmi import archive as archives
from freeflyer.foundation.errors import CosimError
from freeflyer.scenario import assemble, experiment, scenario
from freeflyer.ssp import read as ssp_read
from freeflyer.ssp import write as ssp_write

SSD = "SystemStructure.ssd"
SCENARIOS = [
    name for name in scenario.shipped() if name != "continuous"
]  # that one is the same loop with one FMU more
CHANGED = ["stop_s=0.6", "manipulator_controller.observer=tracking", "free_flyer.base_mass=151.0"]
CHANGED += [
    "manipulator_controller.base_passivity_control=false",
    "base_controller.stiffness=[140, 150, 150, 40, 40, 40]",
]


def export(name: str, path: Path, fmi: int, changes: list[str]) -> None:
    chosen = scenario.load(name, changes)
    with assemble.loaded(chosen, fmi) as system:
        ssp_write.write(chosen, system, path)


@pytest.fixture(scope="module", params=[2, 3])
def version(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture(scope="module")
def packed(version: int, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ssp") / "loop.ssp"
    export("multirate_passive", path, version, CHANGED)
    return path


# Export and import


@pytest.mark.parametrize("name", family(SCENARIOS, 2))
def test_a_system_from_an_ssp_file_gives_a_bit_identical_record(
    tmp_path: Path, version: int, name: str
) -> None:
    path = tmp_path / f"{name}.ssp"
    changes = CHANGED if name == "multirate_passive" else ["stop_s=0.6"]
    export(name, path, version, changes)
    there = scenario.load(name, changes)
    back = ssp_read.read(path, tmp_path / "unpacked")
    assert (back.limits, back.errors, back.expect, back.stop) == (
        there.limits,
        there.errors,
        there.expect,
        there.stop,
    )
    for number, (chosen, fmi) in enumerate(((there, version), (back, None))):
        result = experiment.run(chosen, fmi=fmi)
        result.outcome.record.write(tmp_path / f"{number}.parquet")
    assert (tmp_path / "0.parquet").read_bytes() == (tmp_path / "1.parquet").read_bytes()


def test_equal_systems_give_equal_files(packed: Path, version: int, tmp_path: Path) -> None:
    export("multirate_passive", tmp_path / "again.ssp", version, CHANGED)
    assert packed.read_bytes() == (tmp_path / "again.ssp").read_bytes()


def test_the_exchange_rule_is_exported_and_imported(tmp_path: Path) -> None:
    export("multirate_passive", tmp_path / "a.ssp", 2, ["exchange=parallel"])
    assert ssp_read.read(tmp_path / "a.ssp", tmp_path / "u").exchange == "parallel"


# Schemas of the standard


def schemas(version: int) -> Path:
    package, folder = (
        ("fmpy", "ssp/schema") if version == 2 else ("pyssp_standard", "resources/ssp2")
    )
    found = find_spec(package)
    if found is None or found.origin is None:
        pytest.skip(
            f"the schemas of SSP 2.0 come with {package}, which is not installed (pip install '.[peers]')"
        )
    return Path(found.origin).parent / folder


def test_every_description_is_valid_against_the_schema(packed: Path, version: int) -> None:
    kinds = {".ssd": "SystemStructureDescription.xsd", ".ssv": "SystemStructureParameterValues.xsd"}
    checked = []
    with zipfile.ZipFile(packed) as archive:
        for name in archive.namelist():
            if Path(name).suffix in kinds:
                root = etree.fromstring(archive.read(name))
                assert root.get("version") == {2: "1.0", 3: "2.0"}[version]
                schema = etree.XMLSchema(file=str(schemas(version) / kinds[Path(name).suffix]))
                schema.assertValid(root)
                checked.append(Path(name).suffix)
    assert sorted(checked) == [".ssd", ".ssv", ".ssv", ".ssv"]


def test_the_description_contains_units_steps_and_delays(packed: Path) -> None:
    with zipfile.ZipFile(packed) as archive:
        text = archive.read(SSD).decode()
        assert "resources/free_flyer.fmu" in archive.namelist()
    assert text.count('StepSizeHint value="0.001"') == 3
    assert text.count('StepSizeHint value="0.3"') == 1
    assert '<ssc:BaseUnit kg="1" m="2" s="-2" />' in text
    assert "freeflyer:Delayed" in text


# Invalid files


def changed(packed: Path, path: Path, old: str, new: str, entry: str = SSD) -> Path:
    with zipfile.ZipFile(packed) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    assert old.encode() in files[entry], old
    files[entry] = files[entry].replace(old.encode(), new.encode(), 1)
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return path


WRONG = [
    (
        'source="resources/free_flyer.fmu"',
        'source="../free_flyer.fmu"',
        "a file in the archive is expected",
    ),
    (
        'source="resources/free_flyer.fmu"',
        'source="http://x/free_flyer.fmu"',
        "a file in the archive is expected",
    ),
    (
        'source="resources/free_flyer.fmu"',
        'source="resources/free_flier.fmu"',
        "did you mean 'resources/free_flyer.fmu'",
    ),
    (' source="resources/free_flyer.fmu"', "", "component free_flyer has no source"),
    (
        'type="application/x-fmu-sharedlibrary"',
        'type="application/x-ssp-package"',
        "is of type application/x-ssp-package",
    ),
    (
        "<ssd:SystemStructureDescription ",
        "<!DOCTYPE a><ssd:SystemStructureDescription ",
        "declares a document type",
    ),
    ("encoding='UTF-8'", "encoding='utf-7'", "SystemStructure.ssd is not well-formed XML: "),
    ("<ssd:System ", "<", "is not well-formed XML"),
    ('stopTime="0.6"', 'stopTime="soon"', "the stop time is 'soon'; a number is expected"),
    ('stopTime="0.6"', 'stopTime="inf"', "the stop time is 'inf'; a number is expected"),
    (' stopTime="0.6"', "", "it has no stop time: set it with --set stop_s=SECONDS"),
    ('startTime="0.0"', 'startTime="10"', "only runs that start at 0 are supported"),
    (
        'StepSizeHint value="0.001"',
        'StepSizeHint value="-1"',
        "the step of component free_flyer is -1.0 s",
    ),
    ('StepSizeHint value="0.001"', 'StepSizeHint value="1e-320"', "at least 1e-9 s is expected"),
    ('implementation="CoSimulation"', 'implementation="Foo"', "has the implementation 'Foo'"),
    ("encoding='UTF-8'", "encoding='foo'", "is not well-formed XML"),
    ('source="resources/free_flyer.fmu"', 'source="http://["', "a file in the archive is expected"),
    (
        'startElement="free_flyer"',
        'startElement="free"',
        "the element 'free', which does not exist",
    ),
    (
        'name="reference_trajectory" type',
        'name="free_flyer" type',
        "two elements have the name 'free_flyer'",
    ),
    (
        'implementation="CoSimulation"',
        'implementation="ScheduledExecution"',
        "is for scheduled execution",
    ),
    ("[record]", "[record", "is not valid TOML"),
]


@pytest.mark.parametrize(("old", "new", "sentence"), WRONG)
def test_an_invalid_file_is_rejected_with_its_reason(
    packed: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    old: str,
    new: str,
    sentence: str,
) -> None:
    path = changed(packed, tmp_path / "wrong.ssp", old, new)
    code, error = run_command(capsys, "run", str(path), "--out", str(tmp_path / "out"))
    assert code == 2
    assert sentence in error
    assert not (tmp_path / "out").exists()


def test_an_unsupported_connection_is_rejected(packed: Path, version: int, tmp_path: Path) -> None:
    one = '"base_position[1]"' if version == 2 else '"base_position"'
    for new, sentence in (
        (
            f'endConnector={one}><ssc:LinearTransformation factor="2"/></ssd:Connection>',
            "transforms its value",
        ),
        (f'endConnector={one}><ssc:LinearTransformation factor="1"/></ssd:Connection>', ""),
        ('endConnector="base_pos" />', "has no variable 'base_pos'"),
    ):
        path = changed(packed, tmp_path / "x.ssp", f"endConnector={one} />", new)
        if not sentence:
            ssp_read.read(path, tmp_path / "u")
            continue
        with pytest.raises(CosimError, match=sentence):
            ssp_read.read(path, tmp_path / "u")


def test_an_unknown_parameter_and_an_invalid_boolean_are_rejected(
    packed: Path, tmp_path: Path
) -> None:
    entry = "resources/manipulator_controller.ssv"
    for old, new, sentence in (
        (
            'name="base_passivity_control"',
            'name="base_pasivity_control"',
            "base_pasivity_control belongs to none of its FMUs",
        ),
        ('Boolean value="false"', 'Boolean value="maybe"', "is 'maybe'; true or false is expected"),
    ):
        path = changed(packed, tmp_path / "x.ssp", old, new, entry)
        with pytest.raises(CosimError, match=sentence):
            ssp_read.read(path, tmp_path / "u")


def test_options_without_effect_are_rejected(
    packed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "--fmi belongs to scenarios" in run_command(capsys, "run", str(packed), "--fmi", "3")[1]
    assert "--step has no effect" in run_command(capsys, "run", str(packed), "--step", "0.01")[1]
    assert (
        "is an SSP file; a scenario is expected here"
        in run_command(capsys, "export", str(packed), "--out", "x.ssp")[1]
    )


def test_an_archive_with_an_outside_path_or_a_decompression_bomb_is_rejected(
    packed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refusal(path: Path) -> str:
        with pytest.raises(CosimError) as caught:
            ssp_read.read(path, tmp_path / "unpacked")
        return str(caught.value)

    assert "it does not exist" in refusal(tmp_path / "none.ssp")
    (tmp_path / "no.ssp").write_bytes(b"nonsense")
    assert "it is not a usable zip archive" in refusal(tmp_path / "no.ssp")
    for name in ("../evil", "/evil", "a\\..\\..\\evil"):
        with zipfile.ZipFile(tmp_path / "slip.ssp", "w") as archive:
            archive.writestr(name, b"x")
        assert "points outside the archive" in refusal(tmp_path / "slip.ssp")
    bomb = tmp_path / "bomb.ssp"
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(SSD, b" " * (70 << 20))
    assert "70 MiB; 64 MiB are allowed" in refusal(bomb)
    bomb.write_bytes(
        bomb.read_bytes().replace(struct.pack("<I", 70 << 20), struct.pack("<I", 1000))
    )  # the header states a smaller size
    assert "SSP file" in refusal(bomb)
    monkeypatch.setattr(archives, "LARGEST", 1 << 10)
    assert "1 KiB are allowed" in refusal(packed)
    assert not list(tmp_path.parent.glob("evil"))


def test_invalid_arguments_are_rejected(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(capsys, "export", "multirate_passive", "--out", str(tmp_path / "a.zip")) == (
        2,
        f"freeflyer: --out {tmp_path / 'a.zip'}: a file name that ends in .ssp is expected\n",
    )
    code, error = run_command(capsys, "export", "multirate_passive", "--out", "/proc/x/y.ssp")
    assert code == 2
    assert "cannot be written" in error
    code, error = run_command(capsys, "run", "multirate_passive", "--step", "0.1")
    assert code == 2
    assert "--step belongs to an .ssp file" in error
    code, error = run_command(capsys, "run", str(tmp_path / "none.ssp"), "--step", "-1")
    assert code == 2
    assert "--step -1: a time above zero is expected" in error
    file = tmp_path / "twin.toml"
    file.write_text('extends = "multirate_passive"\n[components.free_flyer]\nkind = "twin"\n')
    code, error = run_command(capsys, "export", str(file), "--out", str(tmp_path / "a.ssp"))
    assert code == 2
    assert (
        "component free_flyer is of kind 'twin'; only FMUs can be packed into an SSP file" in error
    )
    assert not (tmp_path / "a.ssp").exists()


def test_export_and_run_work_on_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "loop.ssp"
    assert command.call(["export", "multirate_passive", "--fmi", "3", "--out", str(path)]) == 0
    assert (
        command.call(["run", str(path), "--set", "stop_s=0.3", "--out", str(tmp_path / "out")]) == 0
    )
    assert "record.parquet" in capsys.readouterr().out
