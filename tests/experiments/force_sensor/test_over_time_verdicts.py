"""Recordings whose friction is not that of the tables, and recordings without any value."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError, RunFileError
from rigtool.experiments.force_filter.motion_states import Reach, State
from rigtool.experiments.force_sensor import (
    procedure_calibration,
    procedure_instrument,
    procedure_over_time,
)
from rigtool.experiments.force_sensor.commanded_inertia import CommandedTurns
from rigtool.experiments.force_sensor.encoder_zero import EncoderZero
from rigtool.experiments.force_sensor.procedure_calibration import require_calibration
from rigtool.experiments.force_sensor.procedure_instrument import (
    friction_at_output,
    largest_friction,
    of_this_instrument,
)
from rigtool.experiments.force_sensor.procedure_over_time import _require_values, reach_of
from rigtool.experiments.force_sensor.results_recordings import Recorded
from rigtool.experiments.force_sensor.signal_faults import SignalFault
from rigtool.experiments.force_sensor.unknown_friction import UnknownFriction
from rigtool.experiments.force_sensor.unknown_inertia import Turns
from rigtool.experiments.outcome import Outcome
from rigtool.recipe import load_recipe
from tests.experiments.deploy.sensors import Model
from tests.experiments.force_filter.plants import PLANT
from tests.experiments.virtual_runs import RECIPE

TABLES = SimpleNamespace(path="tables.h5")


class Part:
    """A stretch that notes by how much it is widened."""

    def __init__(self, states=(), limited=0, faults=(), seen=None):
        self.states, self.limited, self.faults = np.array(states), limited, faults
        self.passes, self.seen = ("with", "without"), seen
        self.turns, self.commanded = Turns(), CommandedTurns()

    def widened(self, by, share):
        self.seen.append((by, share))
        return self


def judged(monkeypatch, forms, share=0.0, zero=None, observed=False):
    """Return by how much u is widened, notes, and the hands that passes were looked at with."""
    seen, hands = [], []

    def unknown(form, hand, bare=0.0, given=()):
        hands.append(hand)
        assert given == (() if form[0] == "with" else ("with",))
        if form[0] == "with":
            assert bare == (forms["without"].size if forms["without"] else 0.0)
        return forms[form[0]]

    quiet = {"unknown_share": share, "lasting_torque": 0.0, "driven_part": 0.0}
    for name, value in quiet.items():
        monkeypatch.setattr(procedure_instrument, name, lambda *given, value=value: value)
    monkeypatch.setattr(procedure_instrument, "changes", lambda *given: (0.0, 0.0, []))
    monkeypatch.setattr(procedure_instrument, "unknown_friction", unknown)
    read = [Recorded("a", (Part(seen=seen),), 0, 0.0)]
    _, notes = of_this_instrument(read, Model(), TABLES, None, observed=observed, zero=zero)
    return seen[0], notes, hands


def gain(size):
    """Return the share of the torque by which friction that is off by `size` moves a load."""
    return pytest.approx(2 * size / friction_at_output(Model()))


def friction(size, widening=1e-3, over_u=0.5, typical=1.0, passes=20):
    return UnknownFriction(size, widening, over_u, typical, passes)


@pytest.mark.parametrize(("passes", "chance"), [(2, True), (8, True), (10, False), (40, False)])
def test_what_few_passes_show_by_chance_asks_for_no_learning(monkeypatch, passes, chance):
    widened, notes, _ = judged(
        monkeypatch, dict.fromkeys(["with", "without"], friction(2e-3, passes=passes))
    )
    assert widened == (pytest.approx(1e-3), gain(2e-3))
    assert ("learn again" in notes[-1]) != chance
    assert (f"where {passes} passes are all in a direction" in notes[-1]) == chance


def test_a_hand_drives_by_more_than_half_of_the_friction():
    expected = 0.5 * PLANT.torque_factor * (PLANT.coulomb + PLANT.housing_friction)
    assert largest_friction(Model(), True) == pytest.approx(expected)
    assert largest_friction(Model(), False) is None


@pytest.mark.parametrize("observed", [True, False])
def test_the_form_of_larger_unknown_friction_counts(monkeypatch, observed):
    forms = {"with": friction(2e-3, 1.5e-3), "without": friction(3e-3, 4e-3)}
    widened, notes, hands = judged(monkeypatch, forms, observed=observed)
    assert widened == (pytest.approx(4e-3), gain(3e-3))
    assert "friction of 3 mN m opposes" in notes[-1]
    assert "wider by 4 mN m" in notes[-1]
    assert hands == [largest_friction(Model(), observed)] * 2
    forms["with"] = friction(2e-3, 5e-3)  # the torque that is given, with friction as ripple off
    widened, notes, _ = judged(monkeypatch, forms, observed=observed)
    assert widened == (pytest.approx(5e-3), gain(3e-3))
    widened, notes, _ = judged(monkeypatch, {"with": friction(2e-3), "without": None})
    assert "friction of 2 mN m" in notes[-1]


@pytest.mark.parametrize(("over_u", "wider"), [(0.32, False), (0.35, True)])
def test_friction_is_in_doubt_from_a_third_of_u(monkeypatch, over_u, wider):
    one = friction(1e-3, 2e-3, over_u)
    widened, notes, _ = judged(monkeypatch, {"with": one, "without": one})
    assert widened == ((2e-3, gain(1e-3)) if wider else (0.0, 0.0))
    assert len(notes) == wider


@pytest.mark.parametrize(("typical", "refused"), [(1.95, False), (2.05, True)])
def test_friction_of_twice_u_is_that_of_another_instrument(monkeypatch, typical, refused):
    one = friction(3e-3, typical=typical)
    if not refused:
        judged(monkeypatch, {"with": one, "without": one})
        return
    with pytest.raises(InsufficientDataError, match=r"by 3 mN m .* hold, 2 times u, 2 times"):
        judged(monkeypatch, {"with": one, "without": one})


@pytest.mark.parametrize("share", [0.05, -0.05])
def test_another_zero_and_friction_under_load_are_in_u_and_noted(monkeypatch, share):
    zero = EncoderZero(math.radians(12.0), math.radians(0.7), 3e-3)
    one = friction(1e-3, 4e-3)
    widened, notes, _ = judged(monkeypatch, {"with": one, "without": one}, share, zero)
    both = math.hypot(share, gain(1e-3).expected)
    assert widened == (pytest.approx(5e-3), pytest.approx(both))
    assert f"torque is 5.0 % {'more' if share > 0 else 'less'} against" in notes[0]
    assert "shows 12.0(0.7) deg" in notes[1]
    assert len(notes) == 3
    widened, notes, _ = judged(monkeypatch, {"with": None, "without": None}, share, zero)
    assert widened == (3e-3, pytest.approx(abs(share)))
    assert "was not checked" in notes[2]
    other = EncoderZero(0.0, math.radians(0.7), 3e-3)
    widened, notes, _ = judged(monkeypatch, {"with": one, "without": one}, zero=other)
    assert widened == (pytest.approx(5e-3), gain(1e-3))
    assert "friction along the angle is not what" in notes[0]
    assert "wider by 3 mN m; the tables are of another instrument" in notes[0]
    quiet = friction(1e-3, over_u=0.1)
    assert judged(monkeypatch, {"with": quiet, "without": quiet}, 0.0, None)[:2] == ((0, 0), [])


# -- no values


def recorded(*temperatures, size=100):
    blocks = [(np.array(degc),) for degc in temperatures]
    return SimpleNamespace(size=size, blocks=lambda name, finite: iter(blocks))


REACH = Reach((0.1, 2.9), 12.0, 0.0456, (20.0, 40.0))


def refused(part, *recordings):
    with pytest.raises(InsufficientDataError) as told:
        _require_values([Recorded("a", (part,), 0, 0.0)], recordings, REACH)
    return str(told.value)


def test_one_value_is_enough():
    states = [State.OUTSIDE, State.STILL]
    _require_values([Recorded("a", (Part(states),), 0, 0.0)], [recorded([30.0])], REACH)


def test_without_a_value_the_first_reason_is_stated():
    none = [State.OUTSIDE] * 3
    faults = (
        SignalFault(0.0, 1.0, "only a remark", False),
        SignalFault(0.0, 1.0, "", True),
        SignalFault(1.0, 2.0, "the encoder leaps", True),
    )
    assert refused(Part(none, 50, faults), recorded([50.0])) == "the encoder leaps"
    limited = refused(Part(none, 51, faults), recorded([50.0]))
    assert "51 samples have a current at its limit" in limited
    assert "check the unit of the current" in limited
    for degc in ([41.0, np.nan, 45.0], [10.0, 19.0]):
        text = refused(Part(none), recorded([np.nan], degc))
        assert f"at {np.nanmin(degc):g} to {np.nanmax(degc):g} degC" in text
        assert "from 20 to 40 degC" in text
    warm = recorded([39.0, 45.0], size=40)
    assert "51 samples have a current at its limit" in refused(
        Part(none, 51), warm, recorded([15.0, 21.0], size=60)
    )
    text = refused(Part(none, 50), warm, recorded([30.0], size=60))
    assert "0.1 to 2.9 rad of the motor, up to 12 rad/s and 45.6 mN m" in text


# -- what was learned


def calibration(constant=0.046, rig=None, recipe=None):
    return SimpleNamespace(
        path="kt.h5", rig=rig, recipe=recipe, constant=constant, require_command=lambda name: None
    )


def test_the_reach_is_that_of_loads_strokes_and_calibration():
    """The rotor turns by the ratio; it creeps below half of the slowest speed under load."""
    sets = (
        "rig.attachment=instrument",
        "ilc_learn.speeds_rev_per_s=[0.9, 1.7]",
        "ilc_learn.loads.speeds_rev_per_s=[0.2, 0.5]",
        "ilc_learn.loads.forces=[0.5, 2.5]",
        "calibrate_kt.temperatures_degc=[35, 22, 30]",
    )
    own = load_recipe(RECIPE, sets)[0]
    found = reach_of(SimpleNamespace(recipe=own), calibration(recipe=own))
    turn = 2 * math.pi * own.rig.angle_ratio
    high = own.measure_force.angle / 360 * turn
    assert found.angle == (0.0, pytest.approx(high))
    assert found.speed == pytest.approx(1.7 * turn)
    assert found.torque == pytest.approx(2.5 * own.rig.load_arm)
    assert found.temperature_degc == (22, 35)
    assert found.slow == pytest.approx(0.1 * turn, rel=1e-3)
    coarse = load_recipe(RECIPE, (*sets, "rig.encoder_counts=500"))[0]  # 0.2 rev/s teach nothing
    slow = reach_of(SimpleNamespace(recipe=coarse), calibration()).slow
    assert slow == pytest.approx(0.25 * turn, rel=1e-3)
    any_warmth = reach_of(SimpleNamespace(recipe=own), calibration())
    assert any_warmth.temperature_degc == (-math.inf, math.inf)
    faster = load_recipe(RECIPE, (*sets, "ilc_learn.loads.speeds_rev_per_s=[0.2, 2.5]"))[0]
    assert reach_of(SimpleNamespace(recipe=faster), calibration()).speed == pytest.approx(
        2.5 * turn
    )


@pytest.mark.parametrize(
    ("ratio", "refused"), [(1.48, False), (1.52, True), (1 / 1.48, False), (1 / 1.52, True)]
)
def test_a_constant_of_half_as_much_again_is_another_motors(ratio, refused, monkeypatch):
    own = load_recipe(RECIPE)[0]
    monkeypatch.setattr(
        procedure_calibration,
        "torque_per_ampere_at",
        lambda kt, degc: SimpleNamespace(value=kt.constant),
    )
    given = calibration(ratio * own.rig.torque_constant)
    if not refused:
        require_calibration(given, own)
        given.rig = own.rig.name
        require_calibration(given, own)
        given.rig = "another"
        with pytest.raises(RunFileError, match="calibration of rig another"):
            require_calibration(given, own)
        return
    with pytest.raises(RunFileError, match="another motor"):
        require_calibration(given, own)


@pytest.mark.parametrize(("again", "moved"), [(True, 0.2), (False, 0.2), (True, 0.0)])
def test_a_zero_that_is_found_once_more_was_another_thing(monkeypatch, again, moved):
    """Recordings are read with it taken off, and kept where nothing of it is left; other friction
    by angle is judged as it is."""
    module, zero = procedure_over_time, SimpleNamespace(moved=moved)
    channels = (*module.NEEDED_CHANNELS, "position_setpoint")

    def recording(name, size=9, has=channels):
        return SimpleNamespace(name=name, size=size, has=has.__contains__)

    made = [recording("one"), recording("empty", 0), recording("other", has=("time",))]
    run = SimpleNamespace(path="run.h5", recordings={one.name: one for one in made})
    given = {}

    def read(one, recipe, kt, model, reach, moved=0.0):
        part = SimpleNamespace(passes=("", f"passes {moved}"), states=np.array([State.AGAINST]))
        return SimpleNamespace(name=one.name, parts=(part,), moved=moved)

    def judged(read, model, tables, kt, *, observed, zero):
        given.update(read=[(one.name, one.moved) for one in read], observed=observed, zero=zero)
        return read, ["judged"]

    monkeypatch.setattr(module, "read_recording", read)
    monkeypatch.setattr(module, "model_and_reach", lambda *_: (model, SimpleNamespace(angle=None)))
    monkeypatch.setattr(module, "largest_friction", lambda model, observed: None)
    monkeypatch.setattr(
        module,
        "encoder_zero",
        lambda passes, *_: zero if passes == ["passes 0.0"] or again else None,
    )
    monkeypatch.setattr(module, "of_this_instrument", judged)
    monkeypatch.setattr(module, "force_outcome", lambda *_: Outcome({}, {}, ("own",)))
    model, rig = SimpleNamespace(scales=[1.0], limits=2.0), SimpleNamespace(load_arm=0.02)
    rig.count_angle = 2 * math.pi / 4000
    recipe = SimpleNamespace(rig=rig)
    tables = SimpleNamespace(recipe=recipe, path="tables.h5")
    found = module.analyse_over_time([run], recipe, kt=None, tables=tables)
    assert found.notes == ("own", "judged")
    expected = (None, 0.0) if again and moved else (zero, moved)
    assert (given["zero"], given["read"]) == (expected[0], [("one", expected[1])])
    assert not given["observed"]
    made[0].has = channels[:-1].__contains__
    module.analyse_over_time([run], recipe, kt=None, tables=tables)
    assert given["observed"]
