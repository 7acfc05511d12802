"""A figure laid out once and drawn once, as pixels and as vectors.

matplotlib goes through all parts of a figure for each output, and twice more for its constrained
layout: most of the time that a figure takes. Here the layout measures each panel once, and one pass
draws for both outputs.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backend_bases import GraphicsContextBase, RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.backends.backend_mixed import MixedModeRenderer
from matplotlib.backends.backend_svg import RendererSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from PIL import Image

DPI = 150
"""Pixels in an inch of a PNG."""

SCALE = DPI / 72
"""Pixels in a point."""

PAD = 0.045
"""Room around a panel with its labels, inches."""

MAX_LAYOUTS = 3
"""Layouts after which the ticks of a figure are taken as they are."""

COMPRESSION = 3
"""Level of deflate of a PNG: half the time of the default 6, files 3 % larger."""


def lay_out(figure: Figure, renderer: Any = None) -> None:
    """Give the panels of a figure's grid the room that their labels leave.

    Labels are measured again only where the new size of a panel changed its ticks. Axes that are
    placed by hand stay where they are.
    """
    for axes in figure.axes:
        _write_powers(axes)
    panels = [axes for axes in figure.axes if axes.get_subplotspec() is not None]
    renderer = renderer or FigureCanvasAgg(figure).get_renderer()
    for _ in range(MAX_LAYOUTS if panels else 0):
        ticks = _ticks(panels)
        _place(figure, panels, renderer)
        if _ticks(panels) == ticks:
            break


def _write_powers(axes: Axes) -> None:
    """Write powers of ten at logarithmic axes as text: matplotlib parses a formula for each."""
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            axis.set_major_formatter(FuncFormatter(_power))


def _power(value: float, place: int | None = None) -> str:
    exponent = math.log10(value) if value > 0 else math.nan
    if not exponent.is_integer():
        return f"{value:g}"
    return "10" + f"{exponent:.0f}".translate(_SUPERSCRIPTS)


_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def _ticks(panels: list[Axes]) -> list[list[float]]:
    return [
        axis.get_majorticklocs().tolist() for axes in panels for axis in (axes.xaxis, axes.yaxis)
    ]


def _place(figure: Figure, panels: list[Axes], renderer: Any) -> None:
    """Place each panel by what its labels need now; all rows and columns keep their ratios."""
    grid: Any = panels[0].get_gridspec()
    pad = PAD / figure.get_size_inches()
    columns, rows = np.full((grid.ncols, 2), pad[0]), np.full((grid.nrows, 2), pad[1])
    places = []
    for axes in panels:
        spec: Any = axes.get_subplotspec()
        column, row = spec.colspan.start, spec.rowspan.start
        places.append((axes, column, row))
        own = axes.get_position(original=True)
        tight: Any = axes.get_tightbbox(renderer, for_layout_only=True)
        whole = tight.transformed(figure.transFigure.inverted())
        sides = own.x0 - whole.x0, whole.x1 - own.x1
        columns[column] = np.maximum(columns[column], pad[0] + sides)
        ends = whole.y1 - own.y1, own.y0 - whole.y0
        rows[row] = np.maximum(rows[row], pad[1] + ends)
    left, width = _cells(columns, grid.get_width_ratios())
    top, height = _cells(rows, grid.get_height_ratios())
    for axes, column, row in places:
        bottom = 1 - top[row] - height[row]
        axes.set_position((left[column], bottom, width[column], height[row]))


def _cells(margins: Any, ratios: Any) -> tuple[Any, Any]:
    """Return starts and sizes of cells one after another between margins, (n, 2), in all 1."""
    shares = np.asarray(ratios, dtype=float) / np.sum(ratios)
    sizes = shares * max(0.1, 1 - margins.sum())
    return np.cumsum(margins.sum(axis=1) + sizes) - sizes - margins[:, 1], sizes


def render(figure: Figure) -> tuple[str, bytes]:
    """Return the figure as SVG and PNG; equal figures give equal bytes."""
    figure.dpi = DPI
    canvas = FigureCanvasAgg(figure)
    pixels, svg, png = canvas.get_renderer(), io.StringIO(), io.BytesIO()
    width, height = int(pixels.width), int(pixels.height)
    vectors = _Vectors(width, height, svg, metadata={"Date": None})
    both: Any = _Both(pixels, MixedModeRenderer(figure, width / DPI, height / DPI, DPI, vectors))
    lay_out(figure, both)
    figure.draw(both)
    vectors.finalize()
    image = Image.fromarray(np.asarray(pixels.buffer_rgba())).convert("RGB")
    image.save(png, "png", dpi=(DPI, DPI), compress_level=COMPRESSION)
    text = _SIZE.sub(_in_points, svg.getvalue(), count=2)
    return _PATH.sub(_rounded, text), png.getvalue()


def save(figure: Figure, kind: str) -> bytes:
    """Return the figure in one format that matplotlib writes."""
    lay_out(figure)
    picture = io.BytesIO()
    figure.savefig(picture, format=kind)
    return picture.getvalue()


class _Both:
    """Draws pixels, and the same with vectors; all else is answered by the pixels."""

    def __init__(self, pixels: RendererAgg, vectors: MixedModeRenderer) -> None:
        self._pixels, self._vectors = pixels, vectors

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._pixels, name)
        if not name.startswith(("draw_", "open_", "close_", "start_", "stop_")):
            return found
        return _in_turn(found, getattr(self._vectors, name))


def _in_turn(first: Callable[..., None], second: Callable[..., None]) -> Callable[..., None]:
    def call(*arguments: Any, **options: Any) -> None:
        first(*arguments, **options)
        second(*arguments, **options)

    return call


class _Vectors(RendererSVG):
    """An SVG whose unit is a pixel instead of a point: what is in points has as many of them."""

    def draw_text(
        self, gc: Any, x: float, y: float, s: str, prop: Any, *others: Any, **options: Any
    ) -> None:
        scaled = prop.copy()
        scaled.set_size(prop.get_size_in_points() * SCALE)
        super().draw_text(gc, x, y, s, scaled, *others, **options)

    def draw_path(self, gc: Any, *others: Any, **options: Any) -> None:
        super().draw_path(_scaled(gc), *others, **options)

    def draw_markers(self, gc: Any, *others: Any, **options: Any) -> None:
        super().draw_markers(_scaled(gc), *others, **options)

    draw_path_collection = RendererBase.draw_path_collection  # by way of draw_path


def _scaled(gc: Any) -> Any:
    """Return a context with lines as wide, and dashes as long, in pixels as these are in points."""
    scaled: Any = GraphicsContextBase()
    scaled.copy_properties(gc)
    scaled.set_linewidth(gc.get_linewidth() * SCALE)
    offset, dashes = gc.get_dashes()
    scaled.set_dashes(offset * SCALE, None if dashes is None else np.multiply(dashes, SCALE))
    return scaled


_SIZE = re.compile(r'\b[\d.]+(?=pt")')
_PATH = re.compile(r' d="[^"]*"')
_NUMBER = re.compile(r"-?\d+\.\d{3,}")


def _in_points(size: re.Match[str]) -> str:
    """Return the size of a page in points; its coordinates stay pixels."""
    return f"{float(size[0]) / SCALE:g}"


def _rounded(path: re.Match[str]) -> str:
    """Round the coordinates of a path to a hundredth of a pixel: half the size, the same picture.

    matplotlib writes six decimals and has no setting for that.
    """
    return _NUMBER.sub(lambda number: f"{float(number[0]):.2f}", path[0]).replace("\n", " ")
