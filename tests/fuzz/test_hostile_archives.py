"""Malicious FMUs and SSP files: the error names file and limit, exit code 2, no file remains."""

from __future__ import annotations

import io
import stat
import struct
import tempfile
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from commands import run_command
from file_targets import SMALL_2, SSD

from freeflyer.fmi import archive, unpacked
from freeflyer.fmi.fmu_description import DESCRIPTION, describe_fmu, ports_in
from freeflyer.foundation.errors import ComponentError

Make = Callable[[zipfile.ZipFile], None]
PREFIX, SUFFIX = SMALL_2.split(b"\n", 1)


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The directory for temporary folders of FMUs."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def named(*names: str) -> Make:
    def make(file: zipfile.ZipFile) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about duplicate names
            for name in names:
                file.writestr(zipfile.ZipInfo(name), b"x")

    return make


def of_kind(mode: int) -> Make:
    def make(file: zipfile.ZipFile) -> None:
        entry = zipfile.ZipInfo("resources/x")
        entry.create_system, entry.external_attr = 3, (mode | 0o644) << 16
        file.writestr(entry, "/etc/passwd")

    return make


def by(method: int) -> Make:
    return lambda file: file.writestr(zipfile.ZipInfo("resources/x"), b"x" * 1000, method)


def add_zeros(file: zipfile.ZipFile) -> None:
    with file.open("resources/zeros", "w") as entry:
        for _ in range(300):
            entry.write(bytes(1 << 20))


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (named("../evil"), "points outside the archive"),
        (named("/evil"), "points outside the archive"),
        (named("a/../../evil"), "points outside the archive"),
        (named("C:/evil"), "points outside the archive"),
        (named("..\\evil"), "points outside the archive"),
        (named("a\\b"), "has a name that is invalid on some operating systems"),
        (named("ab:c"), "has a name that is invalid on some operating systems"),
        (named("a\nb"), "has a name that is invalid on some operating systems"),
        (named("x" * 2000), "has a name that is invalid on some operating systems"),
        (named("a", "a"), "its entries 'a' and 'a' would be one file"),
        (named("a/b", "A/B"), "its entries 'a/b' and 'A/B' would be one file"),
        (named("caf\u00e9", "cafe\u0301"), "would be one file"),
        (
            named("a", "a/b"),
            "its entry 'a' is a file, but its entry 'a/b' needs a folder of that name",
        ),
        (of_kind(stat.S_IFLNK), "its entry 'resources/x' is a symbolic link"),
        (of_kind(stat.S_IFIFO), "its entry 'resources/x' is neither a file nor a folder"),
        (of_kind(stat.S_IFBLK), "its entry 'resources/x' is neither a file nor a folder"),
        (by(zipfile.ZIP_BZIP2), "is compressed by bzip2; deflate is expected"),
        (by(zipfile.ZIP_LZMA), "is compressed by lzma; deflate is expected"),
        (
            add_zeros,
            "it unpacks to 300 MiB, more than 200 times its own size (set FREEFLYER_LARGEST_ARCHIVE=GIB if you trust it)",
        ),
    ],
)
@pytest.mark.parametrize("kind", ["fmu", "ssp"])
def test_an_archive_is_rejected_before_any_entry_is_used(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    temporary: Path,
    kind: str,
    make: Make,
    sentence: str,
) -> None:
    path = tmp_path / f"some.{kind}"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(
            "SystemStructure.ssd" if kind == "ssp" else DESCRIPTION,
            SSD if kind == "ssp" else SMALL_2,
        )
        make(file)
    rejected(capsys, tmp_path, temporary, path, sentence)


def rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, temporary: Path, path: Path, sentence: str
) -> None:
    run = path
    if path.suffix == ".fmu":
        run = tmp_path / "some.toml"
        run.write_text(f'stop_s = 0.1\n[components.x]\nfmu = "{path.name}"\nstep_s = 0.01\n')
    before = sorted(tmp_path.rglob("*"))
    code, error = run_command(capsys, "run", str(run), "--out", str(tmp_path / "out"))
    assert sentence in error
    assert path.name in error
    assert code == 2
    assert not list(temporary.iterdir())
    assert set(tmp_path.rglob("*")) - set(before) <= {tmp_path / "out"}
    assert not (tmp_path.parent / "evil").exists()


