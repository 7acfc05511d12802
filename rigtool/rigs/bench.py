"""What the command line says about the bench: how careful, what to log, whom to ask."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, field

from rigtool.errors import HardwareError, UsageError


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _ask(question: str) -> str:
    print(f"\n{question}", end=" ", file=sys.stderr, flush=True)  # below a bar or a drawing
    answer = sys.stdin.readline()
    if not answer:
        raise HardwareError(f"stdin ended where somebody was to answer: {question}")
    return answer.strip()


@dataclass(frozen=True)
class Operator:
    """Whoever stands at the bench, asked at the terminal.

    Nothing here goes on by itself: without a terminal (`present` is false) each question is a
    `HardwareError` that says what was to be done. `ask` and `say` are replaced in tests.
    """

    ask: Callable[[str], str] = _ask
    say: Callable[[str], None] = _say
    present: bool = field(default_factory=lambda: sys.stdin.isatty())

    def done(self, request: str) -> None:
        """Ask for something to be done at the bench and wait until it is confirmed."""
        self._require(request)
        self.ask(f"{request}, then press Enter:")

    def reading(self, what: str, unit: str) -> float:
        """Ask for a reading, e.g. `reading("force gauge", "N")`; typed wrongly, it is repeated.

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

    def _require(self, what: str) -> None:
        if not self.present:
            raise HardwareError(
                f"nobody is at the terminal to do this: {what}; run the command in a terminal"
            )


@dataclass(frozen=True)
class Bench:
    """How to go about a rig on a line.

    `yes`: move without asking first; `spy`: file that receives every byte on the line.
    """

    yes: bool = False
    spy: str | None = None
    operator: Operator = field(default_factory=Operator)

    def permit(self, plan: str) -> None:
        """Show what is about to move and ask; raises `UsageError` unless that is agreed to."""
        self.operator.say(plan)
        if self.yes:
            return
        if not self.operator.present:
            raise UsageError(
                "the rig would move now, and nobody is at the terminal to agree: look at "
                "--dry-run, then add --yes"
            )
        if not self.operator.agrees("Move now?"):
            raise UsageError("not agreed to: nothing was moved")
