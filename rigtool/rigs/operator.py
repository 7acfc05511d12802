"""The operator: gives permission to move, and does the manual work at the rig."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, field

from rigtool.errors import HardwareError, UsageError
from rigtool.escapes import terminal


def _say(text: str) -> None:
    """Show text at the terminal, that of a device too, which may hold anything."""
    print(terminal(text), file=sys.stderr, flush=True)


def _ask(question: str) -> str:
    # Below a bar or a drawing.
    print(f"\n{terminal(question)}", end=" ", file=sys.stderr, flush=True)
    answer = sys.stdin.readline()
    if not answer:
        raise HardwareError(f"stdin ended before an answer to: {question}")
    return answer.strip()


@dataclass(frozen=True)
class Operator:
    """The person at the rig, asked at the terminal.

    Without a terminal (`present` is false) each question raises a `HardwareError` that states the
    task. `yes` (--yes) is consent in advance; `spy` (--spy) is the file that receives every byte on
    the line. `ask` and `say` are replaced in tests.
    """

    ask: Callable[[str], str] = _ask
    say: Callable[[str], None] = _say
    present: bool = field(default_factory=lambda: sys.stdin.isatty())
    yes: bool = False
    spy: str | None = None

    def done(self, request: str) -> None:
        """Ask for something to be done at the bench and wait until it is confirmed."""
        self._require(request)
        self.ask(f"{request}, then press Enter:")

    def reading(self, what: str, unit: str) -> float:
        """Ask for a reading, e.g. `reading("force gauge", "N")`; after a typing error, ask again.

        The value is shown once more: only Enter takes it; `r`, or anything else, reads again.
        """
        self._require(f"read {what}")
        while True:
            text = self.ask(f"{what} [{unit}]:")
            try:
                value = float(text.replace(",", "."))
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                self.say(f"{text!r} is not a number of {unit}")
                continue
            answer = self.ask(f"{what} {value:g} {unit}: Enter to take it, r to repeat:")
            if not answer:
                return value
            if answer != "r":  # perhaps the right value, typed at the wrong question
                self.say(f"{value:g} {unit} is not taken: type the reading, then Enter alone")

    def agrees(self, question: str) -> bool:
        """Ask a question; only `y` or `yes` agrees."""
        self._require(question)
        return self.ask(f"{question} [y/N]").lower() in ("y", "yes")

    def permit(self, plan: str, consequence: str, question: str) -> None:
        """Show a plan and ask for consent; raises `UsageError` without it.

        `consequence` states the result of a yes, e.g. "the rig would move".
        """
        self.say(plan)
        if self.yes:
            return
        if not self.present:
            raise UsageError(
                f"{consequence} now, and nobody is at the terminal to agree: look at --dry-run, "
                "then add --yes"
            )
        if not self.agrees(question):
            raise UsageError("not agreed to: nothing was changed")

    def _require(self, what: str) -> None:
        if not self.present:
            raise HardwareError(
                f"nobody is at the terminal to do this: {what}; run the command in a terminal"
            )
