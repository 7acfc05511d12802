"""`fft-ripple`: torque ripple against rotor position, speed, torque and power cycle [7.1.3].

The motor turns steadily, and the torque set point of its controller is averaged revolution by
revolution. Friction and load are its mean, which is subtracted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import zip_longest

import numpy as np

from rigtool.errors import InsufficientDataError, RunFileError
from rigtool.experiments.between_set_points import unsampled_note
from rigtool.experiments.controller_torque import require_stable_loop
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure, channels, only_run, record
from rigtool.experiments.ripple.distortion import (
    amplifier_distortion,
    distorted_orders,
    distortion_note,
)
from rigtool.experiments.ripple.imported import analyse_imported
from rigtool.experiments.ripple.orders import (
    HIGHEST_ORDER,
    LoopRipple,
    Ripple,
    compare,
)
from rigtool.experiments.ripple.procedure_shaking import shaken_note, shaken_orders, uneven_note
from rigtool.experiments.ripple.procedure_steady import (
    Collected,
    collected,
    first_and_last,
    steady_samples,
    temperature_at_turns,
)
from rigtool.experiments.ripple.results import (
    comparison_results,
    comparison_table,
    condition_tables,
    loop_note,
    revolutions_table,
    ripple_results,
    steps_note,
    varying_note,
)
from rigtool.experiments.ripple.varying_speed import friction_changes, slowest
from rigtool.experiments.ripple.winding_heat import Lowered, TurnCurrents, winding_heat
from rigtool.experiments.torque_constant.staircases.model import COPPER_COEFFICIENT
from rigtool.experiments.torque_per_ampere import (
    mean_constant,
    torque_per_ampere_at,
    with_constant,
)
from rigtool.numerics.arrays import Array
from rigtool.numerics.welch import Welch
from rigtool.quantity import REFERENCE_DEGC, Quantity, combined, error_line, inherited
from rigtool.recipe import Recipe
from rigtool.rigs import Load, Rig, Task
from rigtool.rigs.motion import SpeedProfile
from rigtool.runfile import Column, Recording, RecordingSpec, Run, RunWriter, Table

ACCELERATION = 30.0
"""During run-up and stop, rad/s2."""

SETTLE_TIME = 0.5
"""After the run-up, s."""

MAX_SEGMENT = 4096
"""Longest segment of Welch's method, samples."""

LARGEST_FALL = 0.5
"""Largest part of the torque constant that heat may take: ferrite loses a fifth in 100 K."""

# -- measuring


