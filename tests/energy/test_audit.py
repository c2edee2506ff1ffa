"""Energy audit of runs: closed balance, agreement with the observers, multi-rate energy."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from freeflyer.analysis.audit.audit import Audit, audit
from freeflyer.analysis.audit.ledger import Port
from freeflyer.foundation.errors import RecordError
from freeflyer.master.record import Record
from freeflyer.scenario import experiment, scenario

EVERY_SAMPLE = "record.every_s=0.001"


@cache
def recorded(name: str, *overrides: str) -> Record:
    return experiment.run(scenario.load(name, overrides)).outcome.record


def audited(name: str, *overrides: str) -> Audit:
    return audit(recorded(name, *overrides))


def without_pc(T_b: float, *overrides: str) -> Audit:
    return audited(
        "multirate_unstable", "stop_s=10", EVERY_SAMPLE, f"base_controller.period={T_b}", *overrides
    )


@pytest.mark.parametrize(
    "overrides",
    [
        (),
        ("manipulator_controller.observer=tracking",),
        ("manipulator_controller.observer=paper",),
        ("base_controller.discretisation=matched",),
        ("base_controller.period=0.07",),
    ],
    ids=lambda overrides: overrides[0] if overrides else "as shipped",
)
def test_the_held_work_equals_the_kinetic_energy_and_the_ports_have_the_stated_residual(
    overrides: tuple[str, ...],
) -> None:
    audit = audited("multirate_passive", "stop_s=20", EVERY_SAMPLE, *overrides)
    balance = audit.balance
    assert balance is not None
    assert balance.kinetic.max() > 0.01
    assert np.abs(balance.residual_of_held).max() < 1e-9 * balance.moved
    assert np.abs(balance.residual_of_ports).max() < 5e-6  # docs/energy_audit.md: 3.2e-6 J in 20 s
    assert np.all(balance.others == 0.0)


def terms(port: Port) -> np.ndarray:
    """Return the sum of all terms of port.work."""
    return (
        port.feed_forward
        + port.reference
        + port.stale
        + port.virtual
        - port.stored
        - port.dissipated
        - port.taken
    )


@pytest.mark.parametrize(
    "name", ["multirate_unstable", "multirate_passive", "overdamped_base", "facility"]
)
def test_the_terms_of_each_port_add_up_to_its_work(name: str) -> None:
    audit = audited(name, "stop_s=12")
    for port in (audit.base, audit.manipulator):
        scale = sum(
            np.abs(term).max()
            for term in (port.feed_forward, port.virtual, port.stored, port.dissipated)
        )
        assert np.abs(terms(port) - port.work).max() < 1e-12 * scale
        assert np.all(np.diff(port.dissipated) >= 0.0)


def test_observers_of_the_applied_wrench_compute_the_true_energy() -> None:
    """The controllers integrate sampled velocities; the audit uses recorded poses and wrenches."""
    audit = without_pc(0.3)
    moved = audit.balance.moved if audit.balance else 0.0
    for port, largest in ((audit.base, 1e-3), (audit.manipulator, 1e-2)):
        assert np.abs(port.work).max() > largest
        assert np.abs(port.observed - port.absorbed).max() < 1e-8 * moved


def test_the_papers_observer_misses_exactly_the_multi_rate_energy() -> None:
    """It observes the held F_B. Its error at port B is the multi-rate energy of the audit."""
    audit = without_pc(0.3, "manipulator_controller.observer=paper")
    missed = (audit.base.observed - audit.base.absorbed).sum(axis=1)[:-1]
    assert np.abs(missed).max() > 1e-3
    assert missed == pytest.approx(audit.base.stale[:-1], abs=1e-3 * np.abs(missed).max())


def test_multi_rate_energy_is_zero_at_one_rate_and_increases_with_the_base_period() -> None:
    audits = [without_pc(T_b) for T_b in (0.001, 0.1, 0.2, 0.3)]
    at_one_rate, *slower = (np.abs(audit.base.stale).max() for audit in audits)
    balance = audits[0].balance
    assert balance is not None
    assert at_one_rate < 1e-15 * balance.moved
    assert 1e-4 < slower[0] < slower[1] < slower[2]
    virtual = [audit.base.virtual[-1] for audit in audits]
    assert 0.0 < virtual[0] < 1e-9 * balance.moved
    assert 5e-5 < virtual[1] < virtual[2] < virtual[3]


def test_a_coarser_record_gives_the_same_energies_with_a_larger_residual() -> None:
    fine, coarse = (
        without_pc(0.3),
        audited("multirate_unstable", "stop_s=10", "base_controller.period=0.3"),
    )
    assert not fine.notes
    assert (
        "`freeflyer run SCENARIO --set record.every_s=0.001` records all samples and closes the balance"
        in coarse.notes[0]
    )
    for term in ("work", "stale", "virtual", "dissipated"):
        one, other = getattr(fine.base, term)[-1], getattr(coarse.base, term)[-1]
        assert other == pytest.approx(one, rel=0.01), term
    assert fine.balance is not None
    assert coarse.balance is not None
    assert np.abs(coarse.balance.residual_of_held).max() > 1e-9 * coarse.balance.moved


def test_the_energy_taken_by_the_passivity_controllers_is_the_work_of_their_wrenches() -> None:
    """The reference is the sum of F_pcb x_b' T over the record."""
    audit = audited("multirate_passive", "stop_s=20", EVERY_SAMPLE)
    record = recorded("multirate_passive", "stop_s=20", EVERY_SAMPLE)
    power = np.sum(
        record["base_controller.passivity_wrench"] * record["free_flyer.base_velocity"], axis=1
    )
    assert audit.base.taken[-1] > 5e-4
    assert audit.base.taken[-1] == pytest.approx(-0.001 * power.sum(), rel=0.02)
    assert np.all(audited("multirate_unstable", "stop_s=10").base.taken == 0.0)


