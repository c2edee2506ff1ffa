"""PD base controller by PythonFMU3 (FMI 3.0): arrays, with a unit if all elements have the same."""

import numpy as np
from pythonfmu3 import Dimension, Float64, Fmi3Causality, Fmi3Slave, Fmi3Variability, Unit


def rotation_error(q, d):
    return 2.0 * (q @ d) * (d[3] * q[:3] - q[3] * d[:3] - np.cross(q[:3], d[:3]))


class PdBaseController3(Fmi3Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time = 0.0
        self.register_units([Unit("m", m=1)])
        self.register_variable(
            Float64(
                "time", causality=Fmi3Causality.independent, variability=Fmi3Variability.continuous
            )
        )
        self.vector("stiffness", [150.0] * 3 + [40.0] * 3, Fmi3Causality.parameter)
        self.vector("damping", [150.0] * 3 + [40.0] * 3, Fmi3Causality.parameter)
        self.vector("position_setpoint", [0.0] * 3, Fmi3Causality.parameter, "m")
        self.vector("orientation_setpoint", [0.0, 0.0, 0.0, 1.0], Fmi3Causality.parameter)
        self.vector("base_position", [0.0] * 3, Fmi3Causality.input, "m")
        self.vector("base_orientation", [0.0, 0.0, 0.0, 1.0], Fmi3Causality.input)
        self.vector("base_velocity", [0.0] * 6, Fmi3Causality.input)
        self.vector("end_effector_position", [0.0] * 3, Fmi3Causality.input, "m")
        self.vector("end_effector_wrench", [0.0] * 6, Fmi3Causality.input)
        self.vector("base_wrench", [0.0] * 6, Fmi3Causality.output)

    def vector(self, name, values, causality, unit=None):
        setattr(self, name, np.array(values))
        variability = (
            Fmi3Variability.tunable
            if causality == Fmi3Causality.parameter
            else Fmi3Variability.continuous
        )
        size = [Dimension(start=str(len(values)))]
        array = Float64(
            name, causality=causality, variability=variability, dimensions=size, unit=unit
        )
        # PythonFMU3 0.3.4's setter calls numpy.reshape(newshape=...), which NumPy 2.4 removed.
        array.setter = lambda value: setattr(self, name, np.array(value))
        self.register_variable(array)

    def do_step(self, current_time, step_size):
        moved = self.base_position - self.position_setpoint
        error = np.concatenate(
            [moved, rotation_error(self.base_orientation, self.orientation_setpoint)]
        )
        force, torque = self.end_effector_wrench[:3], self.end_effector_wrench[3:]
        lever = self.end_effector_position - self.base_position
        reaction = np.concatenate([force, torque + np.cross(lever, force)])
        self.base_wrench = reaction - self.stiffness * error - self.damping * self.base_velocity
        return True
