"""A sensor's model for tests, signals that it explains, and the exported header as a C library."""

import ctypes
import math
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np

from rigtool.experiments.force_filter.kalman import Uncertainty
from rigtool.experiments.force_filter.motion_states import Reach
from rigtool.experiments.force_filter.plant import (
    ANGLE,
    NOISE,
    SPEED,
    STATES,
    TORQUE,
    Plant,
    advance,
    as_record,
)
from rigtool.experiments.force_model.drive import MotorMap
from rigtool.experiments.force_model.model import Kind, Term
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.experiments.force_sensor.sensor import Sensor, SensorProperties
from rigtool.numerics.compiled import compiled_allocating as machine_code
from tests.experiments.force_filter.plants import PLANT, UNCERTAINTY

HOST = Path(__file__).with_name("sensor_host.c")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
INTERVAL, COUNTS, CONSTANT = 125e-6, 4000, (0.046, -4e-5)
WIDTH = 2 * math.pi / COUNTS
WARM = 27.0
REACH = Reach((-1.2, 1.2), 20.0, 0.06, (20.0, 50.0), 0.5)
SCALES = np.stack([[1.0, 0.9, 1.2, 0.6, 0.45, 2.0], [0.0, 0.01, 0.02, 0.03, 0.0, 0.1]], axis=1)

TURN = np.linspace(0, 2 * math.pi, 513)
ROTOR = np.stack(
    [
        1e-4 + 3e-4 * np.cos(7 * TURN),
        5e-5 * np.sin(TURN),
        2e-3 * np.cos(2 * TURN),
        1e-4 * np.sin(3 * TURN),
        5e-5 * (1 + 0.1 * np.cos(TURN)),
    ],
    axis=1,
)


DRIVE = MotorMap(ROTOR, 0.05, 2e-3, 1e-4)
RIPPLE = {1: 5e-4, 2: 3e-4, 3: 1e-4, 4: 3e-5, 6: 2e-4, 7: 4e-4, 14: 5e-5}
GROWING = {(Kind.GAIN_RIPPLE, 2, 0): 4e-3, (Kind.SQUARE_RIPPLE, 3, 1): 6e-3}
LEARNED = SimpleNamespace(
    terms=[Term(Kind.RIPPLE, 1e-3, order, order % 2) for order in RIPPLE]
    + [Term(kind, 1e-3, *key) for kind, *key in GROWING],
    coefficient=np.array([*RIPPLE.values(), *GROWING.values()]),
    covariance=1e-8 * np.eye(len(SLIDING_PARAMETERS) + len(RIPPLE) + len(GROWING)),
    shape=SimpleNamespace(ripple_time=0.05),
    known=SimpleNamespace(angle_ratio=0.85),
)
"""Of the terms, those of the ripple that a power-up draws."""


@dataclass(frozen=True)
class Model:
    """What a sensor takes of a learned model."""

    drive: MotorMap = DRIVE
    scales: ClassVar = np.stack([SCALES, SCALES])
    learned: ClassVar = LEARNED
    rest_variance: ClassVar = 1e-8
    uncertainty: Uncertainty = UNCERTAINTY

    def plant(self, sample_time: float) -> Plant:
        return replace(PLANT, sample_time=sample_time)


def instrument(**changed):
    """Return the instrument of these tests, with some of its properties changed."""
    own = SensorProperties(Model(), REACH, INTERVAL, INTERVAL, WIDTH, CONSTANT, 2.0, 10.0)
    return replace(own, **changed)


def moved(wanted, contact, seed=1):
    """Return samples (3, n) of encoder, current and temperature: the plant of the tests follows an
    angle rad, and feels a torque N m, (n,) each."""
    plant, dt = Model().plant(INTERVAL), INTERVAL
    rng = np.random.default_rng(seed)
    kept = math.exp(-dt / UNCERTAINTY.friction_noise_time)
    noise = UNCERTAINTY.friction_noise * math.sqrt(1 - kept**2) * rng.standard_normal(len(wanted))
    angle, torque = _followed(wanted, contact, noise, kept, as_record(plant)[0], plant.friction_map)
    cogging = np.interp(angle % (2 * math.pi), TURN, ROTOR[:, 0])
    current = (torque + cogging) / (CONSTANT[0] + CONSTANT[1] * WARM)
    return np.stack([np.floor(angle / WIDTH), current, np.full(len(wanted), WARM)])


