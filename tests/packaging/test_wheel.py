"""The top-level packages of the distribution."""

from __future__ import annotations

import base64
import hashlib
import sys
import zipfile
from pathlib import Path

import pytest
from wheels import ROOT, built, run, sdist_unpacked

ROOTS = ("freeflyer", "freeflyer_adapters", "freeflyer_fmus")


def names_in(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built("wheel", ROOT, tmp_path_factory.mktemp("wheel"))


def test_the_wheel_contains_three_packages_and_nothing_else(wheel: Path) -> None:
    names = {name.partition("/")[0] for name in names_in(wheel)}
    assert sorted(name for name in names if not name.endswith(".dist-info")) == sorted(ROOTS)
    assert len(names) == len(ROOTS) + 1


def test_the_sdist_gives_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    own = names_in(built("wheel", sdist_unpacked(tmp_path), tmp_path / "wheel"))
    # A checkout may have compiled files.
    assert own == {name for name in names_in(wheel) if "/prebuilt/" not in name}
    assert {"freeflyer/paper/scenarios/facility.toml", "freeflyer_fmus/c/fmi3.c"} <= own
    assert {"freeflyer/schema/scenario.json", "freeflyer/schema/sweep.json"} <= own
    assert {f"{root}/{file}" for root in ROOTS for file in ("__init__.pyi", "py.typed")} <= own


def other_wheel(name: str, modules: list[str], folder: Path) -> Path:
    """Write a wheel of another project, with a package of that name."""
    about = f"{name}-9.0.dist-info"
    files = {f"{name}/{module}": f"whose = {name!r}\n".encode() for module in modules}
    files[f"{about}/METADATA"] = f"Metadata-Version: 2.1\nName: {name}\nVersion: 9.0\n".encode()
    files[f"{about}/WHEEL"] = (
        b"Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    )
    files[f"{about}/RECORD"] = "".join(
        f"{path},,\n" for path in (*files, f"{about}/RECORD")
    ).encode()
    path = folder / f"{name}-9.0-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for inside, content in files.items():
            archive.writestr(inside, content)
    return path


def test_packages_named_adapters_and_cosim_can_be_installed_and_removed_beside_ours(
    wheel: Path, tmp_path: Path
) -> None:
    run(
        sys.executable, "-P", "-m", "venv", "--without-pip", str(tmp_path / "venv"), folder=tmp_path
    )
    pip = [
        sys.executable,
        "-P",
        "-m",
        "pip",
        "--python",
        str(tmp_path / "venv/bin/python"),
        "--disable-pip-version-check",
    ]
    # Installation of all three, then removal of the others.
    others = [
        other_wheel(name, ["__init__.py", "histogram.py", "cli.py"], tmp_path)
        for name in ("adapters", "cosim")
    ]
    run(*pip, "install", "--no-index", "--no-deps", str(wheel), *map(str, others), folder=tmp_path)
    (site,) = (tmp_path / "venv/lib").glob("python*/site-packages")
    assert (site / "adapters/histogram.py").read_text() == "whose = 'adapters'\n"
    run(*pip, "uninstall", "--yes", "adapters", "cosim", folder=tmp_path)
    assert not (site / "adapters").exists()
    # Our files are still there, unchanged.
    (record,) = site.glob("freeflyer_cosim-*.dist-info/RECORD")
    checked = 0
    for line in record.read_text().splitlines():
        name, digest, _ = line.rsplit(",", 2)
        if digest:
            found = (
                base64.urlsafe_b64encode(hashlib.sha256((site / name).read_bytes()).digest())
                .rstrip(b"=")
                .decode()
            )
            assert digest == f"sha256={found}", name
            checked += 1
    assert checked > 200
