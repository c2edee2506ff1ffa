"""`freeflyer audit` on the command line: its output files and its error messages."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as parquet
import pytest
from commands import run_command

from freeflyer.cli import main as command
from freeflyer.master.provenance import KEY
from freeflyer.scenario import experiment


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("runs") / "passive"
    experiment.run("multirate_passive", ["stop_s=4"]).save(directory)
    return directory


def test_the_audit_writes_a_figure_and_numbers_and_prints_a_table(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.call(["audit", str(run), "--out", str(tmp_path)]) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    assert "Energy into the robot [J]: multirate_passive, 0 s to 4 s" in shown.out
    assert (tmp_path / "energy_audit.png").stat().st_size > 50_000
    assert (tmp_path / "energy_audit.pdf").is_file()
    numbers = json.loads((tmp_path / "energy_audit.json").read_text())
    for port in numbers["ports"].values():
        terms = (
            "feed_forward",
            "reference",
            "multi_rate",
            "virtual",
            "spring",
            "damping",
            "passivity_controller",
        )
        assert sum(port[f"{term}_j"] for term in terms) == pytest.approx(port["work_j"], abs=1e-12)
    works = sum(port["work_j"] for port in numbers["ports"].values())
    balance = numbers["balance"]
    assert abs(works - balance["kinetic_energy_change_j"]) <= balance["residual_of_ports_j"] < 1e-5
    assert numbers["ports"]["B"]["passivity_controller_j"] < 0.0


@pytest.mark.slow
def test_a_record_file_is_accepted_and_results_are_written_beside_it(run: Path) -> None:
    assert command.call(["audit", str(run / "record.parquet")]) == 0
    assert (run / "energy_audit.json").is_file()


def test_a_diverged_run_is_audited_to_its_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    experiment.run("overdamped_base").save(tmp_path)
    assert command.call(["audit", str(tmp_path)]) == 0
    numbers = json.loads((tmp_path / "energy_audit.json").read_text())
    assert numbers["to_s"] == pytest.approx(19.5, abs=1.0)
    assert numbers["ports"]["B"]["virtual_j"] > numbers["balance"]["kinetic_energy_change_j"] > 1.0
    assert "`freeflyer run SCENARIO --set record.every_s=0.001`" in capsys.readouterr().out.replace(
        "\n", " "
    )


def changed(
    run: Path, target: Path, *, drop: str = "", metadata: dict[bytes, bytes] | None = None
) -> str:
    """Write a record without columns that start with `drop`, or with other metadata."""
    table = parquet.read_table(run / "record.parquet")
    table = table.select(
        [name for name in table.column_names if not (drop and name.startswith(drop))]
    )
    parquet.write_table(
        table if metadata is None else table.replace_schema_metadata(metadata), target
    )
    return str(target)


def test_invalid_records_are_rejected_with_the_reason(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ("--out", str(tmp_path / "out"))
    whole = (run / "record.parquet").read_bytes()
    (tmp_path / "half.parquet").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.parquet").write_text("nothing")
    parquet.write_table(pa.table({"time": ["a", "b"]}), tmp_path / "texts.parquet")
    parquet.write_table(pa.table({}), tmp_path / "empty.parquet")
    provenance = json.loads(parquet.read_schema(run / "record.parquet").metadata[KEY])
    no_gains = {**provenance, "parameters": {**provenance["parameters"], "base_controller": {}}}
    unconnected = {**provenance, "sources": {}}
    cases = [
        (str(tmp_path / "nowhere"), "does not exist; give a directory that `freeflyer run` wrote"),
        (
            str(run.parent),
            "has no record.parquet; these subdirectories have a record.parquet: passive",
        ),
        (str(tmp_path / "half.parquet"), "cannot be read as a record of `freeflyer run`"),
        (str(tmp_path / "text.parquet"), "cannot be read as a record of `freeflyer run`"),
        (str(tmp_path / "texts.parquet"), "cannot be read as a record of `freeflyer run`"),
        (str(tmp_path / "empty.parquet"), "cannot be read as a record of `freeflyer run`"),
        (str(run / "summary.json"), "cannot be read as a record of `freeflyer run`"),
        (
            changed(run, tmp_path / "a.parquet", metadata={}),
            "does not contain its provenance",
        ),
        (
            changed(run, tmp_path / "b.parquet", metadata={KEY: b"[1]"}),
            "cannot be read as a record",
        ),
        (changed(run, tmp_path / "c.parquet", metadata={KEY: b"{"}), "cannot be read as a record"),
        (
            changed(run, tmp_path / "d.parquet", drop="base_controller.port_wrench"),
            "lacks component with the base's outputs",
        ),
        (
            changed(run, tmp_path / "e.parquet", drop="reference_trajectory.vel"),
            "it lacks reference_trajectory.velocity",
        ),
        (
            changed(run, tmp_path / "f.parquet", drop="free_flyer.end_effector_velocity[6]"),
            "lacks 6 elements of free_flyer.end_effector_velocity",
        ),
        (
            changed(run, tmp_path / "g.parquet", metadata={KEY: json.dumps(no_gains).encode()}),
            "parameter base_controller.stiffness, parameter base_controller.damping",
        ),
        (
            changed(run, tmp_path / "h.parquet", metadata={KEY: json.dumps(unconnected).encode()}),
            "lacks source of base_controller.base_position",
        ),
    ]
    for record, sentence in cases:
        code, error = run_command(capsys, "audit", record, *out)
        assert sentence in error
        assert code == 2
    assert not (tmp_path / "out").exists()


def test_an_invalid_output_directory_is_rejected(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    code, error = run_command(capsys, "audit", str(run), "--out", str(tmp_path / "file" / "out"))
    assert "cannot be written" in error
    assert code == 2
