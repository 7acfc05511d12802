"""The HTML page: one self-contained file."""

from __future__ import annotations

from importlib.resources import files
from typing import Any
from urllib.parse import quote

from rigtool.errors import UsageError
from rigtool.report.build import Report


def render_page(report: Report) -> str:
    """Return the page as HTML with all figures in it; the same report gives the same text."""
    source = files("rigtool.report").joinpath("page.html").read_text("utf-8")
    return render_template(source, report=report, data_uri=_data_uri, minus=_minus) + "\n"


def render_template(source: str, **values: Any) -> str:
    """Return the text of a template filled with values; text in them is escaped."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(source).render(**values)


def require_pdf() -> None:
    """Raise `UsageError` where WeasyPrint, which makes the PDF, is not installed."""
    try:
        import weasyprint  # noqa: F401
    except (ImportError, OSError):  # OSError: a library that it needs is missing
        raise UsageError(
            "--pdf needs WeasyPrint and Pango: pip install rigtool[pdf], and Pango from your "
            "system; or print index.html from a browser"
        ) from None


def render_pdf(page: str) -> bytes:
    """Return the page as PDF on A4; the same page gives the same bytes."""
    import hashlib

    import weasyprint

    # By default WeasyPrint identifies the file by the time.
    identifier = hashlib.sha256(page.encode()).digest()[:16]
    return weasyprint.HTML(string=page).write_pdf(pdf_identifier=identifier)


def _data_uri(svg: str) -> str:
    # An image of its own: identifiers inside one SVG cannot collide with those of another.
    # base64 would be a third longer.
    return "data:image/svg+xml," + quote(svg.replace("\n", " "), safe=" /:=;,()'!*-.~")


def _minus(text: str) -> str:
    """Replace the leading hyphen of a number by a minus sign."""
    return "−" + text[1:] if text.startswith("-") else text
