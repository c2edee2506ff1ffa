"""Reader for untrusted zip archives (FMUs, SSP files).

The whole archive is checked before any entry is used; nothing in it is executed. Rejected are:
- names that leave the target folder or that collide on another operating system;
- entries that are neither a regular file nor a folder;
- encryption and compression methods other than those of FMI (FMI 3.0, 2.5: deflate or none);
- decompression bombs;
- XML with a document type, so that no external entity is fetched or expanded.
"""

from __future__ import annotations

import errno
import io
import math
import os
import stat
import struct
import unicodedata
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree
from xml.parsers import expat

from freeflyer.foundation.bounded_file import size

MOST_ENTRIES = 50_000
LARGEST = 8 << 30
"""Unpacked bytes allowed for the archive and for each entry; see LARGEST_VARIABLE."""
LARGEST_RATIO, FREE_OF_RATIO = 200, 256 << 20
"""Larger of two limits on the unpacked size: times the packed size, and bytes."""
LARGEST_XML, MOST_ELEMENTS, DEEPEST_ELEMENT = 64 << 20, 2_000_000, 200
LARGEST_VARIABLE = "FREEFLYER_LARGEST_ARCHIVE"
"""Environment variable for a trusted archive: replaces LARGEST [GiB], disables the ratio check."""
LARGEST_DIRECTORY = 32 << 20
"""Bytes of the archive's central directory."""
LONGEST_NAME = 1024

Element = ElementTree.Element


class ArchiveError(ValueError):
    """The reason why an archive is rejected; the caller adds the subject."""


class _Bounded(io.BufferedReader):
    """A file whose reads are bounded: `zipfile` reads the whole central directory in one call."""

    def read(self, count: int | None = -1) -> bytes:
        if count is not None and count > LARGEST_DIRECTORY:
            raise ArchiveError(f"its list of entries has more than {size(LARGEST_DIRECTORY)}")
        return super().read(count)


@contextmanager
def opened(path: Path) -> Iterator[Archive]:
    """Open and check an archive.

    Raises ArchiveError if the archive is invalid, here or while it is read. Raises OSError if it
    does not exist or there is no disk space.
    """
    with _Bounded(io.FileIO(path)) as file:
        try:
            with zipfile.ZipFile(file) as archive:
                yield Archive(archive, os.fstat(file.fileno()).st_size)
        except ArchiveError:
            raise
        except OSError as error:
            if error.errno != errno.EINVAL or error.filename is not None:
                raise
            raise ArchiveError(
                "it is no usable zip archive (an entry lies outside of it)"
            ) from error
        except _DAMAGE as error:
            raise ArchiveError(
                f"it is no usable zip archive ({' '.join(str(error).split()) or type(error).__name__})"
            ) from error


_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    NotImplementedError,
    UnicodeError,
    OverflowError,
)


class Archive:
    """A checked archive; `names` are the names of all entries."""

    def __init__(self, archive: zipfile.ZipFile, packed: int) -> None:
        self._archive = archive
        self._files = _checked(archive.infolist(), packed)

    @property
    def names(self) -> list[str]:
        return self._archive.namelist()

    def read(self, name: str, largest: int) -> bytes:
        """Read an entry of at most `largest` bytes. Raises KeyError if it does not exist."""
        entry = self._archive.getinfo(name)
        if entry.file_size > largest:
            raise ArchiveError(
                f"its entry {name!r} has {size(entry.file_size)}; {size(largest)} are allowed"
            )
        return self._archive.read(entry)  # never more than file_size bytes

    def xml(self, name: str) -> tuple[Element, bytes]:
        """Parse an entry as XML; return its root and its text in UTF-8.

        Raises KeyError if it does not exist, ArchiveError if it is invalid.
        """
        data = self.read(name, LARGEST_XML)
        encoding = _check_xml(name, data)
        try:
            root = ElementTree.fromstring(data)
            if encoding not in ("utf-8", "us-ascii"):
                data = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
            data.decode("utf-8")
        except (ElementTree.ParseError, LookupError, UnicodeError, ValueError) as error:
            raise ArchiveError(f"its {name} is not well-formed XML: {error}") from error
        return root, data

    def extract(self, name: str, target: Path) -> None:
        """Write one entry to a file."""
        with self._archive.open(name) as packed, target.open("wb") as file:
            left = self._archive.getinfo(name).file_size
            while chunk := packed.read(1 << 20):
                left -= len(chunk)
                if left < 0:
                    break
                file.write(chunk)
        if left != 0:
            raise ArchiveError(f"its entry {name!r} has another size than its header states")

    def extract_all(self, folder: Path) -> None:
        """Write every entry into `folder`, which must be empty."""
        for place, entry in self._files.items():
            target = folder.joinpath(*place)
            if entry.is_dir():
                target.mkdir(parents=True, exist_ok=True)
            else:
                target.parent.mkdir(parents=True, exist_ok=True)
                self.extract(entry.filename, target)


