"""Amalgamation: combines the runtime and the C code of a block into one C99 file.

The file is for source-code FMUs. It needs only mathematics and memory functions of the C library.
"""

from __future__ import annotations

import re

from freeflyer_fmus.export.compiler import SOURCES

# The order follows the dependencies.
HEADERS = ("block", "message", "sincos", "integrate", "instance", "internal")
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
    """Return NAME.c with the interface of one FMI version.

    Names with external linkage have the name of the block as a prefix. Therefore several FMUs can
    be linked into one program. As in the FMI standard, the FMI functions have this prefix only if
    FMIx_FUNCTION_PREFIX is defined.
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
    head = f"/* The FMU {name}, FMI {version}.0: equations and runtime in one C99 file. Generated; do not edit.\n"
    head += (
        "   Without fused multiply-add instructions, every platform computes the same bits. */\n"
    )
    return f"{head}{NO_CONTRACTION}{renamed}\n{body}".encode("ascii")