def test_a_record_file_has_all_data_for_the_audit(tmp_path: Path) -> None:
    record = recorded("multirate_unstable", "stop_s=10")
    record.write(tmp_path / "record.parquet")
    again = Record.read(tmp_path / "record.parquet")
    assert again.provenance == record.provenance
    assert np.array_equal(
        audit(again).base.virtual,
        audited("multirate_unstable", "stop_s=10").base.virtual,
    )


def test_rows_that_are_not_finite_are_left_out_with_a_note() -> None:
    record = experiment.run(scenario.load("multirate_unstable", ["stop_s=2"])).outcome.record
    record["free_flyer.base_velocity"][150:, 4] = np.nan
    found = audit(record)
    assert found.time.size == 150
    assert np.isfinite(terms(found.base)).all()
    assert f"The last {record.rows - 150} rows are left out" in found.notes[-1]


def test_a_facility_record_has_ports_but_no_balance() -> None:
    audit = audited("facility", "stop_s=5", EVERY_SAMPLE)
    assert audit.balance is None
    assert "kinetic_energy" in audit.notes[0]
    assert np.abs(audit.manipulator.work).max() > 1e-4
    # The observers integrate the same measured velocities by the trapezoidal rule.
    assert np.abs(audit.base.observed - audit.base.absorbed).max() < 1e-12


def test_parallel_exchange_is_rejected() -> None:
    with pytest.raises(RecordError, match="exchange = 'parallel'"):
        audited("multirate_passive", "stop_s=1", "exchange=parallel")


def test_a_users_component_between_controller_and_robot_is_in_the_work_of_others(
    tmp_path: Path,
) -> None:
    (tmp_path / "kick.py").write_text(
        "import numpy as np\n"
        "from freeflyer.fmi.component import Port, PythonComponent\n"
        "class Kick(PythonComponent):\n"
        "    def __init__(self, name):\n"
        "        unit = ('N.m',) * 6\n"
        "        super().__init__(name, [Port(name='command', size=6, causality='input', units=unit), Port(name='torque', size=6,"
        " causality='output', units=unit, direct=frozenset({'command'}))])\n"
        "    def advance(self, time, size):\n"
        "        self.values['torque'] = self.values['command'] + (0.5 if 1.0 <= time < 1.1 else 0.0) * np.eye(6)[1]\n"
    )
    (tmp_path / "kick.toml").write_text(
        'extends = "multirate_passive"\nstop_s = 2\nrecord.every_s = 0.001\n'
        'connections = ["manipulator_controller.joint_torque -> kick.command", "kick.torque -> free_flyer.joint_torque"]\n'
        '[components.kick]\nkind = "python"\nobject = "kick.py:Kick"\nstep_s = 0.001\n'
    )
    record = recorded(str(tmp_path / "kick.toml"))
    balance = audit(record).balance
    assert balance is not None
    during = (record.time > 0.9995) & (record.time < 1.0995)
    joint_angle = 0.001 * record["free_flyer.joint_velocity"][during, 1].sum()
    assert balance.others[-1] == pytest.approx(0.5 * joint_angle, rel=0.02)
    assert abs(balance.others[-1]) > 1e-4
    assert np.all(balance.others[record.time < 1.0] == 0.0)
    assert np.abs(balance.residual_of_held).max() < 1e-9 * balance.moved
    assert np.abs(balance.residual_of_ports).max() < 1e-2 * abs(balance.others[-1])
