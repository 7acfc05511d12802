"""The filters of `ilc-learn` for a recipe's loop, and how they are reported [Fig. 40, 41]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rigtool.control.plant_models import PlantModel
from rigtool.control.position_loop import Loop, TransferFunction, position_loop
from rigtool.errors import InsufficientDataError, RecipeError, RunFileError, UsageError
from rigtool.experiments.learning.filters import (
    LESS_LEARNING,
    Convergence,
    Inverse,
    Learning,
    LearningFilter,
    convergence,
    zpetc,
)
from rigtool.experiments.learning.measured_loop import InverseResponse, MeasuredLoop
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Run, Table

FREQUENCY_POINTS, LOWEST_FREQUENCY = 400, 1e-5
"""Points of the frequency axis, from DC to half the sampling rate; the first one above DC, as a
part of the last one."""

COMPUTED_BOUND = (
    "follows exactly from the recipe's controller and nominal inertia; nothing was measured"
)
STATED_BOUND = "convergence_bound states its largest value over the plant's uncertainty"
IS_BOUND = "is itself the bound at 95 % for the plant"


@dataclass(frozen=True, eq=False)
class FilterDesign:
    """L, Q and p for a loop, and the convergence criterion, which holds.

    `controller` is C(z): L times C is the inverse of the process sensitivity, for learning on the
    error [eq. 3]. `origin` states where the plant is from.
    """

    learning: Learning
    criterion: Convergence
    controller: TransferFunction
    origin: tuple[str, ...]

    def results(self) -> dict[str, Quantity]:
        """Return the results that describe the filters."""
        criterion, measured = self.criterion, self.learning.measured is not None
        why = STATED_BOUND if measured else COMPUTED_BOUND
        results = {
            "convergence_peak": Quantity(criterion.peak, "1", reason=why),
            "convergence_frequency": Quantity(criterion.peak_frequency, "Hz", reason=why),
        }
        if measured:
            results |= {
                "convergence_bound": Quantity(criterion.bound_peak, "1", reason=IS_BOUND),
                "convergence_bound_frequency": Quantity(
                    criterion.bound_frequency, "Hz", reason=IS_BOUND
                ),
            }
        if isinstance(self.learning.inverse, LearningFilter):
            results["zpetc_phase_advance"] = Quantity(
                float(self.learning.inverse.advance), "1", reason="a whole number of samples"
            )
        return results

    def tables(self) -> dict[str, Table]:
        """Return the criterion and the transfer functions over frequency."""
        frequency = self.criterion.frequency
        axis = {"frequency": Column(frequency, "Hz")}
        loop = self.learning.loop_response(frequency)
        inverse = self.learning.inverse.response(frequency, shifted=False)
        shifted = self.learning.inverse.response(frequency)
        criterion = {
            "magnitude": Column(self.criterion.magnitude, "1", "must be below one"),
            "bound": Column(
                self.criterion.bound,
                "1",
                "largest value over the plant's uncertainty; must be below one, not known (NaN) "
                "without a measured plant",
            ),
        }
        phases = {
            "t_phase": (loop, "complementary sensitivity"),
            "l_phase": (inverse, "learning filter before its phase advance"),
            "l_shifted_phase": (shifted, "learning filter with its phase advance"),
        }
        transfer = {
            "t_magnitude": Column(np.abs(loop), "1", "complementary sensitivity"),
            "l_magnitude": Column(np.abs(inverse), "1", "learning filter"),
            **{
                name: Column(np.unwrap(np.angle(h)), "rad", what)
                for name, (h, what) in phases.items()
            },
        }
        return {
            "convergence": Table(
                ("frequency",),
                {**axis, **criterion},
                "magnitude",
                "|Q (1 - p L T)|: part of a disturbance that one more update would leave",
            ),
            "transfer": Table(
                ("frequency",),
                {**axis, **transfer},
                "t_magnitude",
                "complementary sensitivity T and the learning filter L, its inverse",
            ),
        }


def design_filters(recipe: Recipe, plant: Run | None = None) -> FilterDesign:
    """Return the filters for the recipe's loop, from the plant that identify-plant measured.

    Without `plant` it is the nominal inertia. `ilc_learn.learning_filter` selects L. Raises
    `InsufficientDataError` where the loop is unstable or learning would not converge, `UsageError`
    where L needs a plant that is not given, `RunFileError` where the plant is that of another rig,
    `RecipeError` where the cut-off of Q is not below half the sampling rate.
    """
    settings, rig = recipe.ilc_learn, recipe.rig
    nyquist = 0.5 / rig.sample_time
    if settings.robustness_hz >= nyquist:
        raise RecipeError(
            f"ilc_learn.robustness_hz {settings.robustness_hz:g} Hz reaches half the sampling "
            f"rate, {nyquist:g} Hz: lower it"
        )
    nominal = position_loop(**rig.loop_design)
    measured = None if plant is None else measured_loop(plant, recipe, nominal.controller)
    loop = nominal if measured is None else measured.loop
    if not loop.stable:
        kind = "nominal" if measured is None else "measured"
        inertia = rig.nominal_inertia if plant is None else plant.result("inertia", "kg m2").value
        raise InsufficientDataError(
            f"the position loop is unstable with the {kind} inertia {inertia:.4g} "
            "kg m2: change [rig.controller]"
        )
    system = loop.complementary_sensitivity
    learning = Learning(
        system,
        _inverse(recipe, system, measured),
        cutoff_hz=settings.robustness_hz,
        order=settings.robustness_order,
        factor=settings.learning_factor,
        measured=measured,
    )
    frequency = np.concatenate(
        [[0.0], np.geomspace(nyquist * LOWEST_FREQUENCY, nyquist, FREQUENCY_POINTS - 1)]
    )
    if measured is not None:
        frequency = np.union1d(frequency, measured.frequency)
    criterion = convergence(learning, frequency)
    criterion.require(_remedy(recipe, system))
    return FilterDesign(learning, criterion, nominal.controller, _origin(recipe, plant, learning))


def _remedy(recipe: Recipe, system: TransferFunction) -> str:
    """Return what to change where learning does not converge.

    A zero near z = 1 that is not cancelled, that of a slow integrator, leaves L T above one from
    its frequency on, whatever Q and p are.
    """
    settings, zeros = recipe.ilc_learn, system.zeros()
    modulus = np.abs(zeros)
    kept = zeros[(modulus >= settings.cancel_radius) & (modulus < 1) & (zeros.real > 0)]
    if settings.learning_filter != "zpetc" or not kept.size:
        return LESS_LEARNING
    slowest = kept[np.argmax(np.abs(kept))]
    radius = float(np.abs(slowest))
    slow = float(np.abs(np.log(slowest))) / (2 * np.pi * recipe.rig.sample_time)
    return (
        f"the loop has a zero at {slow:.3g} Hz, radius {radius:.8g}, as of a slow integrator, "
        f"which ilc_learn.cancel_radius = {settings.cancel_radius:g} does not cancel: raise it "
        "above that radius, or raise rig.controller.integrator_hz"
    )


def _inverse(recipe: Recipe, system: TransferFunction, measured: MeasuredLoop | None) -> Inverse:
    """Return the L that the recipe selects."""
    settings = recipe.ilc_learn
    if settings.learning_filter == "zpetc":
        return zpetc(system, settings.cancel_radius)
    if measured is None:
        raise UsageError(
            "--learning-filter frf inverts a measured response: give --plant, a run of "
            "identify-plant"
        )
    return InverseResponse(measured)


def measured_loop(plant: Run, recipe: Recipe, controller: TransferFunction) -> MeasuredLoop:
    """Return the loop of a controller around the plant of a run of identify-plant.

    Raises `RunFileError` where the run is another command's, or of another rig.
    """
    plant.require_command("identify-plant")
    _require_same_rig(plant, recipe)
    rigid = "inertia_motor_side" not in plant.results
    inertia = plant.result("inertia", "kg m2").value
    model = PlantModel(
        inertia,
        plant.result("viscous_friction", "N m s/rad").value,
        None if rigid else plant.result("inertia_motor_side", "kg m2").value / inertia,
        0.0 if rigid else plant.result("antiresonance_frequency", "Hz").value,
        0.0 if rigid else plant.result("antiresonance_damping", "1").value,
    )
    table = plant.table(
        "frequency_response",
        "frequency",
        frequency="Hz",
        magnitude="rad/(N m)",
        phase="rad",
        radius="rad/(N m)",
    )
    used = table["used"] == 1
    magnitude = table["magnitude"][used]
    response = magnitude * np.exp(1j * table["phase"][used])
    return MeasuredLoop(
        Loop(controller, model.held(recipe.rig.sample_time)),
        table["frequency"][used],
        response,
        table["radius"][used] / magnitude,
    )


def _require_same_rig(plant: Run, recipe: Recipe) -> None:
    """Raise `RunFileError` unless the plant is that of the recipe's rig."""
    there = plant.recipe
    if there is None:
        raise RunFileError(f"{plant.path}: holds no recipe, so its rig is unknown: measure again")
    for name in ("name", "attachment", "sample_time"):
        found, expected = getattr(there.rig, name), getattr(recipe.rig, name)
        if found != expected:
            raise RunFileError(
                f"{plant.path}: was measured with rig.{name} {found}, the recipe has {expected}: "
                "give the plant of this rig, or measure it with identify-plant"
            )


