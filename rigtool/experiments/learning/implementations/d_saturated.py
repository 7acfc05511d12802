"""Known loads that drive the loop of implementation D to its limit of current: they are left out.

A heavy load swings on its tendon where the rotor turns fast. Where the controller C lags at the
frequency w of the swing, by its integrator, it adds to it: with a rotor that swings by b its mean
power is -w Im(C) b^2 / 2. At its limit the current shows no torque. The motion is then broken off,
and no load as heavy is lifted as fast afterwards: one model holds for all speeds, so slower strokes
teach it as well.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from rigtool.control.position_loop import position_loop
from rigtool.errors import InsufficientDataError
from rigtool.experiments.controller_torque import naming, require_not_saturated
from rigtool.experiments.force_model.model import Shape
from rigtool.quantity import STANDARD_GRAVITY
from rigtool.recipe import Recipe
from rigtool.runfile import Recording

MOST_HALVINGS = 4
"""How often the integrator is halved in search of one with which the controller leads."""

LOWEST_YIELDING, YIELDING_TRIED = 0.2, 200
"""Lowest frequency of a load on a rotor that yields, over that on one at rest, and how many are
tried."""

FEWEST_LOADS = 2
"""Known loads that a model is learned from, at least."""


class TooHeavy:
    """Which loads, N, at which speeds, rad/s, took more current than there is."""

    def __init__(self) -> None:
        self._limited: list[tuple[float, float]] = []
        self._lifted: set[float] = set()
        self._error: InsufficientDataError | None = None

    def __call__(self, force: float, speed: float) -> bool:
        """Return whether a load as light was too heavy at a speed as slow."""
        return any(force >= f and speed >= v for f, v in self._limited)

    @contextmanager
    def noticed(self, force: float, speed: float = math.inf) -> Iterator[None]:
        """Note an `InsufficientDataError` of the saturated loop, but for one without a load."""
        try:
            yield
        except InsufficientDataError as error:
            if not force:
                raise
            self._limited.append((force, speed))
            self._error = error
        else:
            self._lifted.update({force} - {0.0})

    def require_lifted(self, fewest: int = FEWEST_LOADS) -> None:
        """Raise the error that was noted last where fewer loads were lifted, at whatever speed."""
        if self._error is not None and len(self._lifted) < fewest:
            raise self._error


def unsaturated(
    recordings: Sequence[Recording], recipe: Recipe, fewest: int = 0
) -> list[Recording]:
    """Return the recordings but those of loads whose loop saturated.

    Raises `InsufficientDataError` where fewer loads are left, or one without a load saturated.
    """
    watched, kept = TooHeavy(), []
    for recording in recordings:
        with watched.noticed(recording.condition("force")), naming(recording):
            require_not_saturated(recording, recipe)
            kept.append(recording)
    watched.require_lifted(fewest)
    return kept


def left_out_notes(
    recordings: Sequence[Recording], kept: Sequence[Recording], shape: Shape, recipe: Recipe
) -> Iterator[str]:
    """Yield a note on each of the recordings that is not kept; `shape` is that of the others."""
    names, arm = {recording.name for recording in kept}, recipe.rig.load_arm
    for recording in recordings:
        if recording.name not in names:
            turns = recording.condition("speed") / (2 * math.pi * recipe.rig.angle_ratio)
            force = recording.condition("force")
            own_hz = swing_hz(shape, force * arm**2 / STANDARD_GRAVITY)
            yield (
                f"{recording.name}: {force:g} N at {turns:.3g} rev/s took the current to its limit "
                f"of {recipe.rig.current_limit:g} A. This recording is left out, and no load as "
                "heavy was lifted as fast: slower strokes teach such loads. On its tendon the load "
                f"swings at {own_hz:.3g} Hz{driven(recipe, own_hz)}"
            )


def swing_hz(shape: Shape, load_inertia: float) -> float:
    """Return the frequency at which a load, kg m2, swings on its tendon, Hz, where the rotor is at
    rest."""
    return math.sqrt(shape.stiffness / (load_inertia + shape.grasper_inertia)) / (2 * math.pi)


def yielding_hz(shape: Shape, load_inertia: float, recipe: Recipe) -> float:
    """Return the same where the rotor yields: it is on a spring then, the controller C, less its
    inertia. Seen from the output, of ratio r and torque factor n, r n (Re C(w) - J w^2) is in
    series with the tendon."""
    rig, held = recipe.rig, swing_hz(shape, load_inertia)
    hertz = held * np.geomspace(LOWEST_YIELDING, 1.0, YIELDING_TRIED)
    loop = position_loop(**rig.loop_design).controller.response(hertz).real
    rotor = loop - rig.nominal_inertia * (2 * math.pi * hertz) ** 2
    spring = rig.angle_ratio * rig.torque_factor * np.maximum(rotor, 0.0)
    own = held * np.sqrt(spring / (spring + shape.stiffness))
    return float(hertz[np.argmin(np.abs(own - hertz))])


def driven(recipe: Recipe, frequency_hz: float) -> str:
    """Return that the controller drives a swing, and with which integrator it does not; nothing
    where it leads there already, or with none of those that are tried."""
    design = recipe.rig.loop_design
    for halvings in range(1 + MOST_HALVINGS):
        slower = {**design, "integrator_hz": design["integrator_hz"] / 2**halvings}
        controller = position_loop(**slower).controller
        if controller.response(np.array([frequency_hz])).imag[0] >= 0:
            return (
                ", where the controller's phase lags, so that it drives the swing; with --set "
                f"rig.controller.integrator_hz={slower['integrator_hz']:g} it leads"
                if halvings
                else ""
            )
    return ""
