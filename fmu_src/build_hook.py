"""Wheel build hook: build the shipped FMUs and the native core for the host platform."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class BuildHook(BuildHookInterface):  # type: ignore[misc]
    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if self.target_name != "wheel":
            return
        roots = [str(Path(self.root) / "fmu_src"), str(Path(self.root) / "cosim")]
        sys.path[:0] = roots
        try:
            from freeflyer_fmus.blocks.shipped import BLOCKS
            from freeflyer_fmus.export.archive import build_all
            from freeflyer_fmus.export.compiler import compile_core, host_platform
            from freeflyer_fmus.robot.urdf import load_robot_file

            robot = load_robot_file()
            directory = Path(self.root) / "fmu_src" / "freeflyer_fmus" / "prebuilt"
            # Remove the FMUs of an earlier build, because they must not be in the wheel.
            shutil.rmtree(directory, ignore_errors=True)
            core = Path(self.root) / "cosim" / "freeflyer" / "master" / "core"
            compile_core(core, core / "prebuilt" / "core.so", host_platform())
            for _ in build_all([make(robot) for make in BLOCKS.values()], directory):
                pass
        finally:
            for root in roots:
                sys.path.remove(root)
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{_platform_tag()}"


def _platform_tag() -> str:
    import sysconfig

    return sysconfig.get_platform().replace("-", "_").replace(".", "_")
