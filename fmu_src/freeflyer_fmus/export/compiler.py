"""Compilation of C sources to a shared library, with the C compiler of the `ziglang` wheel."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from freeflyer.foundation.errors import CosimError
from freeflyer.foundation.extras import require
from freeflyer.foundation.home import cache_of_zig
from freeflyer_fmus.errors import BuildError

SOURCES = Path(__file__).parent.parent / "c"
FLAGS: tuple[str, ...] = (
    "-std=c99",
    "-O2",
    "-ffp-contract=off",
    "-fvisibility=hidden",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-pedantic",
    "-g0",
)
# The next flag halves the compile time. A step of an FMU takes the same time with and without this
# flag, because the code is straight-line. Both times were measured.
FLAGS += ("-fno-slp-vectorize",)


@dataclass(frozen=True)
class Platform:
    """Platform: names in FMI 2.0 and FMI 3.0, target name of the compiler, suffix of libraries."""

    fmi2: str
    fmi3: str
    target: str
    suffix: str


LINUX = Platform("linux64", "x86_64-linux", "x86_64-linux-gnu.2.17", ".so")
PLATFORMS = {
    "x86_64-linux": LINUX,
    "aarch64-linux": Platform("aarch64-linux", "aarch64-linux", "aarch64-linux-gnu.2.17", ".so"),
    "x86_64-windows": Platform("win64", "x86_64-windows", "x86_64-windows-gnu", ".dll"),
    "x86_64-darwin": Platform("darwin64", "x86_64-darwin", "x86_64-macos.11.0", ".dylib"),
    "aarch64-darwin": Platform("aarch64-darwin", "aarch64-darwin", "aarch64-macos.11.0", ".dylib"),
}


def host_platform() -> Platform:
    """Return the platform of this machine.

    Raises BuildError if FMUs cannot be built for this platform.
    """
    machine = {"AMD64": "x86_64", "arm64": "aarch64"}.get(platform.machine(), platform.machine())
    name = f"{machine}-{platform.system().lower()}"
    if name not in PLATFORMS:
        raise BuildError(
            f"this machine is {name}, but FMUs can be built only for {', '.join(PLATFORMS)}"
        )
    return PLATFORMS[name]


def fmi_headers() -> Path:
    """Return the directory of the FMI headers that FMPy ships."""
    import fmpy

    return Path(fmpy.__file__).parent / "c-code"


def compiler(target: Platform, *flags: str) -> list[str]:
    """Return the start of a compiler command for a platform: program, target and `flags`.

    Raises MissingExtra if the compiler is not installed.
    """
    require("the compiler of FMUs", ["ziglang"])
    return [sys.executable, "-P", "-m", "ziglang", "cc", "-target", target.target, *flags]


def compile_core(sources: Path, output: Path, target: Platform) -> None:
    """Compile the master's native core (C99, like the FMUs' runtime) into a shared library."""
    output.parent.mkdir(parents=True, exist_ok=True)
    files = sorted(str(path) for path in sources.glob("*.c"))
    run(
        [*compiler(target, "-shared", "-fPIC", *FLAGS), "-Wl,-s", *files, "-lm", "-o", str(output)],
        "compiling the native core",
    )


def compile_library(block_c: Path, output: Path, target: Platform) -> None:
    """Compile block.c and the runtime into one shared library for both FMI versions."""
    sources = sorted(str(path) for path in SOURCES.glob("*.c"))
    command = compiler(target, "-shared", "-fPIC", *FLAGS)
    if target.suffix == ".dylib":
        # A macOS library contains its own path. By default, this path is the temporary build path.
        command.append(f"-Wl,-install_name,@rpath/{output.name}")
    command += [
        "-Wl,-s",
        "-isystem",
        str(fmi_headers()),
        "-I",
        str(SOURCES),
        str(block_c),
        *sources,
        "-lm",
        "-o",
        str(output),
    ]
    run(command, f"compiling {block_c.name} for {target.fmi3}")


def run(command: list[str], subject: str) -> None:
    """Run a compiler command.

    Raises BuildError if the command fails. The message contains `subject` (what the command does)
    and the output of the compiler.
    """
    try:
        environment = {**os.environ, "ZIG_GLOBAL_CACHE_DIR": cache_of_zig()}
    except CosimError as error:
        raise BuildError(str(error)) from error
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode != 0:
        raise BuildError(
            f"{subject} failed (exit code {done.returncode}): {done.stderr.strip()[-2000:]}"
        )
