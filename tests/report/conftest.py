"""Run files of all commands with made-up but plausible tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from rigtool.quantity import Quantity
from rigtool.recipe import load_recipe
from rigtool.report.figures import Picture
from rigtool.report.published import published_table
from rigtool.runfile import Column, Run, RunWriter, Table, open_run

RECIPE = Path(__file__).parents[2] / "recipes" / "briaire-2006.toml"

Make = Callable[..., Path]


def table(
    axes: str, signal: str, description: str = "", **columns: tuple[np.ndarray, str]
) -> Table:
    return Table(
        tuple(axes.split()),
        {name: Column(np.asarray(values), unit) for name, (values, unit) in columns.items()},
        signal,
        description,
    )


def calibration() -> tuple[dict[str, Quantity], dict[str, Table]]:
    degc = np.linspace(20, 50, 7)
    results = {
        "torque_constant": Quantity(45.8e-3, "N m/A", 2e-5, 100),
        "torque_constant_temperature_coefficient": Quantity(-1.16e-3, "1/K", 1e-5),
        "amplifier_gain": Quantity(1.0, "1", reason="taken as given"),
    }
    constant = table(
        "temperature",
        "torque_constant",
        temperature=(degc, "degC"),
        torque_constant=(45.8e-3 * (1 - 1.16e-3 * (degc - 20)), "N m/A"),
        u=(np.full(7, 2e-5), "N m/A"),
    )
    return results, {"torque_constant": constant}


def friction() -> tuple[dict[str, Quantity], dict[str, Table]]:
    speed = np.linspace(-30, 30, 61)
    time = np.linspace(0, 5, 100)

    def curve(coulomb: float, viscous: float) -> Table:
        torque = coulomb * np.sign(speed) + viscous * speed
        return table("speed", "torque", speed=(speed, "rad/s"), torque=(torque, "N m"))

    tables = {
        "torque_speed": curve(2.3e-3, 5.33e-5),
        "torque_speed_coulomb": curve(0, 5.33e-5),
        "torque_speed_viscous": curve(0, 0),
        "friction_model": curve(2.3e-3, 5.33e-5),
        "breakaway_ramp": table(
            "time",
            "torque",
            time=(time, "s"),
            torque=(1e-3 * time, "N m"),
            position=(np.where(time > 2.4, time - 2.4, 0), "rad"),
        ),
    }
    return {"viscous_friction": Quantity(5.33e-5, "N m s/rad", 1e-7)}, tables


def ripple() -> tuple[dict[str, Quantity], dict[str, Table]]:
    position = np.arange(500) * 2 * math.pi / 500
    order, frequency = np.arange(50), np.linspace(0, 1000, 2049)

    def waves(axis: str, values: np.ndarray, unit: str) -> Table:
        wave = 1e-3 * np.sin(2 * position + values[:, None])
        return table(
            f"{axis} position",
            "torque",
            **{axis: (values, unit)},
            position=(position, "rad"),
            torque=(wave, "N m"),
        )

    torques, speeds = np.array([14e-3, 37e-3, 160e-3]), np.arange(3.0, 31, 3)
    tables = {
        "speed_waveforms": waves("speed", speeds, "rad/s"),
        "torque_waveforms": waves("torque_level", torques, "N m"),
        "power_waveforms": waves("power_cycle", np.arange(2), "1"),
        "revolutions": waves("revolution", np.arange(20), "1"),
        "torque_spectrum": table(
            "torque order",
            "amplitude",
            torque=(torques, "N m"),
            order=(order, "1"),
            amplitude=(np.full((3, 50), 1e-4), "N m"),
        ),
        "speed_psd": table(
            "speed frequency",
            "psd",
            speed=(speeds, "rad/s"),
            frequency=(frequency, "Hz"),
            psd=(1e-9 / (1 + frequency) * np.ones((10, 1)), "N2 m2/Hz"),
        ),
    }
    level = tables["torque_waveforms"].columns
    tables["torque_waveforms"] = table(
        "torque position",
        "ripple",
        torque=(torques, "N m"),
        position=(position, "rad"),
        ripple=(level["torque"].values, "N m"),
    )
    return {"strongest_order_lowest_speed": Quantity(2, "1", reason="a whole number")}, tables


def learned() -> tuple[dict[str, Quantity], dict[str, Table]]:
    speed = 0.85 * 2 * math.pi * np.array([-2.0, -1, -0.2, 0.2, 1, 2])
    position = np.arange(425, 1276) * 2 * math.pi / 4000
    torque = 12e-3 * np.sign(speed)[:, None] + 1e-3 * np.sin(2 * position)
    waves = {"speed": (speed, "rad/s"), "position": (position, "rad")}
    frequency = np.concatenate([[0.0], np.geomspace(0.1, 4000, 30)])
    phase = -frequency / 100
    axis = {"frequency": (frequency, "Hz")}
    return {"residual_peak": Quantity(0.4e-3, "N m", 1e-5)}, {
        "convergence": table(
            "frequency",
            "magnitude",
            **axis,
            magnitude=(np.exp(-frequency / 100) / 2, "1"),
            bound=(np.full(31, np.nan), "1"),
        ),
        "transfer": table(
            "frequency",
            "t_magnitude",
            **axis,
            t_magnitude=(np.exp(-frequency / 100), "1"),
            t_phase=(phase, "rad"),
            l_magnitude=(np.exp(frequency / 100), "1"),
            l_phase=(-phase, "rad"),
            l_shifted_phase=(-phase, "rad"),
        ),
        "lookup": table(
            "speed position",
            "torque",
            **waves,
            torque=(torque, "N m"),
            u=(np.full(torque.shape, 1e-5), "N m"),
        ),
        "residual_waveforms": table(
            "speed position",
            "residual",
            **waves,
            before=(torque, "N m"),
            table=(torque, "N m"),
            residual=(0.03 * torque, "N m"),
        ),
    }


def plant() -> tuple[dict[str, Quantity], dict[str, Table]]:
    frequency = np.geomspace(4, 250, 20)
    value = 1 / (1.566e-5 * (2 * np.pi * frequency) ** 2)
    turn = np.full(20, -np.pi)
    axis = {"frequency": (frequency, "Hz")}
    response = table(
        "frequency",
        "magnitude",
        **axis,
        magnitude=(value, "rad/(N m)"),
        phase=(turn, "rad"),
        radius=(0.01 * value, "rad/(N m)"),
        used=(np.arange(20) > 0, "1"),
    )
    fit = table(
        "frequency",
        "magnitude",
        **axis,
        magnitude=(value, "rad/(N m)"),
        phase=(turn, "rad"),
        mass_line=(value, "rad/(N m)"),
    )
    curves = {}
    for name in ("open_loop", "t", "s"):
        curves[f"{name}_magnitude"] = (value, "1")
        curves[f"{name}_phase"] = (turn, "rad")
    loop = table("frequency", "t_magnitude", **axis, **curves)
    results = {
        "inertia": Quantity(1.5665e-5, "kg m2", 8e-9, 11),
        "mass_line_crossing": Quantity(40.2, "Hz", 0.01, 11),
    }
    return results, {"frequency_response": response, "fit": fit, "sensitivities": loop}


def force(attachment: str = "instrument") -> tuple[dict[str, Quantity], dict[str, Table]]:
    """Loads exactly as published, behind a row without load."""
    columns = {name: np.array([0.0, *v]) for name, v in published_table(attachment).columns.items()}
    units = {"applied_force": "N", "error_percent": "%"}
    loads = table(
        "load",
        "mean_torque",
        load=(np.arange(6), "1"),
        mean_torque_u=(np.full(6, 0.1e-3), "N m"),
        **{name: (values, units.get(name, "N m")) for name, values in columns.items()},
    )
    whole = np.linspace(0, 3400, 341)
    stroke = whole[:171]
    sine = 60e-3 * np.sin(np.pi * stroke / 1700)
    lifted = table(
        "position",
        "lifting",
        position=(stroke, "count"),
        lifting=(1.09 * sine, "N m"),
        lowering=(0.91 * sine, "N m"),
        applied=(sine, "N m"),
    )
    noise = 0.5e-3 * np.random.default_rng(1).standard_normal(40)
    tables = {
        "loads": loads,
        "feedforward": table(
            "position",
            "torque",
            position=(whole, "count"),
            torque=(np.where(whole < 1700, 13e-3, -13e-3), "N m"),
            residual=(np.zeros(341), "N m"),
        ),
        "cycles_no_load": table(
            "cycle position",
            "torque",
            cycle=(np.arange(40), "1"),
            position=(whole, "count"),
            torque=(noise[:, None] * np.ones(341), "N m"),
        ),
        "probability_plot": table(
            "quantile",
            "value",
            quantile=(np.linspace(-2, 2, 40), "1"),
            value=(np.sort(noise), "N m"),
        ),
        "shift": lifted,
        "hysteresis": lifted,
    }
    results = {
        "std_torque_no_load": Quantity(0.47e-3, "N m", 0.05e-3, 39),
        "lifting_torque": Quantity(65.4e-3, "N m", 0.2e-3, 4),
        "lowering_torque": Quantity(54.6e-3, "N m", 0.2e-3, 4),
        "peak_shift_counts": Quantity(300, "count", 2, 4),
    }
    return results, tables


def corrected() -> tuple[dict[str, Quantity], dict[str, Table]]:
    """The same, read 0.2 % too high with correction; the largest load was not learned."""
    results, tables = force()
    found = dict(tables["loads"].columns)
    applied = tables["loads"]["applied_torque"].copy()
    mean, percent = 1.002 * applied, np.full(6, 0.2)
    mean[-1] = percent[-1] = np.nan
    found |= {
        "mean_torque": Column(mean, "N m"),
        "error_torque": Column(mean - applied, "N m"),
        "error_percent": Column(percent, "%"),
    }
    corrected = Table(("load",), found, "mean_torque", "")
    return results, {**tables, "loads": corrected, "loads_uncorrected": tables["loads"]}


CONTENTS = {
    "calibrate-kt": calibration,
    "stribeck": friction,
    "fft-ripple": ripple,
    "identify-plant": plant,
    "ilc-learn": learned,
    "measure-force": force,
}


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """Write a run file of a command; `folder` and `name` say where, `sets` change the recipe."""

    def write(
        command: str,
        name: str | None = None,
        *,
        folder: str = ".",
        sets: tuple[str, ...] = (),
        notes: tuple[str, ...] = (),
        inputs: tuple[Path, ...] = (),
    ) -> Path:
        path = tmp_path / folder / f"{name or command}.h5"
        path.parent.mkdir(exist_ok=True)
        recipe, text = load_recipe(RECIPE, sets)
        made = force(recipe.rig.attachment) if command == "measure-force" else CONTENTS[command]()
        if command == "measure-force" and recipe.measure_force.correction != "none":
            made = corrected()
        results, tables = made
        with ExitStack() as stack:
            used = [stack.enter_context(open_run(source)) for source in inputs]
            writer = RunWriter(
                path, command=command, recipe=recipe, recipe_text=text, seed=1, inputs=used
            )
            with writer:
                writer.finish(results, tables, notes)
        return path

    return write


@pytest.fixture
def open_all() -> Iterator[Callable[..., list[Run]]]:
    """Open run files until the test ends."""
    with ExitStack() as stack:
        yield lambda *paths: [stack.enter_context(open_run(path)) for path in paths]


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw one stand-in for the figures of a run: for tests that are not about figures."""
    monkeypatch.setattr(
        "rigtool.report.build.draw_figures",
        lambda runs: [
            Picture(f"figure-63-{label}", 63, "Fig. 63.", "<svg/>", b"\x89PNG") for label, _ in runs
        ],
    )


@pytest.fixture
def unrendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make every figure, and store a stand-in for its picture."""
    monkeypatch.setattr(
        "rigtool.report.figures.style.render_figure",
        lambda figure: ('<?xml version="1.0"?><svg/>', b"\x89PNG"),
    )
