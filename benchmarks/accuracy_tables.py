"""Tables of docs/theory/force-accuracy.md, of what `learned.py` measured."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from oracle import BANDS, MOTIONS, Key, Score, sum_of

from rigtool.experiments.force_filter.accuracy import JUDGED_STATES
from rigtool.experiments.force_filter.motion_states import STATE_NAMES

Condition = tuple[int, str]
CONDITIONS: tuple[Condition, ...] = ((0, "pulses"), (1, "pulses"), (0, "weak"), (1, "weak"))
"""Power-up of the amplifier, which was learned at 0, and contacts."""

FORMS = ("smoothed", "causal")
LIMITS = {"moving": 1.3, "reversal": 1.5, "rest": 1.5}
"""States of the motion, and the error over the known estimator's that is asked for."""

LARGEST, LOADS = 60e-3, (0.0, 0.01, 0.05, 0.2, 1.0)
"""Largest torque that is learned, N m, and edges of bands of it."""

ROW_TIME = 5e-3
"""Time of a row of the reading at the largest of `BANDS`, s."""

Scores = dict[Key, Score]


@dataclass(frozen=True)
class Found:
    """A rig: learned parameters over true ones, scores of what was learned and of the oracle."""

    rig: str
    seed: int
    over: dict[str, float]
    scores: dict[Condition, tuple[Scores, Scores]]


def cells() -> Iterator[tuple[int, int, str]]:
    """Yield the number of each band of load, a state of the reading, and what both are called."""
    for number, low in enumerate(LOADS[:-1]):
        for state in JUDGED_STATES:
            yield number, state, f"from {1e3 * LARGEST * low:g} mN m, {STATE_NAMES[state]}"


