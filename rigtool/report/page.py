"""The HTML page: one file, nothing outside it."""

from __future__ import annotations

from importlib.resources import files
from urllib.parse import quote

from rigtool.report.build import Report


def render_page(report: Report) -> str:
    """Return the page as HTML with all figures in it; the same report gives the same text."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(
        files("rigtool.report").joinpath("page.html").read_text("utf-8")
    )
    return template.render(report=report, data_uri=_data_uri, minus=_minus) + "\n"


def _data_uri(svg: str) -> str:
    # As an image of its own: identifiers inside one SVG cannot collide with those of another.
    # Not base64, which is a third longer.
    return "data:image/svg+xml," + quote(svg.replace("\n", " "), safe=" /:=;,()'!*-.~")


def _minus(text: str) -> str:
    """Write a leading hyphen of a number as the minus sign that it means."""
    return "−" + text[1:] if text.startswith("-") else text