def _checked(
    entries: list[zipfile.ZipInfo], packed: int
) -> Mapping[tuple[str, ...], zipfile.ZipInfo]:
    """Return the entries by the parts of their names. Raises ArchiveError if one is unsafe."""
    if len(entries) > MOST_ENTRIES:
        raise ArchiveError(f"it has {len(entries)} entries; {MOST_ENTRIES} are allowed")
    trusted = os.environ.get(LARGEST_VARIABLE)
    largest = LARGEST if trusted is None else _trusted(trusted)
    total = sum(entry.file_size for entry in entries)
    if total > largest:
        raise ArchiveError(
            f"it unpacks to {size(total)}; {size(largest)} are allowed (set {LARGEST_VARIABLE}=GIB if you trust it)"
        )
    if trusted is None and total > max(FREE_OF_RATIO, LARGEST_RATIO * packed):
        raise ArchiveError(
            f"it unpacks to {size(total)}, more than {LARGEST_RATIO} times its own size (set {LARGEST_VARIABLE}=GIB if you trust it)"
        )
    found: dict[tuple[str, ...], zipfile.ZipInfo] = {}
    spelled: dict[tuple[str, ...], str] = {}
    for entry in entries:
        place = _place(entry)
        # File systems without case, or with another Unicode normal form, would merge these names.
        alike = tuple(unicodedata.normalize("NFC", part).casefold() for part in place)
        if alike in spelled:
            raise ArchiveError(
                f"its entries {spelled[alike]!r} and {entry.filename!r} would be one file"
            )
        spelled[alike] = entry.filename
        found[place] = entry
    for alike, name in spelled.items():
        for length in range(1, len(alike)):
            above = spelled.get(alike[:length])
            if above is not None and not above.endswith("/"):
                raise ArchiveError(f"its entry {above!r} is a file, and a folder of {name!r}")
    return found


def _trusted(text: str) -> int:
    try:
        gibibytes = float(text)
    except ValueError:
        gibibytes = math.nan
    if not 0.0 < gibibytes < 1e9:
        raise ArchiveError(
            f"{LARGEST_VARIABLE} is {text!r}; a number of GiB above zero is expected"
        )
    return int(gibibytes * (1 << 30))


def _place(entry: zipfile.ZipInfo) -> tuple[str, ...]:
    """Return the parts of an entry's name. Raises ArchiveError unless it is safe."""
    name = entry.filename
    path = PurePosixPath(name.replace("\\", "/"))
    if path.is_absolute() or ".." in path.parts or (len(name) > 1 and name[1] == ":"):
        raise ArchiveError(f"its entry {name[:200]!r} points outside the archive")
    if (
        "\\" in name
        or ":" in name
        or any(ord(letter) < 32 for letter in name)
        or not path.parts
        or len(name) > LONGEST_NAME
    ):
        raise ArchiveError(
            f"its entry {name[:200]!r} has a name that is invalid on some operating systems"
        )
    kind = stat.S_IFMT(entry.external_attr >> 16)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        what = "a symbolic link" if kind == stat.S_IFLNK else "neither a file nor a folder"
        raise ArchiveError(f"its entry {name!r} is {what}")
    if entry.flag_bits & 0x1:
        raise ArchiveError(f"its entry {name!r} is encrypted")
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        method = zipfile.compressor_names.get(entry.compress_type, str(entry.compress_type))  # type: ignore[attr-defined]
        raise ArchiveError(f"its entry {name!r} is compressed by {method}; deflate is expected")
    return path.parts


def _check_xml(name: str, data: bytes) -> str:
    """Check XML before it is parsed; return its encoding in lower case.

    Raises ArchiveError if it is not well-formed, has a document type, or exceeds a limit.
    """
    parser = expat.ParserCreate()
    encoding, elements, depth = "utf-8", 0, 0

    def declared(_: str, given: str | None, __: int) -> None:
        nonlocal encoding
        encoding = (given or encoding).lower()

    def doctype(*_: object) -> None:
        raise ArchiveError(f"its {name} is refused: it declares a document type")

    def start(*_: object) -> None:
        nonlocal elements, depth
        elements, depth = elements + 1, depth + 1
        if elements > MOST_ELEMENTS or depth > DEEPEST_ELEMENT:
            raise ArchiveError(
                f"its {name} is refused: it has more than {MOST_ELEMENTS} elements, or more than {DEEPEST_ELEMENT} within each other"
            )

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    parser.XmlDeclHandler, parser.StartDoctypeDeclHandler = declared, doctype
    parser.StartElementHandler, parser.EndElementHandler = start, end
    try:
        parser.Parse(data, True)
    except ArchiveError:
        raise
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise ArchiveError(f"its {name} is not well-formed XML: {error}") from error
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding = "utf-16"
    return encoding
