"""A target that serves the virtual rig over the host-target link (docs/target-link.md)."""

from __future__ import annotations

import math
import struct
import time
import zlib
from collections.abc import Callable, Iterator

from rigtool.errors import RigtoolError, UsageError
from rigtool.recipe import Recipe
from rigtool.rigs.base import Block, Task
from rigtool.rigs.motion import Move
from rigtool.rigs.serial.emulators.server import Emulator
from rigtool.rigs.serial.emulators.target_log import TargetLog
from rigtool.rigs.serial.emulators.uploads import Refused, Uploads
from rigtool.rigs.serial.safety import Watch
from rigtool.rigs.serial.target import link
from rigtool.rigs.serial.target.frames import Frame, Splitter, encode
from rigtool.rigs.serial.target.link import Ability, FrameKind, Refusal, Slot, TargetState
from rigtool.rigs.virtual import VirtualRig

TARGET_NAME = "rigtool target emulator"

MAX_PAYLOAD = 4096
"""Bytes that a frame carries at most."""

VALUE_ERRORS = (RigtoolError, ValueError, ArithmeticError, struct.error)
"""Errors that impossible values cause, wherever they are used."""


class TargetEmulator(Emulator):
    """The virtual rig of a recipe behind the link.

    It simulates as fast as it can, or in real time where `paced`. `keeps_log` false forgets samples
    once they are streamed; `log_bytes` is the memory for them; `channels` those it
    can record, all by default. Raises `UsageError` for one that the link does not have.
    """

    def __init__(
        self,
        recipe: Recipe,
        *,
        paced: bool = False,
        keeps_log: bool = True,
        log_bytes: int = 1 << 28,
        channels: tuple[str, ...] | None = None,
    ) -> None:
        self._recipe, self._paced = recipe, paced
        self._keeps_log, self._log_bytes = keeps_log, log_bytes
        self._channels = link.LINK_CHANNELS if channels is None else channels
        if unknown := set(self._channels) - set(link.LINK_CHANNELS):
            raise UsageError(
                f"channels {', '.join(sorted(unknown))}: the link has none of this name, only "
                f"{', '.join(link.LINK_CHANNELS)}"
            )
        self._boot = 0
        self.reset()
        _warm_up(recipe)

    # -- as a device

    def reset(self) -> None:
        """Restart: the session, the objects and the log are lost."""
        self._boot += 1
        self._splitter = Splitter()
        self._answered = (0, b"")
        self._session = False
        self._refusals = 0
        self._uploads = Uploads(self._log_bytes)
        self.rig: VirtualRig | None = None
        self.state, self.text = TargetState.OFF, ""
        self._fed = time.monotonic()
        self._watchdog = 0.0
        self._signals: Iterator[Block] = iter(())
        self._log = TargetLog()
        self._clock = self._started = 0.0
        self._period = 1.0
        self._current = math.nan
        self._block: Block | None = None  # the last one of the motion that runs
        self._move: float | None = None

    def refuse(self, count: int) -> None:
        """Refuse the next requests."""
        self._refusals = count

    def receive(self, data: bytes) -> bytes:
        """Answer the requests in the received bytes."""
        return b"".join(self._answer(frame) for frame in self._splitter.feed(data))

    def idle(self) -> bytes:
        """Simulate a piece further; stop where the host is silent."""
        if self.state in (TargetState.RUNNING, TargetState.DONE) and self._watchdog > 0:
            silence = time.monotonic() - self._fed
            if silence > self._watchdog and self.state is TargetState.DONE:
                self._end(TargetState.OFF)
            elif silence > self._watchdog:
                self._end(TargetState.TRIPPED, f"the host was silent for {silence:.2f} s: watchdog")
        # All samples are sent before the state says that the motion is over.
        if self.state is TargetState.RUNNING and not self._log.behind(self._visible):
            self._proceed()
        out = b"" if self.state is TargetState.ARMED else self._log.frames(self._visible)
        self.busy = self.state is TargetState.RUNNING and not self._paced
        return out

    # -- requests

    def _answer(self, frame: Frame) -> bytes:
        self._fed = time.monotonic()
        number, answer = self._answered
        if number == frame.sequence and frame.kind != FrameKind.HELLO:
            return answer  # done already, or refused already
        try:
            kind, payload = frame.kind | link.REPLY, self._serve(frame)
        except Refused as error:
            kind, payload = link.REFUSED, bytes([error.code]) + str(error).encode()[:200]
        answer = encode(Frame(kind, frame.sequence, payload))
        self._answered = (frame.sequence, answer)
        return answer

    def _serve(self, frame: Frame) -> bytes:
        try:
            kind = FrameKind(frame.kind)
        except ValueError:
            raise Refused(f"request {frame.kind} is not known", Refusal.BAD_VALUE) from None
        if self._refusals:
            self._refusals -= 1
            raise Refused("the drive reports undervoltage", Refusal.FAULT)
        if kind is not FrameKind.HELLO and not self._session:
            raise Refused("the target was switched on or reset", Refusal.NO_SESSION)
        try:
            return self._handlers()[kind](frame.payload)
        except VALUE_ERRORS as error:
            raise Refused(f"{kind.name}: {error}", Refusal.BAD_VALUE) from error

    def _handlers(self) -> dict[FrameKind, Callable[[bytes], bytes]]:
        return {
            FrameKind.HELLO: self._hello,
            FrameKind.BEGIN: self._uploads.begin,
            FrameKind.CHUNK: self._uploads.chunk,
            FrameKind.COMMIT: self._commit,
            FrameKind.ARM: self._arm,
            FrameKind.START: self._start,
            FrameKind.STATUS: self._status,
            FrameKind.READ: self._read,
            FrameKind.DIGEST: self._digest,
            FrameKind.STOP: self._stop,
            FrameKind.MOVE: self._move_by,
            FrameKind.CLAMP: lambda payload: self._bench(payload, "clamp"),
            FrameKind.SOAK: lambda payload: self._bench(payload, "soak"),
            FrameKind.POWER_CYCLE: self._power_cycle,
            FrameKind.BYE: self._bye,
        }

    def _hello(self, payload: bytes) -> bytes:
        boot = self._boot
        self.reset()
        self._boot, self._session = boot, True
        abilities = ~Ability(0)
        if not self._keeps_log:
            abilities &= ~Ability.KEEPS_LOG
        rig = self._recipe.rig
        return link.Hello(
            link.VERSION,
            boot,
            abilities,
            MAX_PAYLOAD,
            self._log_bytes,
            rig.sample_time,
            rig.encoder_counts,
            link.mask_of(self._channels),
            TARGET_NAME,
        ).pack()

    def _commit(self, payload: bytes) -> bytes:
        slot, data = self._uploads.whole(payload)
        self._take(slot, data)
        self._uploads.keep(slot, data)
        return b""

    def _take(self, slot: Slot, data: bytes) -> None:
        """Check an object; those that change the rig take effect at once."""
        match slot:
            case Slot.RIG:
                self._set_up(link.RigSetup.unpack(data))
            case Slot.LIMITS:
                _, self._watchdog = link.unpack_limits(data)
            case Slot.CONTROLLER:
                self._rig().use_controller(link.read_floats(data).reshape(-1, 6))
            case Slot.MOTION:
                link.unpack_motion(data)
            case Slot.TABLE:
                link.unpack_table(data)
            case Slot.LOAD:
                link.unpack_load(data)
            case _:
                link.read_floats(data)

    def _set_up(self, setup: link.RigSetup) -> None:
        changes = {
            "attachment": "instrument" if setup.instrument else "pulley",
            "sample_time": setup.sample_time,
            "encoder_counts": setup.encoder_counts,
            "current_limit": setup.current_limit,
        }
        rig = self._recipe.rig.model_copy(update=changes)
        recipe = self._recipe.model_copy(update={"rig": rig})
        self.rig = VirtualRig(recipe, setup.torque_constant, setup.use)

    def _arm(self, payload: bytes) -> bytes:
        every, angle, mask, streams = link.ARM.unpack(payload)
        if every == 0 or mask & ~link.mask_of(self._channels) or not mask & 1:
            raise Refused("ARM asks for unknown channels, or every 0th sample")
        self._uploads.require_motion()
        virtual = self._recipe.virtual
        touched = virtual is not None and bool(virtual.contact)
        stop_angle = None if math.isnan(angle) else angle
        self._task = task = self._uploads.task(every, stop_angle, touched=touched)
        self._limits = self._uploads.limits()
        if task.motion.duration > self._limits.duration:
            raise Refused(
                f"the motion lasts {task.motion.duration:g} s, the limit is "
                f"{self._limits.duration:g} s"
            )
        if task.start is not None:
            self._require_within(task.start)
        log = TargetLog(mask, keeps=self._keeps_log or not streams, streams=bool(streams))
        dt = self._uploads.sample_time()
        samples = round(task.motion.duration / dt) // every
        needed = samples * log.sample.itemsize
        if not streams and needed > self._log_bytes:
            raise Refused(
                f"the log would take {needed} bytes, there are {self._log_bytes}: record less "
                "often, or stream"
            )
        self._period = dt * every
        self._log = log
        self.state, self.text = TargetState.ARMED, ""
        return link.ARMED.pack(samples, log.sample.itemsize)

    def _start(self, payload: bytes) -> bytes:
        if self.state is not TargetState.ARMED:
            raise Refused("START without ARM")
        self._watch = Watch(self._limits, self._recipe.rig.encoder_counts)
        self._signals = self._rig().perform(self._task)
        self._started = time.monotonic()
        self.state = TargetState.RUNNING
        self._proceed()  # the approach and the first samples, so that STATUS knows the position
        return b""

    def _status(self, payload: bytes) -> bytes:
        return link.Status(
            self._boot, self.state, self._visible, *self._measured(), self.text
        ).pack()

    def _measured(self) -> tuple[float, float, float, float]:
        """Return time, position, current and temperature: of now, or of the last visible sample."""
        if self._block is None or self.state is not TargetState.RUNNING:
            if self.rig is None:
                return self._clock, math.nan, math.nan, math.nan
            return self._clock, self.rig.position, self._current, self.rig.temperature
        block, count = self._block, self._recipe.rig.count_angle
        row = len(block["time"]) - 1 - (self._log.recorded - self._visible)
        names = ("time", "encoder", "current", "temperature")
        now, encoder, current, temperature = (float(block[name][max(0, row)]) for name in names)
        return now, encoder * count, current, temperature

    def _read(self, payload: bytes) -> bytes:
        first, count = link.READ.unpack(payload)
        data = self._samples(first, count)
        if len(data) + link.FIRST.size > MAX_PAYLOAD:
            raise Refused(f"READ of {count} samples is more than a frame holds")
        return link.FIRST.pack(first) + data

    def _digest(self, payload: bytes) -> bytes:
        return link.CRC32.pack(zlib.crc32(self._samples(*link.DIGEST.unpack(payload))))

    def _samples(self, first: int, count: int) -> bytes:
        if first < self._log.first or first + count > self._visible:
            raise Refused(
                f"samples {first} to {first + count} are not in the log: it holds "
                f"{self._log.first} to {self._visible}"
            )
        return self._log.read(first, count)

    def _stop(self, payload: bytes) -> bytes:
        if self.state is TargetState.RUNNING:
            self._end(TargetState.TRIPPED, "stopped by the host")
        elif self.state is not TargetState.TRIPPED:
            self.state = TargetState.OFF
        return b""

    def _require_within(self, position: float) -> None:
        low, high = self._uploads.limits().position
        if not low <= position <= high:
            raise Refused(f"position {position:g} rad is beyond {low:g} to {high:g} rad")

    def _move_by(self, payload: bytes) -> bytes:
        if self.state is TargetState.RUNNING:
            raise Refused("MOVE while a motion runs")
        (angle,) = link.read_floats(payload).tolist()
        self._require_within(self._rig().position + angle)
        self._move = angle
        self._log = TargetLog()
        self.state, self.text = TargetState.RUNNING, ""
        return b""

    def _bench(self, payload: bytes, what: str) -> bytes:
        if self.state is TargetState.RUNNING:
            raise Refused(f"{what} while a motion runs")
        (value,) = link.read_floats(payload).tolist()
        getattr(self._rig(), what)(value)
        return b""

    def _power_cycle(self, payload: bytes) -> bytes:
        self._rig().power_cycle()
        return b""

    def _bye(self, payload: bytes) -> bytes:
        self._stop(payload)
        self._session = False
        return b""

    def _rig(self) -> VirtualRig:
        if self.rig is None:
            raise Refused("upload slot RIG first")
        return self.rig

    # -- running

    @property
    def _visible(self) -> int:
        """Samples recorded so far: all that were simulated, or those whose time has come."""
        done = self._log.recorded
        if self._paced and self.state is TargetState.RUNNING:
            done = min(done, int((time.monotonic() - self._started) / self._period))
        return done

    def _proceed(self) -> None:
        """Advance; a value that cannot be computed trips."""
        try:
            self._advance()
        except VALUE_ERRORS as error:
            self._end(TargetState.TRIPPED, str(error))

    def _advance(self) -> None:
        if self._move is not None:
            angle, self._move = self._move, None
            self._rig().move_by(angle)
            self._end(TargetState.DONE)
            return
        simulated = self._log.recorded
        if self._paced and (time.monotonic() - self._started) / self._period < simulated:
            return
        block = next(self._signals, None)
        if block is None:
            self._end(TargetState.DONE)
            return
        self._log.add(block)
        if len(block["time"]):
            self._block = block
            self._clock = float(block["time"][-1])
            self._current = float(block["current"][-1])
        if problem := self._watch.problem(block):
            self._end(TargetState.TRIPPED, problem)

    def _end(self, state: TargetState, text: str = "") -> None:
        self._signals = iter(())
        self._move = self._block = None
        self.state, self.text = state, text


def _warm_up(recipe: Recipe) -> None:
    """Compile the simulation before a host waits for it."""
    rig = VirtualRig(recipe, recipe.rig.torque_constant, "")
    for _ in rig.perform(Task(Move(0.0, 100 * recipe.rig.sample_time))):
        pass
