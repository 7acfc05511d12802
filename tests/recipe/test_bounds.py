"""Bounds by unit: values that no bench has are refused, with the unit and the bound."""

import math
import typing

import pytest
from pydantic import BaseModel

from rigtool.errors import RecipeError
from rigtool.recipe import Recipe, load_recipe
from rigtool.recipe.base import UNIT_BOUNDS, unit_of

RECIPE = "recipes/briaire-2006.toml"
OWN_TARGET = "recipes/own-target.toml"


@pytest.mark.parametrize(
    ("setting", "bound"),
    [
        ("stribeck.speed_max=1e9", "0.0001 to 10000 rad/s"),
        ("stribeck.hold_speeds=[1, 2, 30000]", "0.0001 to 10000 rad/s"),
        ("calibrate_kt.temperatures_degc=[293, 308]", "0 to 250 degC"),
        ("calibrate_kt.reference_range_degc=[293, 308]", "0 to 250 degC"),
        ("rig.torque_constant=45.8", "0.0001 to 20 N m/A"),
        ("rig.torque_constant=45.8e-6", "0.0001 to 20 N m/A"),
        ("rig.arm.length=540", "to 10 m"),
        ("rig.inertia.rotor=101", "to 10 kg m2"),
        ("rig.current_limit=1e9", "to 1000 A"),
        ("rig.sample_time=1e-9", "1e-06 to 86400 s"),
        ("measure_force.forces=[60e3]", "to 10000 N"),
        ("measure_force.cycles=1000000000", "at most 100000"),
        ("ilc_learn.loads.cycles=4", "at least 5"),
        ("virtual.instrument.stiffness=1e12", "to 1e+09 N m/rad"),
        ("virtual.motor.friction_asymmetry=1e6", "0 to 100 relative"),
        ("virtual.amplifier.gain=1e9", "1000"),
        ("virtual.thermal.ambient_degc=300", "0 to 250 degC"),
        ("virtual.thermal.winding_resistance=1e9", "to 1e+06 ohm"),
    ],
)
def test_absurd_values_are_refused_with_their_bound(setting, bound):
    with pytest.raises(RecipeError) as caught:
        load_recipe(RECIPE, [setting])
    message = str(caught.value)
    assert bound in message
    assert "--set" in message
    assert setting.partition("=")[0] in message


@pytest.mark.parametrize(
    "setting",
    ["current=1e9", "temperature_degc=5000", "speed=1e9", "position=[-1e9, 1e9]", "duration=1e9"],
)
def test_absurd_limits_are_refused(setting):
    with pytest.raises(RecipeError, match=r"must be from .* (A|degC|rad/s|rad|s), got "):
        load_recipe(OWN_TARGET, [f"serial.limits.{setting}"])


def models(annotation):
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in typing.get_args(annotation) for model in models(part)]


def fields(model, known):
    for name, field in model.model_fields.items():
        inner = models(field.annotation)
        for section in inner:
            if section not in known:
                known.add(section)
                yield from fields(section, known)
        if not inner and "float" in str(field.annotation):
            yield f"{model.__name__}.{name}", field


def test_every_number_of_a_recipe_has_a_unit_or_bounds_of_its_own():
    without = set()
    for name, field in fields(Recipe, {Recipe}):
        bounds = [m for m in field.metadata if getattr(m, "le", getattr(m, "lt", None)) is not None]
        if unit_of(field.description) is None and not bounds:
            without.add(name)
    # in the unit of the channel that an instrument reads; of forces and frequencies by type
    assert without == {"MeasuringInstrument.offset"}


def test_units_are_those_of_the_end_of_a_description():
    assert unit_of("at 20 degC, N m/A") == "N m/A"
    assert unit_of("N m s/rad") == "N m s/rad"
    assert unit_of("for lifting against lowering, N (instrument)") == "N"
    assert unit_of("both directions, rev/s; A learns at the lowest") == "rev/s"
    assert unit_of("kilograms, miles") is None


@pytest.mark.parametrize("unit", UNIT_BOUNDS)
def test_bounds_are_ordered_and_finite(unit):
    low, high = UNIT_BOUNDS[unit]
    assert 0 <= low < high < math.inf


def test_one_set_of_attachments_for_all_commands():
    with pytest.raises(RecipeError, match="'pulley' or 'instrument'"):
        load_recipe(RECIPE, ["rig.attachment=pully"])


@pytest.mark.parametrize("angle", [900, 1.57, 19, 161])
def test_torque_is_read_where_the_speed_is_constant(angle):
    with pytest.raises(RecipeError, match="not between 20 and 160 deg"):
        load_recipe(RECIPE, [f"measure_force.measure_angle={angle}"])


def test_whole_cycles_of_a_full_correction_are_as_many_as_it_reads():
    full = "measure_force.correction=full"
    with pytest.raises(RecipeError, match="4 cycles are too few"):
        load_recipe(RECIPE, [full, "measure_force.cycles=4"])
    assert load_recipe(RECIPE, [full, "measure_force.cycles=5"])[0].measure_force.cycles == 5
    assert load_recipe(RECIPE, ["measure_force.cycles=3"])[0].measure_force.cycles == 3


def test_turns_that_overlap_are_refused():
    with pytest.raises(RecipeError, match="leaves nothing of the angle"):
        load_recipe(RECIPE, ["measure_force.turn_angle=100"])
