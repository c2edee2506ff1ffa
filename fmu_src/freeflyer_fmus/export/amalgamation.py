"""The runtime and a block's C as one file, for targets that compile an FMU themselves: C99, mathematics and memory functions only."""

from __future__ import annotations

import re

from freeflyer_fmus.export.compiler import SOURCES

HEADERS = (
    "block",
    "message",
    "sincos",
    "integrate",
    "instance",
    "internal",
)  # each needs those before it
NO_CONTRACTION = """#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("-ffp-contract=off")
#elif defined(_MSC_VER)
#pragma fp_contract(off)
#endif
"""
SHARED = re.compile(r"\b((?:instance|integrate|message)_\w+)\(")


def amalgamated(name: str, block_c: str, version: int) -> bytes:
    """NAME.c with the interface of one FMI version. Names with external linkage begin with the block's, so that several FMUs
    can be linked into one program; its FMI functions do with FMIx_FUNCTION_PREFIX defined, as the standard has it.
    """
    headers = [(SOURCES / f"{header}.h").read_text(encoding="ascii") for header in HEADERS]
    runtime = [path for path in sorted(SOURCES.glob("*.c")) if not path.stem.startswith("fmi")]
    sources = [
        block_c,
        *(path.read_text(encoding="ascii") for path in (*runtime, SOURCES / f"fmi{version}.c")),
    ]
    shared = sorted({found for text in headers for found in SHARED.findall(text)} | {"block"})
    renamed = "".join(f"#define {symbol} {name}_{symbol}\n" for symbol in shared)
    body = re.sub(
        r'^#include "(?!fmi)[^"]*"\n', "", "\n".join([*headers, *sources]), flags=re.MULTILINE
    )
    head = f"/* The FMU {name}, FMI {version}.0: the equations and the runtime in one C99 file. Generated; do not edit.\n"
    head += (
        "   No product is contracted with a sum: then every platform computes the same bits. */\n"
    )
    return f"{head}{NO_CONTRACTION}{renamed}\n{body}".encode("ascii")
