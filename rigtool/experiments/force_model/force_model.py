"""A learned model with the deviations from it, as a filter for torque over time needs them.

Equations: `model`, those of the filter `plant`; load_stroke = L / load friction coefficient.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from rigtool.experiments.force_filter.kalman import Uncertainty
from rigtool.experiments.force_filter.motion_states import KIND_COUNT
from rigtool.experiments.force_filter.plant import Plant
from rigtool.experiments.force_model.contacts import MotionKind
from rigtool.experiments.force_model.deviations import Deviations
from rigtool.experiments.force_model.drive import MotorMap, drive_of, plant_of
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import Kind
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

    @property
    def drive(self) -> MotorMap:
        """Torque at the shaft by current and rotor angle."""
        return drive_of(self.learned)

    def plant(self, sample_time: float) -> Plant:
        """Return the equations that a filter runs on, at a sample time, s."""
        return plant_of(self.learned, sample_time)

    @property
    def uncertainty(self) -> Uncertainty:
        """Standard deviations of the errors of the equations."""
        own, per_load = self.deviations, self.learned.total(Kind.LOAD_FRICTION)
        relative = own.load / per_load if per_load > 0 else 0.0
        return Uncertainty(own.stroke, relative, own.noise, own.noise_time)

    @property
    def untouched(self) -> Uncertainty:
        """The same for a filter whose random walk is always that of no contact."""
        own = self.uncertainty
        return replace(own, slow_torque_rate=own.torque_rate, step_torque_rate=own.torque_rate)
