"""Frames against bytes computed by hand from CiA 301 and 402, unit conversion, and bus load."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import canopen
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pumped import TABLE, pair

from freeflyer_adapters.cia402 import load, objects
from freeflyer_adapters.cia402.options import options_from
from freeflyer_adapters.cia402.process_data import ACTUAL, SPEED, TARGET
from freeflyer_adapters.cia402.scaling import Motor, Scaling
from freeflyer_adapters.foundation.errors import DeviceError

MOTOR = Motor(rated_torque=0.367, encoder_resolution=4096, gear_ratio=160)


def test_a_target_is_controlword_then_torque_little_endian() -> None:
    # Enable operation 000Fh; -250 per mille is FF06h in two's complement.
    assert TARGET.layout.pack(0x000F, -250) == bytes.fromhex("0f00 06ff")
    assert TARGET.base + 3 == 0x203


def test_an_actual_value_is_statusword_torque_and_position() -> None:
    # Statusword 0001 0010 0011 0111b: Operation enabled, voltage enabled, remote, follows command.
    # Torque 100 per mille; position -65536 increments: FFFF0000h.
    assert ACTUAL.layout.unpack(bytes.fromhex("3712 6400 0000ffff")) == (0x1237, 100, -65536)
    assert SPEED.layout.unpack(bytes.fromhex("fbffffff")) == (-5,)
    assert (ACTUAL.base + 3, SPEED.base + 3) == (0x183, 0x283)


@pytest.mark.parametrize(("pdo", "record"), [(TARGET, 0x1600), (ACTUAL, 0x1A00), (SPEED, 0x1A01)])
def test_the_default_mapping_of_the_shipped_eds_is_that_of_the_profile(
    pdo: object, record: int
) -> None:
    dictionary = objects.dictionary(objects.SHIPPED_EDS, 5)
    entries = [dictionary[record][k].default for k in range(1, 1 + dictionary[record][0].default)]
    assert entries == [e.index << 16 | e.sub << 8 | bits for e, bits in pdo.mapping]  # type: ignore[attr-defined]
    cob = dictionary[record - 0x200][1].default
    assert cob & 0x7FF == pdo.base + 5  # type: ignore[attr-defined]
    for entry, bits in pdo.mapping:  # type: ignore[attr-defined]
        assert len(dictionary.get_variable(entry.index, entry.sub)) == bits


def test_the_shipped_eds_has_every_object_and_the_device_type() -> None:
    dictionary = canopen.import_od(str(objects.SHIPPED_EDS), 1)
    for entry in objects.ENTRIES:
        assert dictionary.get_variable(entry.index, entry.sub) is not None, entry
    assert dictionary[0x1000].default == 0x0002_0192  # a servo drive of the device profile 402
    assert dictionary[0x6502].default & objects.SUPPORTS_TORQUE


def test_unit_conversion_against_a_manual_calculation() -> None:
    # 0.367 N m at the motor are 58.72 N m at the joint, or 1000 units of torque. One revolution of
    # the joint has 4096 x 160 = 655360 increments.
    scaling = Scaling([MOTOR])
    assert scaling.raw_torque(np.array([58.72])).tolist() == [1000]
    assert np.rint(np.pi / scaling.position_step).tolist() == [327680]
    assert np.rint(2 * np.pi / scaling.velocity_step).tolist() == [655360]


@given(st.integers(-(2**31), 2**31 - 1), st.integers(-32767, 32767))
def test_raw_numbers_survive_the_conversion_to_si_and_back(position: int, torque: int) -> None:
    scaling = Scaling([MOTOR])
    assert np.rint((position * scaling.position_step) / scaling.position_step)[0] == position
    assert scaling.raw_torque(torque * scaling.torque_step)[0] == torque


@given(arrays(float, st.integers(1, 60), elements=st.floats(-100, 100)))
def test_rounding_keeps_the_sum_of_all_torques_to_half_a_unit(wanted: np.ndarray) -> None:
    scaling = Scaling([MOTOR])
    raw = np.array([scaling.raw_torque(np.array([w]))[0] for w in wanted])
    assert (
        abs(raw.sum() * MOTOR.torque_step - wanted.sum())
        <= 0.5 * MOTOR.torque_step + 1e-9 * np.abs(wanted).sum()
    )
    assert (np.abs(raw * MOTOR.torque_step - wanted) <= MOTOR.torque_step + 1e-9).all()


@given(arrays(float, 3, elements=st.floats(allow_nan=False, allow_infinity=False, width=32)))
def test_no_torque_overflows_its_16_bits(wanted: np.ndarray) -> None:
    for w in wanted:
        assert abs(Scaling([MOTOR]).raw_torque(np.array([w]))[0]) <= 0x7FFF


def test_the_load_of_six_drives_is_the_sum_of_the_bits() -> None:
    # Longest frames with 11-bit identifiers and n data bytes: 47 + 8 n bits, and
    # floor((34 + 8 n - 1) / 4) stuff bits. n = 0: 55 bits; 1: 65; 4: 95; 8: 135.
    cyclic = 55 + 6 * (95 + 135 + 95) + 2 * 135
    assert load.load(6, 4e-3, 1e6, 0.1, measured_velocity=True) == pytest.approx(
        cyclic / 4000 + 7 * 65 / 100_000
    )
    without = 55 + 6 * (95 + 135) + 2 * 135
    assert load.load(6, 4e-3, 1e6, 0.1, measured_velocity=False) == pytest.approx(
        without / 4000 + 7 * 65 / 100_000
    )


@pytest.mark.parametrize(
    ("cycle", "bitrate", "measured", "sentence"),
    [
        (
            0.001,
            1e6,
            True,
            "take up to 228 % of a CAN bus of 1000 kbit/s, but the limit is 80 %: a cycle of 3 ms fits",
        ),
        (0.001, 1e6, False, "take up to 171 %"),
        (0.002, 1e6, False, "take up to 86 %"),
        (
            0.004,
            5e5,
            True,
            'velocity = "estimated" (no TPDO2) would take 86 %, which is still too much; 1 Mbit/s fits',
        ),
        (0.005, 5e5, True, 'velocity = "estimated" (no TPDO2) would take 69 %, which fits'),
    ],
)
def test_too_high_a_bus_load_is_rejected_with_load_and_remedy(
    cycle: float, bitrate: float, measured: bool, sentence: str
) -> None:
    with pytest.raises(DeviceError, match=re.escape(sentence)):
        load.check("arm", 6, cycle, bitrate, 0.1, 0.8, measured_velocity=measured)


@given(st.integers(1, 20), st.sampled_from([1, 2, 3, 4, 5, 8, 10, 20]), st.booleans())
def test_the_suggested_cycle_is_the_shortest_that_fits(
    joints: int, ms: int, measured: bool
) -> None:
    try:
        load.check("arm", joints, 1e-3 * ms, 1e6, 0.1, 0.8, measured_velocity=measured)
    except DeviceError as error:
        named = int(re.search(r"a cycle of (\d+) ms fits", str(error)).group(1))  # type: ignore[union-attr]
        assert named > ms
        load.check("arm", joints, 1e-3 * named, 1e6, 0.1, 0.8, measured_velocity=measured)
        with pytest.raises(DeviceError):
            load.check("arm", joints, 1e-3 * (named - 1), 1e6, 0.1, 0.8, measured_velocity=measured)


def test_too_high_a_bus_load_is_rejected_before_the_bus_is_opened(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pair(monkeypatch, largest_load=0.1) as bench:
        monkeypatch.setattr(
            "freeflyer_adapters.cia402.arm.open_bus", lambda *a: pytest.fail("the bus was opened")
        )
        with pytest.raises(DeviceError, match="2 drives at a cycle of 4 ms"):
            bench.host.configure()


@pytest.mark.parametrize("made", [load.table, objects.table])
def test_the_docs_contain_the_generated_tables(made: Callable[[], list[str]]) -> None:
    text = (Path(__file__).parents[2] / "docs" / "cia402.md").read_text(encoding="utf-8")
    assert "\n".join(made()) in text


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("rated_torque", [0.5], "rated_torque has 1 entries; one for each of 2 joints"),
        ("rated_torque", [0.5, -1], "rated_torque has -1; a number greater than zero"),
        ("node_ids", [3, 3], "node 3 occurs twice"),
        ("node_ids", [3, 128], "node 128 is not a CANopen node number"),
        ("node_ids", [3, 127], "node 127 occurs twice"),
        ("node_ids", [3], "node_ids has 1 entries"),
        ("velocity", "mesured", "'measured' (TPDO2) or 'estimated'"),
        ("bitrate", 5e6, "bitrate is 5000000.0; a number from 10000 to 1e+06"),
        ("bitrte", 1e6, "unknown key 'bitrte'; did you mean 'bitrate'?"),
        ("joints", 0, "joints is 0"),
    ],
)
def test_an_error_in_the_table_is_one_sentence(key: str, value: object, sentence: str) -> None:
    with pytest.raises(DeviceError, match=re.escape(sentence)):
        options_from("arm", {**TABLE, key: value}, Path())


def test_drives_without_a_rated_torque_are_rejected() -> None:
    with pytest.raises(DeviceError, match="rated_torque is missing"):
        options_from("arm", {"joints": 2}, Path())


def test_an_invalid_or_incomplete_eds_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match=r"missing.eds cannot be read: No such file"):
        objects.dictionary(tmp_path / "missing.eds", 1)
    broken = tmp_path / "broken.eds"
    broken.write_text("no eds at all\n")
    with pytest.raises(DeviceError, match=r"broken.eds cannot be used"):
        objects.dictionary(broken, 1)
    incomplete = tmp_path / "incomplete.eds"
    incomplete.write_text(objects.SHIPPED_EDS.read_text().replace("[6071]", "[2071]"))
    with pytest.raises(DeviceError, match=r"has no object 6071h \(Target torque\)"):
        objects.dictionary(incomplete, 1)
