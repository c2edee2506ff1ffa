"""FMUs of other platforms under emulation, and FMUs compiled from their sources: identical bits."""

from __future__ import annotations

import os
import re
import shutil
import struct
import subprocess
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
import pytest
from families import family
from fmpy.build import build_platform_binary
from fmpy.validation import validate_fmu
from lxml import etree

from freeflyer.fmi.fmu import FmuComponent
from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.export.archive import build, content_token
from freeflyer_fmus.export.c_code import print_block
from freeflyer_fmus.export.compiler import (
    FLAGS,
    PLATFORMS,
    Platform,
    compiler,
    fmi_headers,
    host_platform,
    run,
)
from freeflyer_fmus.export.layout import layout
from freeflyer_fmus.robot.robot import Array, Robot

DRIVE = Path(__file__).parent / "drive.c"
STEPS = 200
FROM_THE_C_LIBRARY = re.compile(r"\b(exp|log|tan|asin|acos|atan|sinh|cosh|tanh|pow|atan2|fmod)\(")
"""C libraries differ in the last bit of these functions."""
DRIVEN = (
    "free_flyer",
    "reference_trajectory",
    "manipulator_controller",
    "base_controller",
    "arm_drive",
    "base_robot",
)
"""Blocks run on other platforms: closed loop, friction, noise (compilation takes seconds)."""


def every_operation(_: Robot) -> Block:
    """A block with every C library function that equations may use."""
    block = Block("every_operation", "All functions available to a block's equations")
    x = block.input("x", [0.3, 0.6], "1", "Arguments")
    one = [
        ca.sin,
        ca.cos,
        ca.tan,
        ca.asin,
        ca.acos,
        ca.atan,
        ca.sinh,
        ca.cosh,
        ca.tanh,
        ca.exp,
        ca.log,
    ]
    one += [ca.sqrt, ca.floor, ca.ceil, ca.fabs, ca.sign]
    two = [ca.fmin, ca.fmax, ca.fmod, ca.atan2, ca.power]
    block.output(
        "y", ca.vertcat(*(f(x[0]) for f in one), *(f(x[0], x[1]) for f in two)), "1", "Results"
    )
    return block


MAKERS: Mapping[str, Callable[[Robot], Block]] = {name: BLOCKS[name] for name in DRIVEN} | {
    "every_operation": every_operation
}


Built = Callable[..., Path]


