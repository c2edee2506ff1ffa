"""Building of .fmu files as reproducible archives.

Each block has one library for each platform, and one model description for each FMI version. The
library of a platform is in the FMUs of both FMI versions.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path

from freeflyer.foundation.errors import CosimError, OutputError
from freeflyer.foundation.reproducible_zip import write_zip
from freeflyer.foundation.temporary_folder import TemporaryFolder
from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.errors import BuildError
from freeflyer_fmus.export import description
from freeflyer_fmus.export.amalgamation import amalgamated
from freeflyer_fmus.export.c_code import print_block
from freeflyer_fmus.export.compiler import FLAGS, SOURCES, Platform, compile_library, host_platform
from freeflyer_fmus.export.scene import SCENE, scene_json

Progress = Callable[[int, int, str], None]
"""Function of the number of finished libraries, the number of all, and what is compiled now."""


def content_token(block: Block) -> str:
    """Return the instantiation token.

    The token is a hash of the descriptions, the equations, the runtime and the compiler flags.
    """
    digest = hashlib.sha256()
    digest.update(description.fmi2(block, ""))
    digest.update(description.fmi3(block, ""))
    digest.update(description.terminals(block) or b"")
    digest.update(print_block(block, "").encode())
    for path in sorted(SOURCES.glob("*.[ch]")):
        digest.update(path.read_bytes())
    digest.update(" ".join(FLAGS).encode())
    return f"{{{digest.hexdigest()[:32]}}}"


def build_all(
    blocks: Iterable[Block],
    directory: Path,
    platforms: Sequence[Platform] | None = None,
    *,
    sources: bool = False,
    progress: Progress | None = None,
) -> Iterator[tuple[Block, dict[int, Path]]]:
    """Write `directory/fmi2/NAME.fmu` and `directory/fmi3/NAME.fmu` of every block.

    The default of `platforms` is the host platform. If `sources` is True, the FMUs contain the C
    sources. Yields each block and the paths of its two FMUs; the keys of the paths are the FMI
    versions. Compilation uses all cores. Files are written atomically. `progress` is called before
    the wait for each library. Raises BuildError if the compiler fails or if the directory is not
    writable.
    """
    targets = [host_platform()] if platforms is None else platforms
    with _scratch() as scratch, ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            jobs = [(block, *_submit(pool, block, scratch, targets)) for block in blocks]
            done, total = 0, len(jobs) * len(targets)
            for block, block_c, libraries in jobs:
                binaries = {}
                for target, library in libraries.items():
                    if progress is not None:
                        progress(done, total, f"{block.name} for {target.fmi3}")
                    binaries[target] = library.result()
                    done += 1
                yield block, _write(block, directory, binaries, block_c if sources else None)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def build(
    block: Block,
    directory: Path,
    platforms: Sequence[Platform] | None = None,
    *,
    sources: bool = False,
) -> dict[int, Path]:
    """Build the FMUs of one block. The arguments are those of `build_all`."""
    ((_, paths),) = build_all([block], directory, platforms, sources=sources)
    return paths


def _submit(
    pool: Executor, block: Block, scratch: Path, targets: Sequence[Platform]
) -> tuple[str, dict[Platform, Future[bytes]]]:
    """Start the compilation of a block for all targets.

    Returns the C code of the block, and for each target the future of its library (bytes). Source
    and libraries are written below `scratch`.
    """
    block_c = print_block(block, content_token(block))
    source = scratch / block.name / "block.c"
    source.parent.mkdir()
    source.write_text(block_c, encoding="ascii")

    def library(target: Platform) -> bytes:
        # The path ends with the final file name, because some library formats store this name.
        path = source.parent / target.fmi3 / f"{block.name}{target.suffix}"
        path.parent.mkdir()
        compile_library(source, path, target)
        return path.read_bytes()

    return block_c, {target: pool.submit(library, target) for target in targets}


def _write(
    block: Block, directory: Path, libraries: Mapping[Platform, bytes], block_c: str | None
) -> dict[int, Path]:
    token, name = content_token(block), block.name
    fmi2 = {
        f"binaries/{target.fmi2}/{name}{target.suffix}": data for target, data in libraries.items()
    }
    fmi3 = {
        f"binaries/{target.fmi3}/{name}{target.suffix}": data for target, data in libraries.items()
    }
    if block_c is not None:
        fmi2[f"sources/{name}.c"] = amalgamated(name, block_c, 2)
        fmi3[f"sources/{name}.c"] = amalgamated(name, block_c, 3)
        fmi3["sources/buildDescription.xml"] = description.build_description(block)
    fmi2["modelDescription.xml"] = description.fmi2(
        block, token, [] if block_c is None else [f"{name}.c"]
    )
    fmi3["modelDescription.xml"] = description.fmi3(block, token)
    grouped = description.terminals(block)
    if grouped:
        fmi3["terminalsAndIcons/terminalsAndIcons.xml"] = grouped
    if block.robot is not None:
        fmi2[SCENE] = fmi3[SCENE] = scene_json(block.robot)
    paths = {version: directory / f"fmi{version}" / f"{name}.fmu" for version in (2, 3)}
    try:
        write_zip(paths[2], fmi2)
        write_zip(paths[3], fmi3)
    except OutputError as error:
        raise BuildError(str(error)) from error
    return paths


@contextlib.contextmanager
def _scratch() -> Iterator[Path]:
    """Yield a temporary directory. Raises BuildError if the file system reports an error."""
    try:
        folder = TemporaryFolder()
    except CosimError as error:
        raise BuildError(str(error)) from error
    with folder as scratch:
        try:
            yield scratch
        except OSError as error:
            raise BuildError(
                f"the temporary directory {scratch} cannot be used: {error.strerror}"
            ) from error