def fmu(path: Path, description: bytes = SMALL_2, **more: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(DESCRIPTION, description)
        for name, data in more.items():
            file.writestr(f"resources/{name}", data)
    return path


def library(path: Path) -> Path:
    """Add an invalid library, so that the FMU is unpacked before its library is loaded."""
    import fmpy

    with zipfile.ZipFile(path, "a") as file:
        file.writestr(f"binaries/{fmpy.platform}/some{fmpy.sharedLibraryExtension}", b"no library")
    return path


def directory_of(data: bytes) -> int:
    return int(struct.unpack_from("<I", data, data.rindex(b"PK\x05\x06") + 16)[0])


def test_an_entry_larger_than_its_stated_size_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, temporary: Path
) -> None:
    path = library(fmu(tmp_path / "liar.fmu", zeros=bytes(70 << 20)))
    data = path.read_bytes()
    assert data.count(struct.pack("<I", 70 << 20)) == 2
    path.write_bytes(data.replace(struct.pack("<I", 70 << 20), struct.pack("<I", 1000)))
    rejected(
        capsys,
        tmp_path,
        temporary,
        path,
        "it is not a usable zip archive (Bad CRC-32 for file 'resources/zeros')",
    )


def test_a_damaged_library_leaves_nothing_behind(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, temporary: Path
) -> None:
    path = library(fmu(tmp_path / "bad.fmu"))
    path.write_bytes(path.read_bytes().replace(b"no library", b"on library"))
    rejected(capsys, tmp_path, temporary, path, "Bad CRC-32 for file 'binaries/")


def test_an_encrypted_entry_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, temporary: Path
) -> None:
    path = fmu(tmp_path / "some.fmu")
    data = bytearray(path.read_bytes())
    data[directory_of(data) + 8] |= 1
    path.write_bytes(data)
    rejected(capsys, tmp_path, temporary, path, "its entry 'modelDescription.xml' is encrypted")


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.99])
def test_a_truncated_archive_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, temporary: Path, share: float
) -> None:
    path = fmu(tmp_path / "some.fmu", x=b"y" * 5000)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    rejected(capsys, tmp_path, temporary, path, "it is not a zip archive")


