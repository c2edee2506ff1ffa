"""canopen as independent reference implementation, in real time and with threads.

The CiA 402 master of canopen controls the virtual drive. The host configures a local canopen node.
"""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import canopen
import numpy as np
import pytest
from canopen.profiles.p402 import BaseNode402
from pumped import TABLE

from freeflyer_adapters.cia402 import objects
from freeflyer_adapters.cia402.network import PolledNetwork
from freeflyer_adapters.cia402.options import options_from
from freeflyer_adapters.cia402.remote_drive import RemoteDrive
from freeflyer_adapters.cia402.state_machine import DriveState
from freeflyer_adapters.device.permit import Permit
from freeflyer_adapters.facility.settings import FacilitySettings
from freeflyer_adapters.facility.virtual_cia402 import VirtualCia402
from freeflyer_adapters.foundation.errors import DeviceError

channels = itertools.count()


@pytest.fixture
def channel() -> str:
    return f"cia402-{os.getpid()}-{next(channels)}"


def until(condition: Any, timeout: float = 5.0) -> None:
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.005)


class Facility(threading.Thread):
    """Thread with the virtual drives at 1 kHz; the joints do not move."""

    def __init__(self, channel: str) -> None:
        super().__init__(daemon=True)
        table = {**TABLE, "interface": "virtual", "channel": channel}
        self.virtual = VirtualCia402(
            "arm", table, Path(), FacilitySettings(arm_watchdog_cycles=100), 0.001
        )
        self.ended = threading.Event()
        self.values = {
            p.name: np.array(p.start or (0.0,) * p.size)
            for p in (*self.virtual.commands, *self.virtual.measurements)
        }
        self.values["joint_position"][:] = (0.25, -1.0)

    def run(self) -> None:
        while not self.ended.wait(0.001):
            self.virtual.receive(self.values)
            self.virtual.send(self.values)
        self.virtual.close()


@pytest.fixture
def master(channel: str) -> Iterator[tuple[canopen.Network, Facility]]:
    """canopen with its Notifier thread and its periodic SYNC, and a facility on the same bus."""
    facility = Facility(channel)
    network = canopen.Network()
    network.connect(interface="virtual", channel=channel)
    facility.start()
    try:
        yield network, facility
    finally:
        network.sync.stop()
        for node in network.values():
            node.rpdo.stop()
        facility.ended.set()
        facility.join()
        network.disconnect()


def enabled(network: canopen.Network, node_id: int) -> BaseNode402:
    node = BaseNode402(node_id, str(objects.SHIPPED_EDS))
    node.sdo.RESPONSE_TIMEOUT = 2.0
    network.add_node(node)
    node.nmt.state = "PRE-OPERATIONAL"
    node.sdo[0x1017].raw = 20
    assert node.nmt.wait_for_heartbeat(2.0) == "PRE-OPERATIONAL"
    node.setup_402_state_machine()
    node.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
    node.nmt.state = "OPERATIONAL"
    network.sync.start(0.01)
    node.rpdo[1].start(0.005)
    node.TIMEOUT_SWITCH_STATE_FINAL = node.TIMEOUT_SWITCH_STATE_SINGLE = node.TIMEOUT_CHECK_TPDO = (
        2.0
    )
    node.check_statusword()
    node.state = "OPERATION ENABLED"
    return node


def test_canopens_cia_402_master_reads_the_mapping_and_controls_the_virtual_drive(
    master: tuple[canopen.Network, Facility],
) -> None:
    network, facility = master
    node = enabled(network, 3)
    logic = facility.virtual.logic.drives[0]
    assert logic.state is DriveState.operation_enabled
    assert [v.index for v in node.rpdo[1]] == [0x6040, 0x6071]
    assert [v.index for v in node.tpdo[1]] == [0x6041, 0x6077, 0x6064]
    assert node.op_mode == "CYCLIC SYNCHRONOUS TORQUE"
    node.rpdo[1][0x6071].raw = 200  # a fifth of 0.5 N m at the motor, behind a gear of 100
    until(lambda: logic.torque == pytest.approx(10.0))
    until(lambda: node.tpdo_values[0x6064] == round(0.25 * 4096 * 100 / (2 * np.pi)))
    assert node.sdo[0x6076].raw == 500
    node.state = "READY TO SWITCH ON"
    until(lambda: logic.torque == 0.0)
    assert logic.braked


