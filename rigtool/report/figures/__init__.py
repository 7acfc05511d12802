"""The thesis's figures, drawn from the tables of run files: same axes, same units."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rigtool.report.figures import force, learning, motor, plant, ripple, style, suspension

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rigtool.runfile import Run


@dataclass(frozen=True)
class Plot:
    """How to draw one figure of the thesis: from which tables of which command's runs."""

    number: int
    command: str
    tables: tuple[str, ...]
    title: str
    draw: Callable[[Run], Figure]


PLOTS = (
    Plot(
        20,
        "calibrate-kt",
        ("torque_constant",),
        "Motor constant as function of motor temperature",
        motor.motor_constant,
    ),
    Plot(
        22,
        "stribeck",
        ("breakaway_ramp",),
        "Static friction: one slow ramp of torque",
        motor.breakaway,
    ),
    Plot(
        23, "fft-ripple", ("power_waveforms",), "Ripple after power off and on", ripple.power_cycles
    ),
    Plot(24, "fft-ripple", ("revolutions",), "Ripple of single revolutions", ripple.revolutions),
    Plot(
        25,
        "fft-ripple",
        ("torque_waveforms",),
        "Ripple grows with motor current",
        ripple.ripple_by_current,
    ),
    Plot(
        26,
        "fft-ripple",
        ("torque_waveforms", "torque_spectrum"),
        "Ripple changes its shape with motor current",
        ripple.shape_by_current,
    ),
    Plot(
        27, "fft-ripple", ("speed_waveforms",), "Ripple at all motor speeds", ripple.ripple_by_speed
    ),
    Plot(28, "fft-ripple", ("speed_psd",), "PSD of the ripple in Figure 27", ripple.psd_by_speed),
    Plot(
        30,
        "stribeck",
        ("torque_speed",),
        "Torque-speed curve without compensation",
        motor.torque_speed,
    ),
    Plot(
        32,
        "stribeck",
        ("torque_speed", "torque_speed_coulomb"),
        "Torque-speed curve with Coulomb friction compensation",
        motor.torque_speed_coulomb,
    ),
    Plot(
        34,
        "stribeck",
        ("torque_speed", "torque_speed_viscous"),
        "Torque-speed curve with Coulomb and viscous friction compensation",
        motor.torque_speed_viscous,
    ),
    Plot(
        35,
        "identify-plant",
        ("frequency_response", "fit"),
        "Frequency response of the plant, and its mass line",
        plant.measured_plant,
    ),
    Plot(
        39,
        "identify-plant",
        ("frequency_response", "fit"),
        "Fitted and measured frequency response of the plant",
        plant.fitted_plant,
    ),
    Plot(
        40,
        "ilc-learn",
        ("transfer",),
        "Complementary sensitivity T and learning filter L, its inverse",
        plant.learning_filter,
    ),
    Plot(41, "ilc-learn", ("convergence",), "Convergence criterion", plant.convergence),
    Plot(
        50,
        "ilc-learn",
        ("lookup",),
        "Content of the two-dimensional lookup table",
        learning.lookup_table,
    ),
    Plot(
        56,
        "ilc-learn",
        ("residual_waveforms",),
        "Feed-forward and remaining disturbance",
        learning.residual,
    ),
    Plot(
        58,
        "measure-force",
        ("feedforward",),
        "Feed-forward signal at the measuring speed",
        force.feedforward,
    ),
    Plot(
        59,
        "measure-force",
        ("cycles_no_load",),
        "Variation over the cycles without load",
        force.variation,
    ),
    Plot(
        60,
        "measure-force",
        ("probability_plot",),
        "Normal probability plot of the readings without load",
        force.probability_plot,
    ),
    Plot(
        61,
        "measure-force",
        ("feedforward",),
        "Feed-forward and remaining disturbance of one cycle",
        force.remaining,
    ),
    Plot(62, "measure-force", ("shift",), "High torque: the peak is shifted", force.shift),
    Plot(
        63, "measure-force", ("hysteresis",), "Lifting and lowering a mass", force.lifting_lowering
    ),
    Plot(
        76,
        "identify-plant",
        ("frequency_response", "sensitivities"),
        "Open loop and sensitivities with the measured plant",
        plant.open_loop,
    ),
    Plot(
        70,
        "suspension",
        ("spring_curve",),
        "Spring constant of the motor's suspension",
        suspension.spring_curve,
    ),
    Plot(
        75,
        "suspension",
        ("eccentric_torque",),
        "Disturbance torque due to pulley eccentricity",
        suspension.eccentric_torque,
    ),
)
"""In the order of the thesis."""


@dataclass(frozen=True)
class Picture:
    """One figure as bytes; `name` is the stem of its files, `number` that of the thesis."""

    name: str
    number: int
    title: str
    svg: str
    png: bytes


def draw_figures(run: Run, label: str) -> Iterator[Picture]:
    """Draw every figure whose tables the run holds; `label` tells this run from others."""
    for plot in PLOTS:
        if plot.command == run.command and all(name in run.tables for name in plot.tables):
            with style.styled():
                svg, png = style.render(plot.draw(run))
            title = f"Fig. {plot.number}. {plot.title} ({label})"
            yield Picture(f"figure-{plot.number}-{label}", plot.number, title, svg, png)
