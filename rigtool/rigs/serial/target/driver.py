"""A target that runs motions by itself: a microcontroller or real-time PC with the 8 kHz loop.

Motions are uploaded as descriptions; the log is downloaded after the run or streamed. The link
is specified in docs/target-link.md.
"""

from __future__ import annotations

import functools
import math
import threading
import zlib
from collections.abc import Callable, Generator

import numpy as np

from rigtool.control.position_loop import controller_sections
from rigtool.errors import HardwareError, RecipeError
from rigtool.numerics.arrays import Array
from rigtool.recipe import Recipe
from rigtool.rigs.base import Block, Load, Task
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.drivers import Driver
from rigtool.rigs.serial.line import Line, RequestRefused
from rigtool.rigs.serial.rig import SerialRig, in_thread
from rigtool.rigs.serial.safety import Watch, slow_move
from rigtool.rigs.serial.target import link, protocol
from rigtool.rigs.serial.target.link import Ability, FrameKind, Refusal, Slot, Status, TargetState
from rigtool.rigs.serial.target.log import Log
from rigtool.rigs.serial.target.protocol import TargetProtocol
from rigtool.signals import CHANNELS

BAUD_RATE = 115200

SMALLEST_CHUNK = 64
"""Payload of a frame at least, bytes, however many frames a line damages."""

POLL_INTERVAL = 0.02
"""Time between two requests for the state while a motion runs, s."""

UPLOAD_ATTEMPTS = 3
"""Attempts to transfer an object longer than a frame with the right CRC-32."""

MAX_OVERTIME = 60.0
"""Time that a motion may take beyond its duration, for the approach, s."""


def probe(line: Line) -> str | None:
    """Return the identity of the target that answers, None where something else does.

    A HELLO ends the session of another host; ports are opened exclusively, so there is no other.
    """
    return _describe(TargetProtocol(line, timeout=line.timeout, retries=1).hello())


