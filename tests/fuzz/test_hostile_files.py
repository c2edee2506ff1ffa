"""Malicious files: special files, endless input, wrong formats; an error and exit code 2."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as parquet
import pytest
from commands import run_command
from link_targets import OWN_DBC, OWN_MAPPING

from freeflyer.cli import main as command
from freeflyer.foundation import bounded_file, toml_file
from freeflyer.foundation.units import factor
from freeflyer.master import record
from freeflyer_adapters.arm.frames import ArmFrames, FrameMapping
from freeflyer_adapters.can.signals import load
from freeflyer_adapters.foundation.errors import DeviceError

TOMLS = {
    "deeply nested arrays": ("x = " + "[" * 20_000, "nested deeper than 40"),
    "42 nested tables": ("[" + ".".join("a" * 42) + "]", "nested deeper than 40"),
    "a number of 5000 digits": ("stop_s = " + "9" * 5000, "an integer of more than 64 bits"),
    "a hexadecimal number": ("stop_s = 0x" + "f" * 20_000, "an integer of more than 64 bits"),
    "one bit too many": ("stop_s = 9223372036854775808", "an integer of more than 64 bits"),
    "a name of 20000 parts": ("a." * 20_000 + "a = 1", "a name of more than 500 parts"),
    "300 KiB": ("#" * (300 << 10), "it has more than 256 KiB"),
}


@pytest.mark.parametrize("command", ["run", "sweep", "predict", "export"])
@pytest.mark.parametrize("what", TOMLS)
def test_toml_that_would_take_too_long_to_parse_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, command: str, what: str
) -> None:
    text, sentence = TOMLS[what]
    (tmp_path / "x.toml").write_text(text)
    begin = time.process_time()
    code, error = run_command(
        capsys, command, str(tmp_path / "x.toml"), "--out", str(tmp_path / "out.ssp")
    )
    assert (sentence in error, code) == (True, 2), error
    assert time.process_time() - begin < 5.0
    assert not (tmp_path / "out.ssp").exists()


@pytest.mark.parametrize("data", [b"x = '\xff'", b"\xff\xfex\x00", b"x = 1\x00", b"\x00" * 100])
def test_invalid_toml_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, data: bytes
) -> None:
    (tmp_path / "x.toml").write_bytes(data)
    code, error = run_command(capsys, "run", str(tmp_path / "x.toml"))
    assert ("is not valid TOML" in error, code) == (True, 2), error


@pytest.mark.parametrize("command", ["run", "sweep"])
def test_a_path_that_is_not_a_regular_file_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, command: str
) -> None:
    os.mkfifo(tmp_path / "fifo.toml")
    (tmp_path / "zero.toml").symlink_to("/dev/zero")
    (tmp_path / "folder.toml").mkdir()
    for name in ("fifo", "zero", "folder"):
        code, error = run_command(capsys, command, str(tmp_path / f"{name}.toml"))
        assert (f"{name}.toml" in error, code) == (True, 2), error
    for name in ("/dev/zero", "x\0.toml", "x" * 5000 + ".toml"):
        assert run_command(capsys, command, name)[0] == 2
    (tmp_path / "child.toml").write_text('extends = "fifo.toml"')
    assert run_command(capsys, "run", str(tmp_path / "child.toml"))[0] == 2


def test_a_fifo_or_device_is_rejected_when_it_is_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo.toml")
    for path in (tmp_path / "fifo.toml", Path("/dev/zero")):
        with pytest.raises(OSError, match="it is not a regular file"):
            toml_file.read(path)
    (tmp_path / "long").write_bytes(b"x" * 11)
    assert len(bounded_file.content(tmp_path / "long", 11)) == 11
    with pytest.raises(OSError, match="it has more than 10 bytes"):
        bounded_file.content(tmp_path / "long", 10)


def test_units_with_expensive_arithmetic_are_rejected() -> None:
    begin = time.process_time()
    for text in (
        "9**9**9**9",
        "9**99999999",
        "9⁹⁹⁹⁹⁹⁹⁹⁹",
        "2**(9**9)*m",
        "((((2*m)**99)**99)**99)**99",
        "m" * 100_000,
        "(" * 50 + "m" + ")" * 50,
    ):
        with pytest.raises(ValueError, match="is not known"):
            factor(text, "m")
    assert time.process_time() - begin < 5.0
    assert factor("(km/h)^2", "m2/s2") == pytest.approx(1 / 3.6**2)
    assert factor("mm²", "m2") == 1e-6


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            "TORQUES: 16",
            "TORQUES: 1000000000000",
            "a message or signal has a size of 1000000000000",
        ),
        (
            "TORQUES: 16",
            "TORQUES //\n: // x\n 1000000000000",
            "a message or signal has a size of 1000000000000",
        ),
        (
            '15|16@0- (0.01,0) [0|0] "Nm" Drive',
            '15|1000000000000@0- (0.01,0) [0|0] "Nm" Drive',
            "a message or signal has a size of 1000000000000",
        ),
        (
            "VAL_ ",
            "SG_MUL_VAL_ 2147484161 Heat Selector 0-4000000000;\nVAL_ ",
            "more than 100000 multiplexer values",
        ),
        (
            '(0.01,0) [0|0] "Nm" Drive',
            '(0,0) [0|0] "Nm" Drive',
            "has the factor 0 and the offset 0",
        ),
        ('(0.01,0) [0|0] "Nm" Drive', '(1e308,0) [0|0] "Nm" Drive', "finite numbers are expected"),
        ("Mode : 7|8@0+", "Mode : -1|8@0+", "starts at bit -1; 0 or more is expected"),
    ],
)
def test_dbcs_with_excessive_sizes_or_invalid_numbers_are_rejected(
    tmp_path: Path, old: str, new: str, sentence: str
) -> None:
    path = tmp_path / "own.dbc"
    assert old in OWN_DBC
    path.write_text(OWN_DBC.replace(old, new, 1))
    with pytest.raises(DeviceError) as caught:
        ArmFrames(FrameMapping(dbc=path, **OWN_MAPPING), 2)  # type: ignore[arg-type]
    assert sentence in str(caught.value)


KCD = '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/hostname">]><NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0">&x;</NetworkDefinition>'


@pytest.mark.parametrize("suffix", ["kcd", "arxml", "sym", "cdd", "xml", ""])
def test_only_dbc_files_are_accepted(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"own.{suffix}"
    path.write_text(KCD)
    with pytest.raises(DeviceError, match=r"a file whose name ends in \.dbc is expected"):
        load(path)
    (tmp_path / "own.dbc").write_text(KCD)
    with pytest.raises(DeviceError, match="cannot be used: DBC: "):
        load(tmp_path / "own.dbc")


def test_no_pickle_cache_of_a_dbc_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CANTOOLS_CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "own.dbc").write_text(OWN_DBC)
    load(tmp_path / "own.dbc")
    assert not (tmp_path / "cache").exists()


def test_a_dbc_that_is_not_a_regular_file_or_too_large_is_rejected(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo.dbc")
    with pytest.raises(DeviceError, match="it is not a regular file"):
        load(tmp_path / "fifo.dbc")
    (tmp_path / "long.dbc").write_bytes(b" " * (5 << 20))
    with pytest.raises(DeviceError, match="it has more than 4 MiB"):
        load(tmp_path / "long.dbc")


@pytest.mark.parametrize(
    "table",
    [
        pa.table({}),
        pa.table({"time": ["a"]}),
        pa.table({"time": [0.0], "a.b": [[1.0]]}),
        pa.table({"time": [0.0]}).replace_schema_metadata({"freeflyer.origin": "[" * 100_000}),
        pa.table({"time": [0.0]}).replace_schema_metadata({"freeflyer.origin": "9" * 100_000}),
        pa.table({"time": [0.0]}).replace_schema_metadata({"freeflyer.origin": b"\xff"}),
        pa.table([[0.0], [1.0], [1.0]], names=["time", "a", "a"]),
    ],
)
def test_a_table_that_is_not_a_record_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, table: pa.Table
) -> None:
    parquet.write_table(table, tmp_path / "record.parquet")
    code, error = run_command(capsys, "audit", str(tmp_path))
    assert ("record" in error, code) == (True, 2), error


def test_a_record_with_too_many_rows_is_rejected_before_reading(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows of nulls are compressed by more than 1000 to 1, without a limit."""
    path = tmp_path / "record.parquet"
    parquet.write_table(pa.table({"time": pa.nulls(5_000_000, pa.float64())}), path)
    assert path.stat().st_size < 5_000_000 * 8 / 1000
    monkeypatch.setattr(record, "MOST_NUMBERS", 4_999_999)
    monkeypatch.setattr(parquet.ParquetFile, "read", lambda _: pytest.fail("it was read"))
    code, error = run_command(capsys, "audit", str(path))
    assert (
        "it has 5000000 rows of 1 columns; at most 4999999 numbers are expected" in error,
        code,
    ) == (True, 2), error


def test_only_the_kind_python_runs_code_of_a_scenario(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`extends` and `fmu` only read files; kind = "python" runs one."""
    (tmp_path / "evil.py").write_text(
        "from pathlib import Path\nPath(__file__).with_name('ran').touch()\n"
    )
    for line in ('extends = "evil.py"', 'extends = "evil"'):
        (tmp_path / "x.toml").write_text(line)
        assert command.call(["run", str(tmp_path / "x.toml"), "--out", str(tmp_path / "out")]) == 2
    for keys in ('fmu = "evil.py"', 'kind = "can_arm"\ndbc = "evil.py"', 'kind = "evil.py"'):
        (tmp_path / "x.toml").write_text(f"stop_s = 0.1\n[components.x]\nstep_s = 0.01\n{keys}\n")
        assert command.call(["run", str(tmp_path / "x.toml"), "--out", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "ran").exists()
    (tmp_path / "x.toml").write_text(
        'stop_s = 0.1\n[components.x]\nstep_s = 0.01\nkind = "python"\nobject = "evil.py:f"\n'
    )
    assert command.call(["run", str(tmp_path / "x.toml"), "--out", str(tmp_path / "out")]) == 2
    assert (tmp_path / "ran").exists()
    capsys.readouterr()
