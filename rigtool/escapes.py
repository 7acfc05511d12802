"""Text from outside, escaped for each language that rigtool writes: no part acts as code."""

from __future__ import annotations

import re

_INVISIBLE = (*range(0x20), *range(0x7F, 0xA0), 0x61C, 0x200E, 0x200F, 0x2028, 0x2029)
_BIDI = (*range(0x202A, 0x202F), *range(0x2066, 0x206A))
_VISIBLE = {
    code: f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
    for code in (*_INVISIBLE, *_BIDI)
    if chr(code) not in "\n\t"
}
_FORMULA = re.compile(r"[=+\-@\t\r\n＝＋－＠]")
_LATEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "%": r"\%",
        "&": r"\&",
        "#": r"\#",
        "_": r"\_",
        "$": r"\$",
        "{": r"\{",
        "}": r"\}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "–": "--",
    }
)


def terminal(text: str) -> str:
    """Show control characters and changes of direction, which a terminal would obey, as codes."""
    return text.translate(_VISIBLE)


def one_line(text: str) -> str:
    """Return text without ends of lines, control characters as `terminal` shows them."""
    return terminal(" ".join(text.splitlines()).replace("\t", " "))


def c_comment(text: str) -> str:
    """Return a line within a comment of C, which no part of it ends; no trigraph is left."""
    apart = one_line(text).replace("*/", "* /").replace("/*", "/ *")
    return re.sub(r"\?(?=\?)", "? ", apart)


def csv_text(text: str) -> str:
    """Return a field that no spreadsheet takes for a formula (OWASP, CSV Injection)."""
    return f"'{text}" if _FORMULA.match(text) else text


def markdown(text: str) -> str:
    """Return text within a line of Markdown: no HTML, no links, no code, no end of a cell."""
    plain = one_line(text).replace("\\", "\\\\").replace("<", "&lt;")
    return plain.replace("|", r"\|").replace("`", r"\`").replace("](", r"]\(")


def latex(text: str) -> str:
    """Return text within LaTeX; a hyphen before a digit is a minus sign, in maths mode."""
    escaped = one_line(text).translate(_LATEX)
    return f"${escaped}$" if text[:1] in "+-" and text[1:2].isdigit() else escaped


def latex_label(text: str) -> str:
    r"""Return the key of a `\label`."""
    return re.sub(r"[^\w.:-]", "-", text)


def figure(text: str) -> str:
    """Return text in a figure of matplotlib: a dollar begins no formula."""
    return one_line(text).replace("$", r"\$")


def is_text(name: str) -> bool:
    """Return whether a name is text without NUL; file systems also have names that are none."""
    return not any(character == "\0" or "\ud800" <= character <= "\udfff" for character in name)
