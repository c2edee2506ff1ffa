"""The names that the distribution takes in an environment."""

from __future__ import annotations

import base64
import hashlib
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOTS = ("freeflyer", "freeflyer_adapters", "freeflyer_fmus")


def run(*command: str, folder: Path, **environment: str) -> str:
    done = subprocess.run(
        command, cwd=folder, env={**os.environ, **environment}, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """This distribution's wheel without what the build hook compiles."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-P", "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    run(*command, folder=ROOT, HATCH_BUILD_NO_HOOKS="true")
    (path,) = folder.glob("*.whl")
    return path


def test_the_wheel_holds_three_packages_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = {name.partition("/")[0] for name in archive.namelist()}
    assert sorted(name for name in names if not name.endswith(".dist-info")) == sorted(ROOTS)
    assert len(names) == len(ROOTS) + 1


def other_wheel(name: str, modules: list[str], folder: Path) -> Path:
    """A wheel of another project, with a package of that name."""
    about = f"{name}-9.0.dist-info"
    files = {f"{name}/{module}": f"whose = {name!r}\n".encode() for module in modules}
    files[f"{about}/METADATA"] = f"Metadata-Version: 2.1\nName: {name}\nVersion: 9.0\n".encode()
    files[f"{about}/WHEEL"] = b"Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    files[f"{about}/RECORD"] = "".join(f"{path},,\n" for path in (*files, f"{about}/RECORD")).encode()
    path = folder / f"{name}-9.0-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for inside, content in files.items():
            archive.writestr(inside, content)
    return path


def test_packages_called_adapters_and_cosim_come_and_go_beside_ours(wheel: Path, tmp_path: Path) -> None:
    run(sys.executable, "-P", "-m", "venv", "--without-pip", str(tmp_path / "venv"), folder=tmp_path)
    pip = [sys.executable, "-P", "-m", "pip", "--python", str(tmp_path / "venv/bin/python"), "--disable-pip-version-check"]
    others = [other_wheel(name, ["__init__.py", "histogram.py", "cli.py"], tmp_path) for name in ("adapters", "cosim")]
    run(*pip, "install", "--no-index", "--no-deps", str(wheel), *map(str, others), folder=tmp_path)
    (site,) = (tmp_path / "venv/lib").glob("python*/site-packages")
    assert (site / "adapters/histogram.py").read_text() == "whose = 'adapters'\n"
    run(*pip, "uninstall", "--yes", "adapters", "cosim", folder=tmp_path)
    assert not (site / "adapters").exists()
    (record,) = site.glob("freeflyer_cosim-*.dist-info/RECORD")
    checked = 0
    for line in record.read_text().splitlines():
        name, digest, _ = line.rsplit(",", 2)
        if digest:
            found = base64.urlsafe_b64encode(hashlib.sha256((site / name).read_bytes()).digest()).rstrip(b"=").decode()
            assert digest == f"sha256={found}", name
            checked += 1
    assert checked > 200
