"""The virtual rig behind the Rig protocol: it keeps the bench's state from task to task."""

from __future__ import annotations

import math
import zlib
from collections.abc import Generator, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rigtool.control.position_loop import controller_sections
from rigtool.errors import RecipeError
from rigtool.numerics.arrays import Array
from rigtool.recipe import Recipe
from rigtool.recipe.virtual import Hand, Virtual
from rigtool.rigs.base import Block, Feedforward, Load, Rig, Task
from rigtool.rigs.motion import CurrentSteps, Motion, Move, Observe, OpenLoop, Path, pieces_of
from rigtool.rigs.virtual import contacts, hand, kernel, layout
from rigtool.rigs.virtual.contacts import Grip, Outside
from rigtool.rigs.virtual.maps import friction_map, rotor_map
from rigtool.rigs.virtual.parameters import parameters, true_rig
from rigtool.rigs.virtual.stability import require_stable

BLOCK_SAMPLES = 16384
"""Approximate number of samples simulated at a time: they fit a processor's cache."""

OBSERVED_CHANNELS = (
    "time",
    "encoder",
    "current_setpoint",
    "current",
    "temperature",
    "reference_torque",
)
"""Channels that can be read without taking part in a motion."""

CONTACTS, HAND = 0xC047AC7, 0x4A4D
"""Streams of the seed for random draws other than the bench's own noise."""

NO_TABLE = (np.zeros((0, 0)), np.zeros(0), np.zeros(3))
SOAK_TIME = 600.0
MOVE_SPEED = 2.0
SETTLE_TIME = 0.5
REST_TIME = 2.0
"""Time in which a motor whose motion was broken off comes to rest without current, s."""


