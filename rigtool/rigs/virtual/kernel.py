"""The step of the simulation, compiled: controller, amplifier, motor, tendon, grasper.

    J dw/dt   = Kt(T) (i + ripple) + cogging - friction - load - tendon            [motor shaft]
    Jg dwg/dt = s - tip friction - F L sin(thg),  s = k (th/n - thg) + c (w/n - wg)  [grasper]

Friction is a bristle model: each contact has a deflection z in -1..1 with x0 dz/dt = w - |w| z and
the torque level*z, after Dahl (1968) and Canudas de Wit et al., IEEE TAC 40(3) 419-425, 1995; the
level follows Stribeck. Pre-sliding, breakaway and reversal come from it.

Steps are those of the leapfrog method (Hairer, Lubich and Wanner, Geometric Numerical Integration,
2006, section I.1): speeds belong to the samples, angles to the middle between them, so that springs
act as they stand in the middle of a step; the encoder is read at the samples. Current and ripple
act with their means over a step. What opposes the shaft's speed in proportion is exact for
torques held over a step (`mobility`); the bristles are implicit, which keeps them stable at any
speed; the tendon is exact (`tendon`); contacts at the output are those of `touching`. SI units;
temperatures in degC.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rigtool.control.lookup_table import blend
from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled
from rigtool.rigs.base import model_torque
from rigtool.rigs.motion import BEGIN, OMEGA, follow
from rigtool.rigs.virtual.layout import (
    ARM_TORQUE,
    CURRENT,
    CURRENT_SETPOINT,
    ENCODER,
    FEEDFORWARD_CURRENT,
    POSITION_SETPOINT,
    REFERENCE_TORQUE,
    SIGNAL_CURRENT,
    SLOW_STEP_SAMPLES,
    TABLE_CURRENT,
    TEMPERATURE,
)
from rigtool.rigs.virtual.touching import Record, touched

_follow, _model_torque, _blend = compiled(follow), compiled(model_torque), compiled(blend)


@compiled
def _table_torque(
    rows: Array, speeds: Array, positions: Array, position: float, speed: float
) -> float:
    """Return what `LookupTable.evaluate` returns, for one sample; the arrays are its `grid`."""
    start, step, period = positions
    count = rows.shape[1]
    if period > 0.0:
        position = start + (position - start) % period
    across = min(max((position - start) / step, 0.0), count - 1.0)
    column = min(int(across), count - 2)
    row = 0
    while row < speeds.shape[0] - 2 and speed >= speeds[row + 1]:
        row += 1
    along = (speed - speeds[row]) / (speeds[row + 1] - speeds[row])
    along = min(max(along, 0.0), 1.0)
    return _blend(rows.reshape(rows.size), row * count + column, count, across - column, along)


@compiled
def _cell(angle: float, count: int) -> tuple[int, float]:
    """Return the cell of a turn of `count` cells that holds an angle, and where in it that is."""
    place = angle * (1.0 / (2.0 * math.pi))
    place = (place - np.floor(place)) * count
    cell = min(int(place), count - 1)
    return cell, place - cell


@compiled
def _torque_constant(s: Record, p: Record) -> float:
    return p.torque_constant * (1.0 + p.torque_constant_coefficient * (s.winding_degc - 20.0))


@compiled
def _bristle(z: float, speed: float, per_speed: float) -> float:
    """Deflection of a bristle one step later, implicit in z; `per_speed` is dt/x0."""
    return (z + speed * per_speed) / (1.0 + abs(speed) * per_speed)


@compiled
def mobility(inertia: float, drag: float, dt: float) -> float:
    """Return m with which w + dt m (T - f w) is the speed one step later under a torque T.

    `drag` f [N m s/rad] opposes the speed w. Exactly it is (1 - exp(-x))/(J x) with x = f dt/J:
    its series 1/(J (1 + x/2 + x2/12)) is 1.4e-3 x^4 off, and stable at any x.
    """
    half = drag * dt / 2.0
    return 3.0 * inertia / (3.0 * inertia * (inertia + half) + half * half)


@compiled
def _stroke(s: Record, p: Record, normals: Array, drawn: int) -> None:
    """Draw the friction of a new stroke; part of the last one's deviation is returned."""
    row = 1 if s.direction > 0 else 0
    scale = 1.0 / math.sqrt(1.0 + p.stroke_payback**2)
    pool = drawn % (normals.shape[0])
    for k in range(3):
        fresh = normals[pool, k]
        deviation = (fresh - p.stroke_payback * s.drawn[row, k]) * scale
        s.drawn[row, k] = fresh
        if k == 0:
            s.stroke_sine = p.stroke_noise * deviation
        elif k == 1:
            s.stroke_cosine = p.stroke_noise * deviation
        else:
            s.stroke_load = p.load_stroke_noise * deviation


