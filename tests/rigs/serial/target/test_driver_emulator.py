"""The emulated target against anything a host could send."""

import functools
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.rigs.base import Feedforward
from rigtool.rigs.motion import Move, Triangle
from rigtool.rigs.serial.emulators.target import TargetEmulator
from rigtool.rigs.serial.target import link
from rigtool.rigs.serial.target.frames import Frame, Splitter, encode
from rigtool.rigs.serial.target.link import FrameKind, Refusal, Slot, TargetState
from tests.rigs.serial.recipes import serial_recipe
from tests.rigs.serial.target.test_driver import virtual

LIMITS = serial_recipe("none").serial.limits


@functools.cache
def emulator():
    """Return the one of all tests; it runs its simulation when it is made, to compile it."""
    return TargetEmulator(virtual())


class Host:
    """Talks to an emulator without a line."""

    def __init__(self, device):
        self.device, self.sequence, self.splitter = device, 0, Splitter()

    def send(self, kind, payload=b"", sequence=None):
        self.sequence += sequence is None
        number = self.sequence if sequence is None else sequence
        (reply,) = self.splitter.feed(self.device.receive(encode(Frame(kind, number, payload))))
        assert reply.sequence == number
        return reply

    def ask(self, kind, payload=b""):
        reply = self.send(kind, payload)
        assert reply.kind == kind | link.REPLY, reply
        return reply.payload

    def refused(self, kind, payload=b""):
        reply = self.send(kind, payload)
        assert reply.kind == link.REFUSED
        return Refusal(reply.payload[0]), reply.payload[1:].decode()

    def put(self, slot, data):
        self.ask(FrameKind.BEGIN, link.BEGIN.pack(slot, len(data)))
        self.ask(FrameKind.CHUNK, link.CHUNK.pack(slot, 0) + data)
        self.ask(FrameKind.COMMIT, link.COMMIT.pack(slot, len(data), zlib.crc32(data)))

    def set_up(self, motion):
        self.ask(FrameKind.HELLO, b"\1")
        setup = link.RigSetup(0.0454, 125e-6, 4000, 10.0, False, "test")
        self.put(Slot.RIG, setup.pack())
        self.put(Slot.LIMITS, link.pack_limits(LIMITS, 5.0))
        self.put(Slot.CONTROLLER, link.floats(0.1, 0, 0, 1, 0, 0))
        self.put(Slot.MOTION, link.pack_motion(motion))
        self.put(Slot.FEEDFORWARD, link.pack_feedforward(Feedforward(1e-5)))

    def run(self):
        self.ask(FrameKind.START)
        while self.status().state is TargetState.RUNNING:
            self.device.idle()

    def status(self):
        return link.Status.unpack(self.ask(FrameKind.STATUS))


@pytest.fixture
def host():
    emulator().reset()
    return Host(emulator())


def arm(every=1, stop=np.nan, mask=0b11111, streams=0):
    return link.ARM.pack(every, stop, mask, streams)


def test_a_session(host):
    host.set_up(Move(0.5, 0.1))
    samples, size = link.ARMED.unpack(host.ask(FrameKind.ARM, arm()))
    assert (samples, size) == (800, 8 * 3 + 4 * 2)
    host.run()
    status = host.status()
    assert (status.state, status.samples) == (TargetState.DONE, 800)
    data = host.ask(FrameKind.READ, link.READ.pack(790, 10))[4:]
    rows = np.frombuffer(data, link.sample_type(0b11111))
    assert rows["position_setpoint"][-1] == pytest.approx(0.5, abs=1e-3)
    host.ask(FrameKind.BYE)
    assert host.refused(FrameKind.STATUS)[0] is Refusal.NO_SESSION


