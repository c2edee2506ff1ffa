"""Effect of each fault on packets, without a transport.

Packets are numbers; a changed packet is negative.
"""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from freeflyer.scenario import scenario
from freeflyer_adapters.base.sealed_odometry import checksum, is_intact, is_sealable, sealed
from freeflyer_adapters.facility import faults, settings
from freeflyer_adapters.facility.can_faults import FAULT_KINDS as ON_CAN
from freeflyer_adapters.facility.faults import KINDS, Fault
from freeflyer_adapters.facility.link_faults import LinkFaults
from freeflyer_adapters.facility.zenoh_faults import FAULT_KINDS as ON_ZENOH
from freeflyer_adapters.foundation.errors import DeviceError


class Negating:
    def changed(
        self, fault: Fault, way: str, packet: int, memory: dict[str, Any], generator: random.Random
    ) -> int | None:
        return -packet


def sent_through(
    *chosen: Fault, packets: int = 50, afterwards: int = 20, seed: int = 1
) -> list[tuple[int, int]]:
    """Send the packets 1 ... `packets`, one per cycle; return (cycle of arrival, packet)."""
    link: LinkFaults[int] = LinkFaults(chosen, 0.001, seed, Negating())
    arrived = []
    for cycle in range(packets + afterwards):
        link.begin_cycle(cycle)
        if cycle < packets:
            link.pass_on("to_device", cycle + 1)
        while (packet := link.due("to_device")) is not None:
            arrived.append((cycle, packet))
    return arrived


def fault(kind: str, **how: Any) -> Fault:
    return Fault(kind=kind, device="arm", **how)


def test_without_faults_every_packet_arrives_in_the_same_cycle_and_in_order() -> None:
    assert sent_through() == [(k, k + 1) for k in range(50)]


@given(share=st.floats(0.0, 1.0), seed=st.integers(1, 1000))
def test_loss_removes_packets_and_does_not_delay_the_others(share: float, seed: int) -> None:
    arrived = sent_through(fault("loss", probability=share), seed=seed)
    assert all(packet == cycle + 1 for cycle, packet in arrived)
    assert len(arrived) == (50 if share == 0.0 else 0 if share == 1.0 else len(arrived))


def test_the_share_of_lost_packets_is_the_given_probability() -> None:
    arrived = sent_through(fault("loss", probability=0.05), packets=20_000)
    assert len(arrived) / 20_000 == pytest.approx(0.95, abs=0.006)  # four standard deviations


def test_a_delay_is_rounded_up_to_whole_cycles_and_keeps_the_order() -> None:
    arrived = sent_through(fault("delay", delay_s=0.0025, begin_s=0.01, duration_s=0.01))
    assert [packet for _, packet in arrived] == list(range(1, 51))
    assert all(cycle - (packet - 1) == 3 for cycle, packet in arrived if 10 <= packet - 1 < 20)
    assert all(
        cycle == packet - 1 for cycle, packet in arrived if packet - 1 < 10 or packet - 1 >= 23
    )


@given(seed=st.integers(1, 1000))
def test_jitter_keeps_the_order_and_its_limit(seed: int) -> None:
    arrived = sent_through(fault("jitter", delay_s=0.005), seed=seed)
    assert [packet for _, packet in arrived] == list(range(1, 51))
    assert all(0 <= cycle - (packet - 1) <= 5 for cycle, packet in arrived)


def test_a_duplicate_arrives_directly_after_its_original() -> None:
    assert [packet for _, packet in sent_through(fault("duplication"), packets=3)] == [
        1,
        1,
        2,
        2,
        3,
        3,
    ]


def test_reordered_packets_change_places_with_their_successors() -> None:
    assert [packet for _, packet in sent_through(fault("reordering"), packets=4)] == [2, 1, 4, 3]


def test_a_cut_link_works_again_after_its_duration() -> None:
    arrived = sent_through(fault("cut", begin_s=0.01, duration_s=0.02))
    assert [packet for _, packet in arrived] == [*range(1, 11), *range(31, 51)]


def test_a_fault_acts_only_in_its_direction_and_only_after_activation() -> None:
    link: LinkFaults[int] = LinkFaults(
        [fault("loss", direction="to_device", begin_s=0.0)], 0.001, 1, Negating()
    )
    link.begin_cycle(None)
    link.pass_on("to_device", 1)
    assert link.due("to_device") == 1
    link.begin_cycle(0)
    link.pass_on("to_device", 2)
    link.pass_on("to_controller", 3)
    assert link.due("to_device") is None
    assert link.due("to_controller") == 3
    assert link.acted["loss"] == 1


def test_a_second_fault_does_not_change_the_random_numbers_of_the_first() -> None:
    first = fault("loss", probability=0.3)
    alone = {packet for _, packet in sent_through(first)}
    both = {
        abs(packet) for _, packet in sent_through(first, fault("flipped_bits", probability=0.5))
    }
    assert alone == both


def test_bits_are_flipped_after_all_sender_faults() -> None:
    class Noting:
        order: list[str] = []

        def changed(
            self,
            fault: Fault,
            way: str,
            packet: int,
            memory: dict[str, Any],
            generator: random.Random,
        ) -> int:
            self.order.append(fault.kind)
            return packet

    noting = Noting()
    link: LinkFaults[int] = LinkFaults(
        [fault("flipped_bits"), fault("stale_stamp")], 0.001, 1, noting
    )
    link.begin_cycle(0)
    link.pass_on("to_device", 1)
    assert noting.order == ["stale_stamp", "flipped_bits"]


