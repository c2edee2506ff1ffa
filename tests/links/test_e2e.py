"""E2E profile 5 against the AUTOSAR specification, and the acceptance rules of the counter."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from freeflyer_adapters.can.e2e import Checker, Protector, Status

DATA_ID = 0x1234


def protected(data: bytes, counter: int = 0, offset: int = 0) -> bytearray:
    protector = Protector(DATA_ID, offset)
    protector._counter = counter
    frame = bytearray(data)
    protector.protect(frame)
    return frame


def test_the_vectors_of_the_specification() -> None:
    """AUTOSAR FO PRS E2E Protocol (849), profile 5: all data 0, data ID 0x1234, counter 0."""
    assert protected(bytes(8)).hex() == "1cca000000000000"
    assert protected(bytes(16), offset=8).hex() == "00000000000000002891000000000000"


def crc_16_ccitt_false(data: bytes) -> int:
    """Independent bitwise CRC-16 of the specification: polynomial 0x1021, start value 0xFFFF."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1021) & 0xFFFF if crc & 0x8000 else (crc << 1) & 0xFFFF
    return crc


@given(st.binary(min_size=3, max_size=64), st.integers(0, 255))
def test_the_crc_covers_the_rest_of_the_frame_and_the_data_id(data: bytes, counter: int) -> None:
    frame = protected(data, counter)
    expected = crc_16_ccitt_false(bytes(frame[2:]) + DATA_ID.to_bytes(2, "little"))
    assert int.from_bytes(frame[:2], "little") == expected
    assert frame[2] == counter


@given(st.binary(min_size=8, max_size=64), st.data())
def test_up_to_three_flipped_bits_are_detected(data: bytes, draw: st.DataObject) -> None:
    frame = protected(data)
    for bit in draw.draw(st.sets(st.integers(0, 8 * len(frame) - 1), min_size=1, max_size=3)):
        frame[bit // 8] ^= 1 << bit % 8
    assert Checker(DATA_ID).check(frame) is Status.wrong_crc


def test_the_data_id_of_another_frame_is_detected() -> None:
    assert Checker(DATA_ID + 1).check(protected(bytes(24))) is Status.wrong_crc


def test_repetition_loss_and_a_large_jump_are_detected() -> None:
    checker = Checker(DATA_ID, most_lost=10)
    frames = [protected(bytes(8), counter=k) for k in range(256)]
    assert [checker.check(frames[k]) for k in (0, 1, 1, 4, 14, 40, 41)] == [
        Status.ok,
        Status.ok,
        Status.repeated,
        Status.some_lost,
        Status.some_lost,
        Status.wrong_sequence,
        Status.ok,
    ]
    assert checker.check(frames[30]) is Status.wrong_sequence  # backwards


def test_the_counter_wraps_around() -> None:
    protector, checker = Protector(DATA_ID), Checker(DATA_ID)
    for _ in range(600):
        frame = bytearray(8)
        protector.protect(frame)
        assert checker.check(frame) is Status.ok


def test_a_short_frame_is_rejected() -> None:
    assert Checker(DATA_ID).check(b"\x00\x00") is Status.wrong_crc
    assert Checker(DATA_ID, offset=8).check(bytes(9)) is Status.wrong_crc