def recordings(recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """List the runs at constant speed, at constant torque, and after power cycles."""
    settings = recipe.fft_ripple
    slow = 2 * math.pi * settings.slow_speed_rev_per_s
    return (
        *(_spec(recipe, "speed", n, v, {}) for n, v in enumerate(settings.speeds)),
        *(
            _spec(recipe, "torque", n, slow, {"torque": (torque, "N m")})
            for n, torque in enumerate(settings.torques)
        ),
        *(
            _spec(recipe, "power_cycle", n, slow, {"power_cycle": (float(n), "1")})
            for n in range(settings.power_cycles)
        ),
    )


def _spec(
    recipe: Recipe, kind: str, number: int, speed: float, conditions: dict[str, tuple[float, str]]
) -> RecordingSpec:
    start = speed / ACCELERATION + SETTLE_TIME
    # Turns that are cut at the encoder's zero need up to one more.
    turns = recipe.fft_ripple.revolutions + 1.1
    return RecordingSpec(
        f"{kind}_{number:03d}",
        channels("time", "current_setpoint", "encoder", "temperature"),
        {
            "speed": (speed, "rad/s"),
            **conditions,
            "steady_from": (start, "s"),
            "steady_until": (start + turns * 2 * math.pi / speed, "s"),
        },
        recipe.fft_ripple.record_every,
    )


def measure(rig: Rig, recipe: Recipe, recorder: RunWriter, *, kt: Run) -> None:
    """Turn steadily under each condition; the amplifier is restarted between power cycles."""
    del kt  # part of the rig already
    require_stable_loop(recipe)
    for spec in recordings(recipe):
        conditions = {name: value for name, (value, _) in spec.conditions.items()}
        if conditions.get("power_cycle", 0) > 0:
            rig.power_cycle()
        speed, until = conditions["speed"], conditions["steady_until"]
        run_up = speed / ACCELERATION
        task = Task(
            SpeedProfile((0.0, run_up, until, until + run_up), (0.0, speed, speed, 0.0)),
            load=Load(torque=conditions.get("torque", 0.0)),
            record_every=spec.record_every,
        )
        record(rig, task, recorder, spec.name)


# -- analysing


def analyse(runs: Sequence[Run], recipe: Recipe, *, kt: Run) -> Outcome:
    """Separate the repeatable ripple from the rest, under each condition.

    Raises `UsageError` for more than one run, `RunFileError` for one without its recordings.
    """
    run = only_run(runs, "fft-ripple", "recordings")
    require_stable_loop(recipe)
    speeds = sorted(run.recordings_named("speed_"), key=lambda r: r.condition("speed"))
    if not speeds:
        raise RunFileError(
            f"{run.path}: has no recording speed_000: give the run file in which fft-ripple "
            "recorded its signals"
        )
    torques = sorted(run.recordings_named("torque_"), key=lambda r: r.condition("torque"))
    cycles = run.recordings_named("power_cycle_")
    recorded = [*speeds, *torques, *cycles]
    steady = [steady_samples(recording) for recording in recorded]
    # one length of Welch's segments for all speeds, for one frequency axis
    shortest = min(map(len, steady[: len(speeds)]))
    segment = min(MAX_SEGMENT, 2 ** int(math.log2(shortest / 2)))
    welches = [Welch(segment) for _ in speeds]
    found = [
        collected(recording, samples, recipe, welch)
        for recording, samples, welch in zip_longest(recorded, steady, welches)
    ]
    constants, per_amperes, heat_note = _constants(kt, recorded, found)
    held = [own.waveforms * k for own, k in zip(found, per_amperes, strict=True)]
    by_amplifier, distortion_notes = _distorted(kt, found, constants)
    by_shaking = shaken_orders(found, held)
    changes = _friction_changes(
        recorded,
        [float(torque.mean()) for torque in held],
        [slowest(own.durations) for own in found],
    )
    ripples = [
        LoopRipple(
            torque - torque.mean(), own.sampling, own.durations, own.steps, change, distorted
        )
        for own, torque, change, distorted in zip(
            found, held, changes, np.hypot(by_amplifier, by_shaking), strict=True
        )
    ]
    by_speed, by_torque = ripples[: len(speeds)], ripples[len(speeds) :][: len(torques)]
    by_cycle = ripples[len(speeds) + len(torques) :]
    comparisons = [compare(by_cycle[0], other, HIGHEST_ORDER) for other in by_cycle[1:]]
    known = dict(zip((recording.name for recording in recorded), constants, strict=True))
    tables = {
        **condition_tables("speed", "speed", "rad/s", speeds, by_speed, known, recipe),
        "speed_psd": _psd_table(speeds, steady[: len(speeds)], welches, segment, known),
        "revolutions": revolutions_table((by_cycle or by_speed)[0]),
    }
    if torques:
        tables |= condition_tables("torque", "torque", "N m", torques, by_torque, known, recipe)
    if cycles:
        tables |= condition_tables("power", "power_cycle", "1", cycles, by_cycle, known, recipe)
    if comparisons:
        tables["power_comparison"] = comparison_table(comparisons)
    results = {**ripple_results(by_speed), **comparison_results(comparisons)}
    for name in ("repeatable_rms", "non_repeatable_rms"):
        results[name] = with_constant(results[name], constants[0])
    notes = [
        heat_note,
        loop_note(recipe, speeds[-1].condition("speed") / (2 * math.pi)),
        *uneven_note(recorded, recipe),
        *varying_note(recorded, ripples),
        *distortion_notes,
        *shaken_note(torques, found[len(speeds) :]),
        *steps_note(recorded, recipe),
        *_resolution_notes(speeds, by_speed, "speed", "rad/s"),
        *_resolution_notes(torques, by_torque, "torque", "N m"),
        *unsampled_note(runs, constants[0].value),
    ]
    if not comparisons:
        notes.append("fewer than two power cycles: nothing to compare")
    return Outcome(results, tables, tuple(notes))


def _distorted(
    kt: Run, found: Sequence[Collected], constants: Sequence[Quantity]
) -> tuple[list[Array], list[str]]:
    """Return `LoopRipple.distorted` of each recording, by the levels of the calibration, and a
    note where they show that the amplifier is not linear."""
    if "linearity" not in kt.tables:
        return [np.zeros(HIGHEST_ORDER)] * len(found), []
    columns = kt.tables["linearity"].columns
    distortion = amplifier_distortion(
        columns["current_setpoint"].values,
        columns["deviation"].values,
        kt.results["amplifier_linearity"].u or 0.0,
    )
    orders = [
        constant.value * distorted_orders(own.waveforms, distortion, HIGHEST_ORDER, own.sampling)
        for own, constant in zip(found, constants, strict=True)
    ]
    ripple = np.array([own.waveforms.mean(axis=0).std() for own in found])
    return orders, distortion_note(distortion, ripple)


def _friction_changes(
    recorded: Sequence[Recording], torque: Sequence[float], lowest: Sequence[float]
) -> list[float]:
    """Return the `friction_changes` of each recording by its mean torque, N m, and the `lowest`
    speed around its turn, over the mean."""
    friction: dict[float, float] = {}
    for recording, mean in zip(recorded, torque, strict=True):
        constant = recording.condition("torque") if "torque" in recording.conditions else 0.0
        speed = recording.condition("speed")
        # A constant torque is known to some per cent of it: without one, friction is known better.
        if speed not in friction or not constant:
            friction[speed] = mean - constant
    speeds = sorted(friction)
    at_slowest = [r.condition("speed") == speeds[0] for r in recorded]
    changes = friction_changes(
        np.array(speeds),
        np.array([friction[speed] for speed in speeds]),
        float(np.min(np.asarray(lowest)[at_slowest])),
    )
    found = dict(zip(speeds, changes.tolist(), strict=True))
    return [found[recording.condition("speed")] for recording in recorded]


def _resolution_notes(
    recordings: Sequence[Recording], ripples: Sequence[Ripple], what: str, unit: str
) -> list[str]:
    """Return a note for each recording whose samples do not resolve all orders of the table."""
    return [
        f"at {recording.condition(what):.3g} {unit} there are {1 / ripple.sampling.step:.0f} "
        f"samples a turn: orders above {ripple.sampling.highest_order:.0f} are not resolved"
        for recording, ripple in zip(recordings, ripples, strict=True)
        if ripple.sampling.highest_order < HIGHEST_ORDER
    ]


def _constants(
    kt: Run, recorded: Sequence[Recording], found: Sequence[Collected]
) -> tuple[list[Quantity], list[Array], str]:
    """Return the torque per ampere of each recording, by turn and cell, and a note on it.

    At the temperature of the housing while it was recorded, lowered by the heat of the winding.
    """
    degrees = [
        temperature_at_turns(recording, own.firsts)
        for own, recording in zip(found, recorded, strict=True)
    ]
    if not np.isfinite(np.concatenate(degrees)).all():
        constant, note = mean_constant(kt, recorded)
        alike = [np.full((1, 1), constant.value)] * len(recorded)
        return [constant] * len(recorded), alike, note
    housings = [torque_per_ampere_at(kt, float(degc.mean())) for degc in degrees]
    kelvin = torque_per_ampere_at(kt, REFERENCE_DEGC + 1), torque_per_ampere_at(kt, REFERENCE_DEGC)
    slope = kelvin[0].value - kelvin[1].value
    falls = [
        -np.log1p(slope / housing.value * (degc - degc.mean()))
        for degc, housing in zip(degrees, housings, strict=True)
    ]
    heat = winding_heat(
        [
            TurnCurrents(
                first_and_last(recording, "time", range(recording.size)),
                own.passed,
                own.current,
                "torque" in recording.conditions,
                fall,
                1 + COPPER_COEFFICIENT * ((degc[1:] + degc[:-1]) / 2 - degrees[0][0]),
            )
            for own, recording, degc, fall in zip(found, recorded, degrees, falls, strict=True)
        ]
    )
    constants, by_cell = [], []
    for own, housing, lowered, fall in zip(found, housings, heat, falls, strict=True):
        turns, (count, cells) = own.current.size, own.waveforms.shape
        place = turns - count + (np.arange(count * cells) + 0.5) / cells
        lower = np.interp(place, np.arange(turns + 1), lowered.fall + fall)
        if lower.max() > LARGEST_FALL:
            raise InsufficientDataError(
                "heat of the winding would lower the torque constant by "
                f"{100 * lower.max():.0f} %; more than {100 * LARGEST_FALL:.0f} % is no motor's: "
                "check the recorded temperature and current"
            )
        by_turn = housing.value * np.exp(-lower.reshape(count, cells))
        by_cell.append(by_turn if own.forward else by_turn[:, ::-1])
        value = float(by_turn.mean())
        lines = [
            *inherited(housing, value / housing.value, "torque constant"),
            error_line("heat of the winding", value * lowered.u, housing.unit),
        ]
        constants.append(combined(value, housing.unit, lines))
    return constants, by_cell, _heat_note(recorded, heat)


def _heat_note(recorded: Sequence[Recording], heat: Sequence[Lowered]) -> str:
    note = "torque by the torque constant at the recorded temperature of the motor"
    means = [float(lowered.fall.mean()) for lowered in heat]
    worst = int(np.argmax(means))
    if means[worst] <= heat[worst].u:
        return note
    return (
        f"{note}; {recorded[worst].name}: the current that holds its torque shows that the "
        f"winding's heat lowers the constant by another {100 * means[worst]:.2f} %, with a "
        f"standard uncertainty of {100 * heat[worst].u:.2f} %"
    )


def _psd_table(
    recordings: Sequence[Recording],
    steady: Sequence[range],
    welches: Sequence[Welch],
    segment: int,
    constants: Mapping[str, Quantity],
) -> Table:
    """Return the PSD of the steady torque by speed, all on one frequency axis."""
    spectra, psd = [], []
    for recording, samples, welch in zip(recordings, steady, welches, strict=True):
        first, last = first_and_last(recording, "time", samples)
        spectra.append(welch.spectrum((last - first) / (len(samples) - 1)))
        psd.append(spectra[-1].psd * constants[recording.name].value ** 2)
    return Table(
        ("speed", "frequency"),
        {
            "speed": Column(np.array([r.condition("speed") for r in recordings]), "rad/s"),
            "frequency": Column(spectra[0].frequency, "Hz"),
            "psd": Column(np.stack(psd), "N2 m2/Hz", "one-sided"),
        },
        "psd",
        f"power spectral density of the motor torque, Welch's method, segments of {segment}",
    )


PROCEDURE = Procedure(
    "fft-ripple",
    recordings,
    measure,
    analyse,
    needed=("kt",),
    bare_motor=True,  # no instrument can follow whole turns
    analyse_imported=analyse_imported,
)
