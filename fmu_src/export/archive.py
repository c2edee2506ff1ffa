"""Block -> .fmu files: one library for both FMI versions, two descriptions, reproducible archives."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from fmu_src.block import Block
from fmu_src.errors import BuildError
from fmu_src.export import description
from fmu_src.export.c_code import print_block
from fmu_src.export.compiler import FLAGS, SOURCES, Platform, compile_library, host_platform

EPOCH = (1980, 1, 1, 0, 0, 0)


def content_token(block: Block) -> str:
    """The instantiation token: a hash of everything that makes the FMU what it is."""
    digest = hashlib.sha256()
    digest.update(description.fmi2(block, ""))
    digest.update(description.fmi3(block, ""))
    digest.update(print_block(block, "").encode())
    for path in sorted(SOURCES.glob("*.[ch]")):
        digest.update(path.read_bytes())
    digest.update(" ".join(FLAGS).encode())
    return f"{{{digest.hexdigest()[:32]}}}"


def build(block: Block, directory: Path, platforms: Sequence[Platform] | None = None) -> dict[int, Path]:
    """Write `directory/fmi2/NAME.fmu` and `directory/fmi3/NAME.fmu`; give their paths by FMI version.

    Raises `BuildError` when the compiler fails or the directory cannot be written. Each file appears whole or not at all.
    """
    token = content_token(block)
    targets = platforms or [host_platform()]
    with _scratch() as scratch:
        source = Path(scratch) / "block.c"
        source.write_text(print_block(block, token), encoding="ascii")
        libraries: dict[Platform, bytes] = {}
        for target in targets:
            library = Path(scratch) / f"{block.name}{target.suffix}"
            compile_library(source, library, target)
            libraries[target] = library.read_bytes()
    return {
        2: write_archive(
            directory / "fmi2" / f"{block.name}.fmu",
            {"modelDescription.xml": description.fmi2(block, token)}
            | {f"binaries/{target.fmi2}/{block.name}{target.suffix}": data for target, data in libraries.items()},
        ),
        3: write_archive(
            directory / "fmi3" / f"{block.name}.fmu",
            {"modelDescription.xml": description.fmi3(block, token)}
            | {f"binaries/{target.fmi3}/{block.name}{target.suffix}": data for target, data in libraries.items()},
        ),
    }


def write_archive(path: Path, files: Mapping[str, bytes]) -> Path:
    """A zip with fixed times and order, so that equal content gives equal bytes."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".partial")
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
            for name in sorted(files):
                entry = zipfile.ZipInfo(name, EPOCH)
                entry.compress_type = zipfile.ZIP_DEFLATED
                entry.external_attr = 0o644 << 16
                archive.writestr(entry, files[name])
        os.replace(partial, path)
    except OSError as error:
        raise BuildError(f"{path} cannot be written: {error.strerror}") from error
    finally:
        with contextlib.suppress(OSError, UnboundLocalError):
            partial.unlink(missing_ok=True)
    return path


@contextlib.contextmanager
def _scratch() -> Iterator[str]:
    """A temporary directory; what goes wrong in it is said in one sentence."""
    try:
        with tempfile.TemporaryDirectory() as scratch:
            yield scratch
    except OSError as error:
        raise BuildError(f"the temporary directory {tempfile.gettempdir()} cannot be used: {error.strerror}") from error
