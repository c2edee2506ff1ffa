"""Draw the random cases of the battery (`sweeps/battery.toml`).

`python -m freeflyer.paper.battery_cases` prints them. Each case combines one to three disturbances.
The ranges are those of RANGES. The generator and its seed were fixed before the scenario `robust`
was run on these cases.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from freeflyer.scenario.scenario import literal

COUNT, SEED = 100, 2026
RANGES = {
    "push on a joint": "one joint, 0.5 to 10 N m for 0.1 s at 10 s",
    "push on the base": "5 to 100 N for 0.1 s, or 1 to 30 N m for 0.1 s, along one axis",
    "noise": "0.3 to 3 times 0.1 mm, 0.1 mrad, 1 mm/s, 1 mrad/s; joints 10 urad, 0.1 mrad/s",
    "wrong masses": "base mass, base inertia and arm mass of the controllers times 0.7 to 1.3",
    "trajectory": "0 to 0.2 m along each axis, 0 to 0.3 rad about one axis, 0.05 to 0.2 Hz",
    "base period": "0.05 to 1 s",
    "late commands": "base command one T_b late, or arm command one T_m late",
    "limited actuators": "1 to 10 N and 0.5 to 5 N m",
    "thrusters": "2 to 10 N and 1 to 5 N m, on for at least 20 ms",
    "start error": "base 0 to 0.03 m and 0 to 0.2 rad along each axis, or 0 to 0.02 m/s and rad/s",
}
Settings = dict[str, Any]


def rounded(values: object) -> Any:
    """Return numbers with four significant digits, so that the file is short."""
    array = np.asarray(values, dtype=float)
    numbers = [float(f"{number:.4g}") for number in array.ravel()]
    return numbers if array.ndim else numbers[0]


class Draw:
    """The disturbances of one case. Each method returns the settings of one entry of RANGES."""

    def __init__(self, random: np.random.Generator) -> None:
        self.random = random

    def logarithmic(self, low: float, high: float) -> float:
        return float(low * (high / low) ** self.random.random())

    def one_of(self, size: int, low: float, high: float) -> list[float]:
        """Return `size` numbers, all of them zero except for one with a random sign."""
        values = np.zeros(size)
        values[self.random.integers(size)] = self.logarithmic(low, high) * self.random.choice(
            [-1, 1]
        )
        return list(rounded(values))

    def push_on_a_joint(self) -> Settings:
        return {"disturbance.pulse_joint_torque": self.one_of(6, 0.5, 10.0)}

    def push_on_the_base(self) -> Settings:
        force, torque = self.one_of(3, 5.0, 100.0), self.one_of(3, 1.0, 30.0)
        zero = [0.0] * 3
        wrench = [*force, *zero] if self.random.random() < 0.5 else [*zero, *torque]
        return {"disturbance.pulse_base_wrench": wrench}

    def noise(self) -> Settings:
        factor = self.logarithmic(0.3, 3.0)
        typical = {
            "position": 1e-4,
            "orientation": 1e-4,
            "velocity": 1e-3,
            "angular_velocity": 1e-3,
            "joint_position": 1e-5,
            "joint_velocity": 1e-4,
        }
        settings = {f"measurement_noise.{k}_noise": rounded(factor * v) for k, v in typical.items()}
        return settings | {"measurement_noise.seed": int(self.random.integers(1, 1000))}

    def wrong_masses(self) -> Settings:
        mass, inertia, arm = self.random.uniform(0.7, 1.3, 3)
        own = np.array([38.0, 20.0, 23.0, 0.0, 0.0, 0.0])
        return {
            f"{name}.{parameter}": rounded(value)
            for name in ("manipulator_controller", "base_controller")
            for parameter, value in (
                ("base_mass", 150.0 * mass),
                ("base_inertia", own * inertia),
                ("arm_mass_factor", arm),
            )
        }

    def trajectory(self) -> Settings:
        return {
            "reference_trajectory.translation_amplitude": rounded(
                self.random.uniform(-0.2, 0.2, 3)
            ),
            "reference_trajectory.rotation_amplitude": self.one_of(3, 0.03, 0.3),
            "reference_trajectory.frequency": rounded(self.logarithmic(0.05, 0.2)),
        }

    def base_period(self) -> Settings:
        return {"base_controller.period": round(self.logarithmic(0.05, 1.0), 3)}

    def late_commands(self) -> Settings:
        if self.random.random() < 0.5:
            return {"base_command_delay.delay": "=base_controller.period"}
        return {"arm_command_delay.delay": "=manipulator_controller.period"}

    def limited_actuators(self) -> Settings:
        force, torque = self.logarithmic(1.0, 10.0), self.logarithmic(0.5, 5.0)
        return {"base_actuators.limit": rounded([force] * 3 + [torque] * 3)}

    def thrusters(self) -> Settings:
        force, torque = self.logarithmic(2.0, 10.0), self.logarithmic(1.0, 5.0)
        return {
            "base_actuators.on_off": True,
            "base_actuators.thruster_wrench": rounded([force] * 3 + [torque] * 3),
        }

    def start_error(self) -> Settings:
        if self.random.random() < 0.5:
            return {"free_flyer.base_velocity": rounded(self.random.uniform(-0.02, 0.02, 6))}
        vector = self.random.uniform(-0.2, 0.2, 3)
        angle = np.linalg.norm(vector)
        quaternion = [*(np.sin(0.5 * angle) / angle * vector), np.cos(0.5 * angle)]
        return {
            "free_flyer.base_position": rounded(self.random.uniform(-0.03, 0.03, 3)),
            "free_flyer.base_orientation": rounded(quaternion),
        }


def drawn() -> dict[str, Settings]:
    """Return the settings of all cases by name. The calls have the same result every time."""
    random = np.random.default_rng(SEED)
    cases = {}
    for number in range(1, COUNT + 1):
        draw = Draw(random)
        kinds: list[Callable[[], Settings]] = [
            getattr(draw, name.replace(" ", "_")) for name in RANGES
        ]
        chosen = random.choice(len(kinds), size=random.integers(1, 4), replace=False)
        settings: Settings = {}
        for place in sorted(chosen):
            settings |= kinds[place]()
        cases[f"drawn {number:03d}"] = settings
    return cases


def as_toml(cases: dict[str, Settings]) -> str:
    """Return the tables [designs.NAME] of a sweep file."""
    parts = []
    for name, settings in cases.items():
        lines = [f'[designs."{name}"]', *(f'"{k}" = {literal(v)}' for k, v in settings.items())]
        parts.append("\n".join(lines) + "\n")
    return "\n".join(parts)


if __name__ == "__main__":
    print(as_toml(drawn()), end="")
