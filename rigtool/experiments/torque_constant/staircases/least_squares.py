"""Least squares on all staircases: columns of each, and columns with a coefficient for all.

Columns of each staircase are projected out of the shared ones first (R. Frisch, F. V. Waugh,
Econometrica 1(4), 387-401, 1933), so that no matrix is larger than one staircase.
"""

from __future__ import annotations

import numpy as np

from rigtool.numerics.arrays import Array


class LeastSquares:
    """Torque (m, p) as columns of each staircase, and shared ones with a coefficient for all."""

    def __init__(self, torque: Array, own: list[Array], shared: list[Array]) -> None:
        self.design = np.mean(np.stack([*own, *shared[:2]], axis=2), axis=0)
        columns, common = np.stack(own, axis=2), np.stack(shared, axis=2)
        self.inverse = np.linalg.pinv(columns)  # (m, c, p)
        self._shared, self._free = common, common - columns @ (self.inverse @ common)
        normal = np.einsum("mpc,mpd->cd", self._free, self._free)
        self.shared_cover = np.linalg.pinv(normal, hermitian=True)  # for residuals of 1
        self.shared = self._coefficients(torque)  # (d,)
        self.own, rest = self.solve(torque)
        self.residual = rest - np.einsum("mpc,mc->mp", columns, self.own)
        self.parameters = self.own.size + common.shape[2]

    def solve(self, torque: Array) -> tuple[Array, Array]:
        """Return coefficients (m, c) of each staircase, and torques (m, p) less what is shared."""
        rest = torque - self._shared @ self._coefficients(torque)
        return np.einsum("mcp,mp->mc", self.inverse, rest), rest

    def _coefficients(self, torque: Array) -> Array:
        return self.shared_cover @ np.einsum("mpc,mp->c", self._free, torque)

    def response(self, weight: Array) -> Array:
        """Return what each torque (m, p) adds to the sum of slopes weighted by (m,)."""
        direct = weight[:, None] * self.inverse[:, 0]
        through = self.shared_cover @ np.einsum("mp,mpc->c", direct, self._shared)
        return direct - self._free @ through


def left_by(columns: list[Array], torque: Array) -> Array:
    """Return what least squares leave of torques (g, p) by columns (g, p) of each kind."""
    q, _ = np.linalg.qr(np.stack(columns, axis=2))
    return torque - np.einsum("gpc,gc->gp", q, np.einsum("gpc,gp->gc", q, torque))


def without_known(inverse: Array, found: Array, known: list[int], variance: Array | float) -> Array:
    """Return the first of the parameters (s, g, c) that least squares find with inverse triangles
    (s, g, c, c), if those `known` are zero, the last of them with this `variance` (s, g) over that
    of a residual."""
    cover = inverse[..., [0, *known], :] @ np.swapaxes(inverse[..., known, :], 2, 3)
    cover[..., -1, -1] += variance
    moved = np.linalg.solve(cover[..., 1:, :], found[..., known, None])
    return found[..., 0] - (cover[..., :1, :] @ moved)[..., 0, 0]
