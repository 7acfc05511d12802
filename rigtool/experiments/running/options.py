"""The options that all commands share, in addition to sources and output."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal


@dataclass(frozen=True)
class CommonOptions:
    """Options as `rigtool.cli.options` collects them.

    With `progress`, progress bars are drawn (stderr is a terminal and --quiet was not given).
    `overrides` are the `key=value` texts of `--set`. `dry_run` lists the motions and moves nothing;
    `yes` lets a rig on a serial line move without asking; `spy` is a file for every byte on that
    line; `live` is where signals are drawn as they arrive, None for nowhere. With `stream`, stdout
    takes values as lines of JSON during the measurement, and nothing else.
    """

    progress: bool = False
    overwrite: bool = False
    seed: int | None = None
    overrides: tuple[str, ...] = ()
    dry_run: bool = False
    yes: bool = False
    spy: str | None = None
    live: Literal["terminal", "window"] | None = None
    stream: bool = False

    def with_override(self, override: str) -> CommonOptions:
        """Return the options with one more `key=value`, which overrules those given so far."""
        return replace(self, overrides=(*self.overrides, override))
