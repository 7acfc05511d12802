"""A figure that is drawn once is the one that matplotlib draws, and nothing of it is cut off."""

import io
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.report.figures import drawing, style

SVG = "{http://www.w3.org/2000/svg}"


def _figure(rows=1, label="torque", low=0.0, high=1.0, scale="linear"):
    figure, axes = style.panels(rows, "time [s]", [label] * rows)
    for panel in axes:
        panel.plot([0, 1, 3], [low, high, low], "--o", linewidth=2.5, label="a curve")
        panel.fill_between([0, 1, 3], [low] * 3, [high] * 3, alpha=0.2, rasterized=rows == 2)
        panel.set_yscale(scale)
        panel.set_ylim(low, high)
    style.legend_above(axes[0])
    return figure


def _strokes(svg):
    """Return width, dashes and place of each line, in parts of the picture's width."""
    root = ET.fromstring(svg)
    size = float(root.get("viewBox").split()[2])
    assert float(root.get("width").removesuffix("pt")) == pytest.approx(72 * style.WIDTH, 1e-3)
    found = []
    for path in root.iter(f"{SVG}path"):
        if "fill: none" not in path.get("style", ""):
            continue
        width = re.search(r"stroke-width: ([\d.]+)", path.get("style"))
        dashes = re.search(r"stroke-dasharray: ([\d.,]+)", path.get("style"))
        dashes = [float(dash) for dash in dashes[1].split(",")] if dashes else []
        places = [float(place) for place in re.findall(r"[\d.]+", path.get("d"))]
        found.append(np.array([float(width[1]) if width else 1, *dashes, *places]) / size)
    return found


def test_the_vectors_are_those_of_matplotlib(monkeypatch):
    """Around text that is measured in pixels: its height depends on them by hinting."""
    with style.styled():
        figure = _figure()
        svg, _ = drawing.render(figure)
        pixels = drawing.RendererAgg(*figure.bbox.size, drawing.DPI)

        def measure(renderer, s, prop, ismath):
            found = pixels.get_text_width_height_descent(s, prop, ismath)
            return [size / drawing.SCALE for size in found]

        monkeypatch.setattr(drawing.RendererSVG, "get_text_width_height_descent", measure)
        own = io.StringIO()
        figure.savefig(own, format="svg")
    drawn, expected = _strokes(svg), _strokes(own.getvalue())
    assert len(drawn) == len(expected) > 3
    for line, other in zip(drawn, expected, strict=True):
        assert line == pytest.approx(other, abs=2e-5)


def test_what_is_drawn_as_pixels_is_a_picture_in_the_vectors():
    with style.styled():
        svg, png = drawing.render(_figure(2))
    assert svg.count("<image ") == 2
    assert png.startswith(b"\x89PNG")


@settings(max_examples=6, deadline=None)
@given(
    rows=st.integers(1, 3),
    label=st.sampled_from(["y", "torque at the output [mN m]"]),
    high=st.floats(1e-6, 1e6),
    scale=st.sampled_from(["linear", "log"]),
)
def test_panels_fill_the_figure_and_nothing_is_cut_off(rows, label, high, scale):
    with style.styled():
        figure = _figure(rows, label, high / 1e4, high, scale)
        drawing.lay_out(figure)
        renderer = drawing.FigureCanvasAgg(figure).get_renderer()
        boxes = [axes.get_tightbbox(renderer, for_layout_only=True) for axes in figure.axes]
    width, height = figure.bbox.size
    assert min(min(box.x0, box.y0) for box in boxes) >= 0
    assert width - 9 <= max(box.x1 for box in boxes) <= width
    assert height - 9 <= max(box.y1 for box in boxes) <= height
    for upper, lower in pairwise(boxes):
        assert upper.y0 >= lower.y1
    assert len({round(axes.get_position().height, 9) for axes in figure.axes}) == 1


def test_powers_of_ten_are_text():
    assert [drawing._power(v) for v in (0.001, 1.0, 1e12, 3.0)] == ["10⁻³", "10⁰", "10¹²", "3"]


COMMAND = """
import sys
from rigtool.report.figures import style
style.import_undocumented()
from matplotlib import artist, lines
assert "linewidth" not in (lines.Line2D.set.__doc__ or ""), "all was documented"
assert "linewidth" in artist.kwdoc(lines.Line2D), "kept from writing"
from tests.report.figures.test_drawing import _figure, drawing
with style.styled():
    svg, png = drawing.render(_figure(2, scale="log", low=0.1))
sys.stdout.buffer.write(svg.encode() + png)
"""


def test_without_documentation_matplotlib_draws_the_same():
    drawn = subprocess.run([sys.executable, "-c", COMMAND], check=True, stdout=subprocess.PIPE)
    with style.styled():
        svg, png = drawing.render(_figure(2, scale="log", low=0.1))
    assert drawn.stdout == svg.encode() + png
