"""The filters of `ilc-learn` for a recipe's loop, and how they are reported [Fig. 40, 41]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.analysis.learning_filter import Convergence, Learning, convergence, zpetc
from rigtool.analysis.plant import position_loop
from rigtool.errors import InsufficientDataError
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Run, Table

FREQUENCIES = 400
"""Points of the frequency axis, from DC to half the sampling rate."""

COMPUTED = "follows exactly from the recipe's controller and nominal inertia; nothing was measured"


@dataclass(frozen=True, eq=False)
class Design:
    """L, Q and p for a loop, and the convergence criterion, which holds."""

    learning: Learning
    criterion: Convergence
    origin: str

    def notes(self) -> tuple[str, ...]:
        """Say what T rests on."""
        return (self.origin,)

    def results(self) -> dict[str, Quantity]:
        """Return what describes the filters in numbers."""
        peak, where = self.criterion.peak, self.criterion.peak_frequency
        return {
            "convergence_peak": Quantity(peak, "1", reason=COMPUTED),
            "convergence_frequency": Quantity(where, "Hz", reason=COMPUTED),
            "zpetc_phase_advance": Quantity(
                float(self.learning.inverse.advance), "1", reason="a whole number of samples"
            ),
        }

    def tables(self) -> dict[str, Table]:
        """Return the criterion and the transfer functions over frequency."""
        frequency = self.criterion.frequency
        axis = {"frequency": Column(frequency, "Hz")}
        loop = self.learning.system.response(frequency)
        inverse = self.learning.inverse.response(frequency, shifted=False)
        shifted = self.learning.inverse.response(frequency)
        magnitude = Column(self.criterion.magnitude, "1", "must be below one")
        phases = {
            "t_phase": (loop, "complementary sensitivity"),
            "l_phase": (inverse, "learning filter before its phase advance"),
            "l_shifted_phase": (shifted, "learning filter with its phase advance"),
        }
        transfer = {
            "t_magnitude": Column(np.abs(loop), "1", "complementary sensitivity"),
            "l_magnitude": Column(np.abs(inverse), "1", "learning filter"),
            **{name: Column(_phase(h), "rad", what) for name, (h, what) in phases.items()},
        }
        return {
            "convergence": Table(
                ("frequency",),
                {**axis, "magnitude": magnitude},
                "magnitude",
                "|Q (1 - p L T)|: part of a disturbance that one more update would leave",
            ),
            "transfer": Table(
                ("frequency",),
                {**axis, **transfer},
                "t_magnitude",
                "complementary sensitivity T and its zero-phase inverse L",
            ),
        }


def design(recipe: Recipe, plant: Run | None = None) -> Design:
    """Return the filters for the recipe's loop, from the plant that identify-plant measured.

    Without `plant` it is the nominal inertia. `ilc_learn.learning_filter` says which L. Raises
    `InsufficientDataError` where the loop is unstable or learning would not converge.
    """
    settings, rig = recipe.ilc_learn, recipe.rig
    loop = position_loop(
        **rig.controller.model_dump(), inertia=rig.nominal_inertia, sample_time=rig.sample_time
    )
    if plant is not None:
        plant.require_command("identify-plant")
    if not loop.stable:
        raise InsufficientDataError(
            f"the position loop is unstable with the nominal inertia {rig.nominal_inertia:.4g} "
            "kg m2: change [rig.controller]"
        )
    system = loop.complementary_sensitivity
    learning = Learning(
        system,
        zpetc(system, settings.cancel_radius),
        cutoff_hz=settings.robustness_hz,
        order=settings.robustness_order,
        factor=settings.learning_factor,
    )
    nyquist = 0.5 / rig.sample_time
    frequency = np.concatenate([[0.0], np.geomspace(nyquist * 1e-5, nyquist, FREQUENCIES - 1)])
    criterion = convergence(learning, frequency)
    criterion.require()
    origin = (
        "T is computed from the recipe's controller and its nominal inertia, "
        f"{rig.nominal_inertia:.4g} kg m2; the plant was not measured"
    )
    return Design(learning, criterion, origin)


def _phase(response: NDArray[np.complex128]) -> NDArray[np.float64]:
    phase: NDArray[np.float64] = np.unwrap(np.angle(response))
    return phase