@compiled
def _tick(s: Record, p: Record, square_current: float, normals: Array, tick: int) -> None:
    """Advance the slow states by TICK samples: heat, friction noise and drift."""
    dt = p.dt * SLOW_STEP_SAMPLES
    warm = 1.0 + 0.00393 * (s.winding_degc - 20.0)  # resistance of copper with temperature
    flow = (s.winding_degc - s.housing_degc) / p.winding_to_housing
    loss = (s.housing_degc - p.ambient_degc) / p.housing_to_ambient
    s.winding_degc += dt * (p.resistance * warm * square_current - flow) / p.winding_capacity
    s.housing_degc += dt * (flow - loss) / p.housing_capacity
    s.friction_noise = p.noise_decay * s.friction_noise + p.noise_gain * normals[tick, 0]
    s.drift = p.drift_decay * s.drift + p.drift_gain * normals[tick, 1]


@compiled
def run(
    parameters: NDArray[np.void],
    state: NDArray[np.void],
    rotor_map: Array,
    friction_map: Array,
    sections: Array,
    section_state: Array,
    closed_loop: bool,
    pieces: Array,
    first: int,
    n: int,
    origin: float,
    model: tuple[float, float, float],
    table: tuple[Array, Array, Array],
    signal: Array,
    normals: Array,
    stroke_normals: Array,
    stop_angle: float,
    record_every: int,
    out: Array,
    touch: Array | None,
    tissues: Array,
) -> int:
    """Simulate up to `n` samples and return how many were done.

    `pieces` (k, 9) describe the set point (`motion.Path`): in closed loop the position [rad] from
    `origin`, in open loop the current [A]; sample `first` of the motion comes first. In closed loop
    the torques [N m] of `model`, `table` (`Feedforward.coefficients`, `LookupTable.grid`; no rows:
    none) and `signal` (m,), which repeats, are added. `out` (n // record_every, 10) receives means.
    `touch` (n, 4) holds the contacts at each sample, `tissues` (k, 5) those that the output runs
    into. Without `touch` (None) there are no contacts, and they are not part of the compiled step.
    """
    p = parameters[0]
    s = state[0]
    per_count = p.encoder_counts / (2.0 * math.pi)
    count = 1.0 / per_count
    map_size = rotor_map.shape[0] - 1
    dt = p.dt
    clamped = p.clamped > 0.5
    instrument = p.instrument > 0.5
    start = s.angle
    torque_constant = _torque_constant(s, p)
    per_torque = 1.0 / p.assumed_torque_constant
    per_stribeck_velocity = 1.0 / p.stribeck_velocity
    per_speed = dt / p.presliding_angle
    damping = p.presliding_damping / p.presliding_angle
    mean = 1.0 / record_every
    encoders = asked_sum = current_sum = arm_sum = outside_sum = 0.0
    position_sum = model_sum = table_sum = signal_sum = 0.0
    square_current = 0.0
    strokes = piece = counted = 0
    model_current = table_current = signal_current = 0.0
    tabled = closed_loop and table[0].shape[0] > 0
    signalled = closed_loop and signal.shape[0] > 0
    step = first % max(signal.shape[0], 1)
    angle, speed, bristle = s.angle, s.speed, s.bristle
    current, ripple = s.current, s.ripple
    grasper_angle, grasper_speed = s.grasper_angle, s.grasper_speed
    setpoint = angle
    done = n
    for k in range(n):
        # Set point
        time = (first + k + 0.5) * dt
        while piece + 1 < pieces.shape[0] and time >= pieces[piece + 1, BEGIN]:
            piece += 1
        since = time - pieces[piece, BEGIN]
        sine, cosine = 0.0, 1.0
        if pieces[piece, OMEGA] != 0.0:
            phase = pieces[piece, OMEGA] * since
            sine, cosine = math.sin(phase), math.cos(phase)
        wanted, wanted_speed, acceleration = _follow(pieces[piece], since, sine, cosine)
        encoder = np.floor((angle - dt / 2.0 * speed) * per_count)
        # Controller
        if closed_loop:
            setpoint = wanted + origin
            model_current = _model_torque(model, wanted_speed, acceleration) * per_torque
            if tabled:
                table_current = per_torque * _table_torque(
                    table[0], table[1], table[2], setpoint, wanted_speed
                )
            if signalled:
                signal_current = signal[step] * per_torque
                step += 1
                if step == signal.shape[0]:
                    step = 0
            u = setpoint - encoder * count
            for j in range(sections.shape[0]):
                y = sections[j, 0] * u + section_state[j, 0]
                section_state[j, 0] = sections[j, 1] * u - sections[j, 4] * y + section_state[j, 1]
                section_state[j, 1] = sections[j, 2] * u - sections[j, 5] * y
                u = y
            asked = u * per_torque + (model_current + table_current + signal_current)
        else:
            asked = wanted
        asked = min(max(asked, -p.current_limit), p.current_limit)
        # Amplifier
        target = p.gain * asked + p.offset
        if p.distortion > 0.0:
            target += p.distortion * math.sin(2.0 * math.pi * target / p.distortion_period)
        mean_current = target + p.current_kept * (current - target)
        current += p.current_step * (target - current)
        square_current += mean_current * mean_current
        # Functions of the rotor's angle
        cell, part = _cell(angle, map_size)
        low, high = rotor_map[cell], rotor_map[cell + 1]
        offset_ripple = low[0] + part * (high[0] - low[0])
        gain_ripple = low[1] + part * (high[1] - low[1])
        saturation_ripple = low[2] + part * (high[2] - low[2])
        cogging = low[3] + part * (high[3] - low[3])
        modulation = low[4] + part * (high[4] - low[4])
        raw = offset_ripple + mean_current * (gain_ripple + abs(mean_current) * saturation_ripple)
        mean_ripple = ripple + p.ripple_step * (raw - ripple) / 2.0
        ripple += p.ripple_step * (raw - ripple)
        # Bearings; `drag` is all that opposes the speed in proportion
        kept = 1.0 / (1.0 + abs(speed) * per_speed)
        bristling = damping * (1.0 - bristle * math.copysign(1.0, speed)) * kept
        bristle = (bristle + speed * per_speed) * kept
        level = p.coulomb
        ratio = speed * per_stribeck_velocity
        if abs(ratio) < 5.0:
            level += (p.static - p.coulomb) * math.exp(-ratio * ratio)
        drag = level * bristling + p.viscous * (1.0 + modulation)
        friction = level * (1.0 + p.asymmetry * bristle) * bristle + s.friction_noise * bristle
        torque = torque_constant * (mean_current + mean_ripple) + cogging - friction
        if touch is None or instrument:
            torque -= p.load_torque
        spring = 0.0
        if clamped:
            spring = p.arm_stiffness * (angle - p.clamp_angle)
            torque -= spring
            drag += p.arm_damping
        if instrument:
            drag += p.housing_viscous
        torque -= drag * speed
        yielding = mobility(p.inertia, drag, dt)
        if instrument:
            # Tendon, grasper and the friction on both sides of the tendon
            twist = p.stiffness * (angle / p.angle_ratio - grasper_angle) + p.damping * (
                speed / p.angle_ratio - grasper_speed
            )
            sine, cosine = math.sin(grasper_angle), math.cos(grasper_angle)
            cell, part = _cell(grasper_angle, map_size)
            shape = friction_map[cell] + part * (friction_map[cell + 1] - friction_map[cell])
            s.housing_bristle = _bristle(s.housing_bristle, speed, dt / p.housing_presliding_angle)
            z = s.housing_bristle
            if z * s.direction < -0.5:
                s.direction = -s.direction
                _stroke(s, p, stroke_normals, strokes)
                strokes += 1
            carried = math.sqrt(twist * twist + p.load_friction_onset**2) - p.load_friction_onset
            level = (
                p.housing_friction * shape * (1.0 + p.housing_asymmetry * z)
                + p.load_friction * (1.0 + s.stroke_load) * carried / p.torque_factor
                + s.stroke_sine * sine
                + s.stroke_cosine * cosine
                + s.drift
            )
            torque -= level * z
            s.tip_bristle = _bristle(s.tip_bristle, grasper_speed, dt / p.tip_presliding_angle)
            tip = p.tip_friction * s.tip_bristle
            if touch is None:
                s.contact = 0.0
            held = p.load_moment * sine + tip + s.contact
            carried = (
                p.tendon_angle * (angle / p.angle_ratio - grasper_angle)
                + p.tendon_speed * (speed / p.angle_ratio - grasper_speed)
                + p.tendon_share * (torque * yielding / p.angle_ratio + held / p.grasper_inertia)
            )
            torque -= carried / p.torque_factor
            if touch is None:
                grasper_speed += dt * (carried - tip - p.load_moment * sine) / p.grasper_inertia
            else:
                grasper_speed, outside, s.contact = touched(
                    p,
                    touch[k],
                    tissues,
                    time,
                    grasper_angle,
                    grasper_speed,
                    sine,
                    carried - tip,
                    p.load_moment * sine,
                    p.grasper_inertia,
                )
                outside_sum += outside
            grasper_angle += dt * grasper_speed
        # Motion
        before = speed
        if touch is None or instrument:
            speed += dt * yielding * torque
        else:
            speed, outside, _ = touched(
                p, touch[k], tissues, time, angle, speed, 1.0, torque, p.load_torque, 1.0 / yielding
            )
            outside_sum += outside
        angle += dt * speed
        # Record and keep the slow clock
        encoders += encoder
        asked_sum += asked
        current_sum += mean_current
        if closed_loop:
            position_sum += setpoint
            model_sum += model_current
            table_sum += table_current
            signal_sum += signal_current
        if clamped:
            arm_sum += spring + p.arm_damping * (before + speed) / 2.0
        counted += 1
        if counted == record_every:
            counted = 0
            row = out[k // record_every]
            row[ENCODER] = encoders * mean
            row[CURRENT_SETPOINT] = asked_sum * mean
            row[CURRENT] = current_sum * mean
            row[ARM_TORQUE] = arm_sum * mean
            row[TEMPERATURE] = s.housing_degc
            row[POSITION_SETPOINT] = position_sum * mean if closed_loop else start
            row[FEEDFORWARD_CURRENT] = model_sum * mean
            row[TABLE_CURRENT] = table_sum * mean
            row[SIGNAL_CURRENT] = signal_sum * mean
            row[REFERENCE_TORQUE] = outside_sum * mean
            encoders = asked_sum = current_sum = arm_sum = outside_sum = 0.0
            position_sum = model_sum = table_sum = signal_sum = 0.0
        if (k + 1) % SLOW_STEP_SAMPLES == 0:
            _tick(s, p, square_current / SLOW_STEP_SAMPLES, normals, k // SLOW_STEP_SAMPLES)
            square_current = 0.0
            torque_constant = _torque_constant(s, p)
        if stop_angle > 0.0 and abs(angle - start) > stop_angle:
            done = k + 1
            break
    s.angle, s.speed, s.bristle = angle, speed, bristle
    s.current, s.ripple = current, ripple
    s.grasper_angle, s.grasper_speed = grasper_angle, grasper_speed
    s.setpoint = setpoint
    return done
