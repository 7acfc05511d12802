"""From the signals of `stribeck` to friction; notes name recordings that are missing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from rigtool.errors import InsufficientDataError, UsageError
from rigtool.experiments.between_set_points import (
    SET_POINT_REMEDY,
    UNSAMPLED_LIMIT,
    UnsampledCurrent,
    setpoint_resolution,
)
from rigtool.experiments.controller_torque import (
    controller_torque,
    encoder_shaking,
    naming,
    require_stable_loop,
    require_unlimited,
    usual_current,
)
from rigtool.experiments.friction.breakaway import Breakaway, TorqueRamp, around_turn, find_ramps
from rigtool.experiments.friction.direction_fit import DirectionFit
from rigtool.experiments.friction.holds import SHAKING_LIMIT, UNEVEN_LIMIT, Holds, find_holds, pool
from rigtool.experiments.friction.low_current import (
    deviation_at_low_current,
    require_calibrated_gain,
)
from rigtool.experiments.friction.offset import Offset, separate_offset
from rigtool.experiments.friction.results import (
    Findings,
    Scale,
    Uncertain,
    add_breakaway,
    add_flatness,
    add_friction,
    add_static_friction,
    breakaway_table,
    holds_table,
    ramp_table,
    torque_speed_table,
)
from rigtool.experiments.friction.results_difference import add_curve_difference, require_different
from rigtool.experiments.friction.results_radial import add_radial_breakaway, add_radial_friction
from rigtool.experiments.friction.stribeck_fit import fit_directions, mean_by_speed
from rigtool.experiments.friction.sweep import TorqueSpeed, torque_speed_curve
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.torque_per_ampere import mean_constant, torque_per_ampere
from rigtool.numerics.arrays import Array
from rigtool.recipe import Recipe
from rigtool.runfile import Recording, Run, Table

NOTED_SHARE = 0.1
"""Part of its limit above which unsampled torque gets a note."""

AMPLIFIER = ("amplifier_gain", "amplifier_linearity")
"""Results of calibrate-kt that a run's currents are compared with; imports may have none."""

SATURATED_REMEDY = "lower stribeck.hold_speeds or the load on the shaft"

HOLD_RECORDING = "holds"
SWEEP_RECORDINGS = ("sweep", "sweep_coulomb", "sweep_viscous")
BREAKAWAY, BREAKAWAY_LOADED, HOLDS_LOADED = "breakaway", "breakaway_loaded", "holds_loaded"


def coulomb_and_viscous(holds: Recording, recipe: Recipe, kt: Run) -> Uncertain:
    """Return Coulomb [N m] and viscous friction [N m s/rad] from holds in both directions."""
    scale = Scale(torque_per_ampere(kt, [holds]))
    fits, *_ = _fit_holds([holds], recipe, scale, kt)
    return (
        float(np.mean([fit.coulomb[0] for fit in fits.values()])),
        float(np.mean([fit.viscous[0] for fit in fits.values()])),
    )


