"""Host device against virtual drives, in virtual time: configuration, activation, losses, stops."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from pumped import TICKS, Pair, pair

from freeflyer_adapters.cia402 import objects
from freeflyer_adapters.cia402.state_machine import DriveState
from freeflyer_adapters.device.device import LifeCycle, SafeStop
from freeflyer_adapters.foundation.errors import DeviceError

STATES = DriveState


def refused(bench: Pair, sentence: str, call: Callable[[], object] | None = None) -> None:
    """Assert that `call` (default: `configure`) raises DeviceError and that the brakes stay on."""
    with pytest.raises(DeviceError, match=re.escape(sentence)):
        (call or bench.host.configure)()
    assert all(drive.braked for drive in bench.logics)


def stored(bench: Pair) -> list[dict[tuple[int, int], str]]:
    """Return the stored objects of each drive."""
    return [
        {
            (i, s): data.hex()
            for i, subs in drive.node.data_store.items()
            for s, data in subs.items()
        }
        for drive in bench.drives
    ]


def stopped(bench: Pair, sentence: str, cycles: int = 40) -> None:
    with pytest.raises(SafeStop, match=re.escape(sentence)):
        bench.cycles(cycles, 0.0, 0.0)


def ramped_down(bench: Pair) -> int:
    """Ramp down, and return the number of cycles."""
    for k in range(1000):
        if bench.host.ramp_down(k * bench.host.cycle):
            return k
    raise AssertionError("the ramp-down has no end")


def test_activation_is_bumpless_and_the_arm_then_follows_commands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch) as bench:
        bench.activated()
        assert [drive.state for drive in bench.logics] == [STATES.operation_enabled] * 2
        assert all((torque == 0.0).all() for torque in bench.joints.torques)
        assert bench.host.state.now is LifeCycle.active
        for _ in range(10):
            bench.cycle(5.0, -2.0)
        bench.host.read()
        np.testing.assert_allclose(bench.host.values["joint_torque"], [5.0, -2.0], atol=0.05)
        # Nine cycles of 4 ms after the SYNC that applied the first target, at 1 kg m^2.
        np.testing.assert_allclose(bench.host.values["joint_velocity"], [0.18, -0.072], atol=1e-3)
        np.testing.assert_allclose(
            bench.host.values["joint_velocity"], bench.joints.velocity, atol=0.02
        )


@pytest.mark.parametrize("faulty", [False, True])
def test_configuration_and_start_check_change_no_drive(
    monkeypatch: pytest.MonkeyPatch, faulty: bool
) -> None:
    with pair(monkeypatch) as bench:
        if faulty:
            bench.joints.virtual.fail(2)
        before = (
            stored(bench),
            [drive.node.nmt.state for drive in bench.drives],
            [drive.state for drive in bench.logics],
        )
        bench.host.configure()
        bench.host.check_start()
        bench.host.stay()
        bench.host.deactivate()
        for _ in range(2 * TICKS):
            bench.joints.tick()
        assert before == (
            stored(bench),
            [d.node.nmt.state for d in bench.drives],
            [d.state for d in bench.logics],
        )
        # Only read requests were sent: 40h is the SDO command "initiate upload".
        assert {m.arbitration_id for m in bench.host_end.sent} == {0x603, 0x607}
        assert {m.data[0] for m in bench.host_end.sent} == {0x40}


def test_the_host_writes_the_objects_of_the_profile(monkeypatch: pytest.MonkeyPatch) -> None:
    with pair(monkeypatch) as bench:
        bench.prepared()
        for node, written in zip((3, 7), stored(bench), strict=True):
            # Numbers are little-endian. A mapping entry has bits, sub-index and object. Bit 30 of a
            # COB-ID: no remote frames.
            assert written[0x6060, 0] == "0a"
            assert (written[0x60C2, 1], written[0x60C2, 2]) == ("04", "fd")
            assert written[0x1006, 0] == (4000).to_bytes(4, "little").hex()
            assert written[0x1016, 1] == (127 << 16 | 50).to_bytes(4, "little").hex()
            assert written[0x1017, 0] == "1400"
            assert written[0x605A, 0] == "0200"
            assert [written[0x1600, k] for k in range(3)] == ["02", "10004060", "10007160"]
            assert [written[0x1A00, k] for k in range(4)] == [
                "03",
                "10004160",
                "10007760",
                "20006460",
            ]
            assert [written[0x1A01, k] for k in range(2)] == ["01", "20006c60"]
            assert (written[0x1400, 1], written[0x1400, 2]) == (
                (0x4000_0200 + node).to_bytes(4, "little").hex(),
                "01",
            )
            assert (written[0x1800, 1], written[0x1801, 1]) == tuple(
                (0x4000_0000 + base + node).to_bytes(4, "little").hex() for base in (0x180, 0x280)
            )


FURTHER_PDO = """
[1802]
ParameterName=TPDO communication parameter 3
ObjectType=0x9
SubNumber=3