def test_equal_seeds_draw_equal_faults_and_other_seeds_draw_others() -> None:
    devices = {"arm_drive": ON_CAN, "base_robot": ON_ZENOH}
    drawn = [faults.draw(faults.RandomFaults(seed=seed, count=20), devices) for seed in (1, 1, 2)]
    assert drawn[0] == drawn[1] != drawn[2]
    faults.check(drawn[0], devices)
    assert all(0.0 <= (f.begin_s or 0.0) <= 5.0 and f.duration_s <= 0.3 for f in drawn[0])


def test_every_kind_is_supported_by_a_device() -> None:
    assert {*ON_CAN, *ON_ZENOH} == set(KINDS)


# Scenario files


@pytest.mark.parametrize(
    ("raw", "sentence"),
    [
        ({"faults": 3}, r"a list of tables, \[\[facility.faults\]\], is expected"),
        ({"faults": [{"kind": "los", "device": "a"}]}, "kind is 'los'; did you mean 'loss'?"),
        ({"faults": [{"kind": "loss"}]}, r"device is missing; the name of a device in \[devices\] is expected"),
        ({"faults": [{"kind": "loss", "device": "a", "probability": 1.5}]}, "probability is 1.5; a number from 0 to 1 is expected"),
        ({"faults": [{"kind": "loss", "device": "a", "probability": float("nan")}]}, "probability is nan"),
        ({"faults": [{"kind": "loss", "device": "a", "bits": 3}]}, "bits does not apply to loss"),
        ({"faults": [{"kind": "loss", "device": "a", "begin": 3}]}, "begin is not known; did you mean 'begin_s'?"),
        ({"faults": [{"kind": "cut", "device": "a", "direction": "back"}]}, "direction is 'back'; one of to_controller, to_device, both"),
        ({"faults": [{"kind": "dead", "device": "a", "direction": "to_device"}]}, "dead affects the whole device and has no direction"),
        ({"faults": [{"kind": "flipped_bits", "device": "a", "bits": 0}]}, "bits is 0; a whole number from 1 to 64 is expected"),
        ({"faults": [{"kind": "delay", "device": "a", "delay_s": True}]}, "delay_s is true"),
        ({"random_faults": []}, "a table is expected"),
        ({"random_faults": {"seed": "x"}}, "seed is 'x'; a whole number"),
        ({"random_faults": {"kinds": ["x"]}}, "kinds is"),
        ({"random_faults": {"kinds": [["loss"]]}}, "kinds is"),
        ({"random_faults": {"count": 100_000_000}}, "count is 100000000; a whole number from 0 to 1000 is expected"),
        ({"faults": [{"device": "a"}]}, "kind is missing; one of loss, delay"),
        ({"faults": [{"kind": "cut", "device": "a", "duration_s": 0.1}]}, "duration_s is measured from begin_s, but begin_s is missing"),
        ({"random_faults": {"cout": 1}}, "cout is not known; did you mean 'count'?"),
    ],
)  # fmt: skip
def test_an_invalid_table_is_rejected_with_the_reason(raw: dict[str, Any], sentence: str) -> None:
    with pytest.raises(DeviceError, match=sentence):
        settings.read(raw)


def test_a_fault_of_an_unknown_device_or_of_an_unsupported_kind_is_rejected() -> None:
    devices = {"arm_drive": ON_CAN, "base_robot": ON_ZENOH}
    with pytest.raises(
        DeviceError,
        match=r"device .arm_driv. is not simulated by this facility; did you mean .arm_drive.\?",
    ):
        faults.check([Fault(kind="loss", device="arm_driv")], devices)
    with pytest.raises(
        DeviceError,
        match="base_robot does not support the fault 'bus_off'; it supports loss, delay",
    ):
        faults.check([Fault(kind="bus_off", device="base_robot")], devices)


def test_faults_are_read_from_a_scenario_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        'extends = "facility"\n[[facility.faults]]\ndevice = "arm_drive"\nkind = "loss"\nprobability = 0.05\n'
    )
    read = settings.read(scenario.load(str(path)).facility)
    assert read.faults == (Fault(kind="loss", device="arm_drive", probability=0.05),)


# The checksum of samples


@given(
    st.binary(min_size=4, max_size=900),
    st.binary(max_size=40),
    st.lists(st.integers(0, 7000), min_size=1, max_size=3, unique=True),
)
def test_up_to_three_changed_bits_are_always_detected(
    message: bytes, attachment: bytes, places: list[int]
) -> None:
    whole = sealed(message, attachment)
    assert is_intact(whole, attachment)
    both = bytearray(whole + attachment)
    # Without the bits of the checksum itself, whose change can only reject an intact sample.
    changed = {p % (8 * len(both)) for p in places} - set(range(16, 32))
    if len({p % (8 * len(both)) for p in places}) < len(places) or not changed:
        return
    for bit in changed:
        both[bit // 8] ^= 1 << bit % 8
    assert not is_intact(bytes(both[: len(whole)]), bytes(both[len(whole) :]))


def test_a_checksum_does_not_use_the_padding_bits_of_cdr() -> None:
    codes = [checksum(b"\0\1\0\0" + bytes([k]), b"") for k in range(256)]
    assert any(is_sealable(code) for code in codes)
    assert all(code & 3 == 0 and code for code in codes if is_sealable(code))
