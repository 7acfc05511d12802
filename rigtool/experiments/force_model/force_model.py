"""A learned model with the deviations from it, as a filter for torque over time needs them.

Equations: `model`, those of the filter `plant`; load_stroke = L / load friction coefficient.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from rigtool.experiments.force_filter.kalman import Uncertainty
from rigtool.experiments.force_filter.motion_states import KIND_COUNT
from rigtool.experiments.force_filter.plant import Plant
from rigtool.experiments.force_model.contacts import MotionKind
from rigtool.experiments.force_model.deviations import Deviations
from rigtool.experiments.force_model.drive import MotorMap, drive_of, plant_of
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import Kind
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.numerics.arrays import Array


@dataclass(frozen=True)
class ForceModel:
    """See the module. `scales` (2, kinds, 2) are the factors from the filter's deviation to the
    standard uncertainty, of the smoothed and of the causal torque: `intervals`. `limits` (3, 2) are
    the thresholds for contacts: `contacts`."""

    learned: LearnedModel
    deviations: Deviations
    scales: Array = field(default_factory=lambda: np.ones((2, KIND_COUNT, 2)) * (1.0, 0.0))
    limits: Array = field(default_factory=lambda: np.full((len(MotionKind), 2), np.inf))

    @cached_property
    def drive(self) -> MotorMap:
        """Torque at the shaft by current and rotor angle."""
        return drive_of(self.learned)

    def plant(self, sample_time: float) -> Plant:
        """Return the equations that a filter runs on, at a sample time, s."""
        return replace(self._plant, sample_time=sample_time)

    @cached_property
    def _plant(self) -> Plant:
        return plant_of(self.learned, 1.0)  # its maps take milliseconds, all behind a gap ask

    @cached_property
    def uncertainty(self) -> Uncertainty:
        """Standard deviations of the errors of the equations."""
        own, per_load = self.deviations, self.learned.total(Kind.LOAD_FRICTION)
        relative = own.load / per_load if per_load > 0 else 0.0
        return Uncertainty(own.stroke, relative, own.noise, own.noise_time)

    @cached_property
    def rest_variance(self) -> float:
        """Variance of the torque at rest, N2 m2 on the output, by the asymmetry A of friction F.

        Friction F z (1 + A z) of a bristle z has the constant part F A while the rotor slides, and
        about none at rest. Sliding shows that part together with a constant torque alone, so that
        rests are off by what is not known of it: n F u(A), n the torque factor, and
        u(A) = (1 - A^2) u(ln ratio) / 2 by the ratio of both directions.
        """
        plant, place = self._plant, SLIDING_PARAMETERS.index("direction_ratio")
        friction = plant.coulomb + plant.housing_friction
        variance = float(self.learned.covariance[place, place])
        return (plant.torque_factor * friction * (1 - plant.asymmetry**2) / 2) ** 2 * variance

    @property
    def untouched(self) -> Uncertainty:
        """The same for a filter whose random walk is always that of no contact."""
        own = self.uncertainty
        return replace(own, slow_torque_rate=own.torque_rate, step_torque_rate=own.torque_rate)
