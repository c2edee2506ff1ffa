"""Reader for untrusted zip archives (FMUs, SSP files).

The list of entries is checked before any entry is read. Nothing in the archive is executed.
An archive is rejected if it contains:
- an entry with a name that points outside the target folder;
- two entries that some operating system would store in one file, for example NAME and name;
- an entry that is neither a regular file nor a folder;
- an encrypted entry;
- an entry with a compression method other than deflate or none (section 2.5 of FMI 3.0).

An archive is also rejected if it is a decompression bomb: a small file that unpacks to a very large
size.

An XML entry with a document type is rejected when it is read. A document type can define entities,
and the XML parser could fetch or expand them.
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
from freeflyer.foundation.errors import one_line

MOST_ENTRIES = 50_000
LARGEST = 8 << 30
"""Largest allowed unpacked size of an archive [bytes], as the sum of all entries."""
LARGEST_RATIO, FREE_OF_RATIO = 200, 256 << 20
"""Two limits of the unpacked size. An archive is rejected only if it exceeds both limits.

The first limit is LARGEST_RATIO times the size of the archive file. The second limit is
FREE_OF_RATIO [bytes]. Thus a small archive with a large ratio is allowed.
"""
LARGEST_XML, MOST_ELEMENTS, DEEPEST_ELEMENT = 64 << 20, 2_000_000, 200
LARGEST_VARIABLE = "FREEFLYER_LARGEST_ARCHIVE"
"""Name of an environment variable with which the user allows large archives.

If the variable is set, its value [GiB] replaces LARGEST, and LARGEST_RATIO is not checked.
"""
LARGEST_DIRECTORY = 32 << 20
"""Largest allowed size [bytes] of an archive's central directory, which is its list of entries."""
LONGEST_NAME = 1024

Element = ElementTree.Element


class ArchiveError(ValueError):
    """An archive is rejected. The message contains only the reason.

    A caller that catches this exception adds the name of the archive.
    """


class _Bounded(io.BufferedReader):
    """A file that rejects a single read of more than LARGEST_DIRECTORY bytes.

    `zipfile` reads the whole central directory with one read. Without the limit, a large central
    directory could use all memory before the archive is checked.
    """

    def read(self, count: int | None = -1) -> bytes:
        if count is not None and count > LARGEST_DIRECTORY:
            raise ArchiveError(f"its list of entries has more than {size(LARGEST_DIRECTORY)}")
        return super().read(count)


@contextmanager
def opened(path: Path) -> Iterator[Archive]:
    """Open and check an archive.

    Raises ArchiveError if the archive is invalid. The `with` block can also raise ArchiveError,
    when it reads an invalid entry. Raises OSError if the archive file cannot be read. The `with`
    block can also raise OSError, for example if the disk is full when an entry is extracted.
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
                "it is not a usable zip archive (an entry lies outside the archive)"
            ) from error
        except _DAMAGE as error:
            raise ArchiveError(f"it is not a usable zip archive ({one_line(error)})") from error


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
    """A checked archive. `names` contains the names of all entries.

    `packed` is the size of the archive file [bytes].
    """

    def __init__(self, archive: zipfile.ZipFile, packed: int) -> None:
        self._archive = archive
        self._files = _checked(archive.infolist(), packed)

    @property
    def names(self) -> list[str]:
        return self._archive.namelist()

    def read(self, name: str, largest: int) -> bytes:
        """Return the content of an entry. The entry may have at most `largest` bytes.

        Raises KeyError if the entry does not exist, ArchiveError if the entry is larger.
        """
        entry = self._archive.getinfo(name)
        if entry.file_size > largest:
            raise ArchiveError(
                f"its entry {name!r} has {size(entry.file_size)}; {size(largest)} are allowed"
            )
        return self._archive.read(entry)  # returns at most file_size bytes

    def xml(self, name: str) -> tuple[Element, bytes]:
        """Parse an entry as XML. Return the root element, and the XML text in UTF-8.

        Raises KeyError if the entry does not exist, ArchiveError if the entry is invalid.
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
        """Write the content of one entry to the file `target`."""
        with self._archive.open(name) as packed, target.open("wb") as file:
            left = self._archive.getinfo(name).file_size
            while chunk := packed.read(1 << 20):
                left -= len(chunk)
                if left < 0:
                    break
                file.write(chunk)
        if left != 0:
            raise ArchiveError(f"its entry {name!r} does not have the size that its header states")

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
    """Check all entries of an archive whose file has `packed` bytes.

    Return the entries. The key of an entry is the tuple of the parts of its path.
    Raises ArchiveError if an entry is unsafe, or if the archive exceeds a limit.
    """
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
        # Some file systems ignore case or normalize Unicode. Such a file system would store two
        # entries in one file if their names differ only in case or in Unicode normalization. Such
        # names have the same value of `alike`.
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
                raise ArchiveError(
                    f"its entry {above!r} is a file, but its entry {name!r} needs a folder of that name"
                )
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
    """Return the parts of an entry's path. Raises ArchiveError if the entry is unsafe."""
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
    """Check the XML text `data` before ElementTree parses it.

    Return the name of its encoding in lower case. `name` is the name of the entry in messages.
    Raises ArchiveError if the XML is not well-formed, has a document type, or exceeds a limit.
    """
    parser = expat.ParserCreate()
    encoding, elements, depth = "utf-8", 0, 0

    def declared(_: str, given: str | None, __: int) -> None:
        nonlocal encoding
        encoding = (given or encoding).lower()

    def doctype(*_: object) -> None:
        raise ArchiveError(
            f"its {name} declares a document type; XML without a document type is expected"
        )

    def start(*_: object) -> None:
        nonlocal elements, depth
        elements, depth = elements + 1, depth + 1
        if elements > MOST_ELEMENTS or depth > DEEPEST_ELEMENT:
            raise ArchiveError(
                f"its {name} has more than {MOST_ELEMENTS} elements, or more than {DEEPEST_ELEMENT} nested elements"
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
