"""How well torque on the output can be known at all: an estimator that knows the rig.

    .venv/bin/python benchmarks/oracle.py [--seeds 5] [--jobs 2] [--rig thesis] [--duration 120]

The filter of `rigtool.experiments.force_filter` with every parameter of the virtual rig, and
none of its random draws; what a product learns can come close to it, hardly beyond. Contacts are
drawn pulses of 0.05 to 2.5 N, or of all kinds. Errors are those of torque after a low-pass:
Butterworth of second order, on both sides of the comparison, zero-phase where smoothed. States are
those of the set point: moving (the housing's bristle is bent to nine tenths), after a reversal, at
rest. `cover` is the share of errors within 1.96 of the filter's own standard deviations, `half` the
mean of these; `q95` the 95 % quantile of errors. mN m throughout.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt, sosfiltfilt

from rigtool.experiments.force_filter.estimate import Filter, Signals
from rigtool.experiments.force_filter.kalman import Uncertainty
from rigtool.experiments.force_filter.plant import Plant
from rigtool.experiments.force_filter.smoothed import smoothed
from rigtool.recipe import Recipe, load_recipe
from rigtool.recipe.commands import ForceMotion
from rigtool.recipe.virtual import Hand, Mass, Pulse, Ramp, Sine, Tissue
from rigtool.rigs import Feedforward, Task, open_rig
from rigtool.rigs.motion import Motion, Triangle
from rigtool.rigs.virtual import hand
from rigtool.rigs.virtual.layout import SLOW_STEP_SAMPLES
from rigtool.rigs.virtual.maps import MAP_SIZE, friction_map, rotor_map

Array = NDArray[np.float64]

RECIPE = Path(__file__).parents[1] / "recipes" / "briaire-2006.toml"
RIGS = {
    "thesis": (),
    "half-stiffness": ("virtual.instrument.stiffness=0.1",),
    "twice-stiffness": ("virtual.instrument.stiffness=0.4",),
    "thrice-load-friction": ("virtual.instrument.load_friction=0.306",),
    "15 K warmer": ("virtual.thermal.ambient_degc=42",),
}
MOTIONS = ("strokes", "free")
CONTACTS = {
    "pulses": (Pulse(kind="pulse", rate_per_min=14, duration=(0.3, 3.0), force=(0.05, 2.5)),),
    "weak": (
        Pulse(kind="pulse", rate_per_min=10, duration=(0.3, 3.0), force=(0.03, 0.6)),
        Ramp(kind="ramp", rate_per_min=6, duration=(0.5, 4.0), force=(0.03, 0.6)),
    ),
    "mixed": (
        Pulse(kind="pulse", rate_per_min=3, duration=(0.3, 3.0), force=(-1.0, 1.5)),
        Ramp(kind="ramp", rate_per_min=3, duration=(0.5, 4.0), force=(0.1, 1.5)),
        Mass(kind="mass", rate_per_min=2, duration=(1.0, 6.0), force=(0.1, 1.0), rise_time=0.2),
        Sine(
            kind="sine",
            rate_per_min=4,
            duration=(1.0, 5.0),
            force=(0.1, 1.0),
            frequency_hz=(0.5, 10.0),
        ),
        Tissue(
            kind="tissue",
            rate_per_min=6,
            duration=(2.0, 8.0),
            angle_deg=100.0,
            stiffness=(0.01, 0.06),
            damping=2e-4,
        ),
    ),
}
STEP, AVERAGED = 8, 2
"""Samples in a step of the filter: 1 ms, and in one of its samples: angles belong to the middle."""
BANDS = (5.0, 10.0)
"""Bandwidths, Hz: amplitudes are right up to them, and the low-pass has its corner above."""
MARGIN = 2.0
"""Left out at both ends of a recording, s."""
LOADED = 4e-3
"""Torque from which on a sample counts as loaded, N m."""


# -- recordings


@dataclass(frozen=True)
class Recorded:
    """A recording at every sample of the loop: signals, and the truth to compare with."""

    recipe: Recipe
    channels: dict[str, Array]

    @property
    def truth(self) -> Array:
        """What truly acted at the end of each step, (m,) N m."""
        torque = self.channels["reference_torque"]
        size = (torque.size // AVERAGED - 1) // (STEP // AVERAGED)
        return torque[STEP - 1 :: STEP][:size]


def record(
    rig: str,
    seed: int,
    motion: str,
    duration: float = 120.0,
    contacts: str = "pulses",
    power_cycle: int = 0,
) -> Recorded:
    """Move a virtual rig for about `duration` s while contacts touch it."""
    drawn = (f"virtual.seed={seed}", f"virtual.power_cycle={power_cycle}")
    recipe, _ = load_recipe(RECIPE, [*RIGS[rig], *drawn])
    assert recipe.virtual is not None
    virtual = recipe.virtual.model_copy(update={"contact": CONTACTS[contacts]})
    recipe = recipe.model_copy(update={"virtual": virtual})
    task = Task(
        _motion(recipe, motion, duration, seed),
        Feedforward(inertia=recipe.rig.nominal_inertia),
        touched=True,
    )
    blocks = list(open_rig(recipe, recipe.rig.torque_constant, f"oracle {motion}").perform(task))
    names = (
        "encoder",
        "current_setpoint",
        "position_setpoint",
        "reference_torque",
        "temperature",
    )
    return Recorded(recipe, {n: np.concatenate([block[n] for block in blocks]) for n in names})


def _motion(recipe: Recipe, motion: str, duration: float, seed: int) -> Motion:
    settings, ratio = recipe.measure_force, recipe.rig.angle_ratio
    if motion == "free":
        return hand.draw(Hand(), ratio, duration, np.random.default_rng([seed, 0xF4EE]))
    strokes = Triangle(
        low=0.0,
        high=math.radians(settings.angle) * ratio,
        speed=2 * math.pi * settings.speed_rev_per_s * ratio,
        turn_angle=math.radians(settings.turn_angle) * ratio,
        cycles=1,
    )
    cycles = max(1, round(duration / strokes.duration))
    return Triangle(strokes.low, strokes.high, strokes.speed, strokes.turn_angle, cycles)


# -- what the oracle knows


def plant_of(recipe: Recipe) -> Plant:
    """Return the parameters of the virtual rig as the filter takes them."""
    virtual, rig = recipe.virtual, recipe.rig
    assert virtual is not None
    motor, instrument = virtual.motor, virtual.instrument
    return Plant(
        sample_time=AVERAGED * rig.sample_time,
        inertia=motor.inertia + instrument.wheel_inertia,
        coulomb=motor.coulomb_friction,
        static=motor.static_friction,
        stribeck_velocity=motor.stribeck_velocity,
        asymmetry=motor.friction_asymmetry,
        presliding_angle=motor.presliding_angle,
        presliding_damping=motor.presliding_damping,
        angle_ratio=rig.instrument.angle_ratio,
        torque_factor=rig.instrument.torque_factor,
        stiffness=instrument.stiffness,
        damping=instrument.damping,
        grasper_inertia=instrument.grasper_inertia,
        housing_friction=instrument.friction,
        housing_asymmetry=instrument.friction_asymmetry,
        housing_viscous=instrument.viscous_friction,
        housing_presliding_angle=instrument.presliding_angle,
        tip_friction=instrument.tip_friction,
        tip_presliding_angle=instrument.tip_presliding_angle,
        load_friction=instrument.load_friction,
        load_friction_onset=instrument.load_friction_onset,
        friction_map=np.stack([friction_map(virtual), np.zeros(MAP_SIZE + 1)], axis=1),
    )


def uncertainty_of(recipe: Recipe) -> Uncertainty:
    """Return how far the virtual rig's draws go."""
    assert recipe.virtual is not None
    motor, instrument = recipe.virtual.motor, recipe.virtual.instrument
    return Uncertainty(
        stroke=instrument.stroke_noise,
        load_stroke=instrument.load_stroke_noise,
        friction_noise=motor.friction_noise,
        friction_noise_time=motor.friction_noise_time,
    )


