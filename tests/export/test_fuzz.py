"""Random FMI calls on every block's C code, under sanitizers, against the standards (fuzz.c)."""

from __future__ import annotations

import re
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from families import family

from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.export.archive import content_token
from freeflyer_fmus.export.c_code import print_block
from freeflyer_fmus.export.compiler import SOURCES, fmi_headers, run
from freeflyer_fmus.robot.robot import Robot

FUZZ = Path(__file__).parent / "fuzz.c"
SEQUENCES = 3000  # a block
STRICT = [
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
# Here the equations are compiled without optimisation and only with checks of array accesses. This
# takes seconds per block. test_runtime_c.py compiles the equations with all checks.
STRAIGHT = [
    "-std=c99",
    "-g0",
    "-O0",
    "-ffp-contract=off",
    "-fsanitize=address",
    "--param",
    "asan-stack=0",
]

pytestmark = pytest.mark.skipif(
    shutil.which("gcc") is None, reason="no system gcc: the sanitizers need one (CI has it)"
)


@pytest.fixture(scope="module")
def runtime(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Runtime and driver, compiled once for all blocks."""
    directory = tmp_path_factory.mktemp("fuzz")

    def compiled(source: Path) -> str:
        target = directory / f"{source.stem}.o"
        run(
            [
                "gcc",
                *STRICT,
                "-isystem",
                str(fmi_headers()),
                "-I",
                str(SOURCES),
                "-c",
                str(source),
                "-o",
                str(target),
            ],
            f"compiling {source.name} with sanitizers",
        )
        return str(target)

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(compiled, [FUZZ, *sorted(SOURCES.glob("*.c"))]))


@pytest.fixture(scope="module")
def met() -> dict[str, int]:
    """Number of occurrences of each deviation from the standards, over all blocks."""
    return {}


@pytest.mark.parametrize("name", family(BLOCKS, ["hand_kinematics"]))
def test_random_call_sequences_satisfy_the_standards(
    robot: Robot, tmp_path: Path, runtime: list[str], met: dict[str, int], name: str
) -> None:
    block = BLOCKS[name](robot)
    source, program, token = tmp_path / "block.c", tmp_path / "fuzz", content_token(block)
    source.write_text(print_block(block, token))
    run(
        ["gcc", *STRAIGHT, "-I", str(SOURCES), "-c", str(source), "-o", str(tmp_path / "block.o")],
        "compiling block.c",
    )
    run(
        [
            "gcc",
            "-fsanitize=address,undefined",
            str(tmp_path / "block.o"),
            *runtime,
            "-lm",
            "-o",
            str(program),
        ],
        "linking",
    )
    first = 1_000_000 * list(BLOCKS).index(name)
    done = subprocess.run(
        [str(program), token, "1" if block.is_sampled else "0", str(first), str(SEQUENCES)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-12000:]
    assert f"{SEQUENCES} sequences, " in done.stdout
    for times, deviation in re.findall(r"^deviation (\d+): (.*)$", done.stdout, re.MULTILINE):
        met[deviation] = met.get(deviation, 0) + int(times)


@pytest.mark.slow
def test_every_listed_deviation_from_the_standards_occurs(met: dict[str, int]) -> None:
    """If a deviation never occurs, remove it from the list in fuzz_model.h."""
    if not met:
        pytest.skip("runs after all blocks")
    assert [deviation for deviation, times in met.items() if times == 0] == []
