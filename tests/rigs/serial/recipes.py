"""Recipes of rigs on a line, for tests."""

from pathlib import Path

from rigtool.recipe import load_recipe

RECIPE = Path(__file__).parents[3] / "recipes" / "briaire-2006.toml"

LIMITS = (
    "serial.limits.current=10",
    "serial.limits.speed=60",
    "serial.limits.position=[-1e5, 1e5]",
    "serial.limits.temperature_degc=90",
    "serial.limits.duration=600",
)


def overrides(port, *more, driver="target", sample_time=None):
    """Return what makes the thesis's recipe one of a rig on a line."""
    period = () if sample_time is None else (f"rig.sample_time={sample_time}",)
    if driver == "maxon":
        more = ("serial.emergency_stop=true", *more)
    return (
        "rig.source=serial",
        f"serial.driver={driver}",
        f'serial.port="{port}"',
        *LIMITS,
        *period,
        *more,
    )


def serial_recipe(port, *more, **options):
    """Return the recipe itself."""
    return load_recipe(RECIPE, overrides(port, *more, **options))[0]
