"""Style of the figures, and their reproducible output as bytes.

Without pyplot there is no global state and no window, and a user's matplotlibrc has no effect.
Colours are those of Okabe and Ito (2008), distinct for the colour-blind. In grey they are alike:
lines that cross differ in their dashes.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rigtool.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE = "#0072B2"
ORANGE = "#D55E00"
GREEN = "#009E73"
PURPLE = "#CC79A7"
YELLOW = "#E69F00"
SKY = "#56B4E9"
BLACK = "#000000"
GREY = "#767676"
BAND = "#EFEFEF"
CYCLE = (BLUE, ORANGE, GREEN, PURPLE, YELLOW, SKY, BLACK)
DASHES = ("-", "--", "-.", ":")
COLOUR_MAP = "cividis"

WIDTH = 6.3
"""Text width of an A4 page, inches."""
HEIGHT = 3.4

_STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.formatter.useoffset": False,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "svg.hashsalt": "rigtool",
    "svg.fonttype": "path",
    "path.simplify_threshold": 0.3,
    # About where the labels of most figures leave a panel: its ticks stay what they are there.
    "figure.subplot.left": 0.09,
    "figure.subplot.right": 0.99,
    "figure.subplot.bottom": 0.13,
    "figure.subplot.top": 0.92,
}


@contextmanager
def styled() -> Iterator[None]:
    """Set matplotlib's defaults and the style, for figures made and saved in this context.

    All that draws is imported here, before a process is copied. Raises `UsageError` as
    `import_drawing`.
    """
    import_drawing()
    import matplotlib
    from cycler import cycler

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE | {"axes.prop_cycle": cycler(color=CYCLE)})
        yield


def import_drawing() -> None:
    """Import all that draws. Raises `UsageError` where the user's own settings prevent it."""
    try:
        from rigtool.report.figures import drawing  # noqa: F401
    except (OSError, ValueError) as error:
        raise UsageError(f"matplotlib: {error}: correct MPLBACKEND or its matplotlibrc") from None


def import_undocumented() -> None:
    """Do as `import_drawing`, for a command, where nobody reads matplotlib's documentation.

    It is written while matplotlib is imported, and takes half of that: a text and a signature of
    all that can be set of each kind of artist.
    """
    try:
        from matplotlib import artist
    except (OSError, ValueError):
        return import_drawing()
    writers = [(artist, "kwdoc"), (artist.Artist, "_update_set_signature_and_docstring")]
    kept = [(owner, name, vars(owner)[name]) for owner, name in writers if name in vars(owner)]
    try:
        for owner, name, _ in kept:
            setattr(owner, name, lambda *_: "")
        import_drawing()
    finally:
        for owner, name, writer in kept:
            setattr(owner, name, writer)


def empty(height: float = HEIGHT, width: float = WIDTH) -> Figure:
    """Return a figure without axes; height and width in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height))


def one_panel(x: str, y: str, height: float = HEIGHT) -> tuple[Figure, Axes]:
    """Return a figure with one pair of axes and their labels."""
    figure, (axes,) = panels(1, x, [y], height)
    return figure, axes


def panels(
    count: int, x: str, ys: list[str], height: float = HEIGHT, **options: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure with `count` panels, one above the other, on one abscissa."""
    figure = empty(height)
    grid = figure.subplots(count, 1, sharex=True, squeeze=False, **options)
    axes = [row[0] for row in grid]
    for panel, label in zip(axes, ys, strict=True):
        panel.set_ylabel(label)
    axes[-1].set_xlabel(x)
    return figure, axes


def points(axes: Axes, x: Any, y: Any, bar: Any, label: str, **options: Any) -> None:
    """Draw measured points with error bars; `bar` None draws none."""
    drawn: dict[str, Any] = {
        "fmt": "o",
        "color": BLUE,
        "markersize": 3.5,
        "capsize": 2,
        "linewidth": 0.9,
    }
    axes.errorbar(x, y, bar, label=label, **(drawn | options))


def legend_above(axes: Axes, columns: int = 3) -> None:
    """Place the legend above the plot, where it covers nothing."""
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=columns, borderaxespad=0.2)


def colours(count: int) -> list[Any]:
    """Return distinct colours: those of `CYCLE`, or shades of `COLOUR_MAP` where it has too few."""
    from matplotlib import colormaps

    if count <= len(CYCLE):
        return list(CYCLE[:count])
    return [colormaps[COLOUR_MAP](index / (count - 1) * 0.92) for index in range(count)]


def render_figure(figure: Figure) -> tuple[str, bytes]:
    """Return the figure as SVG and PNG, drawn once; equal figures give equal bytes."""
    from rigtool.report.figures import drawing

    return drawing.render(figure)


def save_figure(figure: Figure, kind: str) -> bytes:
    """Return the figure in one format: png, svg or pdf."""
    from rigtool.report.figures import drawing

    return drawing.save(figure, kind)
