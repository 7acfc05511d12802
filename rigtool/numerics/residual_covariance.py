"""Covariance of least-squares parameters whose residuals are correlated in time.

    cov = (X'X)^-1 n S (X'X)^-1,  S = 1/B sum over j = 1..B of L_j L_j',
    L_j = sqrt(2/n) sum over t of x_t e_t cos(pi j (t - 1/2) / n)

S estimates the long-run covariance of the moments x_t e_t from their B lowest cosine coefficients,
without assuming how residuals e are correlated; being a mean of B squares it has B degrees of
freedom, which Student's t then needs (Lazarus, Lewis, Stock & Watson, "HAR inference:
recommendations for practice", J. Business & Economic Statistics 36(4) 541-559, 2018).
"""

from __future__ import annotations

import numpy as np

from rigtool.numerics.arrays import Array, Mask

MIN_COEFFICIENTS = 4
"""Fewest coefficients, for any correlation: fewer do not determine an uncertainty."""


def long_run_covariance(design: Array, residual: Array, independent: float) -> tuple[Array, int]:
    """Return covariance (p, p) of the parameters and its degrees of freedom B.

    `design` (n, p) and `residual` (n,) are in the order of time. Rows of zeros stand for samples
    that were left out, so that the others keep their distance in time. `independent` is the number
    of independent samples equivalent to the residuals; B = n_i^(2/3).
    """
    count = len(residual)
    # The published rule, 0.4 n^(2/3), assumes a correlation of 0.7 from sample to sample, where n
    # samples count as n_i = 0.18 n: 1.3 n_i^(2/3). B is lower because n_i is itself estimated.
    lowest = int(min(max(independent ** (2 / 3), MIN_COEFFICIENTS), count - 1))
    moments = design * residual[:, None]
    coefficients = cosine_transform(moments)[1 : lowest + 1]
    spread = coefficients.T @ coefficients * (2 / lowest)
    inverse = np.linalg.inv(design.T @ design)
    covariance: Array = inverse @ spread @ inverse
    return covariance, lowest


def cosine_transform(values: Array) -> Array:
    """Return the sums over t of values (n, k) times cos(pi j (t - 1/2) / n), j = 0..n-1.

    The DCT-II from a real Fourier transform of n values (J. Makhoul, IEEE Trans. Acoust., Speech,
    Signal Process. 28(1) 27-34, 1980).
    """
    count = len(values)
    turned = np.fft.rfft(np.concatenate([values[::2], values[1::2][::-1]]), axis=0)
    phase = np.exp(-0.5j * np.pi * np.arange(len(turned)) / count)
    turned = (phase * turned.T).T
    return np.concatenate([turned.real, -turned.imag[(count - 1) // 2 : 0 : -1]])


def kept_by_fit(design: Array, lowest: int, more: Array | None = None) -> Array:
    """Return the part (p,) of the moments' lowest coefficients that a fit leaves in residuals.

    Under independent errors e, the residuals are M e, M = I - X (X'X)^-1 X', so that the power of a
    coefficient w'e is that of M w: small where slow regressors of `design` (n, p) resemble each
    other times a slow cosine. A covariance over the product of two roots of it is that without the
    loss (the leverage correction of MacKinnon & White, J. Econometrics 29, 305-325, 1985). `more`
    (n, q) are regressors whose parameters are not asked for.
    """
    basis = np.linalg.qr(design if more is None else np.column_stack([design, more]))[0]
    lowest = min(lowest, (len(design) - 1) // 2)
    # cos^2 = (1 + cos 2)/2 makes the sum of squares one of coefficients.
    power = np.sum(design**2, axis=0) * lowest / 2
    power += np.sum(cosine_transform(design**2)[2 : 2 * lowest + 1 : 2], axis=0) / 2
    lost = [
        np.sum(cosine_transform(basis * column[:, None])[1 : lowest + 1] ** 2)
        for column in design.T
    ]
    return 1 - np.array(lost) / power


def independent_samples(residual: Array, used: Mask, lag: int) -> float:
    """Return the number of independent samples equivalent to residuals (n,), where `used`.

    From their correlation at one lag, that of a first-order process: n/lag (1 - r)/(1 + r), at most
    n/lag.
    """
    both = used[lag:] & used[:-lag]
    before, after = residual[:-lag][both], residual[lag:][both]
    power = float(np.mean(residual[used] ** 2)) if used.any() else 0.0
    r = float(np.mean(before * after)) / power if both.any() and power > 0 else 0.0
    r = min(max(r, 0.0), 0.999)
    return float(np.count_nonzero(used)) / lag * (1 - r) / (1 + r)