class VirtualRig(Rig):
    """A simulated motor with encoder, amplifier and instrument.

    `torque_constant` is the controller's, N m/A. `stream` names the use (a command), so that each
    has its own noise from the same seed. Raises `RecipeError` without [virtual], or where its
    values cannot be simulated.
    """

    def __init__(self, recipe: Recipe, torque_constant: float, stream: str) -> None:
        if recipe.virtual is None:
            raise RecipeError(
                "the recipe has no table [virtual], which describes the simulated rig: add one; "
                "`rigtool recipe briaire-2006` shows it"
            )
        self._virtual: Virtual = recipe.virtual
        self._rig = true_rig(recipe.rig, recipe.virtual)
        self._stream = zlib.crc32(stream.encode())
        self._tasks = 0
        self._under_way = False
        self._power_cycle = self._virtual.power_cycle
        self._time = 0.0
        self._clamp_angle = 0.0
        self._assumed_torque_constant = torque_constant
        self._sections = controller_sections(**recipe.rig.loop_design)
        self._section_state = np.zeros((len(self._sections), 2))
        self._setpoint: float | None = None  # of the closed loop, rad; None while it is open
        self._rotor_map = rotor_map(self._virtual, self._virtual.amplifier, self._power_cycle)
        self._friction_map = friction_map(self._virtual)
        self._state = np.zeros(1, dtype=layout.STATE)
        self._state["direction"] = 1.0
        ambient = self._virtual.thermal.ambient_degc
        self._state["winding_degc"] = self._state["housing_degc"] = ambient
        for load in (Load(), Load(clamped=True)):
            require_stable(self._parameters(load)[0])

    @property
    def position(self) -> float:
        """Angle shown by the encoder, rad."""
        count = self._rig.count_angle
        angle, speed = (float(self._state[name][0]) for name in ("angle", "speed"))
        return math.floor((angle - self._rig.sample_time / 2 * speed) / count) * count

    @property
    def temperature(self) -> float:
        """Temperature of the housing, degC."""
        return float(self._state["housing_degc"][0])

    def use_controller(self, sections: Array) -> None:
        """Take these second-order sections, (n, 6), instead of those of the recipe."""
        self._sections = np.array(sections)
        self._section_state = np.zeros((len(self._sections), 2))

    # -- the bench between recordings

    def move_by(self, angle: float) -> None:
        """Turn the shaft by an angle, rad, and come to rest; nothing is recorded."""
        duration = SETTLE_TIME + abs(angle) / MOVE_SPEED
        for _ in self._run(Task(Move(angle, duration), record_every=64)):
            pass
        for _ in self._run(Task(Move(0.0, SETTLE_TIME), record_every=64)):
            pass

    def clamp(self, angle: float) -> None:
        """Clamp the arm with the shaft at this angle, rad."""
        self._clamp_angle = angle
        self._state["angle"] = angle
        self._state["speed"] = self._state["bristle"] = 0.0
        self._setpoint = None

    def soak(self, temperature_degc: float) -> None:
        """Wait until the motor has this temperature throughout, degC."""
        self._state["winding_degc"] = self._state["housing_degc"] = temperature_degc
        self._time += SOAK_TIME

    def power_cycle(self) -> None:
        """Switch the amplifier off and on: it calibrates itself again."""
        self._power_cycle += 1
        self._rotor_map = rotor_map(self._virtual, self._virtual.amplifier, self._power_cycle)
        self._state["current"] = self._state["ripple"] = 0.0
        self._setpoint = None

    # -- tasks

    def perform(self, task: Task) -> Generator[Block, None, None]:
        """Run a task and yield its signals in blocks; moves to the motion's start first.

        A task that observes has the motion of the recipe's [virtual.hand]: another controller's,
        with the loop of [rig.controller], or that of a hand at the output.
        """
        if isinstance(task.motion, Observe):
            yield from self._observe(task)
            return
        if task.start is not None:
            self.move_by(task.start - self._closed_loop_setpoint())
        try:
            yield from self._run(task)
        except GeneratorExit:
            if self._under_way:
                for _ in self._run(Task(CurrentSteps((0.0,), REST_TIME))):
                    pass
            raise

    def _observe(self, task: Task) -> Iterator[Block]:
        """Let a hand or another controller move the rig, and yield the readable signals."""
        rng = np.random.default_rng([self._virtual.seed, self._stream, self._tasks, HAND])
        ratio, duration = self._rig.angle_ratio, task.motion.duration
        motion = hand.draw(self._virtual.hand, ratio, duration, rng)
        if self._virtual.hand.moves == "motor":
            inertia = self._rig.nominal_inertia
            moved = replace(task, motion=motion, feedforward=Feedforward(inertia))
            blocks: Iterator[Block] = self.perform(moved)
        else:
            for _ in self._run(
                *self._by_hand(replace(task, touched=False), self._approach(motion))
            ):
                pass
            blocks = self._run(*self._by_hand(task, motion))
        for block in blocks:
            yield {name: block[name] for name in OBSERVED_CHANNELS if name in block}

    def _approach(self, motion: Motion) -> Move:
        """Return the way of the hand to where its motion starts."""
        assert motion.start is not None
        angle = motion.start - self._output_angle() * self._rig.angle_ratio
        return Move(angle, SETTLE_TIME + abs(angle) / MOVE_SPEED)

    def _by_hand(self, task: Task, motion: Motion) -> tuple[Task, Motion]:
        """Return a task for the motor, which has no current, and the motion of the hand."""
        idle = CurrentSteps((0.0,), motion.duration)
        return replace(task, motion=idle, feedforward=Feedforward()), motion

    def _output_angle(self) -> float:
        """Return the true angle of grasper or pulley, rad."""
        name = "grasper_angle" if self._rig.attachment == "instrument" else "angle"
        return float(self._state[name][0])

    def _closed_loop_setpoint(self) -> float:
        if self._setpoint is None:  # close the loop where the rotor is
            self._section_state[:] = 0.0
            self._setpoint = self.position
        return self._setpoint

    def _run(self, task: Task, grip: Motion | None = None) -> Iterator[Block]:
        """Run a task; `grip` is the motion, on the motor's scale, of a hand at the output."""
        self._tasks += 1
        stream = [self._virtual.seed, self._stream, self._tasks]
        rng = np.random.default_rng(stream)
        dt, every, motion = self._rig.sample_time, task.record_every, task.motion
        assert not isinstance(motion, Observe)
        origin = 0.0
        closed_loop = not isinstance(motion, OpenLoop)
        if closed_loop:
            here = self._closed_loop_setpoint()
            origin = float(here if task.start is None else task.start)
        else:
            self._setpoint = None
        record = self._parameters(task.load, None if grip is None else self._virtual.hand)
        outside = self._outside(task, grip, [*stream, CONTACTS])
        needs_time = outside is not None or not isinstance(motion, Path)
        ff = task.feedforward
        signal = np.zeros(0) if ff.signal is None else np.ascontiguousarray(ff.signal, np.float64)
        total = round(motion.duration / dt)
        shortest = layout.SLOW_STEP_SAMPLES * every
        block = shortest * max(1, BLOCK_SAMPLES // shortest)
        for first in range(0, total, block):
            count = min(block, total - first)
            steps = np.arange(first, first + count if needs_time else first, dtype=np.float64)
            time = (steps + 0.5) * dt
            out = np.zeros((count // every, len(layout.COLUMNS)))
            done = kernel.run(
                record,
                self._state,
                self._rotor_map,
                self._friction_map,
                self._sections,
                self._section_state,
                closed_loop,
                motion.pieces if isinstance(motion, Path) else _by_samples(motion, time),
                first,
                count,
                origin,
                ff.coefficients,
                NO_TABLE if ff.table is None else ff.table.grid,
                signal,
                rng.standard_normal((count // layout.SLOW_STEP_SAMPLES + 1, 2)),
                rng.standard_normal((512, 3)),
                task.stop_angle or 0.0,
                every,
                out,
                None if outside is None else outside.at(time),
                np.zeros((0, 5)) if outside is None else outside.tissues(),
            )
            self._require_bounds()
            if closed_loop:
                self._setpoint = float(self._state["setpoint"][0])
            recorded = self._recorded(out[: done // every], every, task.load, rng)
            if task.touched:
                recorded["reference_torque"] = out[: done // every, layout.REFERENCE_TORQUE]
            self._under_way = done == count and first + count < total
            yield recorded
            self._time += done * dt
            if done < count:
                return

    def _require_bounds(self) -> None:
        moving = [self._state[0][name] for name in ("angle", "grasper_angle", "winding_degc")]
        if not np.isfinite(moving).all():
            raise RecipeError(
                "the equations of [virtual] left all bounds while they were simulated: its "
                "values are beyond any rig; compare them with `rigtool recipe briaire-2006`"
            )

    def _outside(self, task: Task, grip: Motion | None, seed: list[int]) -> Outside | None:
        """Return the contacts on the output during a task; None without any."""
        if not task.touched and grip is None:
            return None
        ratio = self._rig.angle_ratio
        acting = self._virtual.contact if task.touched else ()
        touches = contacts.draw(acting, task.motion.duration, seed)
        held = None
        if grip is not None:
            here = self._output_angle() * ratio
            held = Grip(grip, here if grip.start is None else grip.start, ratio)
        return Outside(touches, self._rig.load_arm, held)

    def _recorded(self, out: Array, every: int, load: Load, rng: np.random.Generator) -> Block:
        """Return the channels of the means in `out` (n, 10), with the sensors' noise."""
        rows, sensors = len(out), self._virtual.sensors
        average = 1 / math.sqrt(every)
        middle = np.arange(rows, dtype=np.float64) * every + (every - 1) / 2
        block = {
            "time": self._time + middle * self._rig.sample_time,
            "position_setpoint": out[:, layout.POSITION_SETPOINT],
            "encoder": out[:, layout.ENCODER],
            "current_setpoint": out[:, layout.CURRENT_SETPOINT],
            "current": sensors.current_gain * out[:, layout.CURRENT]
            + sensors.current_noise * average * rng.standard_normal(rows),
            "feedforward_current": out[:, layout.FEEDFORWARD_CURRENT],
            "table_current": out[:, layout.TABLE_CURRENT],
            "signal_current": out[:, layout.SIGNAL_CURRENT],
            "temperature": out[:, layout.TEMPERATURE]
            + sensors.temperature_offset
            + sensors.temperature_noise * rng.standard_normal(rows),
        }
        if load.radial_force:
            spring = self._virtual.eccentricity.spring_constant
            error = sensors.micrometer_error * rng.spawn(1)[0].standard_normal()  # one reading
            pull = load.radial_force * (1 + self._virtual.misstated.weights)
            block["deflection"] = np.full(rows, pull / spring + error)
        if load.clamped:
            force = out[:, layout.ARM_TORQUE] / self._rig.arm.length
            force = force * (sensors.force_gain + sensors.force_linearity * force)
            force = force + sensors.force_noise * rng.standard_normal(rows)
            if sensors.force_resolution > 0:
                force = np.round(force / sensors.force_resolution) * sensors.force_resolution
            block["force"] = force
            block["rotor_angle"] = np.full(rows, self._clamp_angle)
        return block

    def _parameters(self, load: Load, hand: Hand | None = None) -> NDArray[np.void]:
        return parameters(
            self._rig,
            self._virtual,
            load,
            assumed_torque_constant=self._assumed_torque_constant,
            clamp_angle=self._clamp_angle,
            hand=hand,
        )


def _by_samples(motion: Motion, time: Array) -> Array:
    """Return a piece for each of these times (n,), with the motion's set point at it."""
    position, speed, acceleration = motion.setpoint(time)
    return pieces_of(time, position, speed, acceleration / 2)