def test_a_request_sent_twice_is_done_once(host):
    host.set_up(Move(0.5, 0.1))
    host.ask(FrameKind.MOVE, link.floats(0.2))
    host.device.idle()
    before = host.status().position
    first = host.send(FrameKind.MOVE, link.floats(0.2))
    again = host.send(FrameKind.MOVE, link.floats(0.2), sequence=host.sequence)
    assert first == again
    host.device.idle()
    assert host.status().position - before == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize(
    ("kind", "payload", "code", "message"),
    [
        (FrameKind.START, b"", Refusal.NOT_NOW, "START without ARM"),
        (FrameKind.ARM, arm(every=0), Refusal.NOT_NOW, "every 0th sample"),
        (FrameKind.ARM, arm(mask=0), Refusal.NOT_NOW, "unknown channels"),
        (FrameKind.ARM, b"short", Refusal.BAD_VALUE, "ARM"),
        (FrameKind.READ, link.READ.pack(0, 5), Refusal.NOT_NOW, "not in the log"),
        (FrameKind.MOVE, link.floats(float("nan")), Refusal.BAD_VALUE, "not finite"),
        (FrameKind.MOVE, link.floats(1e300), Refusal.NOT_NOW, "beyond -100000 to 100000 rad"),
        (FrameKind.CHUNK, link.CHUNK.pack(5, 0) + b"x", Refusal.NOT_NOW, "does not fit"),
        (FrameKind.BEGIN, link.BEGIN.pack(5, 2**32 - 1), Refusal.BAD_VALUE, "no memory"),
        (FrameKind.BEGIN, link.BEGIN.pack(99, 5), Refusal.BAD_VALUE, "99"),
        (FrameKind.COMMIT, link.COMMIT.pack(5, 8, 1), Refusal.BAD_CRC, "CRC-32"),
        (77, b"", Refusal.BAD_VALUE, "request 77 is not known"),
    ],
)
def test_refusals_say_why(host, kind, payload, code, message):
    host.set_up(Move(0.5, 0.1))
    got, text = host.refused(kind, payload)
    assert got is code
    assert message in text


def test_motions_that_cannot_be_are_refused_or_trip(host):
    host.set_up(Triangle(0.0, 1.0, 0.0, 0.1, 1))  # speed zero
    assert host.refused(FrameKind.ARM, arm())[0] is Refusal.BAD_VALUE


def test_another_host_may_begin_with_the_number_that_was_last(host):
    host.set_up(Move(0.5, 0.1))
    reply = host.send(FrameKind.HELLO, b"\1", sequence=host.sequence)
    assert reply.kind == FrameKind.HELLO | link.REPLY
    assert host.refused(FrameKind.ARM, arm())[1].startswith("ARM before RIG, LIMITS")


def test_hello_in_the_middle_stops_and_forgets(host):
    host.set_up(Move(0.5, 10.0))
    host.ask(FrameKind.ARM, arm())
    host.ask(FrameKind.START)
    host.device.idle()
    boot = link.Hello.unpack(host.ask(FrameKind.HELLO, b"\1")).boot
    status = host.status()
    assert (status.state, status.samples, status.boot) == (TargetState.OFF, 0, boot)
    host.device.reset()
    assert link.Hello.unpack(host.ask(FrameKind.HELLO, b"\1")).boot != boot


@settings(max_examples=80, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 20), st.binary(max_size=40)), max_size=12),
    st.binary(max_size=40),
)
def test_whatever_is_sent_is_answered(requests, noise):
    emulator().reset()
    host = Host(emulator())
    host.set_up(Move(0.1, 0.01))
    emulator().receive(noise + b"\0")
    for kind, payload in requests:
        reply = host.send(kind, payload)
        assert reply.kind in (kind | link.REPLY, link.REFUSED)
        emulator().idle()


@settings(max_examples=50, deadline=None)
@given(st.sampled_from(list(Slot)), st.binary(max_size=64))
def test_whatever_object_comes_up_is_taken_or_refused(slot, data):
    emulator().reset()
    host = Host(emulator())
    host.set_up(Move(0.1, 0.01))
    host.ask(FrameKind.BEGIN, link.BEGIN.pack(slot, len(data)))
    host.ask(FrameKind.CHUNK, link.CHUNK.pack(slot, 0) + data)
    host.send(FrameKind.COMMIT, link.COMMIT.pack(slot, len(data), zlib.crc32(data)))
    reply = host.send(FrameKind.ARM, arm())
    if reply.kind == FrameKind.ARM | link.REPLY and struct.unpack("<IH", reply.payload)[0] < 10000:
        host.ask(FrameKind.START)
        for _ in range(20):
            emulator().idle()