def test_too_many_entries_or_a_too_large_directory_are_rejected(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    temporary: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = fmu(tmp_path / "some.fmu", **{f"x{k}": b"" for k in range(100)})
    with monkeypatch.context() as patch:
        patch.setattr(archive, "MOST_ENTRIES", 100)
        rejected(capsys, tmp_path, temporary, path, "it has 101 entries; 100 are allowed")
    monkeypatch.setattr(archive, "LARGEST_DIRECTORY", 1000)
    rejected(capsys, tmp_path, temporary, path, "its list of entries has more than 1000 bytes")


def test_a_large_trusted_archive_is_accepted(
    tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "some.fmu"
    with zipfile.ZipFile(fmu(path), "a", zipfile.ZIP_DEFLATED) as file:
        add_zeros(file)
    monkeypatch.setenv("FREEFLYER_LARGEST_ARCHIVE", "1")
    folder = unpacked.take(path)
    assert (folder / "resources" / "zeros").stat().st_size == 300 << 20
    unpacked.give_back(folder)
    assert not list(temporary.iterdir())
    monkeypatch.setenv("FREEFLYER_LARGEST_ARCHIVE", "0.25")
    with pytest.raises(ComponentError, match="it unpacks to 300 MiB; 256 MiB are allowed"):
        unpacked.take(path)
    monkeypatch.setenv("FREEFLYER_LARGEST_ARCHIVE", "much")
    with pytest.raises(ComponentError, match="is 'much'; a number of GiB above zero is expected"):
        unpacked.take(path)


def test_an_archive_that_changes_after_it_was_described_is_checked_again(
    tmp_path: Path, temporary: Path
) -> None:
    path = fmu(tmp_path / "some.fmu")
    describe_fmu(path)
    with zipfile.ZipFile(path, "a") as file:
        file.writestr("../evil", b"x")
    with pytest.raises(ComponentError, match="points outside"):
        unpacked.take(path)
    assert not list(temporary.iterdir())


LAUGHS = b"".join(b'<!ENTITY x%d "%s">' % (k, b"&x%d;" % (k - 1) * 10) for k in range(1, 12))


@pytest.mark.parametrize(
    "declared",
    [
        b'<!DOCTYPE a [<!ENTITY x0 "ha">' + LAUGHS + b"]>",
        b'<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]>',
        b'<!DOCTYPE a SYSTEM "http://127.0.0.1:9/a.dtd">',
        b'<!DOCTYPE a [<!ENTITY % x SYSTEM "file:///dev/zero"> %x;]>',
        b"<!DOCTYPE a>",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_xml_with_a_document_type_is_rejected_before_parsing(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    temporary: Path,
    declared: bytes,
    encoding: str,
) -> None:
    text = (
        b"<?xml version='1.0'?>"
        + declared
        + SUFFIX.replace(b'modelName="some"', b'modelName="&x11;"')
    ).decode()
    path = fmu(tmp_path / "some.fmu", text.encode(encoding))
    rejected(
        capsys,
        tmp_path,
        temporary,
        path,
        "its modelDescription.xml declares a document type",
    )


def test_xml_with_too_many_or_too_deep_elements_is_rejected(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    temporary: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    deep = SUFFIX.replace(b"<CoSimulation", b"<a>" * 5000 + b"</a>" * 5000 + b"<CoSimulation")
    rejected(
        capsys,
        tmp_path,
        temporary,
        fmu(tmp_path / "deep.fmu", deep),
        "or more than 200 nested elements",
    )
    monkeypatch.setattr(archive, "MOST_ELEMENTS", 1000)
    wide = SUFFIX.replace(b"<CoSimulation", b"<a/>" * 1000 + b"<CoSimulation")
    rejected(
        capsys, tmp_path, temporary, fmu(tmp_path / "wide.fmu", wide), "more than 1000 elements"
    )
    monkeypatch.setattr(archive, "LARGEST_XML", 1 << 10)
    rejected(capsys, tmp_path, temporary, fmu(tmp_path / "long.fmu"), "1 KiB are allowed")


def test_a_description_in_another_encoding_is_read(tmp_path: Path) -> None:
    text = (
        SMALL_2.decode()
        .replace('encoding="UTF-8"', 'encoding="ISO-8859-1"')
        .replace('modelName="some"', 'modelName="größe"')
    )
    assert describe_fmu(fmu(tmp_path / "latin.fmu", text.encode("latin-1"))).modelName == "größe"
    assert (
        describe_fmu(
            fmu(tmp_path / "wide.fmu", text.replace("ISO-8859-1", "UTF-16").encode("utf-16"))
        ).modelName
        == "größe"
    )


def test_variables_with_too_many_elements_are_rejected(tmp_path: Path) -> None:
    from file_targets import SMALL_3

    huge = SMALL_3.replace(b'<Dimension start="3"/>', b'<Dimension start="1000000000000"/>')
    with pytest.raises(
        ComponentError, match="its variables have 2000000000005 elements; 4194304 are allowed"
    ):
        ports_in(fmu(tmp_path / "huge.fmu", huge))


def test_describing_an_fmu_does_not_run_its_code(
    tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import ctypes

    def load(*_: object, **__: object) -> None:
        raise AssertionError("a library is loaded")

    monkeypatch.setattr(ctypes, "CDLL", load)
    path = library(fmu(tmp_path / "some.fmu"))
    assert describe_fmu(path).modelName == "some"
    assert ports_in(path)[0]["u"].start == (1.5,)
    assert not list(temporary.iterdir())


def test_an_archive_within_an_archive_is_not_unpacked(tmp_path: Path, temporary: Path) -> None:
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w") as file:
        file.writestr("../evil", b"x")
    folder = unpacked.take(fmu(tmp_path / "some.fmu", inner=inner.getvalue()))
    assert (folder / "resources" / "inner").read_bytes() == inner.getvalue()
    unpacked.give_back(folder)
