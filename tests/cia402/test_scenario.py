"""Effects of a control period of 4 ms and of a target delay of one SYNC; without a clock."""

from __future__ import annotations

from pathlib import Path

import pytest

from freeflyer.scenario import experiment, scenario
from freeflyer.scenario.experiment import Result

DRIVES = """
import numpy as np
from freeflyer.fmi.component import Port, PythonComponent

STEP = np.array([0.367, 0.367, 0.209, 0.209, 0.08, 0.08]) * 160 / 1000

class Drives(PythonComponent):
    "The torque follows its target one period later, in thousandths of the rated torque."
    variable_step = False

    def __init__(self, name):
        unit = ("N.m",) * 6
        super().__init__(name, [
            Port(name="target", size=6, causality="input", units=unit),
            Port(name="torque", size=6, causality="output", units=unit, sampled=True),
        ])

    def step(self, time, size):
        self.values["torque"][:] = np.rint(self.values["target"] / STEP) * STEP
"""
TEXT = """extends = "facility_cia402"
connections = ["drives.torque -> arm_drive.joint_torque_command"]
delayed = ["manipulator_controller.joint_torque -> drives.target"]
[components.drives]
kind = "python"
object = "drives.py:Drives"
step_s = {0}
[components.hand_kinematics.parameters]
period = {0}
[components.manipulator_controller.parameters]
period = {0}
[components.base_controller.parameters]
period = {0}
[components.satellite]
step_s = {0}
[components.reference_trajectory]
step_s = {0}
"""


def late(folder: Path, period: float) -> Result:
    (folder / "drives.py").write_text(DRIVES)
    path = folder / "late.toml"
    path.write_text(TEXT.format(period))
    return experiment.run(scenario.load(str(path)))


def errors(result: Result) -> dict[str, float]:
    return {
        name: numbers["max"]
        for name, numbers in result.summary.items()
        if name.endswith(("_error_m", "_error_deg"))
    }


def test_four_milliseconds_and_a_delay_of_one_sync_change_the_errors_little(tmp_path: Path) -> None:
    fast = errors(experiment.run(scenario.load("facility")))
    for result in (experiment.run(scenario.load("facility_cia402")), late(tmp_path, 0.004)):
        assert result.as_expected
        assert len(errors(result)) == 4
        for name, value in errors(result).items():
            assert value == pytest.approx(fast[name], rel=0.04), name
        assert result.summary["observed_energy_j"]["manipulator"]["min"] > 0.0


def test_at_eight_milliseconds_the_delay_of_one_sync_makes_the_loop_diverge(tmp_path: Path) -> None:
    result = late(tmp_path, 0.008)
    assert result.outcome.diverged
    assert result.outcome.simulated < 5.0