[1802sub0]
ParameterName=Highest sub-index supported
ObjectType=0x7
DataType=0x0005
AccessType=const
DefaultValue=2
PDOMapping=0

[1802sub1]
ParameterName=COB-ID
ObjectType=0x7
DataType=0x0007
AccessType={access}
DefaultValue=$NODEID+0x380
PDOMapping=0

[1802sub2]
ParameterName=Transmission type
ObjectType=0x7
DataType=0x0005
AccessType=rw
DefaultValue=1
PDOMapping=0

[1A02]
ParameterName=TPDO mapping parameter 3
ObjectType=0x9
SubNumber=2

[1A02sub0]
ParameterName=Number of mapped objects
ObjectType=0x7
DataType=0x0005
AccessType=rw
DefaultValue=1
PDOMapping=0

[1A02sub1]
ParameterName=Mapped object 1
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=0x60410010
PDOMapping=0
"""


def test_further_pdos_in_the_eds_of_a_drive_are_disabled(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    own = tmp_path / "own.eds"
    own.write_text(
        objects.SHIPPED_EDS.read_text(encoding="utf-8") + FURTHER_PDO.format(access="rw")
    )
    with pair(monkeypatch, drives={"eds": str(own)}, eds=str(own)) as bench:
        assert not bench.drives[0].node.get_data(0x1802, 1)[3] & 0x80
        bench.activated()
        assert bench.drives[0].node.get_data(0x1802, 1)[3] & 0x80
    own.write_text(
        objects.SHIPPED_EDS.read_text(encoding="utf-8") + FURTHER_PDO.format(access="ro")
    )
    with pair(monkeypatch, drives={"eds": str(own)}, eds=str(own)) as bench:
        sentence = "drive of joint 1 (node 3) does not disable its further PDO (1802h): SDO abort, Code 0x06010002"
        refused(bench, sentence, bench.prepared)


def test_a_torque_takes_effect_at_the_next_sync(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch) as bench:
        bench.activated()
        for _ in range(3):
            bench.cycle(0.0, 0.0)
        bench.host.read()
        bench.host.values["joint_torque_command"][:] = (10.0, 0.0)
        start = len(bench.joints.torques)
        bench.host.write()
        for _ in range(3):
            bench.cycle(10.0, 0.0)
        acted = [bool(torque[0]) for torque in bench.joints.torques[start:]]
        first = acted.index(True)
        assert 0 < first < TICKS
        assert all(acted[first:])


def test_without_tpdo2_the_speed_is_estimated_from_positions(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch, velocity="estimated") as bench:
        bench.activated()
        assert bench.drives[0].node.get_data(0x1801, 1)[3] & 0x80  # not valid
        sent: list[int] = []
        send = bench.drive_end.send

        def watched(message: can.Message) -> None:
            sent.append(message.arbitration_id)
            send(message)

        monkeypatch.setattr(bench.drive_end, "send", watched)
        for _ in range(30):
            bench.cycle(2.0, -2.0)
        assert 0x183 in sent
        assert 0x283 not in sent
        # Tolerance: the resolution of 2 pi / 409600 in 4 ms, and the change of speed in a cycle.
        np.testing.assert_allclose(
            bench.host.values["joint_velocity"], bench.joints.velocity, atol=0.03
        )
        assert bench.host.bus_load < 0.25


@pytest.mark.parametrize(
    ("drives", "host", "sentence"),
    [
        ({"rated_torque": [0.5, 0.25]}, {}, "drive of joint 2 (node 7): the rated torque (6076h) is 0.25 N m, but the scenario has 0.2 N m"),
        ({"gear_ratio": 50}, {}, "drive of joint 1 (node 3): the gear ratio (6091h:01) is 50, but the scenario has 100"),
        ({"encoder_resolution": 8192}, {}, "the encoder resolution (608Fh:01) is 8192 increments, but the scenario has 4096 increments"),
        ({}, {"joint_effort_limit": (200.0, 40.0)}, "the max torque (6072h) is 150 N m at the joint, but the scenario's joint_effort_limit is 200 N m"),
        ({"node_ids": [3, 8]}, {}, "drive of joint 2 (node 7) does not return device type (1000h): no answer within 0.3 s; is the drive"),
    ],
    ids=["rated torque", "gear", "encoder", "max torque", "missing"],
)  # fmt: skip
def test_a_different_drive_is_rejected_with_both_numbers(
    monkeypatch: pytest.MonkeyPatch, drives: dict[str, Any], host: dict[str, Any], sentence: str
) -> None:
    with pair(monkeypatch, drives=drives, **host) as bench:
        refused(bench, sentence)


@pytest.mark.parametrize(
    ("entry", "value", "sentence"),
    [
        (
            objects.DEVICE_TYPE,
            0x0003_0191,
            "is of device profile 401 (1000h is 0x00030191); a drive of profile 402 is expected",
        ),
        (objects.SUPPORTED_MODES, 0x1FF, "has no cyclic synchronous torque mode"),
        (objects.GEAR_SHAFT_TURNS, 0, "the driving shaft revolutions (6091h:02) is 0"),
    ],
)
def test_a_device_without_the_profile_is_rejected(
    monkeypatch: pytest.MonkeyPatch, entry: objects.Entry, value: int, sentence: str
) -> None:
    with pair(monkeypatch) as bench:
        bench.drives[1].set(entry, value)
        refused(bench, sentence)


def test_an_sdo_abort_is_reported_with_drive_object_and_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch) as bench:
        bench.drives[0].node.object_dictionary[0x605A].access_type = "ro"
        sentence = "drive of joint 1 (node 3) does not accept 2 for quick stop option code (605Ah): SDO abort, Code 0x06010002"
        refused(bench, sentence, bench.prepared)


def test_an_arm_at_another_start_position_is_rejected_with_both_positions(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch, start_joint_position=(0.0, 0.5)) as bench:
        bench.host.configure()
        with pytest.raises(
            DeviceError, match=r"joint 2 is at 0\.0000 rad, the scenario starts at 0\.5000 rad"
        ):
            bench.host.check_start()


def test_prepared_drives_are_off_and_deactivation_ends_operational(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch) as bench:
        bench.prepared()
        for _ in range(10):
            assert [drive.state for drive in bench.logics] == [STATES.switch_on_disabled] * 2
            assert bench.joints.virtual.logic.braked
            bench.host.stay()
        assert [drive.node.nmt.state for drive in bench.drives] == ["OPERATIONAL"] * 2
        assert set(bench.controlwords(3) + bench.controlwords(7)) == {0x00}
        bench.host.deactivate()
        bench.joints.tick()
        assert [drive.state for drive in bench.logics] == [STATES.switch_on_disabled] * 2
        assert [drive.node.nmt.state for drive in bench.drives] == ["PRE-OPERATIONAL"] * 2


def test_a_fault_that_remains_after_its_reset_is_reported_and_nothing_is_switched_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch) as bench:
        bench.joints.virtual.fail(2, 0x4310)
        monkeypatch.setattr(bench.logics[1], "apply_controlword", lambda word: None)
        refused(
            bench,
            "drive of joint 2 (node 7) stays in the state Fault (statusword 0x0218",
            bench.prepared,
        )
        bench.host.deactivate()
        bench.joints.tick()
        assert not bench.controlwords(3)
        assert [drive.node.nmt.state for drive in bench.drives] == ["PRE-OPERATIONAL"] * 2


def test_a_drive_that_does_not_become_enabled_is_named_with_its_state_and_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch) as bench:
        bench.prepared()
        monkeypatch.setattr(
            bench.logics[1], "apply_controlword", lambda word: bench.logics[1].fail(0x4310)
        )
        with pytest.raises(
            DeviceError,
            match=re.escape(
                "drive of joint 2 (node 7) does not reach the state Operation enabled: it is in the state Fault"
            ),
        ) as caught:
            bench.host.activate(lambda: False)
        assert "its error code (603Fh) is 0x4310 (drive temperature too high)" in str(caught.value)
        bench.host.deactivate()
        for _ in range(TICKS):
            bench.joints.tick()
        assert bench.joints.virtual.logic.braked
        assert [drive.node.nmt.state for drive in bench.drives] == ["PRE-OPERATIONAL"] * 2


def test_each_step_to_operation_enabled_answers_the_statusword_of_the_step_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch) as bench:
        bench.prepared()
        seen: list[tuple[int, int]] = []
        send, take = bench.host_end.send, bench.drive_end.send
        # Record controlwords and the statuswords of TPDOs in their order on the bus.
        for end, call, first in ((bench.host_end, send, 0x200), (bench.drive_end, take, 0x180)):

            def record(
                message: can.Message, call: Callable[..., None] = call, first: int = first
            ) -> None:
                if message.arbitration_id in (first + 3, first + 7):
                    seen.append(
                        (message.arbitration_id, int.from_bytes(message.data[:2], "little") & 0x6F)
                    )
                call(message)

            monkeypatch.setattr(end, "send", record)
        bench.host.activate(lambda: False)
        needs = {0x06: (0x40,), 0x07: (0x21,), 0x0F: (0x23, 0x27)}
        for node in (3, 7):
            statusword, controlwords = 0x40, []  # Switch on disabled, as `prepare` has measured
            for identifier, value in seen:
                if identifier == 0x180 + node:
                    statusword = value
                elif identifier == 0x200 + node:
                    assert statusword in needs[value], (node, value, statusword)
                    controlwords.append(value)
            assert list(dict.fromkeys(controlwords)) == [0x06, 0x07, 0x0F]


def test_an_earlier_fault_is_reset_by_the_activation(monkeypatch: pytest.MonkeyPatch) -> None:
    with pair(monkeypatch) as bench:
        bench.joints.virtual.fail(1)
        assert bench.logics[0].state is STATES.fault
        bench.activated()
        assert bench.logics[0].state is STATES.operation_enabled
        # The reset is sent once, by SDO (2Bh: download of two bytes), before the NMT start.
        sent = bench.host_end.sent
        controlwords = [
            m.data[4]
            for m in sent
            if m.arbitration_id == 0x603 and m.data[:3] == bytes.fromhex("2b 40 60")
        ]
        assert controlwords == [0x00, 0x80, 0x00]
        started = next(k for k, m in enumerate(sent) if m.arbitration_id == 0 and m.data[0] == 1)
        assert all(m.arbitration_id not in (0x203, 0x207) for m in sent[:started])
        assert all(m.data[:3] != bytes.fromhex("2b 40 60") for m in sent[started:])


def test_no_cyclic_frame_resets_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    with pair(monkeypatch) as bench:
        bench.joints.virtual.fail(1)
        bench.activated()
        bench.cycles(10, 1.0, 1.0)
        bench.joints.virtual.fail(2, 0x2310)
        stopped(bench, "left the state Operation enabled by itself")
        ramped_down(bench)
        bench.host.on_error("tried")
        bench.host.deactivate()
        for _ in range(300):
            bench.joints.tick()
        assert bench.logics[1].state is STATES.fault
        assert not [
            controlword
            for node in (3, 7)
            for controlword in bench.controlwords(node)
            if controlword & 0x80
        ]


def test_a_fault_is_reset_by_an_edge_even_if_the_bit_was_set_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch) as bench:
        bench.joints.virtual.fail(1)
        bench.logics[0].apply_controlword(0x80)  # reset the fault
        bench.joints.virtual.fail(1)
        bench.activated()
        assert bench.logics[0].state is STATES.operation_enabled


def test_a_drive_fault_stops_the_loop_with_its_state_and_ramps_the_others_down(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch) as bench:
        bench.activated()
        for _ in range(20):
            bench.cycle(8.0, -4.0)
        bench.joints.virtual.fail(2, 0x2310)
        stopped(
            bench,
            "drive of joint 2 (node 7) left the state Operation enabled by itself: it is in the state Fault reaction active",
        )
        ramped_down(bench)
        assert bench.host.at_rest
        assert bench.logics[0].state is STATES.switch_on_disabled
        assert bench.logics[1].state is STATES.fault
        assert bench.host.report()["emergencies"] == 1.0
        assert bench.joints.velocity.tolist() == [0.0, 0.0]


def test_an_emergency_stops_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    with pair(monkeypatch) as bench:
        bench.activated()
        bench.drives[0].node.emcy.send(0x3210, 1)
        stopped(
            bench,
            "drive of joint 1 (node 3) sent an emergency: it is in the state Operation enabled (statusword 0x1237, EMCY 0x3210 (",
        )


def test_a_drive_whose_heartbeat_is_missing_stops_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    with pair(monkeypatch) as bench:
        bench.activated()
        bench.drive_end.dropped.add(0x707)
        stopped(bench, "drive of joint 2 (node 7) has sent no heartbeat for")


def test_lost_tpdos_are_counted_and_too_many_stop_the_loop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch) as bench:
        bench.activated()
        for k in range(20):
            bench.drive_end.dropped = {0x187} if k % 5 in (1, 2) else set()
            bench.cycle(1.0, 1.0)
        assert bench.host.report()["cycles_lost"] == 8.0
        assert bench.host.report()["longest_loss_cycles"] == 2.0
        bench.drive_end.dropped = {0x187}
        stopped(
            bench,
            "5 cycles in a row were lost, the limit is 5 (TPDOs of arm, cycles of 0.004 s); no TPDO from node 7",
        )


def test_one_lost_speed_is_a_lost_cycle(monkeypatch: pytest.MonkeyPatch) -> None:
    with pair(monkeypatch) as bench:
        bench.activated()
        bench.drive_end.dropped = {0x283}
        bench.cycle(0.0, 0.0)
        assert bench.host.report()["cycles_lost"] == 1.0


def test_without_the_host_every_drive_stops_by_itself_and_the_session_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch) as bench:
        bench.activated()
        for _ in range(20):
            bench.cycle(8.0, -4.0)
        assert abs(bench.joints.velocity).min() > 0.1
        ticks = 0
        while not bench.joints.virtual.logic.braked:
            bench.joints.tick()
            ticks += 1
            # The watchdog's four cycles, then at most twice the ramp-down time.
            assert ticks < 4 * TICKS + 500 + 2
        assert {drive.error for drive in bench.logics} <= {
            objects.SYNC_LOST,
            objects.HEARTBEAT_LOST,
        }
        assert {drive.state for drive in bench.logics} == {STATES.fault}
        for _ in range(1100):
            bench.joints.tick()
        assert bench.joints.virtual.session_is_over


def test_syncs_without_targets_stop_the_drives(monkeypatch: pytest.MonkeyPatch) -> None:
    with pair(monkeypatch) as bench:
        bench.activated()
        bench.host_end.dropped = {0x203, 0x207}
        stopped(bench, "left the state Operation enabled by itself")
        assert bench.logics[0].error == objects.RPDO_LOST


def test_the_drives_stop_when_the_heartbeat_of_the_host_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch) as bench:
        bench.activated()
        bench.host_end.dropped = {0x700 + 127}
        stopped(bench, "left the state Operation enabled by itself")
        assert bench.logics[0].error == objects.HEARTBEAT_LOST


def test_a_second_controller_is_rejected_while_the_first_sends_sync_or_has_enabled_a_drive(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch) as bench:
        bench.host_end.waiting.append(can.Message(arbitration_id=0x80, is_extended_id=False))
        refused(bench, "another controller sends SYNC")
    with pair(monkeypatch) as bench:
        for logic in bench.logics:
            for word in (0x06, 0x07, 0x0F):
                logic.apply_controlword(word)
        with pytest.raises(
            DeviceError,
            match=re.escape(
                "(node 3) is in the state Operation enabled already: another controller has enabled it"
            ),
        ):
            bench.host.configure()
        bench.host.deactivate()
        for _ in range(3):
            bench.joints.tick()
        assert not bench.joints.virtual.logic.braked  # the drives of the first controller continue


def test_a_sync_of_another_controller_stops_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    with pair(monkeypatch) as bench:
        bench.activated()
        bench.host_end.waiting.append(can.Message(arbitration_id=0x80, is_extended_id=False))
        stopped(bench, "another controller sends SYNC", cycles=1)


def test_targets_of_another_controller_are_detected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def foreign_target() -> can.Message:
        return can.Message(
            arbitration_id=0x207, is_extended_id=False, data=bytes.fromhex("0f00 0000")
        )

    with pair(monkeypatch) as bench:
        bench.host.configure()
        bench.host_end.waiting.append(foreign_target())
        refused(bench, "another controller sends SYNC, targets", bench.host.check_start)
    with pair(monkeypatch) as bench:
        bench.activated()
        bench.host_end.waiting.append(foreign_target())
        stopped(bench, "another controller sends SYNC, targets", cycles=1)


def stopped_in_order(bench: Pair) -> None:
    bench.host.revoke("tried")
    ramped_down(bench)


@pytest.mark.parametrize(
    "stop",
    [stopped_in_order, lambda bench: bench.host.on_error("tried"), lambda bench: None],
    ids=["graded", "error", "immediate"],
)
def test_after_every_stop_frames_of_any_controller_move_no_drive(
    monkeypatch: pytest.MonkeyPatch, stop: Callable[[Pair], None]
) -> None:
    with pair(monkeypatch) as bench:
        bench.activated()
        bench.cycles(20, 8.0, -4.0)
        stop(bench)
        bench.host.deactivate()
        for _ in range(1000):
            bench.joints.tick()
        assert [drive.node.nmt.state for drive in bench.drives] == ["PRE-OPERATIONAL"] * 2
        for controlword in (0x00, 0x80, 0x00, 0x06, 0x07, 0x0F, 0x0F):
            for node in (3, 7):
                data = controlword.to_bytes(2, "little") + bytes.fromhex("6400")
                bench.drive_end.waiting.append(
                    can.Message(arbitration_id=0x200 + node, is_extended_id=False, data=data)
                )
            bench.drive_end.waiting.append(can.Message(arbitration_id=0x80, is_extended_id=False))
            for _ in range(TICKS):
                bench.joints.tick()
                assert bench.joints.virtual.logic.braked
                assert all(drive.braked for drive in bench.logics)


def test_a_delayed_loop_stops_and_never_enables_a_drive_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch, watchdog_cycles=25) as bench:  # 0.1 s of the real clock
        bench.activated()
        bench.cycles(20, 8.0, -4.0)
        time.sleep(0.12)
        for _ in range(700):  # the drives' watchdogs expire
            bench.joints.tick()
        assert {drive.state for drive in bench.logics} == {STATES.fault}
        start = len(bench.host_end.sent)
        stopped(bench, "the loop was held up for 0.", cycles=1)
        bench.host.write()
        assert bench.host_end.sent[start:] == []
        bench.host.revoke("the loop was held up")
        ramped_down(bench)
        bench.host.deactivate()
        for _ in range(50):
            bench.joints.tick()
        controlwords = {
            controlword for node in (3, 7) for controlword in bench.controlwords(node, start)
        }
        assert controlwords <= {0x00, 0x02}, controlwords
        assert {drive.state for drive in bench.logics} == {STATES.fault}


def test_the_graded_stop_ends_with_brakes_and_silent_drives_are_not_at_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch) as bench:
        bench.activated()
        for _ in range(20):
            bench.cycle(8.0, -4.0)
        ramped_down(bench)
        assert bench.host.at_rest
        assert bench.joints.virtual.logic.braked
        bench.host.deactivate()
        assert bench.host.state.now is LifeCycle.inactive
    with pair(monkeypatch) as bench:
        bench.activated()
        bench.joints.stalled = True
        ramped_down(bench)
        assert not bench.host.at_rest


def test_limits_clamp_and_stop_as_for_every_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    with pair(monkeypatch, joint_velocity_limit=(0.05, 0.05)) as bench:
        bench.activated()
        with pytest.raises(SafeStop, match=r"joint 1 moves at .* rad/s, its limit is 0\.05 rad/s"):
            bench.cycles(50, 1000.0, 0.0)
        assert bench.host.report()["joint_effort_limit_acted"] > 0
        assert max(torque[0] for torque in bench.joints.torques) <= 100.0
    with pair(monkeypatch) as bench:
        bench.activated()
        bench.host.read()
        bench.host.values["joint_torque_command"][:] = np.nan
        with pytest.raises(SafeStop, match="finite numbers are expected"):
            bench.host.write()


def test_one_target_is_sent_per_sync_for_any_number_of_writes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch) as bench:
        bench.activated()
        before = bench.host.report()["cycles_with_targets_sent"]
        bench.host.read()
        for _ in range(4):
            bench.host.write()
        assert bench.host.report()["cycles_with_targets_sent"] == before + 1


def test_the_device_can_be_activated_again_after_a_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    with pair(monkeypatch) as bench:
        bench.activated()
        ramped_down(bench)
        bench.host.deactivate()
    with pair(monkeypatch) as bench:
        bench.activated()
        bench.host.on_error("tried")
        assert bench.host.state.now is LifeCycle.safe_stop
        bench.joints.tick()
        # The host has commanded this state and sent SYNC; no watchdog has expired.
        assert {drive.state for drive in bench.logics} == {STATES.switch_on_disabled}
        bench.host.deactivate()
        for _ in range(300):
            bench.joints.tick()
        assert bench.joints.virtual.logic.braked
