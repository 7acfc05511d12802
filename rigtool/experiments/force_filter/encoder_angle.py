"""The angle between an encoder's counts: from the instants of its edges while it is slow.

An encoder that shows floor(angle / count) is exact at its edges. The angle is known at these
points:

- A recorded sample that is the mean of some samples of the loop keeps the instant of a single edge
  within it: the part of the samples behind the edge.
- Where edges follow each other faster, the mean itself, half a count up, is the angle at the
  middle.
- A rotor that turns within a count, between two passages of one edge, is taken half a count beyond
  that edge, as it is as often more as less, from the first passage until the middle of the time
  between: friction holds it where its way has ended until the torque on it has changed its side.
  The edge itself would make both ends of a stroke up to a count short; a peak in the middle alone
  made the mean there 0.2 counts short on three drawn rigs, held so it is 0.1.

Between them the angle is interpolated monotonically (F. N. Fritsch and R. E. Carlson, SIAM J.
Numer. Anal. 17(2) 238-246, 1980).
"""

from __future__ import annotations

import numpy as np

from rigtool.numerics.arrays import Array


def known_angles(encoder: Array) -> tuple[Array, Array]:
    """Return places, in samples, and angles there, in counts, from recorded samples (n,), counts.

    A place of 0 is the begin of the first sample, 1 its end.
    """
    low, high = np.floor(encoder), np.ceil(encoder)
    part = encoder - low
    number = np.arange(len(encoder))
    before = np.concatenate([encoder[:1], encoder[:-1]])
    after = np.concatenate([encoder[1:], encoder[-1:]])
    rising = (before <= low) & (after > low) & (part > 0)
    falling = (before > low) & (after <= low) & (part > 0)
    # Neighbours further off than the edge's two counts: the rotor passes several in a sample
    single = (np.abs(before - encoder) <= 1) & (np.abs(after - encoder) <= 1)
    touched = (part > 0) & single & ~rising & ~falling  # crossed to and fro within the sample
    between = (part == 0) & (np.abs(after - encoder) == 1)  # an edge just between two samples
    fast = ~single
    places = [
        number[rising & single] + 1 - part[rising & single],
        number[falling & single] + part[falling & single],
        number[touched] + 0.5,
        number[between] + 1.0,
        number[fast] + 0.5,
    ]
    angles = [
        high[rising & single],
        high[falling & single],
        high[touched],
        np.maximum(encoder, after)[between],
        encoder[fast] + 0.5,
    ]
    place, angle = np.concatenate(places), np.concatenate(angles)
    order = np.argsort(place, kind="stable")
    place, angle = place[order], angle[order]
    keep = np.diff(place, prepend=-np.inf) > 1e-6
    return place[keep], angle[keep]


def interpolated(encoder: Array, place: Array) -> Array:
    """Return the angle, in counts, at places of recorded samples (n,), see `known_angles`."""
    from scipy.interpolate import PchipInterpolator

    known, angle = known_angles(encoder)
    ends = np.array([0.0, len(encoder)])
    inside = (known > 0) & (known < len(encoder))
    known = np.concatenate([ends[:1], known[inside], ends[1:]])
    angle = np.concatenate([encoder[:1] + 0.5, angle[inside], encoder[-1:] + 0.5])
    # A whole sample between two passages shows on which side of the edge the rotor turned
    turned = np.flatnonzero((np.diff(angle) == 0) & (np.diff(known) >= 2))
    passed, time = known[turned], np.diff(known)[turned]
    middle = passed + time / 2
    stopped = passed + np.minimum(1.0, time / 4)
    held = np.tile(encoder[middle.astype(np.intp)] + 0.5, 2)
    turned = np.tile(turned, 2) + 1
    known = np.insert(known, turned, np.concatenate([stopped, middle]))
    angle = np.insert(angle, turned, held)
    return PchipInterpolator(known, angle)(place)
