"""Recursive filters of second order, block by block, with numpy alone.

    y_k = b0 u_k + b1 u_(k-1) + b2 u_(k-2) - a1 y_(k-1) - a2 y_(k-2)

in state space: s of the next sample = A s + B u, y = C s + b0 u. Over a block of L samples,

    y = T u + O s,   s of the next block = A^L s + R u

with T, O and R made of b0 and C A^i B; products of matrices do many blocks at once. The states
before all blocks are sums over the blocks before, each by a power of A^L; doubling adds them up
(W. D. Hillis, G. L. Steele, Commun. ACM 29(12) 1170-1183, 1986). `scipy.signal` gives the same, but
its import takes longer than these filters an hour of samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigtool.numerics.arrays import Array

BLOCK, PIECE = 32, 65536
"""Samples of a block, and of the blocks that are filtered at once."""


@dataclass(frozen=True)
class Biquad:
    """A filter by its coefficients."""

    b0: float
    b1: float
    b2: float
    a1: float
    a2: float

    def state_space(self) -> tuple[Array, Array]:
        """Return A (2, 2) and B (2,), transposed direct form II; C is (1, 0)."""
        feed = np.array([self.b1 - self.a1 * self.b0, self.b2 - self.a2 * self.b0])
        return np.array([[-self.a1, 1.0], [-self.a2, 0.0]]), feed


def butterworth(rate: float, cutoff_hz: float) -> Biquad:
    """Return the Butterworth low-pass of order 2 for signals of a rate, Hz, by the bilinear
    transform (A. V. Oppenheim, R. W. Schafer, Discrete-Time Signal Processing, 3rd ed., 7.2)."""
    k = math.tan(math.pi * cutoff_hz / rate)
    whole = 1 + math.sqrt(2) * k + k * k
    gain = k * k / whole
    rest = (1 - math.sqrt(2) * k + k * k) / whole
    return Biquad(gain, 2 * gain, gain, 2 * (k * k - 1) / whole, rest)


def filtered(section: Biquad, values: Array, steady: Array | None = None) -> Array:
    """Return signals (..., n) behind a filter, in their precision.

    It starts at zero, or as if values `steady` (...,) had lasted for ever.
    """
    change, feed = section.state_space()
    powers = [np.eye(2)]
    for _ in range(BLOCK):
        powers.append(change @ powers[-1])
    seen = np.array([power[0] for power in powers[:BLOCK]])  # O: C A^i
    response = np.append(section.b0, seen[:-1] @ feed)
    place = np.arange(BLOCK)
    late = place[:, None] - place
    through = np.where(late >= 0, response[late], 0.0)
    reach = np.array([power @ feed for power in powers[BLOCK - 1 :: -1]])  # R'
    state = np.zeros((*values.shape[:-1], 2))
    if steady is not None:
        state = np.asarray(steady)[..., None] * np.linalg.solve(np.eye(2) - change, feed)
    found = np.empty(values.shape, np.result_type(values, np.float32))
    for first in range(0, values.shape[-1], PIECE):
        piece = values[..., first : first + PIECE]
        size = piece.shape[-1]
        blocks = np.zeros((*piece.shape[:-1], -(-size // BLOCK), BLOCK))
        blocks.reshape(*piece.shape[:-1], -1)[..., :size] = piece
        ends = blocks @ reach
        states = np.concatenate([state[..., None, :], ends[..., :-1, :]], axis=-2)
        power, apart = powers[BLOCK], 1
        while apart < states.shape[-2]:
            states[..., apart:, :] += states[..., :-apart, :] @ power.T
            power, apart = power @ power, 2 * apart
        state = states[..., -1, :] @ powers[BLOCK].T + ends[..., -1, :]
        blocks = blocks @ through.T + states @ seen.T
        found[..., first : first + size] = blocks.reshape(*piece.shape[:-1], -1)[..., :size]
    return found


def filtered_both_ways(section: Biquad, values: Array, margin: int) -> Array:
    """Return signals (..., n) filtered forward and backward, without phase shift.

    Both ends are continued by `margin` samples, less than n, reflected at the end's point, as
    F. Gustafsson compares it, IEEE Trans. Signal Process. 44(4) 988-992, 1996.
    """
    before = 2 * values[..., :1] - values[..., margin:0:-1]
    after = 2 * values[..., -1:] - values[..., -2 : -margin - 2 : -1]
    longer = np.concatenate([before, values, after], axis=-1)
    longer = filtered(section, longer, longer[..., 0])[..., ::-1]
    longer = filtered(section, longer, longer[..., 0])[..., ::-1]
    return longer[..., margin : margin + values.shape[-1]]
