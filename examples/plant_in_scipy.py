"""Integrate the free-flyer with scipy: the arm moves, and the free base turns the other way.

This example needs the extra `export`.
"""

import numpy as np
from scipy.integrate import solve_ivp

from freeflyer_fmus import InProcessBlock

plant = InProcessBlock("free_flyer")
plant.start()
names = [variable.name for variable in plant.block.having("state")]
sizes = np.cumsum([plant.value(name).size for name in names])


def part(x: np.ndarray, name: str) -> np.ndarray:
    """Return the elements of the state `name`."""
    return np.split(x, sizes[:-1])[names.index(name)]


def rates(time: float, x: np.ndarray) -> np.ndarray:
    """Return dx/dt for a damped joint torque, and no wrench on the base."""
    torque = np.array([2.0 * np.sin(2.0 * time), 0.0, 0.0, 0.0, 0.0, 0.0])
    plant.set("joint_torque", torque - 5.0 * part(x, "joint_velocity"))
    return plant.derivatives(time, x)


done = solve_ivp(rates, (0.0, 5.0), plant.x, rtol=1e-9, atol=1e-9)
angle = 2.0 * np.degrees(np.arcsin(part(done.y[:, -1], "base_orientation")[2]))
print(f"{done.t.size} steps; joint 1 at {part(done.y[:, -1], 'joint_position')[0]:.3f} rad")
print(f"the base has turned by {angle:.3f} deg about z")
print(
    f"largest eigenvalue of the linearised plant: {np.linalg.eigvals(plant.linearise().A).real.max():.2g} 1/s"
)
