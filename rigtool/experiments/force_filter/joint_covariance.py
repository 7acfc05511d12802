"""The joint covariance P of the states x and of q behind the low-pass, see `passed`.

    step     P- = Phi P Phi'          update  P = P- - K K' s^2 (1 - rho)

It is flat, `rows` (n,): `JOINT_STATES` rows of `ROW_LENGTH` columns one behind the other
and a row to compute with, so that a processor works on eight columns at once.
"""

from __future__ import annotations

from rigtool.experiments.force_filter.linear import ROW_LENGTH, forwards
from rigtool.experiments.force_filter.passed import JOINT_STATES
from rigtool.experiments.force_filter.plant import MOVING_STATES, NOISE, STATES
from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled

SPARE_ROW = JOINT_STATES * ROW_LENGTH
"""Where the row to compute with begins."""

JOINT_LENGTH = SPARE_ROW + ROW_LENGTH
"""How many numbers the rows are."""


@compiled
def at(i: int, j: int) -> int:
    """Return where element (i, j) is."""
    return i * ROW_LENGTH + j


@compiled
def propagate(rows: Array, turned: Array, factors: Array, samples: int, kept: float) -> None:
    """Multiply the joint covariance by a step's derivative from both sides.

    The rows that move first; then their columns, as rows of the transpose. q has moved before.
    `kept` is what remains of the noise; `turned` (12 * ROW_LENGTH,) is overwritten.
    """
    for k in range(samples):
        forwards(rows, ROW_LENGTH, factors, k)
    for m in range(STATES):
        for i in range(MOVING_STATES):
            turned[at(m, i)] = rows[at(i, m)]
    for k in range(samples):
        forwards(turned, MOVING_STATES + 1, factors, k)
    for i in range(MOVING_STATES):
        for j in range(i + 1):
            rows[at(i, j)] = rows[at(j, i)] = turned[at(i, j)]
        rows[at(i, NOISE)] *= kept
        for j in range(MOVING_STATES, JOINT_STATES):
            rows[at(j, i)] = rows[at(i, j)]
    for j in range(MOVING_STATES, JOINT_STATES):
        rows[at(NOISE, j)] *= kept
        rows[at(j, NOISE)] = rows[at(NOISE, j)]
    rows[at(NOISE, NOISE)] *= kept


@compiled
def renew(rows: Array, i: int, deviation: float) -> None:
    """Let state i be independent of all others again, with this standard deviation."""
    for j in range(JOINT_STATES):
        rows[at(i, j)] = rows[at(j, i)] = 0.0
    rows[at(i, i)] = deviation * deviation


@compiled
def remove(rows: Array, gain: Array, scale: float) -> None:
    """Take scale^2 gain gain' off the joint covariance."""
    # written out, so that a processor does all rows of eight columns at once
    g0, g1, g2, g3 = scale * gain[0], scale * gain[1], scale * gain[2], scale * gain[3]
    g4, g5, g6, g7 = scale * gain[4], scale * gain[5], scale * gain[6], scale * gain[7]
    g8, g9, g10, g11 = scale * gain[8], scale * gain[9], scale * gain[10], scale * gain[11]
    g12, g13 = scale * gain[12], scale * gain[13]
    for j in range(ROW_LENGTH):
        rows[SPARE_ROW + j] = scale * gain[j]
    for j in range(ROW_LENGTH):
        g = rows[SPARE_ROW + j]
        rows[j] -= g0 * g
        rows[ROW_LENGTH + j] -= g1 * g
        rows[2 * ROW_LENGTH + j] -= g2 * g
        rows[3 * ROW_LENGTH + j] -= g3 * g
        rows[4 * ROW_LENGTH + j] -= g4 * g
        rows[5 * ROW_LENGTH + j] -= g5 * g
        rows[6 * ROW_LENGTH + j] -= g6 * g
        rows[7 * ROW_LENGTH + j] -= g7 * g
        rows[8 * ROW_LENGTH + j] -= g8 * g
        rows[9 * ROW_LENGTH + j] -= g9 * g
        rows[10 * ROW_LENGTH + j] -= g10 * g
        rows[11 * ROW_LENGTH + j] -= g11 * g
        rows[12 * ROW_LENGTH + j] -= g12 * g
        rows[13 * ROW_LENGTH + j] -= g13 * g
