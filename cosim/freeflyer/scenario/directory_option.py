"""Command line options for the directory of a run."""

from __future__ import annotations

import argparse

from freeflyer.foundation.output_file import folder


def add_directory(parser: argparse.ArgumentParser, default: str) -> None:
    """Add the options for the directory of a run. `default` describes the default directory."""
    parser.add_argument("--out", type=folder, metavar="DIR", help=f"default: {default}")
    how = parser.add_mutually_exclusive_group()
    how.add_argument(
        "--keep",
        action="store_const",
        dest="existing",
        const="keep",
        help="if DIR is not empty, rename it to DIR.1 (without this option, only if DIR has a finished run)",
    )
    how.add_argument(
        "--overwrite",
        action="store_const",
        dest="existing",
        const="overwrite",
        help="if DIR has an earlier run, replace its results",
    )