def _origin(recipe: Recipe, plant: Run | None, learning: Learning) -> tuple[str, ...]:
    nominal = recipe.rig.nominal_inertia
    if plant is None:
        return (
            "the loop's complementary sensitivity T is computed from the recipe's controller and "
            f"nominal inertia, {nominal:.4g} kg m2. The plant was not measured: without --plant "
            "its uncertainty, and a bound of the convergence criterion, are not known",
        )
    inertia, measured = plant.result("inertia"), learning.measured
    assert measured is not None
    u = "" if inertia.u is None else f" (u {inertia.u:.2g})"
    notes = [
        f"the loop's complementary sensitivity T is computed from the recipe's controller and the "
        f"measured plant ({plant.path.name}): "
        f"inertia {inertia.value:.5g}{u} kg m2, {100 * (inertia.value / nominal - 1):+.2g} % from "
        "the nominal one"
    ]
    if inertia.u is None:
        notes.append(
            "the plant was measured without --kt: the bound of the convergence criterion does "
            "not include the uncertainty of the torque constant"
        )
    if isinstance(learning.inverse, InverseResponse):
        last = learning.inverse.last_line
        notes.append(
            f"L is the inverse of the measured response up to its last coherent line, {last:.4g} "
            "Hz, and falls to zero within an octave above"
        )
    return tuple(notes)
