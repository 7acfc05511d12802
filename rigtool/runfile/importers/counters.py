"""Counters that begin again: at a stated value, or at one that the samples show."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from rigtool.recipe.mapping import Mapping, Signal
from rigtool.runfile.importers.raw import Array, Raw
from rigtool.runfile.schema import TIME

POSITIONS = ("encoder", "position", "position_setpoint", "output_position")

CLOCK_BITS = (16, 32)
ENCODER_BITS = range(10, 33)
"""Widths of counters of time and of position."""

LARGEST_STEP, LARGEST_SMOOTH_STEP = 0.1, 0.4
"""Parts of a counter's range that no step between two samples exceeds: of any motion, and of one
whose steps differ from one to the next by no more than the first."""

OTHER_STEP = 1.5
"""A step over the end of a counter is at most as many times as large as any other."""


def unwrapped(values: Array, wraps_at: float) -> Array:
    """Return a counter (n,) that goes on over its overflows, steps of half its range."""
    turns = np.round(np.diff(values) / wraps_at)
    return values - wraps_at * np.concatenate([[0.0], np.cumsum(turns)])


def with_shown_ends(raw: Raw, mapping: Mapping) -> tuple[Mapping, list[str]]:
    """Return the mapping with the ends of counters that only the samples state, and notes."""
    found, notes = {}, []
    for name, signal in mapping.signals.items():
        values = raw.columns[signal.column]
        values = values[np.isfinite(values)]
        ends = _ends(name, signal, mapping) if signal.wraps_at is None and len(values) > 2 else ()
        end = next((end for end in ends if _begins_again(values, end)), None)
        if end is not None:
            found[name] = signal.model_copy(update={"wraps_at": end})
            zero = "; its zero is open by multiples of that" if name in POSITIONS else ""
            notes.append(f"{name} begins again at {end:.10g}: state wraps_at for it{zero}")
    return mapping.model_copy(update={"signals": mapping.signals | found}), notes


def _ends(name: str, signal: Signal, mapping: Mapping) -> Iterator[float]:
    """Yield raw values at which a signal may begin again: of a turn, or of a number of bits."""
    if name == TIME and not signal.nanoseconds:
        yield from (2.0**bits for bits in CLOCK_BITS)
    if name not in POSITIONS:
        return
    if mapping.unit(name) == "rad":
        yield 2 * math.pi / abs(mapping.factor(name) * signal.scale)
    elif name == "encoder" and mapping.rig.encoder_counts is not None:
        yield mapping.rig.encoder_counts / abs(signal.scale)
    if signal.unit == "count":
        yield from (2.0**bits for bits in ENCODER_BITS)


def _begins_again(values: Array, end: float) -> bool:
    """Return whether raw values (n,) are those of a counter with this end.

    They stay within its range, and steps over the end are like the others: a sample that is wrong
    alone is none.
    """
    steps = np.diff(values)
    over = np.abs(steps) > end / 2
    if not over.any() or over.all() or float(np.ptp(values)) > end:
        return False
    usual, whole = float(np.abs(steps[~over]).max()), np.diff(unwrapped(values, end))
    across, change = (float(np.abs(part).max()) for part in (whole[over], np.diff(whole)))
    largest = LARGEST_SMOOTH_STEP if change < LARGEST_STEP * end else LARGEST_STEP
    return usual < largest * end and across <= OTHER_STEP * usual