def analyse(
    runs: Sequence[Run],
    recipe: Recipe,
    *,
    kt: Run,
    against: Run | None = None,
    reference: Run | None = None,
) -> Outcome:
    """Return friction from the recordings that the runs hold; notes name those that are missing.

    With `against`, also the difference of the held curve against that of another run; with
    `reference`, the ratio of that to the difference of a third run. Raises `UsageError` where a run
    without constant speeds is to be compared.
    """
    require_stable_loop(recipe)
    recordings = {
        name: [one for run in runs if (one := run.recordings.get(name)) is not None and one.size]
        for name in (HOLD_RECORDING, *SWEEP_RECORDINGS, BREAKAWAY, BREAKAWAY_LOADED, HOLDS_LOADED)
    }
    everything = [recording for parts in recordings.values() for recording in parts]
    constant, note = mean_constant(kt, everything)
    found = Findings(Scale(constant), notes=[note])
    if not everything:
        runs[0].recording(HOLD_RECORDING)  # raises, naming the recordings that are there
    missing = [name for name, parts in recordings.items() if not parts]
    if missing:
        found.notes.append(f"not recorded, so without results: {', '.join(missing)}")
    unloaded, highest = _breakaway(recordings[BREAKAWAY], recipe, found)
    loaded, _ = _breakaway(recordings[BREAKAWAY_LOADED], recipe, found, unloaded)
    curves = _sweeps(recordings, recipe, found)
    fits: dict[int, DirectionFit] = {}
    offset = None
    if recordings[HOLD_RECORDING]:
        fits, holds, notes, bent = _fit_holds(recordings[HOLD_RECORDING], recipe, found.scale, kt)
        found.notes.extend(notes)
        found.tables["holds"] = holds_table(holds)
        offset = separate(fits, holds, [b for b in (unloaded, loaded) if b is not None])
        _note_lacking(UnsampledCurrent.of(runs), holds, found)
        start, slope = holds.lagging_line()
        found.common["ripple that lags behind its angle"] = abs(start), abs(slope)
        found.common["amplifier at low current"] = bent, bent / float(np.abs(holds.speed).std())
        for recording in recordings[HOLDS_LOADED][:1]:
            add_radial_friction(
                holds,
                _find_holds(recording, recipe, found.scale),
                recording.condition("radial_force"),
                found,
                recipe.rig.weights_relative_u,
                offset,
            )
    elif "sweep" in curves:
        fits = _fit_sweep(curves["sweep"])
        found.notes.append("friction is taken from the sweep, without repeated measurements")
    if fits:
        add_friction(fits, offset, found)
    if against is not None:
        if not recordings[HOLD_RECORDING]:
            raise UsageError(f"{runs[0].path}: holds no constant speeds to compare by --against")
        require_different(runs, against, reference)
        add_curve_difference(found, against, reference)
    if (series := unloaded or loaded) is not None:
        found.tables["breakaway"] = breakaway_table(series.position, unloaded, loaded)
    if highest is not None:
        found.tables["breakaway_ramp"] = highest
    add_static_friction(unloaded, fits, offset, found)
    if unloaded is not None:
        add_breakaway(unloaded, found)
    if unloaded is not None and loaded is not None and not unloaded.stuck + loaded.stuck:
        add_radial_breakaway(unloaded, loaded, found, recipe.rig.weights_relative_u)
    if "sweep_viscous" in curves:
        add_flatness(curves["sweep_viscous"], found)
    return Outcome(found.results, found.tables, tuple(found.notes))


# -- holds and sweeps


def _angle(recording: Recording, recipe: Recipe) -> Array:
    return recording.read("encoder") * recipe.rig.count_angle


def _find_holds(recording: Recording, recipe: Recipe, scale: Scale) -> Holds:
    """Return the holds of a recording; raises `InsufficientDataError` where current saturates."""
    with naming(recording):
        asked = recording.read("current_setpoint")
        largest = float(np.abs(asked).max(initial=0.0))
        require_unlimited(largest, recipe, SATURATED_REMEDY, usual_current(asked))
    followed = recording.has("position_setpoint")
    found = find_holds(
        time=recording.read("time"),
        angle=_angle(recording, recipe),
        torque=controller_torque(recording, scale.value, asked),
        setpoint=recording.read("position_setpoint") if followed else None,
        inertia=recipe.rig.nominal_inertia,
        count=recipe.rig.count_angle,
    )
    # Twice the variance: both directions are rounded to the same steps and err alike, so that the
    # mean of the two is no better than each.
    step = scale.value * setpoint_resolution(asked, recipe.stribeck.record_every)
    expected = encoder_shaking(recipe, found.speed)
    return replace(
        found,
        u=np.hypot(found.u, step / math.sqrt(6)),
        shaking=np.where(found.shaking > 0, found.shaking, expected),
    )