def print_tables(found: Sequence[Found]) -> None:
    """Print, as Markdown: errors over the oracle's by condition, rigs and single rig, the share of
    errors within the intervals by load and state; learned parameters over true ones."""
    for band in BANDS:
        print(f"\nby condition, {band:g} Hz\n")
        _head("contacts, power-up, motion", *LIMITS, *HEADS)
        for contacts in ("pulses", "weak"):
            for power_cycle in (0, 1):
                for motion in MOTIONS:
                    print(_by_condition(found, (power_cycle, contacts), motion, band))
        _print_single_ratios(found, band)
    sets: dict[int, list[Found]] = {}
    for one in found:
        sets.setdefault(one.seed // 10, []).append(one)
    _print_by_rigs({f"{own[0].seed} to {own[-1].seed}": own for own in sets.values()})
    _print_by_rigs({f"{one.rig} ({one.seed})": [one] for one in found} | {"all": list(found)})
    for power_cycle in (0, 1):
        own = [(power_cycle, contacts) for contacts in ("pulses", "weak")]
        print(f"power-up {power_cycle}:", *(_holds(found, own, motion) for motion in MOTIONS))
    print("\nby load and state\n")
    _head("load, state", *(f"{contacts}, {power_cycle}" for power_cycle, contacts in CONDITIONS))
    for *_, cell in cells():
        _line(cell, *(_pair(_in_cell(found, [c], cell, True)) for c in CONDITIONS))
    print("\nall contacts and power-ups together\n")
    for *_, cell in cells():
        _line(cell, _pair(_in_cell(found, list(CONDITIONS), cell, True)))
    print("\nlearned over true: median, least, largest")
    for name in found[0].over:
        over = [one.over[name] for one in found]
        print(f"  {name:56}{np.median(over):8.3f}{min(over):8.3f}{max(over):8.3f}", flush=True)


HEADS = ("all, mN m", "95 % holds in (known), %", "width at rest", "score over known's")


def _head(*names: str) -> None:
    _line(*names)
    print("| --- " * len(names) + "|")


def _line(*texts: str) -> None:
    print("| " + " | ".join(texts) + " |")


def _pair(texts: Sequence[str]) -> str:
    return " / ".join(texts)


Both = tuple[Score, Score]
"""Scores of what was learned, and of the oracle."""


def _sum(
    found: Sequence[Found],
    conditions: Sequence[Condition],
    motions: Sequence[str],
    form: str,
    band: float,
    state: str,
) -> Both:
    """Return the scores of rigs, conditions and motions together."""
    keys = [(motion, form, band, state) for motion in motions]
    both = [one.scores[condition] for one in found for condition in conditions]
    own, known = (sum_of([each[place][key] for each in both for key in keys]) for place in (0, 1))
    return own, known


def _ratio(both: Both) -> float:
    own, known = (math.sqrt(one.squares / max(one.count, 1)) for one in both)
    return own / known if known else math.nan


def _share(one: Score) -> float:
    return 100 * one.covered / one.count


def _of_all(each: Sequence[Both]) -> list[str]:
    """Return error, share within the intervals and score of both forms."""
    return [
        _pair([f"{1e3 * math.sqrt(own.squares / own.count):.2f}" for own, _ in each]),
        _pair([f"{_share(own):.1f} ({_share(known):.1f})" for own, known in each]),
        _pair(
            [
                f"{own.interval_scores / own.count / (known.interval_scores / known.count):.2f}"
                for own, known in each
            ]
        ),
    ]


def _by_condition(found: Sequence[Found], condition: Condition, motion: str, band: float) -> str:
    """Return a row of the table by condition; in brackets the largest ratio of a rig and form."""
    texts = []
    for state in LIMITS:
        each = [_ratio(_sum(found, [condition], [motion], form, band, state)) for form in FORMS]
        single = max(ratio for *_, ratio in _single(found, [condition], [motion], band, state))
        texts.append(f"{_pair([f'{ratio:.2f}' for ratio in each])} ({single:.2f})")
    rest = [_sum(found, [condition], [motion], form, band, "rest") for form in FORMS]
    halves = [[each.half_widths / each.count for each in both] for both in rest]
    widths = [own / known for own, known in halves]
    of_all = _of_all([_sum(found, [condition], [motion], form, band, "all") for form in FORMS])
    texts += [*of_all[:2], _pair([f"{width:.2f}" for width in widths]), of_all[2]]
    named = {"strokes": "strokes", "free": "free motion"}[motion]
    return f"| {condition[1]}, {condition[0]}, {named} | " + " | ".join(texts) + " |"


def _single(
    found: Sequence[Found],
    conditions: Sequence[Condition],
    motions: Sequence[str],
    band: float,
    state: str,
) -> Iterator[tuple[Found, Condition, str, str, float]]:
    """Yield rig, condition, motion, form and ratio of each recording."""
    for one in found:
        for condition in conditions:
            for motion in motions:
                for form in FORMS:
                    ratio = _ratio(_sum([one], [condition], [motion], form, band, state))
                    yield one, condition, motion, form, ratio


def _print_single_ratios(found: Sequence[Found], band: float) -> None:
    """Print how many ratios of single recordings are beyond the limits, and their mean."""
    every, beyond, other = [], 0, 0
    for state, limit in LIMITS.items():
        own = list(_single(found, CONDITIONS, MOTIONS, band, state))
        ratios = np.array([ratio for *_, ratio in own])
        far = [one for one in own if one[-1] > limit]
        print(f"  {state}: {len(far)} of {len(own)} beyond {limit}, mean {_geometric(ratios):.3f}")
        beyond, other = beyond + len(far), other + sum(one[1][0] == 1 for one in far)
        every.append(ratios)
    together = np.concatenate(every)
    print(f"  {beyond} of {together.size}, {other} at another power-up, {_geometric(together):.3f}")
    for one, condition, motion, form, ratio in _single(found, CONDITIONS, MOTIONS, band, "moving"):
        if ratio > LIMITS["moving"]:
            key = (motion, form, band, "moving")
            share = _share(one.scores[condition][0][key])
            print(f"    {one.seed} {condition} {motion} {form}: {ratio:.2f}, {share:.1f} % hold")


def _geometric(ratios: np.ndarray) -> float:
    return float(np.exp(np.nanmean(np.log(ratios[ratios > 0]))))


def _print_by_rigs(groups: Mapping[str, Sequence[Found]]) -> None:
    """Print a row for each of some groups of rigs, all conditions together, at the last band."""
    print()
    own = [f"{motion}: {head}" for motion in MOTIONS for head in (HEADS[0], *HEADS[1::2])]
    _head("rigs", *own)
    for name, rigs in groups.items():
        texts = []
        for motion in MOTIONS:
            each = [_sum(rigs, CONDITIONS, [motion], form, BANDS[-1], "all") for form in FORMS]
            texts += _of_all(each)
        both = [_sum(rigs, CONDITIONS, MOTIONS, form, BANDS[-1], "all") for form in FORMS]
        _line(name, *texts, _of_all(both)[2])


def _holds(found: Sequence[Found], conditions: Sequence[Condition], motion: str) -> str:
    """Return error, share within the intervals and score of some conditions."""
    each = [_sum(found, conditions, [motion], form, BANDS[-1], "all") for form in FORMS]
    return f"{motion}: {', '.join(_of_all(each))};"


def _in_cell(
    found: Sequence[Found], conditions: Sequence[Condition], cell: str, times: bool
) -> list[str]:
    """Return the share within the intervals, %, and the time, s, of a band of load and state."""
    texts = []
    for form in FORMS:
        keys = [(motion, form, BANDS[-1], cell) for motion in MOTIONS]
        one = sum_of([each.scores[c][0][key] for each in found for c in conditions for key in keys])
        share = f"{_share(one):.0f}" if one.count else "-"
        texts.append(f"{share} ({one.count * ROW_TIME:.0f})" if times else share)
    return texts
