"""The HTML page: one file, nothing outside it."""

from __future__ import annotations

from importlib.resources import files
from urllib.parse import quote

from rigtool.errors import UsageError
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


def require_pdf() -> None:
    """Raise `UsageError` where the program that prints the page is not installed."""
    try:
        import weasyprint  # noqa: F401
    except (ImportError, OSError):  # OSError: it is there, the libraries that it needs are not
        raise UsageError(
            "--pdf needs WeasyPrint and Pango: pip install rigtool[pdf], and Pango from your "
            "system; or print index.html from a browser"
        ) from None


def render_pdf(page: str) -> bytes:
    """Return the page as PDF on A4; the same page gives the same bytes."""
    import hashlib

    import weasyprint

    # WeasyPrint would name the file by the time.
    identifier = hashlib.sha256(page.encode()).digest()[:16]
    found: bytes = weasyprint.HTML(string=page).write_pdf(pdf_identifier=identifier)
    return found


def _data_uri(svg: str) -> str:
    # As an image of its own: identifiers inside one SVG cannot collide with those of another.
    # Not base64, which is a third longer.
    return "data:image/svg+xml," + quote(svg.replace("\n", " "), safe=" /:=;,()'!*-.~")


def _minus(text: str) -> str:
    """Write a leading hyphen of a number as the minus sign that it means."""
    return "−" + text[1:] if text.startswith("-") else text
