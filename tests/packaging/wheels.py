"""Build the sdist and the wheel of this project, and run commands."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def run(*command: str, folder: Path, timeout: float = 120.0, **environment: str) -> str:
    done = subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=timeout,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def built(target: str, source: Path, folder: Path, *, fmus: bool = False) -> Path:
    """Build a wheel or sdist. Without `fmus`, it has no compiled files of the build hook."""
    command = [sys.executable, "-P", "-m", "hatchling", "build", "-t", target, "-d", str(folder)]
    hooks = {} if fmus else {"HATCH_BUILD_NO_HOOKS": "true"}
    run(*command, folder=source, timeout=900.0 if fmus else 120.0, **hooks)
    (path,) = folder.iterdir()
    return path


def sdist_unpacked(folder: Path) -> Path:
    """Return the source tree of the sdist. Builds there leave this checkout unchanged."""
    shutil.unpack_archive(built("sdist", ROOT, folder / "sdist"), folder / "unpacked")
    (source,) = (folder / "unpacked").iterdir()
    return source
