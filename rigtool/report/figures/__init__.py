"""The thesis's figures, drawn from the tables of run files: same axes, same units."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rigtool.report.figures import (
    force,
    instrument,
    learning,
    motor,
    plant,
    ripple,
    style,
    suspension,
    sweep,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rigtool.runfile import Run


OWN = 101
"""Number of the first figure that is not in the thesis."""


@dataclass(frozen=True)
class Plot:
    """How to draw one figure of the thesis: from which tables of which command's runs.

    `implementations` are the ways of learning that it shows, any where empty.
    """

    number: int
    command: str
    tables: tuple[str, ...]
    title: str
    draw: Callable[[Run], Figure]
    implementations: tuple[str, ...] = ()

    def fits(self, run: Run) -> bool:
        """Say whether a run is of the command, learned in one of the ways, and has the tables."""
        if self.command != run.command or not all(name in run.tables for name in self.tables):
            return False
        learned = "C" if run.recipe is None else run.recipe.ilc_learn.implementation
        return not self.implementations or learned in self.implementations


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
    Plot(42, "ilc-learn", ("tuning",), "Amplitude and phase tables by speed", sweep.tuning),
    Plot(
        44,
        "ilc-learn",
        ("iterations",),
        "Disturbance as function of the number of learning runs",
        sweep.iterations,
        ("A", "standard"),
    ),
    Plot(
        46,
        "ilc-learn",
        ("sweep",),
        "No repetitive disturbance compensation",
        sweep.without,
        ("A",),
    ),
    Plot(
        47,
        "ilc-learn",
        ("sweep",),
        "Implementation A, amplitude and phase tables not active",
        sweep.without_tables,
        ("A",),
    ),
    Plot(
        48,
        "ilc-learn",
        ("sweep",),
        "Implementation A, amplitude and phase tables active",
        sweep.compensated,
        ("A",),
    ),
    Plot(
        50,
        "ilc-learn",
        ("lookup",),
        "Content of the two-dimensional lookup table",
        learning.lookup_table,
        ("B", "C", "D"),
    ),
    Plot(
        51,
        "ilc-learn",
        ("sweep",),
        "Disturbance and feed-forward from the table",
        sweep.disturbance_and_table,
        ("B",),
    ),
    Plot(
        52,
        "ilc-learn",
        ("sweep",),
        "Implementation B, torque over speed",
        sweep.without_tables,
        ("B",),
    ),
    Plot(
        54,
        "ilc-learn",
        ("sweep",),
        "Implementation B with amplitude table, torque over speed",
        sweep.compensated_and_table,
        ("B",),
    ),
    Plot(
        56,
        "ilc-learn",
        ("residual_waveforms",),
        "Feed-forward and remaining disturbance",
        learning.residual,
        ("C", "D"),
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
    Plot(
        OWN,
        "measure-force",
        ("series", "levels"),
        "Torque at the load over time: from effort and motion, and by the sensor",
        instrument.by_time,
    ),
    Plot(
        OWN + 1,
        "measure-force",
        ("series", "levels"),
        "Hysteresis: effort of the motor against torque at the load",
        instrument.hysteresis,
    ),
    Plot(
        OWN + 2,
        "measure-force",
        ("series", "levels"),
        "Error by load: median and 95 % of the samples of each run",
        instrument.error_by_level,
    ),
)
"""In the order of the thesis, then those that it does not have."""


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
        if plot.fits(run):
            with style.styled():
                svg, png = style.render(plot.draw(run))
            number = f"Fig. {plot.number}. " if plot.number < OWN else ""
            title = f"{number}{plot.title} ({label})"
            yield Picture(f"figure-{plot.number}-{label}", plot.number, title, svg, png)