def signals_of(recorded: Recorded) -> Signals:
    """Return the drive torque by the rig's own equations: amplifier, ripple, heat, cogging."""
    recipe = recorded.recipe
    virtual, rig = recipe.virtual, recipe.rig
    assert virtual is not None
    motor, amplifier, thermal = virtual.motor, virtual.amplifier, virtual.thermal
    width = 2 * math.pi / rig.encoder_counts
    low = recorded.channels["encoder"] * width
    per_angle = rotor_map(virtual, amplifier, virtual.power_cycle)
    size = len(per_angle) - 1
    place = np.mod((low + width / 2) * (size / (2 * math.pi)), size)
    columns = [np.interp(place, np.arange(size + 1), column) for column in per_angle.T]
    offset, gain, saturation, cogging, modulation = columns
    lag = 2 * math.pi * amplifier.bandwidth_hz * rig.sample_time
    torque = _drive_torque(
        recorded.channels["current_setpoint"],
        np.stack([offset, gain, saturation]),
        rig.sample_time,
        np.array(
            [
                amplifier.gain,
                amplifier.offset,
                -math.expm1(-lag),
                -math.expm1(-lag) / lag,
                1 - math.exp(-2 * math.pi * amplifier.ripple_corner_hz * rig.sample_time),
                motor.torque_constant,
                motor.torque_constant_temperature_coefficient,
            ]
        ),
        np.array(
            [
                thermal.ambient_degc,
                thermal.winding_resistance,
                thermal.winding_to_housing,
                thermal.winding_capacity,
                thermal.housing_to_ambient,
                thermal.housing_capacity,
            ]
        ),
    )
    size = len(low) // AVERAGED
    torque, viscous = (
        signal[: size * AVERAGED].reshape(size, AVERAGED).mean(axis=1)
        for signal in (torque + cogging, motor.viscous_friction * (1 + modulation))
    )
    return Signals(torque, viscous, low[AVERAGED // 2 : size * AVERAGED : AVERAGED], width)


@njit(cache=True)
def _drive_torque(asked: Array, ripples: Array, dt: float, drive: Array, thermal: Array) -> Array:
    """Return the motor's torque (n,) [N m] for the current asked for (n,) [A]."""
    gain, offset, current_step, current_kept, ripple_step, constant, coefficient = drive
    ambient, resistance, to_housing, winding_capacity, to_ambient, housing_capacity = thermal
    torque = np.empty(asked.size)
    current = ripple = square = 0.0
    winding = housing = ambient
    warm = 1.0 + coefficient * (winding - 20.0)
    for k in range(asked.size):
        target = gain * asked[k] + offset
        mean = target + current_kept * (current - target)
        current += current_step * (target - current)
        square += mean * mean
        by_current = ripples[1, k] + abs(mean) * ripples[2, k]
        change = ripple_step * (ripples[0, k] + mean * by_current - ripple)
        torque[k] = constant * warm * (mean + ripple + change / 2)
        ripple += change
        if (k + 1) % SLOW_STEP_SAMPLES == 0:
            flow = (winding - housing) / to_housing
            power = resistance * (1.0 + 0.00393 * (winding - 20.0)) * square / SLOW_STEP_SAMPLES
            winding += SLOW_STEP_SAMPLES * dt * (power - flow) / winding_capacity
            housing += (
                SLOW_STEP_SAMPLES
                * dt
                * (flow - (housing - ambient) / to_ambient)
                / housing_capacity
            )
            warm = 1.0 + coefficient * (winding - 20.0)
            square = 0.0
    return torque


def estimates(recorded: Recorded, band_hz: float) -> dict[str, tuple[Array, Array]]:
    """Return torque behind a low-pass and its standard deviation, (m,) N m each, causal and
    smoothed."""
    plant, uncertainty = plant_of(recorded.recipe), uncertainty_of(recorded.recipe)
    signals = signals_of(recorded)
    return both_forms(plant, uncertainty, signals, band_hz)


def both_forms(
    plant: Plant, uncertainty: Uncertainty, signals: Signals, band_hz: float
) -> dict[str, tuple[Array, Array]]:
    """Return torque behind a low-pass and its standard deviation by causal and smoothed filter."""
    corner_hz = ForceMotion(bandwidth_hz=band_hz).corner_hz
    causal = Filter(plant, uncertainty, STEP // AVERAGED, corner_hz).add(signals)
    torque, deviation = smoothed(plant, uncertainty, STEP // AVERAGED, corner_hz, signals)
    rate = AVERAGED / (STEP * plant.sample_time)
    return {
        "causal": (causal.passed, causal.deviation),
        "smoothed": (lowpassed(torque, band_hz, rate, True), deviation),
    }


# -- how good


def motion_states(recorded: Recorded) -> dict[str, NDArray[np.bool_]]:
    """Return which steps are moving, after a reversal, at rest, with and without load, (m,)."""
    recipe = recorded.recipe
    assert recipe.virtual is not None
    setpoint = recorded.channels["position_setpoint"]
    bent = _bristle(setpoint, recipe.virtual.instrument.presliding_angle)
    speed = np.gradient(setpoint, recipe.rig.sample_time)
    count = recorded.truth.size
    bent, speed = (values[STEP - 1 :: STEP][:count] for values in (bent, speed))
    rest = np.abs(speed) < 1e-3
    moving = (np.abs(bent) > 0.9) & ~rest
    loaded = np.abs(recorded.truth) > LOADED
    used = np.zeros(count, dtype=bool)
    margin = round(MARGIN / (STEP * recipe.rig.sample_time))
    used[margin : count - margin] = True
    return {
        "all": used,
        "moving": used & moving,
        "moving, unloaded": used & moving & ~loaded,
        "moving, loaded": used & moving & loaded,
        "reversal": used & ~moving & ~rest,
        "rest": used & rest,
    }


@njit(cache=True)
def _bristle(path: Array, presliding_angle: float) -> Array:
    bent = np.zeros(path.size)
    for k in range(1, path.size):
        step = path[k] - path[k - 1]
        side = math.copysign(1.0, step)
        bent[k] = side - (side - bent[k - 1]) * math.exp(-abs(step) / presliding_angle)
    return bent


def lowpassed(torque: Array, band_hz: float, rate_hz: float, zero_phase: bool) -> Array:
    """Return a torque (m,) after the low-pass that a bandwidth stands for."""
    corner_hz = ForceMotion(bandwidth_hz=band_hz).corner_hz
    sections = butter(2, corner_hz, fs=rate_hz, output="sos")
    found: Array = (sosfiltfilt if zero_phase else sosfilt)(sections, torque)
    return found


@dataclass(frozen=True)
class Score:
    """Errors of one estimate in one state: sums, so that recordings can be put together."""

    count: int
    squares: float
    covered: int
    half_widths: float
    interval_scores: float
    errors: Array

    def __add__(self, other: Score) -> Score:
        """Put two recordings together."""
        return Score(
            self.count + other.count,
            self.squares + other.squares,
            self.covered + other.covered,
            self.half_widths + other.half_widths,
            self.interval_scores + other.interval_scores,
            np.concatenate([self.errors, other.errors]),
        )

    def __str__(self) -> str:
        if not self.count:
            return "-"
        rmse, half = math.sqrt(self.squares / self.count), self.half_widths / self.count
        quantile = float(np.quantile(self.errors, 0.95))
        share = 100 * self.covered / self.count
        return f"{1e3 * rmse:8.2f}{share:7.1f}{1e3 * half:7.2f}{1e3 * quantile:7.2f}"


Key = tuple[str, str, float, str]
"""Motion, causal or smoothed, bandwidth in Hz, state."""


def scores(recorded: Recorded, motion: str) -> Iterator[tuple[Key, Score]]:
    """Compare the oracle with what truly acted."""
    states = motion_states(recorded)
    for band in BANDS:
        for form, _, error, deviation in judged(recorded, band):
            for state, chosen in states.items():
                yield (motion, form, band, state), score(error[chosen], deviation[chosen])


def judged(recorded: Recorded, band: float) -> Iterator[tuple[str, Array, Array, Array]]:
    """Yield each form, and the oracle's torque in it, errors and standard deviations, (m,) N m."""
    rate = 1 / (STEP * recorded.recipe.rig.sample_time)
    for form, (torque, deviation) in estimates(recorded, band).items():
        truth = lowpassed(recorded.truth, band, rate, form == "smoothed")
        yield form, torque, np.abs(torque - truth), deviation


def score(error: Array, deviation: Array) -> Score:
    """Return the score of errors (n,) against stated standard deviations (n,), N m.

    That of 95 % intervals is of T. Gneiting, A. E. Raftery, J. Am. Stat. Assoc. 102(477) 2007,
    section 6.2: their width, and 2 / 0.05 of what an error is beyond.
    """
    half = 1.96 * deviation
    return Score(
        error.size,
        float(error @ error),
        int(np.count_nonzero(error <= half)),
        float(half.sum()),
        float(np.sum(2 * half + 2 / 0.05 * np.maximum(error - half, 0))),
        error[::10],
    )


def measured(rig: str, seed: int, duration: float, contacts: str) -> tuple[str, dict[Key, Score]]:
    """Return the scores of one rig and seed."""
    found: dict[Key, Score] = {}
    for motion in MOTIONS:
        found.update(scores(record(rig, seed, motion, duration, contacts), motion))
    return rig, found


def print_table(rig: str, found: dict[Key, Score]) -> None:
    """Print one rig's scores."""
    print(f"\n{rig:22}{'':24}{'rmse':>8}{'cover':>7}{'half':>7}{'q95':>7}")
    for (motion, form, band, state), one in sorted(found.items()):
        if one.count:
            print(f"  {motion:8} {form:9}{band:3.0f} Hz  {state:18} {one}", flush=True)


def main() -> None:
    """Measure every rig and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--rig", choices=RIGS, action="append")
    parser.add_argument("--duration", type=float, default=120.0)
    parser.add_argument("--contacts", choices=CONTACTS, default="pulses")
    arguments = parser.parse_args()
    work = [
        (rig, seed, arguments.duration, arguments.contacts)
        for rig in arguments.rig or RIGS
        for seed in range(1, arguments.seeds + 1)
    ]
    tables: dict[str, dict[Key, Score]] = {}
    begun = time.perf_counter()
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for rig, found in pool.map(measured, *zip(*work, strict=True)):
            table = tables.setdefault(rig, {})
            for key, one in found.items():
                table[key] = table[key] + one if key in table else one
    for rig, table in tables.items():
        print_table(rig, table)
    if len(tables) > 1:
        keys = next(iter(tables.values()))
        together = {key: sum_of([table[key] for table in tables.values()]) for key in keys}
        print_table("all rigs", together)
    print(f"\n{len(work)} recordings of each motion, {time.perf_counter() - begun:.0f} s")


def sum_of(parts: list[Score]) -> Score:
    """Put several scores together."""
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total


if __name__ == "__main__":
    main()
