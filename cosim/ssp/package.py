"""The zip archive of an SSP file, from anybody: nothing leaves its directory, nothing swells, no XML fetches anything."""

from __future__ import annotations

import lzma
import shutil
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree

from cosim.errors import ScenarioError
from cosim.near import did_you_mean
from cosim.ssp.names import tag

LARGEST_TEXT = 64 << 20
LARGEST_FMU = 2 << 30
LARGEST_PACKAGE = 8 << 30

Element = ElementTree.Element


@contextmanager
def opened(path: Path, directory: Path) -> Iterator[Package]:
    """ScenarioError, in one sentence, for whatever is wrong with the archive, then or while it is read."""
    package = Package(path, directory)
    if not path.is_file():
        raise package.fail("it is not a file" if path.exists() else "it does not exist")
    try:
        with zipfile.ZipFile(path) as archive:
            package.enter(archive)
            yield package
    except OSError as error:
        raise package.fail(f"it cannot be unpacked into {directory}: {error.strerror or error}") from error
    except RecursionError as error:
        raise package.fail("its systems are nested too deeply") from error
    except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, RuntimeError, EOFError) as error:
        raise package.fail(f"it is no usable zip archive ({error})") from error


class _Refusing(ElementTree.TreeBuilder):
    """Builds no tree of a file with a document type: nothing in it is fetched or expanded."""

    def doctype(self, name: str, public: str | None, system: str | None) -> None:
        raise ValueError("it declares a document type")


def parser() -> ElementTree.XMLParser:
    return ElementTree.XMLParser(target=_Refusing())


class Package:
    def __init__(self, path: Path, directory: Path) -> None:
        self.path, self.directory = path, directory
        self._unpacked: dict[str, Path] = {}

    def fail(self, message: str) -> ScenarioError:
        return ScenarioError(f"SSP file {self.path}: {message}")

    def enter(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self._check_entries()

    def _check_entries(self) -> None:
        entries = self._archive.infolist()
        for entry in entries:
            if entry.filename.startswith(("/", "\\")) or ".." in PurePosixPath(entry.filename.replace("\\", "/")).parts:
                raise self.fail(f"it is refused: its entry {entry.filename!r} points outside the archive")
        if sum(entry.file_size for entry in entries) > LARGEST_PACKAGE:
            raise self.fail(f"it is refused: it unpacks to more than {LARGEST_PACKAGE >> 30} GiB")

    def _entry(self, name: str, largest: int) -> zipfile.ZipInfo:
        try:
            entry = self._archive.getinfo(name)
        except KeyError:
            raise self.fail(f"it contains no {name}{did_you_mean(name, self._archive.namelist())}") from None
        if entry.file_size > largest:
            raise self.fail(f"its entry {name} is refused: it has {entry.file_size >> 20} MiB, {largest >> 20} are allowed")
        return entry

    def xml(self, name: str, wanted: str) -> Element:
        data = self._archive.read(self._entry(name, LARGEST_TEXT))
        try:
            root = ElementTree.fromstring(data, parser())
        except ValueError as error:  # a document type, or an encoding that the parser cannot take
            raise self.fail(f"{name} is refused: {error}") from error
        except (ElementTree.ParseError, LookupError) as error:
            raise self.fail(f"{name} is not well-formed XML: {error}") from error
        if root.tag != tag(wanted):
            raise self.fail(f"{name} has the root {root.tag}; {tag(wanted)} is expected")
        return root

    def source(self, element: Element, subject: str) -> str:
        """The entry that a `source` attribute names: relative to the description, inside the archive."""
        try:
            uri = urlsplit(element.get("source", ""))
        except ValueError as error:
            raise self.fail(f"{subject} has the source {element.get('source')!r}; a file in the archive is expected") from error
        name = unquote(uri.path).removeprefix("./")
        if uri.scheme or uri.netloc or uri.fragment or not name or name.startswith("/") or ".." in PurePosixPath(name).parts:
            raise self.fail(f"{subject} has the source {element.get('source')!r}; a file in the archive is expected")
        if element.get("sourceBase", "SSD") != "SSD":
            raise self.fail(f"{subject} has a source inside another resource; a file in the archive is expected")
        return name

    def unpack(self, name: str) -> Path:
        if name not in self._unpacked:
            entry, target = self._entry(name, LARGEST_FMU), self.directory / name
            target.parent.mkdir(parents=True, exist_ok=True)
            with self._archive.open(entry) as packed, target.open("wb") as file:
                shutil.copyfileobj(packed, file)
            self._unpacked[name] = target
        return self._unpacked[name]