@pytest.fixture(scope="module")
def built(robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> Built:
    """Build a block's FMUs once, for the host and other platforms, with sources."""

    @cache
    def directory(name: str, *platforms: Platform) -> Path:
        made = tmp_path_factory.mktemp("fmus")
        build(MAKERS[name](robot), made, [host_platform(), *platforms], sources=True)
        return made

    return directory


def library(built: Path, name: str, target: Platform, directory: Path) -> Path:
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / f"{name}{target.suffix}"
    with zipfile.ZipFile(built / "fmi2" / f"{name}.fmu") as archive:
        path.write_bytes(archive.read(f"binaries/{target.fmi2}/{name}{target.suffix}"))
    return path


@dataclass(frozen=True)
class Machine:
    """Run a platform's programs on this machine. `drive` is drive.c, compiled for the platform."""

    target: Platform
    directory: Path
    command: tuple[str, ...] = ()
    environment: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # The flags are those of the FMU libraries. Therefore the compiler builds its part of the C
        # library only once.
        flags = [*FLAGS, "-fPIC", "-Wl,-s", "-isystem", str(fmi_headers())]
        system = ["-ldl"] if "linux" in self.target.target else []
        run(
            [*compiler(self.target, *flags), str(DRIVE), *system, "-o", str(self.drive)],
            "compiling drive.c",
        )

    @property
    def drive(self) -> Path:
        return self.directory / "drive.exe"

    def values(self, block: Block, library: Path) -> Array:
        """Return all readable values of the block after each step (steps, values)."""
        vector, count = test_vector(block)
        done = subprocess.run(
            [*self.command, str(self.drive), f"./{library.name}", content_token(block)],
            input=vector,
            env=os.environ | self.environment,
            cwd=library.parent,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert done.returncode == 0, done.stderr[-2000:]
        return np.frombuffer(bytes.fromhex(done.stdout), dtype=">f8").reshape(STEPS, count)


def test_vector(block: Block) -> tuple[str, int]:
    """Return the input of drive.c (random inputs near the start values) and its output's width."""
    plan = layout(block)
    first, inputs = plan.ranges["inputs"]
    start = np.array(plan.start[first : first + inputs])
    read = [
        first + k
        for name in ("states", "outputs", "derivatives")
        for first, n in [plan.ranges[name]]
        for k in range(n)
    ]
    values = start + 1e-2 * (1.0 + np.abs(start)) * np.random.default_rng(1).uniform(
        -1.0, 1.0, (STEPS, inputs)
    )
    fields = [
        STEPS,
        inputs,
        len(read),
        bits(block.default_step),
        *range(first, first + inputs),
        *read,
        *map(bits, values.flat),
    ]
    return "\n".join(map(str, fields)), len(read)


test_vector.__test__ = False  # type: ignore[attr-defined]


def bits(value: float) -> str:
    return struct.pack(">d", value).hex()


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return Machine(host_platform(), tmp_path_factory.mktemp("here"))


@pytest.fixture(scope="module")
def aarch64_linux(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    """Needs the Debian packages qemu-user and libc6-arm64-cross."""
    program = shutil.which("qemu-aarch64") or shutil.which("qemu-aarch64-static")
    if program is None:
        pytest.skip(
            "no qemu-aarch64 (nor qemu-aarch64-static): nothing here runs programs for aarch64-linux"
        )
    root = Path("/usr/aarch64-linux-gnu")
    if not (root / "lib" / "ld-linux-aarch64.so.1").exists():
        pytest.skip(f"no C library for aarch64-linux in {root} (Debian: libc6-arm64-cross)")
    return Machine(
        PLATFORMS["aarch64-linux"], tmp_path_factory.mktemp("aarch64"), (program, "-L", str(root))
    )


@pytest.fixture(scope="module")
def x86_64_windows(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    """Needs the Debian packages wine and wine64.

    A full Wine prefix takes seconds and 700 MB. A console program does not need a full prefix. With
    WINEBOOTSTRAPMODE, Wine assumes that the prefix is being set up and uses Wine's installed
    libraries. The "disable" time stamp prevents a setup.
    """
    program = shutil.which("wine64") or shutil.which("wine")
    if program is None:
        pytest.skip("no wine64 (nor wine): nothing here runs programs for x86_64-windows")
    with tempfile.TemporaryDirectory() as prefix:
        (Path(prefix) / ".update-timestamp").write_text("disable\n")
        environment = {
            "WINEPREFIX": prefix,
            "WINEBOOTSTRAPMODE": "1",
            "WINEDEBUG": "-all",
            "DISPLAY": "",
        }
        environment["WINEDLLOVERRIDES"] = "mscoree,mshtml="  # prevents a download dialog
        yield Machine(
            PLATFORMS["x86_64-windows"], tmp_path_factory.mktemp("windows"), (program,), environment
        )
        # The Wine server outlives its last program and still uses the prefix.
        if server := shutil.which("wineserver"):
            subprocess.run([server, "-w"], env=os.environ | environment, timeout=60, check=False)


def assert_same(block: Block, values: Array, expected: Array) -> None:
    """Compare bit for bit, or within 1e-12 if the C library's functions are used."""
    assert np.isfinite(values).all()
    if FROM_THE_C_LIBRARY.search(print_block(block, "")):
        np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12)
    else:
        assert values.tobytes() == expected.tobytes()


@pytest.mark.parametrize("machine", family(["aarch64_linux", "x86_64_windows"]))
@pytest.mark.parametrize("name", family(MAKERS, ["base_robot"]))
def test_another_platform_computes_the_same_bits(
    robot: Robot,
    built: Built,
    here: Machine,
    request: pytest.FixtureRequest,
    machine: str,
    name: str,
) -> None:
    there: Machine = request.getfixturevalue(machine)
    block = MAKERS[name](robot)
    directory = built(name, there.target)
    values = [
        m.values(block, library(directory, name, m.target, m.directory / name))
        for m in (there, here)
    ]
    assert_same(block, *values)


# Sources


@pytest.mark.parametrize("name", family(MAKERS, ["base_robot"]))
@pytest.mark.parametrize("version", [2, 3])
def test_fmus_with_binaries_and_sources_are_valid(built: Built, version: int, name: str) -> None:
    path = built(name, PLATFORMS["aarch64-linux"]) / f"fmi{version}" / f"{name}.fmu"
    assert validate_fmu(str(path)) == []
    if version == 3:
        schema = etree.XMLSchema(
            file=str(Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3BuildDescription.xsd")
        )
        with zipfile.ZipFile(path) as archive:
            schema.assertValid(etree.fromstring(archive.read("sources/buildDescription.xml")))


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("program", ["gcc", "clang"])
def test_the_sources_compile_without_warnings(
    built: Built, tmp_path: Path, program: str, version: int
) -> None:
    """The sources are C99 and use only mathematics and memory functions of the C library."""
    if shutil.which(program) is None:
        pytest.skip(f"no {program} on this machine (CI has it)")
    flags = [
        "-std=c99",
        "-pedantic",
        "-Wall",
        "-Wextra",
        "-Wconversion",
        "-Wno-sign-conversion",
        "-Werror",
        "-O1",
    ]
    for name in SMALL:
        with zipfile.ZipFile(built(name) / f"fmi{version}" / f"{name}.fmu") as archive:
            sources = [
                entry
                for entry in archive.namelist()
                if entry.startswith("sources/") and entry.endswith(".c")
            ]
            assert sources == [f"sources/{name}.c"]
            (tmp_path / f"{name}.c").write_bytes(archive.read(sources[0]))
        headers = tmp_path / "headers"  # only the standard's headers
        headers.mkdir(exist_ok=True)
        for header in fmi_headers().glob(f"fmi{version}*.h"):
            shutil.copy(header, headers)
        prefix = f"-DFMI{version}_FUNCTION_PREFIX={name}_"
        run(
            [
                program,
                *flags,
                prefix,
                "-isystem",
                str(headers),
                "-c",
                str(tmp_path / f"{name}.c"),
                "-o",
                str(tmp_path / f"{name}.o"),
            ],
            program,
        )
    # Two FMUs can be linked into one program. FMPy's FMI 2.0 header supports no prefix. Therefore
    # the names fmi2... are equal in both FMUs.
    objects = [str(tmp_path / f"{name}.o") for name in SMALL]
    own = [set(re.findall(r" [A-TV-Z] (\w+)", symbols(path))) for path in objects]
    assert all(len(names) > 10 for names in own)
    assert {name for name in own[0] & own[1] if not name.startswith("fmi2")} == set()
    used = {name for path in objects for name in re.findall(r" U (\w+)", symbols(path))}
    assert used <= MATHEMATICS | MEMORY, used - MATHEMATICS - MEMORY


def symbols(path: str) -> str:
    return subprocess.run(["nm", path], capture_output=True, text=True, check=True).stdout


SMALL = ("reference_trajectory", "base_robot")
MATHEMATICS = {
    "ceil",
    "cos",
    "cosh",
    "exp",
    "sinh",
    "fabs",
    "floor",
    "llround",
    "log10",
    "lround",
    "pow",
    "sin",
    "sincos",
    "sqrt",
}
MEMORY = {
    "calloc",
    "free",
    "malloc",
    "memcpy",
    "memset",
    "strlen",
    "_GLOBAL_OFFSET_TABLE_",
}  # strlen: generated by gcc


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
def test_an_importers_build_of_the_sources_computes_the_same_bits(
    robot: Robot, built: Built, fmus: Path, tmp_path: Path, version: int
) -> None:
    """FMPy's build of sources/, compared with the shipped binary."""
    if shutil.which("cmake") is None or shutil.which("gcc") is None:
        pytest.skip("no cmake and gcc on this machine (CI has them)")
    name = "manipulator_controller"
    unpacked, own = tmp_path / "unpacked", tmp_path / f"{name}.fmu"
    with zipfile.ZipFile(built(name) / f"fmi{version}" / own.name) as archive:
        archive.extractall(
            unpacked, [entry for entry in archive.namelist() if not entry.startswith("binaries/")]
        )
    (tmp_path / "build").mkdir()
    build_platform_binary(unpacked, tmp_path / "build", configuration="Release")
    with zipfile.ZipFile(own, "w") as archive:
        for path in unpacked.rglob("*"):
            archive.write(path, path.relative_to(unpacked).as_posix())
    records = []
    for path in (own, fmus / f"fmi{version}" / own.name):
        component = FmuComponent(name, path)
        component.enter_initialization(0.0, {})
        component.exit_initialization()
        u, y = np.zeros(6), np.zeros(6)
        write, read = (
            component.bind_inputs(["desired_velocity"], u),
            component.bind_outputs(["end_effector_wrench"], y),
        )
        found = []
        for k in range(50):
            u[:] = np.sin(0.1 * k + np.arange(6))
            write()
            component.step(k * 1e-3, 1e-3)
            read()
            found.append(y.copy())
        component.close()
        records.append(np.array(found))
    assert records[0].tobytes() == records[1].tobytes()


# Dependencies of a library


@pytest.fixture(scope="module")
def small(robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], bytes]:
    """Return the bytes of a library for a platform and build number.

    The bytes contain the names of the imported libraries.
    """

    @cache
    def needs(platform: str, which: int = 0) -> bytes:
        target, directory = PLATFORMS[platform], tmp_path_factory.mktemp(f"small{which}")
        build(every_operation(robot), directory, [target])
        return library(directory, "every_operation", target, directory / platform).read_bytes()

    return needs


@pytest.mark.parametrize("platform", family(PLATFORMS))
def test_library_builds_are_reproducible(small: Callable[[str, int], bytes], platform: str) -> None:
    assert tempfile.gettempdir().encode() not in small(platform, 0)
    assert small(platform, 0) == small(platform, 1)


@pytest.mark.parametrize("platform", family(["x86_64-linux", "aarch64-linux"]))
def test_linux_libraries_need_only_a_c_library_of_2012(
    small: Callable[[str, int], bytes], platform: str
) -> None:
    data = small(platform, 0)
    versions = {tuple(map(int, found)) for found in re.findall(rb"GLIBC_(\d+)\.(\d+)", data)}
    assert versions
    assert max(versions) <= (2, 17)
    assert set(re.findall(rb"[\w.+-]+\.so\.\d+", data)) == {b"libc.so.6", b"libm.so.6"}


@pytest.mark.slow
def test_windows_libraries_need_only_the_system(small: Callable[[str, int], bytes]) -> None:
    needed = {
        name.lower()
        for name in re.findall(rb"[\w.-]+\.dll", small("x86_64-windows", 0), re.IGNORECASE)
    }
    # The universal C runtime is a part of Windows since Windows 10.
    others = {name for name in needed if not name.startswith(b"api-ms-win-crt-")}
    assert others == {b"kernel32.dll", b"every_operation.dll"}


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["x86_64-darwin", "aarch64-darwin"])
def test_macos_libraries_need_only_the_system(
    small: Callable[[str, int], bytes], platform: str
) -> None:
    data = small(platform, 0)
    named = set(re.findall(rb"[@\w.+-]*/[\w./+-]+\.dylib", data))
    assert named == {b"@rpath/every_operation.dylib", b"/usr/lib/libSystem.B.dylib"}
    # LC_BUILD_VERSION for macOS: the oldest supported release.
    head = struct.pack("<3I", 0x32, 32, 1)
    (oldest,) = struct.unpack_from("<I", data, data.index(head) + len(head))
    assert oldest >> 16 == 11
