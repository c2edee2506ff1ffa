"""Our SSP files in the peers that read them, and a third-party SSP file in our master."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import closed_loop
import ecos_peer
import libcosim_peer
import pytest
import reference_loops
from families import family
from masters import FOUR, arguments, difference, own_master
from reference_loops import Rule

from freeflyer.scenario import assemble, experiment, scenario
from freeflyer.ssp import read as ssp_read
from freeflyer.ssp import write as ssp_write


def exported(path: Path, base_step: float) -> Path:
    chosen = scenario.load(
        "multirate_passive", ["stop_s=2.1", f"base_controller.step_s={base_step}"]
    )
    with assemble.loaded(chosen, 2) as system:
        ssp_write.write(chosen, system, path)
    return path


@pytest.mark.parametrize("base_step", [0.001, 0.3])
def test_libcosim_runs_our_ssp_with_both_periods(tmp_path: Path, base_step: float) -> None:
    """libcosim forwards a slow slave's outputs at the end of a step, like our parallel exchange."""
    fmus = closed_loop.fmus(2)
    record = libcosim_peer.run_ssp(
        exported(tmp_path / "a.ssp", base_step), fmus, 0.001, 2.1, closed_loop.RECORDED
    )
    assert difference(own_master(2, "parallel", base_step, 2.1, moving=False), record) < 1e-9


@pytest.mark.parametrize("base_step", family([0.3, 0.001]))
def test_ecos_runs_our_ssp_with_both_periods(tmp_path: Path, base_step: float) -> None:
    """ecos forwards a slow slave's outputs one smallest step after the start of its step."""
    fmus = closed_loop.fmus(2)
    record = ecos_peer.run_ssp(
        exported(tmp_path / "a.ssp", base_step), fmus, 0.001, 2.1, closed_loop.RECORDED
    )
    assert difference(own_master(2, "parallel", 0.001, 2.1, moving=False), record) < 1e-9
    expected = reference_loops.run(
        fmus, *arguments(base_step, 2.1, moving=False), Rule(rounds=FOUR)
    )
    assert difference(expected, record) < 1e-9


MASS = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class Mass(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.mass, self.force, self.position, self.speed = 1.0, 0.0, 0.0, 0.0
        self.register_variable(Real("mass", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        self.register_variable(Real("force", causality=Fmi2Causality.input))
        self.register_variable(Real("position", causality=Fmi2Causality.output))

    def do_step(self, time, step):
        self.speed += step * self.force / self.mass
        self.position += step * self.speed
        return True
"""
SPRING = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class Spring(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.stiffness, self.length, self.position, self.force = 1.0, 0.0, 0.0, 0.0
        self.register_variable(Real("stiffness", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        self.register_variable(Real("length", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        self.register_variable(Real("position", causality=Fmi2Causality.input))
        self.register_variable(Real("force", causality=Fmi2Causality.output))

    def do_step(self, time, step):
        self.force = self.stiffness * (self.length - self.position)
        return True
"""


def oscillator(folder: Path) -> Path:
    """Write a third-party SSP file: FMUs by PythonFMU, the system by pyssp-standard."""
    from pyssp_standard.ssd import (
        Component,
        Connection,
        Connector,
        DefaultExperiment,
        ParameterBinding,
        System,
        TypeReal,
    )
    from pyssp_standard.ssp import SSP
    from pyssp_standard.ssv import SSV

    # The FMUs.
    for name, source in (("mass", MASS), ("spring", SPRING)):
        (folder / f"{name}.py").write_text(source)
        command = [
            sys.executable,
            "-m",
            "pythonfmu",
            "build",
            "-f",
            str(folder / f"{name}.py"),
            "-d",
            str(folder),
        ]
        subprocess.run(command, check=True, capture_output=True)

    def component(name: str, file: str, **connectors: str) -> Component:
        made = Component()
        made.name, made.source, made.component_type = (
            name,
            f"resources/{file}",
            "application/x-fmu-sharedlibrary",
        )
        made.connectors = [
            Connector(name=key, kind=kind, type_=TypeReal(None)) for key, kind in connectors.items()
        ]
        return made

    # Parameters of the spring, then the system: both FMUs in a loop.
    with SSV(folder / "spring.ssv", mode="w") as values:
        values.name, values.version = "spring", "1.0"
        values.add_parameter("length", "Real", value="0.5", unit="m")
        values.add_unit("m", {"m": "1"})
    with SSP(folder / "oscillator.ssp", mode="w") as package:
        for file in ("Mass.fmu", "Spring.fmu", "spring.ssv"):
            package.add_resource(folder / file)
        with package.system_structure as structure:
            structure.name, structure.version = "oscillator", "1.0"
            structure.system = System(None, "root")
            mass = component("mass", "Mass.fmu", force="input", position="output")
            spring = component("spring", "Spring.fmu", position="input", force="output")
            spring.parameter_bindings = [ParameterBinding(source="resources/spring.ssv")]
            structure.system.elements = [mass, spring]
            structure.system.connections = [
                Connection(start_element=a, start_connector=p, end_element=b, end_connector=p)
                for a, p, b in (("mass", "position", "spring"), ("spring", "force", "mass"))
            ]
            structure.default_experiment = DefaultExperiment()
            structure.default_experiment.start_time, structure.default_experiment.stop_time = (
                0.0,
                1.0,
            )
    return folder / "oscillator.ssp"


def test_a_plain_third_party_ssp_runs_as_in_fmpy(tmp_path: Path) -> None:
    from fmpy.ssp.simulation import simulate_ssp
    from fmpy.ssp.ssd import Parameter, ParameterSet

    path = oscillator(tmp_path)
    chosen = ssp_read.read(path, tmp_path / "unpacked", step=0.01)
    ours = experiment.run(chosen).outcome.record
    assert ours.time[-1] == 1.0
    # FMPy does not apply the parameter bindings of a file: its user passes them.
    length = ParameterSet(parameters=[Parameter(name="spring.length", value="0.5")])
    theirs = simulate_ssp(str(path), stop_time=1.0, step_size=0.01, parameter_set=length)
    for index in (50, 99):  # FMPy's rows contain the end of the step that starts at their time
        assert ours["mass.position"][index + 1] == pytest.approx(
            theirs["mass.position"][index], abs=1e-12
        )
    assert ours["mass.position"][-1] > 0.1
    shutil.rmtree(tmp_path / "unpacked")
