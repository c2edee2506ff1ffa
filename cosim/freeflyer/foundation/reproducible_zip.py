"""Zip files in which equal content gives equal bytes."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

from freeflyer.foundation.output_file import write_whole

EPOCH = (1980, 1, 1, 0, 0, 0)
"""Time of all entries."""


def write_zip(path: Path, files: Mapping[str, bytes]) -> None:
    """Write a zip file, completely or not at all. The entries have a fixed time and order.

    Raises OutputError if the file cannot be written.
    """

    def pack(partial: Path) -> None:
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
            for name in sorted(files):
                entry = zipfile.ZipInfo(name, EPOCH)
                entry.compress_type = zipfile.ZIP_DEFLATED
                entry.external_attr = 0o644 << 16
                archive.writestr(entry, files[name])

    write_whole(path, pack)
