"""Results of the tendon, beside a search whose answer to a wrong bench is known."""

import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import Kind, Known, Term
from rigtool.experiments.force_model.records import ROWS_HZ
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.experiments.learning.implementations.d_tendon import (
    inertia_notes,
    stroke_notes,
    tendon_results,
)
from rigtool.experiments.load_disturbance.reading import LoadedPair
from rigtool.recipe import load_recipe
from tests.experiments.virtual_runs import RECIPE

BENCH = (
    "rig.weights_relative_u=0.002",
    "rig.instrument.grasper_length_u=1e-4",
    "rig.instrument.angle_ratio_relative_u=0.004",
)
RIG = load_recipe(RECIPE)[0]
NUMBER = {name: SLIDING_PARAMETERS.index(name) for name in ("stiffness", "damping", "tip_friction")}


@dataclass(frozen=True, eq=False)
class Swinging:
    moment: float
    load_inertia: float
    torques: np.ndarray | None = None


class Sliding:
    """Learning whose stiffness is that of the chosen records, each one its number apart."""

    def __init__(self, records):
        self.problem = SimpleNamespace(records=records, known=Known(0.85, 1.18, 1e-5))
        self.learned = self._shape(0.13)

    def _shape(self, stiffness):
        shape = SimpleNamespace(stiffness=stiffness, damping=8e-4, tip_friction=1e-3)
        return SimpleNamespace(shape=shape)

    def learned_from(self, chosen):
        return self._shape(0.13 + sum(2**k for k, used in enumerate(chosen) if used))

    def covariance_of(self, model, chosen):
        """Relative: 0.01, 0.02.. by parameter for all records, more for fewer."""
        part = len(chosen) / sum(chosen)
        return np.diag((0.01 * np.arange(1, len(SLIDING_PARAMETERS) + 1)) ** 2) * part

    def moved_by(self, records, known):
        """By the stiffness all that the moments gain, by others what the rest gains."""
        first, own = records[0], self.problem
        found = np.zeros(len(SLIDING_PARAMETERS))
        found[NUMBER["stiffness"]] = first.moment / own.records[0].moment - 1
        found[NUMBER["damping"]] = first.load_inertia / own.records[0].load_inertia - 1
        found[NUMBER["tip_friction"]] = known.angle_ratio / own.known.angle_ratio - 1
        # at a ratio that is off, the power at the motor is still that at the tip
        assert known.angle_ratio * known.torque_factor == pytest.approx(0.85 * 1.18, rel=1e-12)
        return found


def test_each_thing_that_the_bench_may_have_wrong_is_a_line():
    records = [Swinging(0.01 * k, 1e-4 * k) for k in range(1, 7)]
    pairs = [
        LoadedPair(records[0], (records[1],), 0.02),
        LoadedPair(records[2], (records[3],), 0.02),
        LoadedPair(records[4], (records[5],), 0.02),
    ]
    rig = load_recipe(RECIPE, BENCH)[0].rig
    found = tendon_results(
        SimpleNamespace(sliding=Sliding(records)), pairs, np.array([5.0, 2.0, 5.0]), rig
    )
    arm, weights = rig.load_arm_u / rig.load_arm, rig.weights_relative_u
    ratio = rig.angle_ratio_relative_u
    moved = {
        "tendon_stiffness": {"weights": weights, "arm": arm},
        "tendon_damping": {"weights": weights, "arm": (1 + arm) ** 2 - 1},
        "tip_friction": {"ratio": ratio},
    }
    inputs = {"weights": (1.0, weights), "arm": (rig.load_arm, rig.load_arm_u)}
    inputs["ratio"] = (rig.angle_ratio, rig.angle_ratio * ratio)
    value = {"tendon_stiffness": 0.13, "tendon_damping": 8e-4, "tip_friction": 1e-3}
    for name, parameter in zip(value, NUMBER, strict=True):
        own = 0.01 * (NUMBER[parameter] + 1)
        off = list(moved[name].values())
        assert found[name].value == value[name]
        assert found[name].u == pytest.approx(value[name] * math.hypot(own, *off), rel=1e-9)
        lines = [line for line in found[name].budget if line.value]
        expected = [
            (*inputs[key], value[name] * part / inputs[key][1]) for key, part in moved[name].items()
        ]
        assert [(line.value, line.u, line.sensitivity) for line in lines] == [
            pytest.approx(each, rel=1e-9) for each in expected
        ]
    # the slowest speed has records 2 and 3, the fastest the others
    assert found["tendon_stiffness_shift"].value == pytest.approx(0.13 + 4 + 8)
    assert found["tendon_stiffness_resonance"].value == pytest.approx(0.13 + 1 + 2 + 16 + 32)
    own = 0.01 * (NUMBER["stiffness"] + 1) * math.sqrt(6 / 2)
    for name, share in (("shift", own), ("resonance", own * math.sqrt(2 / 4))):
        stated = found[f"tendon_stiffness_{name}"]
        assert stated.u / stated.value == pytest.approx(math.hypot(share, weights, arm), rel=1e-9)


