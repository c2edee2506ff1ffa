"""Thruster lag for model exchange, by PythonFMU3: the master integrates it. States are scalars."""

from pythonfmu3 import (
    Float64,
    Fmi3Causality,
    Fmi3Initial,
    Fmi3SlaveBase,
    Fmi3Variability,
    ModelExchange,
)


class ThrusterLagMe(Fmi3SlaveBase, ModelExchange):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time = 0.0
        self.time_constant = 0.02
        self.command, self.wrench, self.rate = [0.0] * 6, [0.0] * 6, [0.0] * 6
        continuous = Fmi3Variability.continuous
        self.register_variable(
            Float64("time", causality=Fmi3Causality.independent, variability=continuous)
        )
        self.register_variable(
            Float64(
                "time_constant",
                causality=Fmi3Causality.parameter,
                variability=Fmi3Variability.tunable,
            )
        )
        for k in range(6):
            self.element(
                Float64(f"command[{k + 1}]", causality=Fmi3Causality.input, variability=continuous),
                self.command,
                k,
            )
            state = Float64(
                f"wrench[{k + 1}]",
                causality=Fmi3Causality.output,
                variability=continuous,
                initial=Fmi3Initial.exact,
            )
            self.element(state, self.wrench, k)
            rate = Float64(
                f"rate[{k + 1}]",
                causality=Fmi3Causality.local,
                variability=continuous,
                derivative=state.value_reference,
            )
            self.element(rate, self.rate, k)

    def element(self, variable, values, k):
        variable.getter = lambda: values[k]
        variable.setter = lambda value: values.__setitem__(k, value)
        self.register_variable(variable)

    def get_continuous_state_derivatives(self):
        self.rate[:] = [
            (u - x) / self.time_constant for u, x in zip(self.command, self.wrench, strict=True)
        ]
        return list(self.rate)
