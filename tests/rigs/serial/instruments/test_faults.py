"""Every instrument on a bad line: complete and correct readings, or a clear end; no wrong number.

None of the protocols has a checksum. A damaged reading is known by its form or because it stands
alone; what is less than `SPIKE_RATIO` times the usual difference of readings may pass, and is the
bound of what is asserted here.
"""

import re
import time
from dataclasses import replace

import numpy as np
import pytest

from rigtool.errors import HardwareError
from rigtool.recipe.serial import MeasuringInstrument
from rigtool.rigs import Load, Task
from rigtool.rigs.motion import CurrentSteps
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.instruments import gauge, open_gauge
from rigtool.rigs.serial.instruments.gauge import SPIKE_RATIO
from tests.rigs.serial import toy
from tests.rigs.serial.emulators import instruments as emulators
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.hosted.test_hosted import toy_rig
from tests.rigs.serial.instruments.test_runs import Loaded
from tests.thorough import first_of

NOISE = 0.004
"""Half the width of what readings scatter by, in the unit shown."""

BOUND = 3 * SPIKE_RATIO * NOISE
"""Two uniformly scattered readings differ by 2/3 of NOISE in the median, at most by twice it."""

DEVICES = {
    "mark10": ("force", emulators.Mark10Emulator, {"unit": "N"}, 1.0),
    "sauter": ("force", emulators.SauterEmulator, {}, -1.0),
    "mecmesin": ("force", emulators.MecmesinEmulator, {"unit": "N"}, 1.0),
    "kern": ("force", emulators.KernEmulator, {"unit": "N"}, 1.0),
    "scpi": ("temperature", emulators.ScpiEmulator, {"unit": "C"}, 1.0),
    "number-lines": ("temperature", emulators.NumberLinesEmulator, {"unit": "C"}, 1.0),
}
SILENT = Operator(ask=lambda question: "", say=lambda text: None, present=True)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Waits of a tenth, so that a fault costs a test no second."""
    module = "rigtool.rigs.serial.instruments."
    monkeypatch.setattr(f"{module}readings.Polled.timeout", 0.05)
    monkeypatch.setattr(f"{module}scpi.READING_TIMEOUT", 0.05)
    monkeypatch.setattr(f"{module}scpi.ANSWER_TIMEOUT", 0.05)
    monkeypatch.setattr(f"{module}kern.Kern.pause", 0.0)
    monkeypatch.setattr(f"{module}number_lines.NUMBER_TIMEOUT", 0.05)


class Shown:
    """What a device shows: a drift and noise, with all that it has shown."""

    def __init__(self, seed):
        self.random = np.random.default_rng(seed)
        self.start = time.monotonic()
        self.log = []

    def __call__(self):
        now = time.monotonic()
        value = 5 + 0.05 * (now - self.start) + self.random.uniform(-NOISE, NOISE)
        self.log.append((now, value))
        return value

    def worst(self, moments, values, reach):
        """Return how far values are from all that was shown within `reach` s before them."""
        times, shown = np.array(self.log).T
        worst = 0.0
        for moment, value in zip(moments, values, strict=True):
            near = shown[(times > moment - reach) & (times <= moment + 0.01)]
            assert near.size
            worst = max(worst, float(np.abs(near - value).min()))
        return worst


def opened(driver, port):
    return open_gauge(DEVICES[driver][0], MeasuringInstrument(driver=driver, port=port), SILENT)


def bad_line(seed, first=25, every=5, count=14):
    """Return faults of all kinds, one in `every` writes, some of them of questions."""
    random = np.random.default_rng(seed)
    return tuple(
        Fault(
            str(random.choice(["flip", "lose", "double", "cut", "late"])),
            at=first + every * number + int(random.integers(0, 2)),
            byte=int(random.integers(0, 20)),
            seed=int(random.integers(0, 1000)),
            towards="device" if random.random() < 0.25 else "host",
        )
        for number in range(count)
    )


@pytest.mark.parametrize("seed", first_of(range(3)))
@pytest.mark.parametrize("driver", DEVICES)
def test_no_wrong_number_from_a_line_that_damages_readings(driver, seed):
    _, make, settings, sign = DEVICES[driver]
    shown = Shown(seed)
    device = make(shown, **settings)
    with serve(device, *bad_line(seed)) as server, opened(driver, server.port) as instrument:
        clock = instrument._line
        begin = clock.now()
        instrument.begin(begin)
        values, moments = [], []
        while clock.now() < begin + 1.2:
            time.sleep(0.05)
            moments.append(np.linspace(clock.now() - 0.04, clock.now(), 20))
            values.append(instrument.at(moments[-1]))
            assert instrument.problem() is None
        facts = instrument.report()
    assert server.error is None
    at, got = np.concatenate(moments), sign * np.concatenate(values)
    assert np.isfinite(got).all()
    assert facts["missing_samples"] == 0
    assert shown.worst(at + clock.opened, got, 0.3) < BOUND
    found = facts["retries"] + facts["discarded_lines"] + facts["spikes"]
    assert found >= 3  # of 14: some hurt nobody, such as a doubled end of line


@pytest.mark.parametrize("driver", [name for name in DEVICES if name != "number-lines"])
def test_answer_to_an_older_question_is_not_taken_for_a_new_one(driver):
    """Of two answers that come together after a repeated question the later one counts."""
    start = time.monotonic()
    _, make, settings, sign = DEVICES[driver]
    device = make(lambda: 10 * (time.monotonic() - start), **settings)
    faults = [Fault("late", at=at) for at in range(20, 60, 8)]
    with serve(device, *faults) as server, opened(driver, server.port) as instrument:
        clock = instrument._line
        instrument.begin(clock.now())
        time.sleep(0.8)
        instrument.at(np.array([clock.now()]))
        times, values = np.array(instrument._times), np.array(instrument._values)
        facts = instrument.report()
    assert facts["retries"] >= len(faults)
    age = times + clock.opened - start - sign * values / 10
    assert age.max() < 0.04  # a timeout of 0.05 s lies before the repeated question
    assert age.min() > -2e-4


def test_units_are_asked_until_two_answers_agree():
    """`mN` that lost its first letter is a unit as well, and so is K in place of C."""
    device = emulators.MecmesinEmulator(lambda: 2500.0, unit="mN")
    with (
        serve(device, Fault("lose", at=0, byte=0)) as server,
        opened("mecmesin", server.port) as instrument,
    ):
        assert "in mN" in instrument.report()["identity"]
        assert set(instrument._values) == {2.5}
    assert b"b" not in device.asked
    device = emulators.ScpiEmulator(lambda: 21.0, unit="C")
    flipped = Fault("flip", at=4, byte=0, seed=bit_of_seed(3))  # the first answer to UNIT:TEMP?
    with serve(device, flipped) as server, opened("scpi", server.port) as instrument:
        assert set(instrument._values) == {21.0}
    assert device.asked[:7].count(b"UNIT:TEMP?") == 3


def bit_of_seed(bit):
    """Return a seed by which a flip hits this bit."""
    return next(
        seed for seed in range(100) if np.random.default_rng(seed).integers(0, 8, 1)[0] == bit
    )


def test_gauge_that_answers_differently_each_time_is_refused():
    device = emulators.MecmesinEmulator(lambda: 1.0, unit="mN")
    faults = [Fault("lose", at=at, byte=0) for at in range(0, 8, 2)]
    with (
        serve(device, *faults) as server,
        pytest.raises(HardwareError, match=r"b'U' is answered differently each time, last 'm?N'"),
    ):
        opened("mecmesin", server.port).__enter__()


def test_damaged_digit_of_a_slow_thermometer_is_never_used():
    """It is known once the next reading has come: until then the one before it holds."""
    sent, got = [], []
    device = emulators.NumberLinesEmulator(lambda: sent.append(24.5) or 24.5, unit="C", decimals=1)
    wrong = [Fault("flip", at=at, byte=0, seed=bit_of_seed(2)) for at in (41, 44)]  # 64.5
    with serve(device, *wrong) as server, opened("number-lines", server.port) as instrument:
        while len(sent) < 40:
            time.sleep(0.001)
        device.period = 0.7  # none comes within the time in which the next is waited for
        clock = instrument._line
        instrument.begin(clock.now())
        while len(sent) < 47:
            got.append(instrument.at(np.array([clock.now() - 0.1, clock.now()])))
        read, spikes = list(instrument._values), instrument.report()["spikes"]
    assert read.count(64.5) == spikes == 2
    assert set(np.concatenate(got).tolist()) == {24.5}


# -- beside a drive

LOST = {
    "pull": ("the line is lost", dict.fromkeys(DEVICES, True)),
    "silence": ("no valid re(ply|ading)", dict.fromkeys(DEVICES, True)),
    "reset": ("", {}),
    "refuse": ("refuses", {"mark10": True}),  # the others are asked again
}


@pytest.mark.parametrize("kind", LOST)
@pytest.mark.parametrize("driver", DEVICES)
def test_a_run_is_complete_and_right_or_stops_and_says_why(driver, kind, monkeypatch):
    monkeypatch.setattr(gauge, "MAX_SILENCE", 0.3)
    message, ends = LOST[kind]
    channel, make, settings, sign = DEVICES[driver]
    drive = toy.ToyEmulator()
    drive.motor = Loaded()
    shown = Shown(1)
    got, error = [], None
    with serve(drive) as server, serve(make(shown, **settings), Fault(kind, at=25)) as beside:
        more = (f"serial.{channel}.driver={driver}", f'serial.{channel}.port="{beside.port}"')
        operator = replace(SILENT, yes=True)
        rig = toy_rig(server.port, "serial.watchdog=2", *more, operator=operator)
        try:
            with rig:
                got.extend(
                    rig.perform(Task(CurrentSteps((0.0, 0.3), 0.3), load=Load(clamped=True)))
                )
        except HardwareError as failure:
            error = str(failure)
        assert drive.mode is None
        assert drive.limit == 20.0
    values = sign * np.concatenate([block[channel] for block in got])
    kept = values[np.isfinite(values)]
    assert np.abs(kept - 5).max() < BOUND + 0.2  # the drift of the run and what passes
    if ends.get(driver):
        assert re.search(message, error)
        assert f"serial.{channel} ({driver} on " in error
    else:
        assert error is None
        assert len(values) == 150
        assert np.isfinite(values).all()