def test_one_speed_has_no_stiffness_of_its_own():
    records = [Swinging(0.01, 1e-4), Swinging(0.02, 1e-4)]
    rig = load_recipe(RECIPE)[0].rig
    pairs = [LoadedPair(records[0], (records[1],), 0.02)]
    found = tendon_results(SimpleNamespace(sliding=Sliding(records)), pairs, np.array([5.0]), rig)
    assert list(found) == ["tendon_stiffness", "tendon_damping", "tip_friction"]


def learned(scatter, periods=13, shown=True):
    """Four cycles of 0.5 s that swing so often, of a load whose own frequency is 6.5 Hz."""
    inertia = 0.2 / (2 * math.pi * 6.5) ** 2
    time = np.arange(4 * 50) / ROWS_HZ
    torques = np.sin(math.pi * periods * time).reshape(4, 50)  # an odd number has no mean cycle
    record = Swinging(0.02, 0.7 * inertia, torques)
    shape = SimpleNamespace(stiffness=0.2, grasper_inertia=0.3 * inertia)
    model = SimpleNamespace(learned=SimpleNamespace(shape=shape))
    strokes, scatters = {"load_000": record}, {"load_000": scatter}
    return SimpleNamespace(model=model, strokes=strokes, scatter=scatters, shown=shown)


def test_a_load_that_swings_on_its_tendon_is_named_with_both_frequencies():
    (note,) = stroke_notes(learned(4.2), RIG)
    assert note.startswith("load_000: its cycles scatter by 4.2 times")
    assert "mostly at 6.5 Hz; on its tendon the output swings at 6.5 Hz, at 5.71 Hz where" in note
    assert "the rotor yields, so the loop lets the load swing" in note
    assert "--set rig.controller.integrator_hz=2 it leads" in note
    for periods in (7, 19):
        (note,) = stroke_notes(learned(4.2, periods), RIG)
        assert f"mostly at {periods / 2:g} Hz" in note
        assert "so something else differs from cycle to cycle" in note


def test_a_rotor_that_yields_lets_the_load_swing_more_slowly():
    (note,) = stroke_notes(learned(4.2, 9), RIG)
    assert "mostly at 4.5 Hz" in note
    assert "so the loop lets the load swing" in note
    assert "--set rig.controller.integrator_hz=0.5 it leads" in note


def test_cycles_that_repeat_need_no_remark():
    assert not list(stroke_notes(learned(2.9), RIG))
    assert not list(stroke_notes(learned(3.0), RIG))


def test_short_strokes_show_no_deviations():
    (note,) = stroke_notes(learned(1.0, shown=False), RIG)
    assert "shorter than 1 s at constant speed. 3 % of the friction is assumed" in note


@pytest.mark.parametrize(
    ("error", "shown"),
    [
        (0.19e-5, None),
        (-0.19e-5, None),
        (0.21e-5, "1.2e-05 kg m2 on the motor shaft, 21 % more"),
        (-0.34e-5, "6.6e-06 kg m2 on the motor shaft, 34 % less than the 1e-05 kg m2"),
    ],
)
def test_an_inertia_that_is_not_the_stated_one_has_a_note(error, shown):
    terms = Term(Kind.OFFSET, 1e-3), Term(Kind.INERTIA, 1e-6), Term(Kind.VISCOUS, 1e-3)
    known, coefficient = Known(0.85, 1.2, 1e-5), np.array([1.0, error, 1.0])
    model = LearnedModel(terms, None, known, coefficient, None, None)
    notes = list(inertia_notes(model))
    assert len(notes) == (shown is not None)
    assert all(shown in note and "identify-plant" in note for note in notes)
