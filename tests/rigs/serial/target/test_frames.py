"""Frames against vectors of the link's document, and for any content."""

import binascii
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.control.lookup_table import LookupTable
from rigtool.rigs.base import Load
from rigtool.rigs.motion import CurrentRamp, CurrentSteps, Move, SpeedProfile, Triangle
from rigtool.rigs.serial.line import DamagedReply
from rigtool.rigs.serial.target import link
from rigtool.rigs.serial.target.frames import (
    Frame,
    Splitter,
    cobs_decode,
    cobs_encode,
    decode,
    encode,
)

DOCUMENT = (Path(__file__).parents[4] / "docs" / "target-link.md").read_text()


def hexadecimal(pattern):
    return bytes.fromhex(re.search(pattern, DOCUMENT)[1])


def test_vectors_of_the_document():
    assert encode(Frame(link.FrameKind.HELLO, 1, b"\1")) == hexadecimal(
        r"the line carries `([^`]+)`"
    )
    assert cobs_encode(hexadecimal(r"`([^`]+)` is encoded as")) == hexadecimal(
        r"is encoded as `([^`]+)`"
    )
    assert binascii.crc_hqx(b"123456789", 0) == 0x31C3


@pytest.mark.parametrize(
    ("plain", "coded"),
    [
        # S. Cheshire and M. Baker 1999, and the examples of Wikipedia's article on COBS
        ("", "01"),
        ("00", "01 01"),
        ("00 00", "01 01 01"),
        ("11 22 33 44", "05 11 22 33 44"),
        ("11 00 00 00", "02 11 01 01 01"),
    ],
)
def test_published_examples_of_cobs(plain, coded):
    assert cobs_encode(bytes.fromhex(plain)) == bytes.fromhex(coded)
    assert cobs_decode(bytes.fromhex(coded)) == bytes.fromhex(plain)


@given(st.binary(max_size=2000))
def test_cobs_comes_back_without_zeros(data):
    coded = cobs_encode(data)
    assert 0 not in coded
    assert cobs_decode(coded) == data
    assert len(coded) <= len(data) + len(data) // 254 + 2


@given(st.integers(252, 256), st.integers(0, 3))
def test_cobs_at_the_length_of_a_block(length, zeros):
    data = b"\7" * length + b"\0" * zeros + b"\7" * length
    assert cobs_decode(cobs_encode(data)) == data


@given(
    st.lists(
        st.builds(Frame, st.integers(0, 255), st.integers(0, 65535), st.binary(max_size=600)),
        max_size=6,
    ),
    st.integers(1, 700),
)
def test_frames_come_back_however_they_are_cut(frames, piece):
    stream = b"".join(map(encode, frames))
    splitter = Splitter()
    got = []
    for first in range(0, len(stream), piece):
        got += splitter.feed(stream[first : first + piece])
    assert got == frames
    assert splitter.damaged == 0


@given(st.binary(min_size=1, max_size=200), st.data())
def test_a_flipped_bit_never_gives_another_frame(payload, data):
    whole = encode(Frame(9, 7, payload))[:-1]
    at = data.draw(st.integers(0, len(whole) - 1))
    damaged = bytearray(whole)
    damaged[at] ^= 1 << data.draw(st.integers(0, 7))
    got = Splitter().feed(bytes(damaged) + b"\0")
    # A zero made by the flip cuts the frame in two: both parts fail. (16 bits of CRC catch all
    # single flips in the plain frame; COBS may turn one into more.)
    assert all(frame == Frame(9, 7, payload) for frame in got)


def test_decode_says_what_is_wrong():
    with pytest.raises(DamagedReply, match="too short"):
        decode(cobs_encode(b"1234"))
    with pytest.raises(DamagedReply, match="CRC"):
        decode(cobs_encode(b"12345678"))
    with pytest.raises(DamagedReply, match="cut"):
        decode(b"\x09abc")


@pytest.mark.parametrize(
    "motion",
    [
        SpeedProfile((0.0, 0.1, 0.7), (0.0, 1 / 3, -2.0)),
        Triangle(0.1, 2.6, 1.1, 0.3, 7),
        Move(-0.7, 1.3),
        CurrentSteps((0.0, 0.1, -0.2), 0.4),
        CurrentRamp(-0.02, -0.3),
    ],
)
def test_motions_come_back_as_they_were(motion):
    assert link.unpack_motion(link.pack_motion(motion)) == motion


def test_objects_come_back_as_they_were():
    table = LookupTable(
        np.linspace(0, 1, 5), np.array([-2.0, -1, 1]), np.random.default_rng(1).random((3, 5)),
        np.array([0, 0.5, 1]), np.array([0, 0.3, 1]),
    )  # fmt: skip
    back = link.unpack_table(link.pack_table(table))
    for name in ("position", "speed", "torque", "low_speed", "amplitude"):
        np.testing.assert_array_equal(getattr(back, name), getattr(table, name))
    assert link.unpack_table(link.pack_table(None)) is None
    load = Load(1.5, 0.1, 22.0, clamped=True)
    assert link.unpack_load(link.pack_load(load)) == load
    setup = link.RigSetup(0.0454, 125e-6, 4000, 3.5, True, "calibrate-kt")
    assert link.RigSetup.unpack(setup.pack()) == setup
    hello = link.Hello(link.VERSION, 7, link.Ability.TABLE, 256, 1000, 1e-3, 4000, 0x1FF, "Ärger")
    assert link.Hello.unpack(hello.pack()) == hello
    status = link.Status(7, link.TargetState.TRIPPED, 3, 0.5, 1.0, 2.0, 30.0, "hot")
    assert link.Status.unpack(status.pack()) == status


@given(st.binary(max_size=60))
def test_unpacking_any_bytes_raises_nothing_else_than_value_errors(data):
    for unpack in (link.unpack_motion, link.unpack_table, link.unpack_load, link.unpack_limits):
        try:
            unpack(data)
        except (ValueError, DamagedReply):
            continue


def test_channels_by_bit_are_those_of_the_document():
    rows = re.findall(r"^\| (\d+) \| `(\w+)` \| (f[48]) \|", DOCUMENT, re.MULTILINE)
    assert [name for _, name, _ in rows] == list(link.LINK_CHANNELS)
    for bit, name, kind in rows:
        assert link.channels_of(1 << int(bit)) == (name,)
        assert link.sample_type(1 << int(bit))[name] == np.dtype(kind)
    kinds = re.findall(r"^\| (\d+) \| ([A-Z_]+) \|", DOCUMENT, re.MULTILINE)
    assert {name: int(kind) for kind, name in kinds} == {k.name: int(k) for k in link.FrameKind}
    assert struct.calcsize("<BIHHIdIH") == 27
