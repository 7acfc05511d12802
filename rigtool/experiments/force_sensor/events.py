"""Events: contacts that the torque of a whole recording shows, and when they were.

Contacts are found by samples so far (`force_model.contacts`), by a filter that a contact leaves
wrong for `LEVEL_MEMORY`. The torque of the whole recording, with its intervals of 95 %, says more:

- A contact whose interval always holds zero is none, nor is the fall of another one, which may be
  found as a contact that begins with that one's end: within `JUMP_WINDOW` it shows none. What is
  found within the memory of another contact is one only where `SURE` times the interval does not
  hold zero, and begins where something let go last before.
- Where `SURE` times the interval does not hold zero for `LET_GO_TIME`, something touches, whether
  samples so far showed it or not.
- Contacts are one event where nothing lets go between them.

An event starts where the torque passes half of its highest value in the `JUMP_WINDOW` after the
contact was found, so that a force that grows slowly starts where it shows. It ends where the torque
falls below half of its mean since the last contact in it was found. When a torque M that is known
to h either way passed a level L is known between the last row before with M + h < L (or M - h > L)
and the first one behind: the farther of both is taken for an end of the 95 % interval. Besides,
edges within a period T of the low-pass's corner are one:

    u^2 = (farthest / 1.96)^2 + T^2 / 12
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rigtool.experiments.force_filter.accuracy import COVERAGE_FACTOR
from rigtool.experiments.force_filter.motion_states import State
from rigtool.experiments.force_model.contacts import JUMP_WINDOW, LEVEL_MEMORY, Contact
from rigtool.experiments.force_sensor.results_over_time import ROWS_PER_PERIOD, TorqueRows
from rigtool.numerics.arrays import Array, Mask
from rigtool.numerics.plateaus import runs_of

LET_GO_TIME = 0.2
"""Time without a torque, s, after which another contact begins: fingers tap five times a second."""

SURE = 2.0
"""Intervals of 95 % that hold an error in a second of memory: 99.99 % in each of its moments."""

UNSEEN = -1
"""Step at which samples so far show a contact that only the whole recording shows."""

Place = tuple[float, float]
"""A time and its standard uncertainty, in rows."""


@dataclass(frozen=True)
class Event:
    """Rows, and parts of them, at which something begins and ceases to touch, each with its
    standard uncertainty; `found` is the first step at which samples so far show it, or `UNSEEN`."""

    start: Place
    found: int
    end: Place

    @property
    def rows(self) -> slice:
        """The rows from its start to its end, one at least."""
        last = int(self.end[0])
        return slice(min(math.ceil(self.start[0]), last), last + 1)


def events(rows: TorqueRows) -> list[Event]:
    """Return the contacts that the rows of a stretch show, in order, none in two of them."""
    known = rows.states != State.OUTSIDE
    half = np.where(known, COVERAGE_FACTOR * rows.u, np.inf)
    shown = _Shown(np.where(known, rows.torque, 0.0), half, rows.every, rows.step_time)
    joined, found, before = shown.joined(rows.contacts), list[Event](), 0
    begins = [each[0].begin // rows.every for each in joined] + [len(known)]
    for each, behind in zip(joined, begins[1:], strict=True):
        start = shown.started(each[0], slice(before, each[-1].rows(rows.every).stop))
        end = shown.ended(each[-1], slice(int(start[0]), behind))
        seen = (contact.found for contact in each if contact.found != UNSEEN)
        found.append(Event(start, next(seen, UNSEEN), end))
        before = found[-1].rows.stop
    return found


@dataclass(frozen=True, eq=False)
class _Shown:
    """A torque (m,) N m, known to `half` (m,) N m either way; a row is `every` steps, `row_time`
    s."""

    torque: Array
    half: Array
    every: int
    row_time: float

    def _size(self, time: float) -> int:
        return round(time / self.row_time)

    def joined(self, contacts: Sequence[Contact]) -> list[list[Contact]]:
        """Return the contacts of each event, in order."""
        nothing, sure = np.abs(self.torque) <= self.half, np.abs(self.torque) > SURE * self.half
        joined, stop, memory, last = list[list[Contact]](), 0, 0, -1
        every = sorted([*contacts, *self._unseen(contacts, sure)], key=lambda c: c.begin)
        for contact in every:
            own = contact.rows(self.every)
            remembered = own.start < memory
            memory = own.stop + self._size(LEVEL_MEMORY)
            first = own.start + (self._size(JUMP_WINDOW) if contact.begin <= last else 0)
            if not (sure if remembered else ~nothing)[first : own.stop].any():
                continue
            if remembered:
                surely = first + int(sure[first : own.stop].argmax())
                begin = (own.start + self._let_go(nothing[own.start : surely])) * self.every
                if begin > contact.begin:
                    contact = replace(contact, begin=begin, found=max(begin, contact.found))
            last = contact.end
            if joined and not self._let_go(nothing[stop : contact.rows(self.every).start]):
                joined[-1].append(contact)
            else:
                joined.append([contact])
            stop = own.stop
        return joined

    def _unseen(self, contacts: Sequence[Contact], sure: Mask) -> Iterator[Contact]:
        """Yield what touches beside the contacts that were found."""
        beside = sure.copy()
        for contact in contacts:
            beside[contact.rows(self.every)] = False
        for begin, end in runs_of(beside):
            if end - begin >= self._size(LET_GO_TIME):
                yield Contact(begin * self.every, UNSEEN, (end - 1) * self.every)

    def _let_go(self, nothing: Mask) -> int:
        """Return the end of the last run of at least `LET_GO_TIME`; 0 without one."""
        long = (end for begin, end in runs_of(nothing) if end - begin >= self._size(LET_GO_TIME))
        return max(long, default=0)

    def started(self, contact: Contact, within: slice) -> Place:
        """Return when a contact starts, between two rows."""
        row = max(contact.found, contact.begin) // self.every - within.start
        behind = slice(row, row + self._size(JUMP_WINDOW) + 1)
        side = self._side(within, behind)
        level = side[behind].max() / 2
        row += int((side[behind] > level).argmax())
        below = np.flatnonzero(side[:row] <= level)
        place = _passed(side, int(below[-1]), level) if len(below) else 0.0
        return self._place(place, side, level, within)

    def ended(self, contact: Contact, within: slice) -> Place:
        """Return when a contact ends, between two rows."""
        # what samples so far do not show may start behind the first row that is sure
        first = max(max(contact.found, contact.begin) // self.every - within.start, 0)
        own = slice(first, contact.rows(self.every).stop - within.start)
        side = self._side(within, own)
        level = side[own].mean() / 2
        above = np.flatnonzero(side[own] > level)
        row = own.start + int(above[-1]) if len(above) else own.stop - 1
        if row == own.stop - 1:  # it may last longer than samples so far showed
            below = np.flatnonzero(side[row + 1 :] <= level)
            row += int(below[0]) if len(below) else len(side) - 1 - row
        return self._place(_passed(side, row, level), side, level, within)

    def _side(self, within: slice, own: slice) -> Array:
        """Return the torque within rows, with the sign that makes it positive in some of them."""
        torque = self.torque[within]
        return -torque if torque[own].sum() < 0 else torque

    def _place(self, place: float, side: Array, level: float, within: slice) -> Place:
        """Return a place, with its uncertainty, at which a torque within rows passes a level."""
        surely = np.flatnonzero(np.abs(side - level) > self.half[within])
        first = surely[surely <= place].max(initial=0)
        last = surely[surely >= place].min(initial=max(len(side) - 1, int(place)))
        farthest = max(place - first, last - place)
        u = math.hypot(farthest / COVERAGE_FACTOR, ROWS_PER_PERIOD / math.sqrt(12))
        return within.start + place, u


def _passed(torque: Array, row: int, level: float) -> float:
    """Return where a torque passes a level, between a row and the next."""
    here, there = torque[row], torque[min(row + 1, len(torque) - 1)]
    passes = (here > level) != (there > level)
    return row + (float((level - here) / (there - here)) if passes else 0.0)
