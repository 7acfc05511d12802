"""What every command is told beside its sources and output."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal


@dataclass(frozen=True)
class CommonOptions:
    """The options that all commands share, as `rigtool.cli.options` collects them.

    `progress` says whether progress bars are drawn (stderr is a terminal and nobody objected).
    `overrides` are the `key=value` texts of `--set`. `dry_run` says what would move and moves
    nothing; `yes` lets a rig on a serial line move without asking; `spy` is a file for every byte
    on that line; `live` says where signals are drawn while they come, if anywhere.
    """

    json: bool = False
    quiet: bool = False
    progress: bool = False
    overwrite: bool = False
    seed: int | None = None
    overrides: tuple[str, ...] = ()
    dry_run: bool = False
    yes: bool = False
    spy: str | None = None
    live: Literal["terminal", "window"] | None = None

    def with_override(self, override: str) -> CommonOptions:
        """Return the options with one more `key=value`, which counts above those given so far."""
        return replace(self, overrides=(*self.overrides, override))