def _fit_holds(
    recordings: Iterable[Recording], recipe: Recipe, scale: Scale, kt: Run
) -> tuple[dict[int, DirectionFit], Holds, list[str], float]:
    """Return the fit by direction (+1, -1), the holds that it rests on, notes, and the torque, N m,
    by which the amplifier is off its straight line."""
    parts, bent = [], 0.0
    setpoints, currents = [], []
    for recording in recordings:
        parts.append(_find_holds(recording, recipe, scale))
        if recording.has("current"):
            setpoints.append(recording.read("current_setpoint"))
            currents.append(recording.read("current"))
    every = pool(parts)
    if setpoints:  # before a fit that fails by it
        asked, shown = np.concatenate(setpoints), np.concatenate(currents)
        bent = scale.value * deviation_at_low_current(
            current_setpoint=asked,
            current=shown,
            sample_time=recipe.rig.sample_time * recipe.stribeck.record_every,
            friction_current=float(np.mean(np.abs(every.torque))) / scale.value,
        )
        if all(name in kt.results for name in AMPLIFIER):
            gain, linearity = (kt.results[name] for name in AMPLIFIER)
            require_calibrated_gain(
                current_setpoint=asked,
                current=shown,
                calibrated=gain,
                deviation=linearity.value,
                allowed=2 * (scale.constant.u or 0.0) / scale.value,
            )
    return *fit_holds(parts, encoder_shaking(recipe, every.speed)), bent


def fit_holds(
    parts: list[Holds], by_steps: Array | float = 0.0
) -> tuple[dict[int, DirectionFit], Holds, list[str]]:
    """Return the fit by direction of holds from several recordings, those that are used, and notes.

    Left out are holds in which the shaft shakes; a note states why. `by_steps` (n,) is the part of
    the shaking that the encoder's steps make in all holds, where it is known. Raises
    `InsufficientDataError` where a direction cannot be fitted.
    """
    everything = pool(parts)
    shaken, speed = everything.shaking > SHAKING_LIMIT, np.abs(everything.speed)
    stepped = shaken & (2 * np.square(by_steps) > everything.shaking**2)  # most of the variance
    uneven = everything.uneven > UNEVEN_LIMIT
    steps = "the encoder's steps shake it; take more counts, or a softer controller"
    turns = "the loop lets ripple or friction vary it; take a stiffer controller, or turn faster"
    reasons = (
        (shaken & ~stepped, SHAKING_LIMIT, "the shaft starts and stops, or vibrates"),
        (stepped, SHAKING_LIMIT, steps),
        (uneven & ~shaken, UNEVEN_LIMIT, turns),
    )
    notes = [
        f"holds left out at {', '.join(f'{v:.3g}' for v in np.unique(speed[chosen].round(3)))} "
        f"rad/s, where the speed varies by more than {100 * limit:.0f} %: {reason}"
        for chosen, limit, reason in reasons
        if chosen.any()
    ]
    steady = everything[everything.steady]
    try:
        return fit_directions(steady.speed, steady.torque, steady.u, steady.swing), steady, notes
    except InsufficientDataError as error:
        raise InsufficientDataError("; ".join([*notes, str(error)])) from None


def _note_lacking(lacking: UnsampledCurrent, holds: Holds, found: Findings) -> None:
    """Add the torque that the samples miss between set points to the uncertainty of friction.

    Raises `InsufficientDataError` where it exceeds its limit.
    """
    left_out = np.array([found.scale.value * lacking.at(speed) for speed in np.abs(holds.speed)])
    worst = int(np.argmax(np.abs(left_out)))
    if not left_out[worst]:
        return
    found.common["current between set points"] = lacking.line(found.scale.value)
    limit = UNSAMPLED_LIMIT * float(np.mean(np.abs(holds.torque)))
    text = (
        f"torque between set points differs from that of the samples, most at "
        f"{abs(holds.speed[worst]):.3g} rad/s by {left_out[worst] * 1e3:.3g} mN m "
        "with its uncertainty"
    )
    if abs(left_out[worst]) > limit:
        raise InsufficientDataError(
            f"{text}: more than {limit * 1e3:.3g} mN m, {100 * UNSAMPLED_LIMIT:.0f} % of the "
            f"torque read as friction; {SET_POINT_REMEDY}"
        )
    if abs(left_out[worst]) > NOTED_SHARE * limit:
        found.notes.append(f"{text}, which is in the uncertainty of friction: {SET_POINT_REMEDY}")


def _fit_sweep(curve: TorqueSpeed) -> dict[int, DirectionFit]:
    whole = curve.revolutions >= 1
    speed, torque = curve.speed[whole], curve.torque[whole]
    if len(speed) < 6:
        raise InsufficientDataError(
            f"the sweep turns the shaft through whole revolutions at {len(speed)} speeds, 6 are "
            "needed: sweep more slowly, or record holds"
        )
    # Third differences remove slope and curvature: the rest is scatter.
    scatter = float(np.median(np.abs(np.diff(torque, 3)))) / math.sqrt(20) / 0.6745
    return fit_directions(speed, torque, np.full(len(speed), max(scatter, 1e-9)))


