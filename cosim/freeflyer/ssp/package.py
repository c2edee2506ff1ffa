"""Reader for the zip archive of an untrusted SSP file.

An entry is read as XML or unpacked to a file.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree

from freeflyer.fmi import archive
from freeflyer.fmi.archive import Archive, ArchiveError
from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.ssp.names import tag

Element = ElementTree.Element


@contextmanager
def opened(path: Path, directory: Path) -> Iterator[Package]:
    """Open and check an SSP file. `directory` is the directory for the unpacked FMUs.

    Raises ScenarioError if the archive is invalid. The `with` block can also raise ScenarioError,
    when it reads an invalid entry.
    """
    package = Package(path, directory)
    if not path.is_file():
        raise package.fail("it is not a file" if path.exists() else "it does not exist")
    try:
        with archive.opened(path) as found:
            package.enter(found)
            yield package
    except ArchiveError as error:
        raise package.fail(str(error)) from error
    except OSError as error:
        raise package.fail(
            f"it cannot be unpacked into {directory}: {error.strerror or error}"
        ) from error
    except RecursionError as error:
        raise package.fail("its systems are nested too deeply") from error


class Package:
    """An open SSP file."""

    def __init__(self, path: Path, directory: Path) -> None:
        self.path, self.directory = path, directory
        self._unpacked: dict[str, Path] = {}

    def fail(self, message: str) -> ScenarioError:
        """Return an exception with a message that starts with the path of the SSP file."""
        return ScenarioError(f"SSP file {self.path}: {message}")

    def enter(self, found: Archive) -> None:
        self._archive = found

    def _require(self, name: str) -> None:
        if name not in self._archive.names:
            raise self.fail(f"it contains no {name}{did_you_mean(name, self._archive.names)}")

    def xml(self, name: str, wanted: str) -> Element:
        """Return the root element of the XML entry `name`.

        `wanted` is the expected name of the root element with its prefix, for example `ssd:System`.
        Raises ScenarioError if the entry does not exist, or if its root element has another name.
        """
        self._require(name)
        root, _ = self._archive.xml(name)
        if root.tag != tag(wanted):
            raise self.fail(f"{name} has the root element {root.tag}; {tag(wanted)} is expected")
        return root

    def source(self, element: Element, subject: str) -> str:
        """Return the name of the archive entry to which the attribute `source` of `element` refers.

        The source must be a relative path. The path starts from the folder of the description
        file. The path must not leave the archive. Raises ScenarioError for any other source.
        `subject` is the subject of the error message.
        """
        try:
            uri = urlsplit(element.get("source", ""))
        except ValueError as error:
            raise self.fail(
                f"{subject} has the source {element.get('source')!r}; a file in the archive is expected"
            ) from error
        name = unquote(uri.path).removeprefix("./")
        if (
            uri.scheme
            or uri.netloc
            or uri.fragment
            or not name
            or name.startswith("/")
            or ".." in PurePosixPath(name).parts
        ):
            raise self.fail(
                f"{subject} has the source {element.get('source')!r}; a file in the archive is expected"
            )
        if element.get("sourceBase", "SSD") != "SSD":
            raise self.fail(
                f"{subject} has a source inside another resource; a file in the archive is expected"
            )
        return name

    def unpack(self, name: str) -> Path:
        """Extract the entry `name` and return the path of the extracted file.

        A second call for the same entry returns the same path.
        """
        if name not in self._unpacked:
            self._require(name)
            target = self.directory / name
            target.parent.mkdir(parents=True, exist_ok=True)
            self._archive.extract(name, target)
            self._unpacked[name] = target
        return self._unpacked[name]