class TargetRig(SerialRig):
    """The rig behind a target."""

    _protocol: TargetProtocol
    _hello: link.Hello

    def __init__(
        self, recipe: Recipe, torque_constant: float, use: str, operator: Operator
    ) -> None:
        super().__init__(recipe, torque_constant, use, operator)
        self.streams = self._settings.log == "stream"
        self._in_session = False
        self._up: dict[Slot, bytes] = {}  # objects in the target
        self._arrived: list[tuple[int, bytes]] = []  # streamed, and not yet in a log
        self._logs: list[Log] = []
        self._damaged_segments = self._damaged_frames = 0
        self._clock_offset = 0.0  # of the host's clock against the target's, at the last START, s

    def _open_line(self) -> Line:
        return Line(
            self._settings.port,
            self._settings.baud_rate or BAUD_RATE,
            spy=self._operator.spy,
            driver="target",
        )

    def _connect(self) -> str:
        if self._in_session:
            self._damaged_frames += self._protocol.damaged
        self._up.clear()
        self._protocol = TargetProtocol(self.line)
        self._protocol.samples = lambda first, data: self._arrived.append((first, data))
        self._hello = hello = self._protocol.hello()
        self._in_session = True
        self._require_match(hello)
        self._chunk = hello.max_payload - link.CHUNK.size
        rig = self._recipe.rig
        sections = controller_sections(**rig.loop_design)
        setup = link.RigSetup(
            self._torque_constant,
            rig.sample_time,
            rig.encoder_counts,
            min(rig.current_limit, self._limits.current),
            rig.attachment == "instrument",
            self._use,
        )
        self._put(Slot.RIG, setup.pack())
        self._put(Slot.LIMITS, link.pack_limits(self._limits, self._settings.watchdog))
        self._put(Slot.CONTROLLER, link.floats(*sections.ravel()))
        return _describe(hello)

    def _require_match(self, hello: link.Hello) -> None:
        rig = self._recipe.rig
        if hello.version != link.VERSION:
            raise HardwareError(
                f"{self.line.port}: the target speaks version {hello.version} of the link, this "
                f"rigtool version {link.VERSION}: update the older one"
            )
        for what, own, theirs, unit in (
            ("sample_time", rig.sample_time, hello.sample_time, " s"),
            ("encoder_counts", rig.encoder_counts, hello.encoder_counts, ""),
        ):
            if not math.isclose(own, theirs, rel_tol=1e-9):
                raise RecipeError(
                    f"rig.{what} is {own:g}{unit} in the recipe and {theirs:g}{unit} in the "
                    "target: correct the recipe"
                )

    def _halt(self) -> None:
        if self._in_session:
            self._protocol.call(FrameKind.STOP)

    def _restore(self) -> None:
        if self._in_session:
            self._protocol.call(FrameKind.BYE)
            self._in_session = False

    def _position(self) -> float:
        return self._status().position

    def _reason(self, need: str) -> str | None:
        if need in CHANNELS:
            if self._hello.channels & link.mask_of((need,)):
                return None
            more = (
                f": add [serial.{need}]" if need in ("force", "temperature", "deflection") else ""
            )
            return f"the target does not record its {need}{more}"
        ability = Ability.__members__.get(need.upper())
        if ability is None or ability in self._hello.abilities:
            return None
        return "the target does not offer it"

    def _facts(self) -> dict[str, int]:
        return {
            "damaged_frames": self._damaged_frames + self._protocol.damaged,
            "missing_samples": sum(log.missing for log in self._logs),
            "samples_read_again": sum(log.read_again for log in self._logs),
            "damaged_segments": self._damaged_segments + sum(log.damaged for log in self._logs),
        }

    # -- between recordings

    def clamp(self, angle: float) -> None:
        """Clamp the arm with the shaft at this angle, rad."""
        if Ability.CLAMP in self._hello.abilities:
            self._protocol.call(FrameKind.CLAMP, link.NUMBER.pack(angle))
        else:
            super().clamp(angle)

    def soak(self, temperature_degc: float) -> None:
        """Wait until the motor has this temperature throughout, degC."""
        if Ability.SOAK in self._hello.abilities:
            self._protocol.call(FrameKind.SOAK, link.NUMBER.pack(temperature_degc))
        else:
            super().soak(temperature_degc)

    def power_cycle(self) -> None:
        """Switch the amplifier off and on: it calibrates itself again."""
        if Ability.POWER_CYCLE in self._hello.abilities:
            self._protocol.call(FrameKind.POWER_CYCLE)
        else:
            super().power_cycle()

    def _host_time(self, time: Array) -> Array:
        """Return the time of the line's clock at these times of the target's, s."""
        return self._clock_offset + time

    def _set_load(self, load: Load) -> None:
        if Ability.LOAD in self._hello.abilities:
            self._put(Slot.LOAD, link.pack_load(load))
        else:
            super()._set_load(load)

    def move_by(self, angle: float) -> None:
        """Turn the shaft by an angle, rad, and come to rest; nothing is recorded."""
        self._require_permission(Task(slow_move(angle, self._limits)))
        self._protocol.call(FrameKind.MOVE, link.NUMBER.pack(angle))
        self._require_done(self._await_end(MAX_OVERTIME))

    # -- motions

    def _execute(self, task: Task) -> Generator[Block, None, None]:
        added = task.feedforward
        signal = b"" if added.signal is None else link.floats(*added.signal)
        self._put(Slot.MOTION, link.pack_motion(task.motion))
        self._put(Slot.FEEDFORWARD, link.pack_feedforward(added))
        self._put(Slot.TABLE, link.pack_table(added.table))
        self._put(Slot.SIGNAL, signal)
        streams = self.streams
        if streams and Ability.STREAM not in self._hello.abilities:
            raise RecipeError('the target cannot stream: set serial.log = "memory"')
        mask = self._hello.channels & link.recorded_under(task.load)
        stop = math.nan if task.stop_angle is None else task.stop_angle
        self._protocol.call(FrameKind.ARM, link.ARM.pack(task.record_every, stop, mask, streams))
        keeps = Ability.KEEPS_LOG in self._hello.abilities
        period = self._recipe.rig.sample_time * task.record_every
        log = Log(link.sample_type(mask), period, self if keeps else None)
        self._logs.append(log)
        self._arrived.clear()
        # A lost request must be repeated before the watchdog expires.
        self._protocol.timeout = min(protocol.REPLY_TIMEOUT, self._settings.watchdog / 3)
        self._protocol.streaming = streams
        self._protocol.call(FrameKind.START)
        before, status, after = self.line.now(), self._status(), self.line.now()
        self._clock_offset = (before + after) / 2 - status.time
        patience = task.motion.duration + MAX_OVERTIME
        if streams:
            yield from in_thread(functools.partial(self._follow, log, patience))
            return
        status = self._await_end(patience)
        self._protocol.timeout = protocol.REPLY_TIMEOUT
        yield from log.fetch(status.samples)
        self._require_done(status)

    def _await_end(self, patience: float) -> Status:
        """Ask for the state until a motion is over; stop it beyond a limit."""
        until = self.line.now() + patience
        watch = Watch(self._limits, self._recipe.rig.encoder_counts)
        while True:
            status = self._status()
            if status.state is not TargetState.RUNNING:
                return status
            self._watch_over(status, watch, until)
            self.line.pause(min(POLL_INTERVAL, self._settings.watchdog / 4))

    def _watch_over(self, status: Status, watch: Watch, until: float) -> None:
        counts = self._recipe.rig.encoder_counts / (2 * math.pi)
        measured = {
            "time": np.array([status.time]),
            "encoder": np.array([status.position * counts]),
            "current": np.array([status.current]),
            "temperature": np.array([status.temperature]),
        }
        if self.watcher is not None and not self._protocol.streaming:
            self.watcher(measured)
        problem = watch.problem(measured)
        if problem is None and self.line.now() > until:
            problem = f"{self.line.port}: the motion did not end in time: it was stopped"
        if problem:
            self._protocol.call(FrameKind.STOP)
            raise HardwareError(problem)

    def _require_done(self, status: Status) -> None:
        if status.state is not TargetState.DONE:
            why = status.text or f"it is {status.state.name} before the end of the motion"
            raise HardwareError(f"{self.line.port}: the target stopped: {why}")

    def _follow(
        self, log: Log, patience: float, put: Callable[[Block], None], stop: threading.Event
    ) -> None:
        """Take samples as they are streamed, and put them in whole segments."""
        watch = Watch(self._limits, self._recipe.rig.encoder_counts)
        line = self.line
        until, asked = line.now() + patience, -math.inf
        status: Status | None = None
        while not stop.is_set() and (status is None or status.state is TargetState.RUNNING):
            self._protocol.listen(POLL_INTERVAL)
            self._take_arrived(log)
            for block in log.complete():
                put(block)
            if line.now() - asked > min(0.1, self._settings.watchdog / 4):
                status = self._status()
                asked = line.now()
                if status.state is TargetState.RUNNING:
                    self._watch_over(status, watch, until)
        self._protocol.timeout, self._protocol.streaming = protocol.REPLY_TIMEOUT, False
        if status is None or stop.is_set():
            return
        self._take_arrived(log)
        for block in log.rest(status.samples):
            put(block)
        self._require_done(status)

    def _take_arrived(self, log: Log) -> None:
        """Take what has come, and hand it on before it is compared with the target's log."""
        for first, data in self._arrived:
            log.take(first, data)
        self._arrived.clear()
        if self.watcher is not None and len((block := log.fresh())["time"]):
            self.watcher(block)

    # -- on the line

    def _status(self) -> Status:
        status = Status.unpack(self._protocol.call(FrameKind.STATUS))
        if status.boot != self._hello.boot:
            raise HardwareError(
                f"{self.line.port}: the target was reset in the middle; its measured samples are "
                "lost: find out why it restarted"
            )
        return status

    def _put(self, slot: Slot, data: bytes) -> None:
        """Upload an object, unless the target has it already."""
        if self._up.get(slot) == data:
            return
        self._up.pop(slot, None)
        for attempt in range(UPLOAD_ATTEMPTS):
            self._protocol.call(FrameKind.BEGIN, link.BEGIN.pack(slot, len(data)))
            offset = 0
            while offset < len(data):
                piece = data[offset : offset + self._chunk]
                self._adapting(FrameKind.CHUNK, link.CHUNK.pack(slot, offset) + piece)
                offset += len(piece)
            try:
                self._protocol.call(
                    FrameKind.COMMIT, link.COMMIT.pack(slot, len(data), zlib.crc32(data))
                )
            except RequestRefused as error:
                if error.code != Refusal.BAD_CRC or attempt == UPLOAD_ATTEMPTS - 1:
                    raise
                continue
            break
        self._up[slot] = data

    def read_log(self, first: int, count: int, size: int) -> bytes:
        """Return samples of `size` bytes from the target's log, verified by CRC-32.

        Raises `HardwareError` where they do not come whole.
        """
        for _ in range(UPLOAD_ATTEMPTS):
            parts, at = [], first
            while at < first + count:
                number = min(max(1, self._chunk // size), first + count - at)
                reply = self._adapting(FrameKind.READ, link.READ.pack(at, number))
                parts.append(reply[link.FIRST.size :])
                at += number
            data = b"".join(parts)
            if self.matches(first, count, data):
                return data
            self._damaged_segments += 1
        raise HardwareError(
            f"{self.line.port}: samples {first} to {first + count} came with a wrong CRC-32 "
            f"{UPLOAD_ATTEMPTS} times: the line damages data"
        )

    def matches(self, first: int, count: int, data: bytes) -> bool:
        """Return whether these are the samples in the target's log, by their CRC-32."""
        reply = self._protocol.call(FrameKind.DIGEST, link.DIGEST.pack(first, count))
        return reply == link.CRC32.pack(zlib.crc32(data))

    def _adapting(self, kind: FrameKind, payload: bytes) -> bytes:
        """Send a request that moves many bytes; smaller pieces follow where it had to be repeated.

        Long frames are hit by disturbances more often than short ones.
        """
        before = self.line.counts.retries
        reply = self._protocol.call(kind, payload)
        largest = self._hello.max_payload - link.CHUNK.size
        if self.line.counts.retries > before:
            self._chunk = max(SMALLEST_CHUNK, self._chunk // 2)
        else:
            self._chunk = min(largest, self._chunk + self._chunk // 16)
        return reply


def _describe(hello: link.Hello) -> str:
    return (
        f"{hello.name}, link version {hello.version}, {1 / hello.sample_time:g} Hz, log of "
        f"{hello.log_bytes / 2**20:.3g} MiB"
    )


DRIVER = Driver(probe, (BAUD_RATE,), make_rig=TargetRig)