@machine_code
def _followed(wanted, contact, noise, kept, record, friction_map):
    """Return the angle and the drive's torque at each sample."""
    x, integral = np.zeros(STATES), 0.0
    angle, torque = np.empty(len(wanted)), np.empty(len(wanted))
    for k in range(len(wanted)):
        angle[k] = x[ANGLE]
        error = wanted[k] - x[ANGLE]
        integral += error * record.sample_time
        torque[k] = 2.0 * error + 30.0 * integral - 8e-3 * x[SPEED]
        x[TORQUE] = contact[k]
        x[NOISE] = kept * x[NOISE] + noise[k]
        advance(x, record, friction_map, torque[k], 5e-5, None, 0, 0.0, 0.0)
    return angle, torque


def motions():
    """Return samples by the name of the motion: strokes and free motion with contacts, rest, and
    strokes with a force that swings."""
    time = np.arange(round(4.0 / INTERVAL)) * INTERVAL
    pulse = 0.04 * np.clip(np.minimum((time % 2 - 0.7) / 0.05, (1.3 - time % 2) / 0.05), 0, 1)
    sines = np.sin(3.1 * time) + 0.6 * np.sin(7.3 * time + 1) + 0.2 * np.sin(23.0 * time)
    free = 0.5 * sines * np.clip(np.abs((time % 3) - 1.5) / 0.3 - 1, 0, 1)
    wanted = {
        "strokes": np.abs(1.6 * time % 2 - 1) - 0.5,
        "free": free,
        "rest": np.full(len(time), 0.3),
        "creeping": 0.03 * time + 1.5e-3 * np.sin(2 * math.pi * 60 * time),
    }
    swinging = 0.02 * np.sin(2 * math.pi * 2 * time)
    return {name: moved(angle, pulse) for name, angle in wanted.items()} | {
        "swinging": moved(wanted["strokes"], swinging)
    }


def compiled(folder, text, *flags, name="sensor"):
    """Return a library of the exported header, strictly compiled; soon, without `-O` in `flags`."""
    (folder / "sensor.h").write_text(text)
    library = folder / f"{name}.so"
    build = ["cc", *STRICT, *flags, "-shared", "-fPIC", f"-I{folder}", HOST, "-o", library]
    subprocess.run([*build, "-lm"], check=True, timeout=120)
    return CSensor(library)


class CSensor:
    """The exported sensor; takes blocks of any length."""

    def __init__(self, path):
        self._library = ctypes.CDLL(str(path))
        self._library.sensor_begin()

    def gap(self):
        self._library.sensor_gap()

    def begin(self):
        self._library.sensor_begin()

    def add(self, samples):
        """Return readings (m, 5) that samples (3, n) complete: torque, u, low, high and state."""
        values = np.ascontiguousarray(np.asarray(samples, dtype=np.float64).T)
        readings = np.empty((len(values) + 1, 5))
        pointers = (array.ctypes.data_as(ctypes.c_void_p) for array in (values, readings))
        return readings[: self._library.sensor_run(len(values), *pointers)].copy()


def expected(own, samples, behind=None):
    """Return what the sensor in Python reads, as `CSensor.add` does, `behind` a gap other ones."""
    sensor = Sensor(own, context=False)
    if behind is not None:
        sensor.add(behind)
        sensor = Sensor(own, context=False, before=sensor.power_up)
    found = sensor.add(samples)
    torque, u = found.torque, found.u
    readings = np.stack([torque, u, torque - 1.96 * u, torque + 1.96 * u, found.states], axis=1)
    readings[found.states == 0, :4] = np.nan
    return readings
