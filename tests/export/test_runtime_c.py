"""C runtime: sine and cosine, messages, time over many steps, gcc warnings, sanitizers."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import mpmath
import numpy as np
import pytest
from casadi import SX
from families import family

from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.export.archive import content_token
from freeflyer_fmus.export.c_code import print_block
from freeflyer_fmus.export.compiler import SOURCES, compiler, fmi_headers, host_platform, run
from freeflyer_fmus.export.layout import layout
from freeflyer_fmus.robot.robot import Robot

DRIVER = Path(__file__).parent / "driver.c"


def compiled(tmp_path: Path, text: str) -> ctypes.CDLL:
    source, library = tmp_path / "probe.c", tmp_path / "probe.so"
    source.write_text(text)
    zig = compiler(host_platform(), "-shared", "-fPIC", "-std=c99", "-O2", "-ffp-contract=off")
    run(
        [
            *zig,
            "-I",
            str(SOURCES),
            str(source),
            str(SOURCES / "message.c"),
            "-lm",
            "-o",
            str(library),
        ],
        "probe",
    )
    return ctypes.CDLL(str(library))


def test_sine_and_cosine_are_within_one_ulp(tmp_path: Path) -> None:
    text = '#include "sincos.h"\nvoid probe(const double *x, double *s, double *c, int n) { for (int i = 0; i < n; i++) sin_cos(x[i], s + i, c + i); }\n'
    library = compiled(tmp_path, text)
    random = np.random.default_rng(1)
    quarter = np.arange(-200, 200) * np.pi / 4
    x = np.concatenate(
        [
            random.uniform(-4, 4, 4000),
            random.uniform(-1.6e6, 1.6e6, 4000),
            quarter,
            np.nextafter(quarter, 9e9),
            [0.0, -0.0, 1e-300, 2e6, -1e9],
        ]
    )
    s, c = np.empty_like(x), np.empty_like(x)
    pointer = ctypes.POINTER(ctypes.c_double)
    library.probe(*(array.ctypes.data_as(pointer) for array in (x, s, c)), len(x))
    mpmath.mp.prec = 200
    for angle, *both in zip(x, c, s, strict=True):
        for found, exact in zip(both, mpmath.cos_sin(mpmath.mpf(float(angle))), strict=True):
            assert abs(mpmath.mpf(float(found)) - exact) <= np.spacing(abs(float(exact))), angle


@pytest.mark.parametrize(
    "value",
    [
        0.0,
        1.0,
        -1.0,
        0.3,
        1e-3,
        123456.0,
        1234567.0,
        -2.5e-7,
        1e300,
        1e-300,
        0.999999999,
        9.9999951,
        1e5,
        3.14159265,
        float("inf"),
        float("nan"),
    ],
)
def test_numbers_in_messages_are_written_with_six_digits(tmp_path: Path, value: float) -> None:
    text = (
        '#include "message.h"\n#include <string.h>\n'
        'void probe(double value, char *text) { Message m; message_begin(&m, ""); message_add_number(&m, value); strcpy(text, m.text); }\n'
    )
    library = compiled(tmp_path, text)
    out = ctypes.create_string_buffer(400)
    library.probe(ctypes.c_double(value), out)
    written = out.value.decode().replace("infinity", "inf")
    assert written.lower() == f"{value:.6g}".lower()


def counter(_: Robot) -> Block:
    block = Block("counter", "Counts its samples")
    block.sampled_every("period", 0.004, "Period")
    count = block.state("count", 0.0, "1", "Number of samples")
    block.update("count", count + 1.0)
    return block


def watch(_: Robot) -> Block:
    block = Block("watch", "Integrates one")
    block.state("elapsed", 0.0, "s", "Seconds since the start")
    block.derivative("elapsed", SX(1.0))
    return block


@pytest.mark.parametrize(("make", "expected"), [(counter, 2.5e6), (watch, 1e4)])
@pytest.mark.parametrize("summed", family([True, False]))
def test_ten_million_steps_end_at_the_exact_time(
    robot: Robot, tmp_path: Path, make: Callable[[Robot], Block], expected: float, summed: bool
) -> None:
    """If the importer adds up its step sizes (`summed`), its time has an error of 1.6e-6 s."""
    block = make(robot)
    token = content_token(block)
    (tmp_path / "block.c").write_text(print_block(block, token))
    zig = compiler(
        host_platform(), "-std=c99", "-O2", "-isystem", str(fmi_headers()), "-I", str(SOURCES)
    )
    files = [
        str(DRIVER.with_name("clock.c")),
        str(tmp_path / "block.c"),
        *map(str, sorted(SOURCES.glob("*.c"))),
    ]
    run([*zig, *files, "-lm", "-o", str(tmp_path / "clock")], "compiling clock.c")
    state = layout(block).reference[block.having("state")[0].name]
    command = [str(tmp_path / "clock"), token, str(int(summed)), str(state)]
    last, value = map(
        float, subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    )
    assert value == pytest.approx(expected, abs=1e-9)
    # The error is one rounding error of the last step's end. If `summed`, the error of the
    # importer's time is added.
    assert abs(last - 1e4) < (2e-6 if summed else 2e-12)


@pytest.mark.skipif(
    shutil.which("gcc") is None, reason="no system gcc: the sanitizers need one (CI has it)"
)
@pytest.mark.parametrize("name", family(BLOCKS, ["hand_kinematics"]))
def test_the_runtime_has_no_sanitizer_findings_and_no_gcc_warnings(
    robot: Robot, tmp_path: Path, name: str
) -> None:
    """Legal and illegal calls of both interfaces; address, leak and undefined-behaviour checks."""
    block = BLOCKS[name](robot)
    source = tmp_path / "block.c"
    token = content_token(block)
    source.write_text(print_block(block, token))
    program = tmp_path / "driver"
    flags = [
        "-std=c99",
        "-g",
        "-O1",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-pedantic",
        "-fsanitize=address,undefined",
        "-fno-sanitize-recover=all",
    ]
    files = [str(DRIVER), str(source), *map(str, sorted(SOURCES.glob("*.c")))]
    run(
        [
            "gcc",
            *flags,
            "-isystem",
            str(fmi_headers()),
            "-I",
            str(SOURCES),
            *files,
            "-lm",
            "-o",
            str(program),
        ],
        "gcc with sanitizers",
    )
    done = subprocess.run(
        [str(program), token, "1" if block.is_sampled else "0"],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "all calls made" in done.stdout
