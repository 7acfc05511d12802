"""Errors that a user can meet, each with the exit code of the command line.

Every message gives the value that was found, the limit that it violates, and a remedy.
"""

from __future__ import annotations

from collections.abc import Iterable


def did_you_mean(name: str, known: Iterable[str], otherwise: str = "") -> str:
    """Return the question for the known name nearest to a misspelt one, or another remedy."""
    import difflib  # only here: the time of `rigtool --help` counts

    close = difflib.get_close_matches(name, list(known), 1, cutoff=0.75)
    return f"did you mean {close[0]}?" if close else otherwise


class RigtoolError(Exception):
    """Base of all errors that rigtool raises on purpose (exit code 1, failed while running)."""

    exit_code = 1


class UsageError(RigtoolError):
    """The command line asks for something that cannot be done as asked (exit code 2)."""

    exit_code = 2


class RecipeError(RigtoolError, ValueError):
    """A recipe cannot be read or does not describe a rig (exit code 3)."""

    exit_code = 3


class RunFileError(RigtoolError, ValueError):
    """A run file cannot be read, is damaged, or is of another kind than needed (exit code 3)."""

    exit_code = 3


class InsufficientDataError(RigtoolError, ValueError):
    """The data do not support the requested result (exit code 4)."""

    exit_code = 4


class HardwareError(RigtoolError, OSError):
    """A rig or an instrument beside it fails (exit code 5)."""

    exit_code = 5