def _sweeps(
    recordings: dict[str, list[Recording]], recipe: Recipe, found: Findings
) -> dict[str, TorqueSpeed]:
    curves = {}
    labels = ("no compensation", "Coulomb compensation", "Coulomb and viscous compensation")
    names = ("torque_speed", "torque_speed_coulomb", "torque_speed_viscous")
    for recording_name, table, label in zip(SWEEP_RECORDINGS, names, labels, strict=True):
        for recording in recordings[recording_name][:1]:
            curves[recording_name] = torque_speed_curve(
                time=recording.read("time"),
                setpoint=recording.read("position_setpoint"),
                torque=controller_torque(recording, found.scale.value),
                inertia=recipe.rig.nominal_inertia,
            )
            found.tables[table] = torque_speed_table(curves[recording_name], label)
        if len(recordings[recording_name]) > 1:
            found.notes.append(f"of several recordings {recording_name!r} the first was taken")
    return curves


def separate(
    fits: dict[int, DirectionFit], holds: Holds, breakaways: Sequence[Breakaway]
) -> Offset | None:
    """Separate a constant torque from asymmetric friction.

    None for one direction only, or where fewer than half of its speeds were held in the other.
    """
    if len(fits) < 2:
        return None
    lowest = max(fit.lowest for fit in fits.values())
    forward, backward = (
        mean_by_speed(holds.speed[k] * sign, holds.torque[k], holds.u[k])
        for sign, k in ((1, holds.speed > 0), (-1, holds.speed < 0))
    )
    level, middle, u, speeds = [], [], [], []
    for speed, up, up_u in zip(*forward, strict=True):
        j = int(np.argmin(np.abs(backward[0] - speed)))
        if speed < lowest or abs(backward[0][j] - speed) > 0.01 * speed:
            continue
        speeds.append(float(speed))
        middle.append((up + backward[1][j]) / 2)
        u.append(math.hypot(up_u, backward[2][j]) / 2)
        # From the fits: a noisy level would itself look like asymmetry.
        level.append(float(np.mean([fit.level(np.array(speed)) for fit in fits.values()])))
    if 2 * len(level) < np.count_nonzero(forward[0] >= lowest):
        return None
    for breakaway in breakaways:
        mean = breakaway.middle
        if math.isfinite(mean.u):
            level.append(breakaway.level.value)
            middle.append(mean.value)
            u.append(mean.u)
            speeds.append(0.0)
    if not level:
        return None
    return separate_offset(
        np.array(level), np.array(middle), np.maximum(u, 1e-12), np.array(speeds)
    )


# -- breakaway


def _breakaway(
    recordings: Sequence[Recording], recipe: Recipe, found: Findings, pair: Breakaway | None = None
) -> tuple[Breakaway | None, Table | None]:
    """Return breakaway around the turn from all ramps, and the highest ramp as a table.

    Positions are those of `pair`, where another series is given to compare with. A note states why
    ramps without breakaway give no result.
    """
    ramps: list[TorqueRamp] = []
    highest: Table | None = None
    for recording in recordings:
        time, angle = recording.read("time"), _angle(recording, recipe)
        torque = controller_torque(recording, found.scale.value)
        threshold = recipe.stribeck.breakaway_angle
        here = find_ramps(time=time, angle=angle, torque=torque, threshold=threshold)
        highest = highest or ramp_table(here, time, angle, torque)
        ramps.extend(here)
    if not ramps:
        return None, None
    try:
        series = around_turn(ramps, None if pair is None else pair.position)
    except InsufficientDataError as error:
        found.notes.append(f"{recordings[0].name!r} is without results: {error}")
        return None, highest
    if series.stuck:
        found.notes.append(
            f"{recordings[0].name!r}: the shaft did not break away in {series.stuck} of "
            f"{len(ramps)} ramps, up to {recipe.stribeck.breakaway_limit * 1e3:.3g} mN m: a mean "
            "without them would be too low and is not stated; raise stribeck.breakaway_limit"
        )
    return series, highest
