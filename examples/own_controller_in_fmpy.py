"""Export an own controller as an FMU, and run it beside the free-flyer in a loop over FMPy.

This example needs the extra `export`.
"""

from pathlib import Path

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

from freeflyer_fmus import Block, export_fmus, fmu_path


def joint_damper() -> Block:
    """Return a sampled controller that damps the joints and holds their start positions."""
    block = Block("joint_damper", "Joint springs and dampers")
    block.sampled_every("period", 1e-3, "Sampling time")
    stiff, damp = [50.0, 50.0, 50.0, 20.0, 10.0, 5.0], [8.0, 8.0, 8.0, 2.0, 1.0, 0.5]
    stiffness = block.parameter("stiffness", stiff, "N.m/rad", "Spring of each joint")
    damping = block.parameter("damping", damp, "N.m.s/rad", "Damper of each joint")
    desired = block.parameter("desired", [0.0] * 6, "rad", "Desired joint positions")
    q = block.input("joint_position", [0.0] * 6, "rad", "Measured joint positions")
    v = block.input("joint_velocity", [0.0] * 6, "rad/s", "Measured joint velocities")
    block.output("joint_torque", -stiffness * (q - desired) - damping * v, "N.m", "Joint torques")
    return block


class Slave:
    """An FMU of FMI 2.0 with arrays of real variables."""

    def __init__(self, path: Path) -> None:
        description = read_model_description(path)
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.fmu = FMU2Slave(
            guid=description.guid,
            unzipDirectory=extract(path),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=path.stem,
        )
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=0.0)

    def of(self, name: str, size: int) -> list[int]:
        return [self.references[f"{name}[{k + 1}]"] for k in range(size)]

    def get(self, name: str, size: int = 6) -> np.ndarray:
        return np.array(self.fmu.getReal(self.of(name, size)))

    def set(self, name: str, values: np.ndarray) -> None:
        self.fmu.setReal(self.of(name, len(values)), list(values))


paths = export_fmus("own_fmus", block=joint_damper())
plant, controller = Slave(fmu_path("free_flyer")), Slave(paths["joint_damper"][2])
plant.fmu.enterInitializationMode()
plant.fmu.exitInitializationMode()
start = plant.get("joint_position")
controller.set("desired", start + 0.2)
controller.fmu.enterInitializationMode()
controller.fmu.exitInitializationMode()
for k in range(4000):  # the controller samples first, then its torque is held for 1 ms
    for name in ("joint_position", "joint_velocity"):
        controller.set(name, plant.get(name))
    controller.fmu.doStep(k * 1e-3, 1e-3)
    plant.set("joint_torque", controller.get("joint_torque"))
    plant.fmu.doStep(k * 1e-3, 1e-3)
print("joints have moved by", np.round(plant.get("joint_position") - start, 4), "rad")
print("the base has moved by", np.round(plant.get("base_position", 3), 4), "m")
for slave in (plant, controller):
    slave.fmu.terminate()
    slave.fmu.freeInstance()
