"""Workers: loopback only, one BLAS thread, no shared FMU folders, no files of another build."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from freeflyer.analysis.sweep import file as sweep_file
from freeflyer.analysis.sweep import task as sweep_task
from freeflyer.analysis.sweep.cluster import connected
from freeflyer.analysis.sweep.plan import Plan
from freeflyer.fmi import unpacked
from freeflyer.fmi.fmu import FmuComponent
from freeflyer.scenario import assemble, parameters, scenario

SWEEP = 'scenario = "multirate_passive"\nset = ["stop_s=0.01"]\n[grid]\n"robot.base_mass" = [150, 100.0]\n'


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    (tmp_path / "mass.toml").write_text(SWEEP)
    return Plan(sweep_file.read(str(tmp_path / "mass.toml")))


def test_workers_listen_on_the_loopback_only_and_have_one_blas_thread() -> None:
    with connected(None, 1) as client:
        me = psutil.Process()
        listening = [
            socket
            for process in (me, *me.children(recursive=True))
            for socket in process.net_connections()
        ]
        addresses = {socket.laddr.ip for socket in listening if socket.status == psutil.CONN_LISTEN}
        threads = client.submit(os.environ.get, "OMP_NUM_THREADS").result()
    assert addresses == {"127.0.0.1"}
    assert threads == "1"
    assert not any(
        "spawn_main" in " ".join(child.cmdline()) for child in me.children(recursive=True)
    )


def test_other_commands_do_not_import_dask_and_scipy_stats() -> None:
    code = "import sys\nfrom freeflyer.cli import run, sweep\nassert not {'distributed', 'scipy.stats'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_robot_parameter_is_set_in_plant_and_controllers(plan: Plan) -> None:
    run = plan.run(1)
    chosen = plan.setup.scenario(run.case, run.assignments)
    with assemble.loaded(chosen) as system:
        values = parameters.resolve(chosen, system.components)
    for component in ("free_flyer", "manipulator_controller", "base_controller"):
        assert values[component]["base_mass"] == 100.0
    alone = scenario.load("multirate_passive", ["robot.base_mass=100.0", "stop_s=0.01"])
    assert alone.robot == chosen.robot


def test_a_worker_with_other_files_is_rejected(plan: Plan) -> None:
    other = replace(plan.setup, files={**plan.setup.files, "base_controller": "0" * 64})
    with pytest.raises(
        sweep_task.WorkerRefused,
        match="its file of component base_controller is not the same as in the sweep",
    ):
        sweep_task.run_batch(other, sweep_task.metrics.versions()["freeflyer-cosim"], [plan.run(0)])
    with pytest.raises(sweep_task.WorkerRefused, match="the same version on the worker"):
        sweep_task.run_batch(plan.setup, "9.9", [plan.run(0)])


def test_instances_never_share_a_folder_and_kept_folders_are_reused(
    fmus: Path, tmp_path: Path
) -> None:
    path = fmus / "fmi2" / "reference_trajectory.fmu"
    with unpacked.kept_in(tmp_path):
        first, second = FmuComponent("first", path), FmuComponent("second", path)
        assert len(list(tmp_path.iterdir())) == 2
        first.close()
        third = FmuComponent("third", path)
        assert len(list(tmp_path.iterdir())) == 2
        for component in (second, third):
            component.enter_initialization(0.0, {})
            component.exit_initialization()
            component.close()
    FmuComponent("after", path).close()
    assert len(list(tmp_path.iterdir())) == 2


def test_a_run_does_not_depend_on_earlier_runs(plan: Plan, tmp_path: Path) -> None:
    def numbers(row: sweep_task.Row) -> sweep_task.Row:
        return {key: value for key, value in row.items() if key not in ("wall_s", "run_s")}

    alone = [sweep_task.row(plan.setup, plan.run(number)) for number in (0, 1)]
    with unpacked.kept_in(tmp_path):
        again = [sweep_task.row(plan.setup, plan.run(number)) for number in (1, 0, 1, 0)]
    assert [numbers(row) for row in again] == [numbers(alone[k]) for k in (1, 0, 1, 0)]
    assert alone[0] != alone[1]


def test_a_changed_fmu_file_is_unpacked_again(fmus: Path, tmp_path: Path) -> None:
    path = tmp_path / "some.fmu"
    path.write_bytes((fmus / "fmi2" / "reference_trajectory.fmu").read_bytes())
    (tmp_path / "kept").mkdir()
    with unpacked.kept_in(tmp_path / "kept"):
        before = FmuComponent("one", path)
        path.write_bytes((fmus / "fmi2" / "linear_trajectory.fmu").read_bytes())
        before.close()  # its folder has the previous content of the file
        after = FmuComponent("one", path)
        after.enter_initialization(0.0, {})
        after.close()
    assert before.description.modelName == "reference_trajectory"
    assert after.description.modelName == "linear_trajectory"
    assert set(before.ports) != set(after.ports)
