"""Whether tables are of the instrument that was recorded: u is widened, or nothing is given."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_sensor.commanded_inertia import commanded_inertia
from rigtool.experiments.force_sensor.encoder_zero import EncoderZero
from rigtool.experiments.force_sensor.procedure_calibration import changes, torque_per_current
from rigtool.experiments.force_sensor.results_recordings import Recorded
from rigtool.experiments.force_sensor.unknown_friction import (
    DOUBTED,
    FEWEST_PASSES,
    REFUSED,
    Passes,
    UnknownFriction,
    driven_part,
    lasting_torque,
    unknown_friction,
    unknown_share,
)
from rigtool.experiments.force_sensor.unknown_inertia import UnknownInertia, unknown_inertia
from rigtool.runfile import Run

HAND_PART_OF_FRICTION = 0.5
"""Part of the friction from which on a torque that drives an observed rig is that of a hand."""


def friction_at_output(model: ForceModel) -> float:
    """Return the sliding friction of bearings and housing, N m on the output."""
    plant = model.plant(1.0)
    return plant.torque_factor * (plant.coulomb + plant.housing_friction)


def largest_friction(model: ForceModel, observed: bool) -> float | None:
    """Return the torque N m with which friction may drive a pass: more is a hand, which may have
    moved a rig that was `observed`; None where rigtool moved it."""
    return HAND_PART_OF_FRICTION * friction_at_output(model) if observed else None


def of_this_instrument(
    read: Sequence[Recorded],
    model: ForceModel,
    tables: Run,
    kt: Run,
    *,
    observed: bool,
    zero: EncoderZero | None = None,
) -> tuple[list[Recorded], list[str]]:
    """Return the recordings with u widened where the tables do not hold friction or torque
    constant, and notes.

    Where a rig was `observed`, a hand may have moved it; they were read with the `zero`. Raises
    `InsufficientDataError` where the friction is that of another instrument.
    """
    hand = largest_friction(model, observed)
    forms = list(zip(*(part.passes for r in read for part in r.parts), strict=True))
    bare = unknown_friction(forms[1], hand, given=forms[0])
    given = unknown_friction(forms[0], hand, bare.size if bare else 0.0)
    share, notes = unknown_share(forms[0]), []
    if share:
        notes.append(_of_share(share, tables))
    by, other, later = changes(tables, kt, model)
    share, notes = math.hypot(share, other), notes + later
    if zero is not None:
        by = math.hypot(by, zero.spread)
        notes.append(_of_zero(zero, tables))
    every = [part for r in read for part in r.parts]
    heavier = commanded_inertia([part.commanded for part in every])
    if heavier := heavier or unknown_inertia([part.turns for part in every]):
        by = math.hypot(by, heavier.torque)
        notes.append(_of_inertia(heavier, tables))
    notes += _of_loads(forms, hand, model, kt)
    wider, gain, said = _of_friction([one for one in (given, bare) if one], model, tables)
    notes += [said] if said else []
    by, share = math.hypot(by, wider), math.hypot(share, gain)
    return [replace(r, parts=tuple(p.widened(by, share) for p in r.parts)) for r in read], notes


def _of_friction(
    both: Sequence[UnknownFriction], model: ForceModel, tables: Run
) -> tuple[float, float, str]:
    """Return by what u is wider where the tables do not hold the friction, N m, by what part of the
    torque, and a note, empty where they do; by the torque with and without its ripple."""
    found = max(both, key=lambda one: one.size, default=None)
    if found is None:
        return (
            0.0,
            0.0,
            f"whether {tables.path} is of this instrument was not checked: that needs the same "
            f"angles {FEWEST_PASSES} times in both directions, with nothing touching in most",
        )
    if found.typical > REFUSED:
        raise InsufficientDataError(
            f"every motion is opposed in both directions by {found.size * 1e3:.3g} mN m of "
            f"friction that {tables.path} does not hold, {found.typical:.2g} times u, {REFUSED:g} "
            "times at most is taken into u: the tables are of another instrument or mounting, the "
            "encoder was zeroed elsewhere, or a load opposes all motion alike; learn again with "
            "ilc-learn --implementation D"
        )
    if found.over_u <= DOUBTED:
        return 0.0, 0.0, ""
    gain = 2 * found.size / friction_at_output(model)
    wider = max(one.widening for one in both)
    reason = (
        f"strokes deviate so by chance where {found.passes} passes are all in a direction, "
        "which a longer recording decides"
        if found.by_chance
        else "the encoder was zeroed elsewhere, or the instrument or the torque constant has "
        "changed: learn again"
    )
    return (
        wider,
        gain,
        f"friction of {found.size * 1e3:.3g} mN m opposes motion in both directions and "
        f"{tables.path} does not hold: u is wider by {wider * 1e3:.3g} mN m, and by "
        f"{100 * gain:.1f} % of the torque, since friction and load may both be read too "
        f"large or too small; {reason}",
    )


def _of_share(share: float, tables: Run) -> str:
    return (
        f"through reversals under a load, torque is {100 * abs(share):.1f} % "
        f"{'more' if share > 0 else 'less'} against the load's direction of motion and as much "
        "the other way with it: u is wider by this share; the load opposes motion itself, a "
        f"mass swings at the turns (move slower), or {tables.path} does not hold the friction "
        "under load: learn again"
    )


def _of_zero(zero: EncoderZero, tables: Run) -> str:
    if not zero.moved:
        return (
            f"friction along the angle is not what {tables.path} holds: u is wider by "
            f"{zero.spread * 1e3:.3g} mN m; the tables are of another instrument or mounting, or "
            "the encoder was zeroed elsewhere: learn again"
        )
    return (
        f"the encoder shows {math.degrees(zero.moved):.1f}({math.degrees(zero.u):.1f}) deg of the "
        f"motor more than when {tables.path} was learned, by friction and ripple along the angle: "
        "torque is read with this taken off, what --stream and --live show is not; zero the "
        "encoder where it was zeroed then"
    )


def _of_inertia(found: UnknownInertia, tables: Run) -> str:
    return (
        f"at both ends of the motion a torque of {found.torque * 1e3:.3g} mN m goes with the "
        f"acceleration, as an inertia of {found.inertia * 1e6:.3g} kg mm2 takes it that hangs at "
        f"the output and was not learned: u is wider by this torque; a mass hangs there, or "
        f"{tables.path} was learned with less inertia: learn again"
    )


def _of_loads(
    forms: Sequence[Sequence[Passes]], hand: float | None, model: ForceModel, kt: Run
) -> list[str]:
    """Return notes on torques that may be loads or errors of the current."""
    notes = []
    if lasting := max((lasting_torque(form, hand) for form in forms), key=abs):
        moved = -lasting / torque_per_current(model, kt)
        notes.append(
            f"a torque of {lasting * 1e3:.3g} mN m acts most of the time, if not always, at every "
            "angle and in both directions: a load that lasts, ripple of another power-up, or the "
            f"current's zero has moved by {moved * 1e3:.3g} mA since {kt.path}, which u does not "
            "include: calibrate again if nothing touches"
        )
    if hand is not None and (part := driven_part(forms[0], hand)):
        notes.append(
            f"in {100 * part:.0f} % of the passes a torque drives the rotor by more than "
            f"{100 * HAND_PART_OF_FRICTION:.0f} % of its friction: a hand moves the rig, or the "
            "current that was recorded is too small or not all of the motor's"
        )
    return notes