def test_canopens_cia_402_master_receives_a_fault_with_its_emergency_and_resets_it(
    master: tuple[canopen.Network, Facility],
) -> None:
    network, facility = master
    node = enabled(network, 7)
    facility.virtual.fail(2, 0x4310)
    until(node.is_faulted)
    until(lambda: [e.code for e in node.emcy.active] == [0x4310])
    assert node.sdo[0x603F].raw == 0x4310
    assert node.state == "FAULT"
    node.reset_from_fault()
    assert node.state == "OPERATION ENABLED"
    until(lambda: not node.emcy.active)


def test_canopens_quick_stop_ends_in_switch_on_disabled(
    master: tuple[canopen.Network, Facility],
) -> None:
    network, facility = master
    node = enabled(network, 3)
    node.rpdo[1][0x6071].raw = 100
    until(lambda: facility.virtual.logic.drives[0].torque > 0)
    node.controlword = 0x02
    until(lambda: node.state == "QUICK STOP ACTIVE")
    until(lambda: node.state == "SWITCH ON DISABLED")
    assert facility.virtual.logic.drives[0].braked


def test_the_drive_responds_to_errors_with_the_abort_codes_of_the_standard(
    master: tuple[canopen.Network, Facility],
) -> None:
    network, _ = master
    node = enabled(network, 3)
    for index, sub, value, code in (
        (0x6060, 0, 8, 0x06090030), (0x605A, 0, 6, 0x06090030), (0x1A00, 0, 0, 0x08000022), (0x6041, 0, 0, 0x06010002),
    ):  # fmt: skip
        variable = node.sdo[index][sub] if sub or index == 0x1A00 else node.sdo[index]
        with pytest.raises(canopen.SdoAbortedError) as caught:
            variable.raw = value
        assert caught.value.code == code, hex(index)


def test_a_reset_node_boots_with_its_default_objects(
    master: tuple[canopen.Network, Facility],
) -> None:
    network, facility = master
    node = enabled(network, 3)
    boots: list[int] = []
    node.nmt.add_heartbeat_callback(lambda state: boots.append(state))
    node.rpdo[1].stop()
    node.nmt.state = "RESET"
    until(lambda: 0 in boots)
    until(lambda: facility.virtual.logic.drives[0].braked)
    assert node.sdo[0x1017].raw == 0
    assert node.sdo[0x6076].raw == 500


@pytest.fixture
def remote(channel: str) -> Iterator[tuple[RemoteDrive, canopen.LocalNode]]:
    """Host side of a drive, connected to a local node of canopen with a drive's parameters."""
    options = options_from("arm", {**TABLE, "interface": "virtual", "channel": channel}, Path())
    there = canopen.Network()
    there.connect(interface="virtual", channel=channel)
    node = there.create_node(3, str(objects.SHIPPED_EDS))
    node.sdo[0x6076].raw, node.sdo[0x6072].raw = 500, 3000
    node.sdo[0x608F][1].raw, node.sdo[0x6091][1].raw = 4096, 100
    here = PolledNetwork(can.Bus(interface="virtual", channel=channel))
    try:
        yield (
            RemoteDrive(
                "arm", 0, 3, options, here, timeout=2.0, permit=Permit("arm", watchdog=16_000_000)
            ),
            node,
        )
    finally:
        here.disconnect()
        there.disconnect()


def test_the_host_compares_and_configures_canopens_local_node(
    remote: tuple[RemoteDrive, canopen.LocalNode],
) -> None:
    drive, node = remote
    node.sdo[0x6041].raw = 0x0250
    drive.identify()
    drive.compare(effort=150.0)
    with pytest.raises(DeviceError, match="max torque"):
        drive.compare(effort=151.0)
    node.sdo[0x6061].raw = 10
    drive.set_up(0.0025)
    assert (node.sdo[0x60C2][1].raw, node.sdo[0x60C2][2].raw) == (25, -4)
    node.tpdo[1].read()
    node.rpdo[1].read()
    assert [(v.index, v.length) for v in node.tpdo[1]] == [(0x6041, 16), (0x6077, 16), (0x6064, 32)]
    assert [(v.index, v.length) for v in node.rpdo[1]] == [(0x6040, 16), (0x6071, 16)]
    assert (node.tpdo[1].cob_id, node.tpdo[1].trans_type, node.tpdo[1].enabled) == (0x183, 1, True)
    assert node.nmt.state == "PRE-OPERATIONAL"


def test_the_host_rejects_a_local_node_that_stays_in_another_mode(
    remote: tuple[RemoteDrive, canopen.LocalNode],
) -> None:
    drive, _ = remote
    with pytest.raises(
        DeviceError,
        match=r"stays in mode 0 \(6061h\); mode 10 \(cyclic synchronous torque\) is expected",
    ):
        drive.set_up(0.004)
