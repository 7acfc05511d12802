"""Draws the figures of docs/odrive-cogging.md from the run files that its commands write.

python docs/figures/odrive_cogging.py FOLDER
"""

import sys
from pathlib import Path

import numpy as np

from rigtool.report.figures import style
from rigtool.runfile import open_run

HERE = Path(__file__).parent
ANGLE = "rotor angle [deg]"


def around_the_turn(run):
    """Current of the held-out run, the map, and what is left."""
    table = run.table("held_out_waveforms")
    figure, (upper, lower) = style.panels(2, ANGLE, 2 * ["current [A]"], 4.2)
    angle = np.degrees(table["position"])
    upper.plot(angle, table["ripple"], color=style.BLUE, label="held-out run")
    upper.plot(angle, table["learned"], color=style.ORANGE, linewidth=0.8, label="learned map")
    lower.plot(angle, table["ripple"], color=style.BLUE, linewidth=0.5, alpha=0.5)
    lower.plot(angle, table["remaining"], color=style.ORANGE, label="what the map leaves")
    for axes in (upper, lower):
        style.legend_above(axes)
    lower.set_xlim(0, 360)
    lower.set_xticks(range(0, 361, 60))
    return figure


def by_order(run):
    """Amplitude of each order before and after, with the noise floor of what is left."""
    table = run.table("held_out")
    figure, axes = style.one_panel("order of rotation", "amplitude [A]")
    order = table["order"]
    axes.bar(order, table["amplitude"], width=0.9, color=style.BLUE, label="held-out run")
    axes.bar(order, table["remaining"], width=0.9, color=style.ORANGE, label="what the map leaves")
    axes.plot(order, table["remaining_noise_floor"], "k", linewidth=0.7, label="noise floor")
    axes.set_yscale("log")
    axes.set_ylim(2e-4, 1)
    axes.set_xlim(0, 100)
    style.legend_above(axes, 3)
    return figure


def turned_map(run):
    """Map c beside map a, and turned back by what was found."""
    spectrum, shift = run.table("map_spectrum"), run.table("map_comparison")["shift"][2]
    angle = np.linspace(0, 2 * np.pi, 1000)
    turned = np.exp(1j * np.multiply.outer(angle, spectrum["order"]))
    a, c = (
        spectrum["amplitude"][i] * np.exp(1j * spectrum["phase"][i])  # maps in their order: a b c d
        for i in (0, 2)
    )
    back = c * np.exp(1j * spectrum["order"] * shift)
    figure, panels = style.panels(2, ANGLE, 2 * ["current [A]"], 4.2)
    for axes, other, label in (
        (panels[0], c, "map c, after a restart"),
        (panels[1], back, f"map c turned by {-np.degrees(shift):.1f} deg"),
    ):
        axes.plot(np.degrees(angle), np.real(turned @ a), color=style.BLUE, label="map a")
        axes.plot(
            np.degrees(angle),
            np.real(turned @ other),
            color=style.ORANGE,
            linewidth=0.8,
            label=label,
        )
        style.legend_above(axes)
    panels[1].set_xlim(0, 360)
    panels[1].set_xticks(range(0, 361, 60))
    return figure


def main(folder):
    """Draw all three."""
    for name, file, draw in (
        ("odrive-turn", "held-out.h5", around_the_turn),
        ("odrive-orders", "held-out.h5", by_order),
        ("odrive-maps", "maps.h5", turned_map),
    ):
        with open_run(Path(folder) / file) as run, style.styled():
            svg, png = style.render_figure(draw(run))
        (HERE / f"{name}.svg").write_text(svg)
        Path(folder, f"{name}.png").write_bytes(png)  # to look at


if __name__ == "__main__":
    main(sys.argv[1])
