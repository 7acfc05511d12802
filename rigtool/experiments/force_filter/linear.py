"""The equations of a sample, linearised about the states: filter and smoother spend most time here.

A sample maps rows to rows. Those of the speeds of rotor and output are sums of nearly all rows,
each other one is the sum of two, and the last rows stay. `plant.advance` gives the `FACTOR_COUNT`
factors:

    w' = f0 angle + f1 w + f2 z + f3 h + f4 a + f5 v + f6 sine + .. + f10 torque
    v' = f11 angle + f12 w + f13 a + f14 v + f15 t + f16 torque
    z' = f17 z + f18 w,   h' = f19 h + f20 w,   t' = f21 t + f22 v
    angle' = angle + f23 w',   a' = a + f23 v'

and on a bare shaft, f24 > 0, instead a' = f24 angle', v' = f24 w'. Matrices are flat, rows of
`ROW_LENGTH` columns one behind the other, so that a processor works on eight columns at once.
"""

from __future__ import annotations

from rigtool.experiments.force_filter.plant import (
    ANGLE,
    BRISTLE,
    COSINE,
    GRASPER,
    GRASPER_SPEED,
    HOUSING,
    LOAD,
    NOISE,
    SINE,
    SPEED,
    TIP,
    TORQUE,
)
from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled

ROW_LENGTH = 16

THETA, W, Z, H = ANGLE * ROW_LENGTH, SPEED * ROW_LENGTH, BRISTLE * ROW_LENGTH, HOUSING * ROW_LENGTH
A, V, T = GRASPER * ROW_LENGTH, GRASPER_SPEED * ROW_LENGTH, TIP * ROW_LENGTH
S, C, L, N, M = (
    SINE * ROW_LENGTH,
    COSINE * ROW_LENGTH,
    LOAD * ROW_LENGTH,
    NOISE * ROW_LENGTH,
    TORQUE * ROW_LENGTH,
)
"""Where the rows begin."""


@compiled
def _read(factors: Array, k: int) -> tuple[float, ...]:
    """Return the factors of sample k."""
    speed = factors[k, 0], factors[k, 1], factors[k, 2], factors[k, 3], factors[k, 4], factors[k, 5]
    last = factors[k, 6], factors[k, 7], factors[k, 8], factors[k, 9], factors[k, 10]
    outer = factors[k, 11], factors[k, 12], factors[k, 13], factors[k, 14], factors[k, 15]
    bends = factors[k, 16], factors[k, 17], factors[k, 18], factors[k, 19], factors[k, 20]
    rest = factors[k, 21], factors[k, 22], factors[k, 23], factors[k, 24]
    return (*speed, *last, *outer, *bends, *rest)


@compiled
def forwards(rows: Array, columns: int, factors: Array, k: int) -> None:
    """Advance the first `columns` of a flat matrix (n,), 12 rows of `ROW_LENGTH`, by sample k of
    `factors` (samples, `FACTOR_COUNT`)."""
    found = _read(factors, k)
    w0, w1, w2, w3, w4, w5, w6, w7, w8, w9, w10 = found[:11]
    v0, v1, v2, v3, v4, v5, z0, z1, h0, h1, t0, t1, dt, shaft = found[11:]
    for j in range(columns):
        angle, w, z, h = rows[THETA + j], rows[W + j], rows[Z + j], rows[H + j]
        a, v, t, torque = rows[A + j], rows[V + j], rows[T + j], rows[M + j]
        # in pairs: a sum in a row waits for each term
        new_w = (w0 * angle + w1 * w) + (w2 * z + w3 * h) + ((w4 * a + w5 * v) + w10 * torque)
        late = (w6 * rows[S + j] + w7 * rows[C + j]) + (w8 * rows[L + j] + w9 * rows[N + j])
        new_w += late
        new_v = (v0 * angle + v1 * w) + (v2 * a + v3 * v) + (v4 * t + v5 * torque)
        rows[THETA + j], rows[W + j] = angle + dt * new_w, new_w
        rows[A + j], rows[V + j] = a + dt * new_v, new_v
        rows[Z + j], rows[H + j] = z0 * z + z1 * w, h0 * h + h1 * w
        rows[T + j] = t0 * t + t1 * v
    if shaft > 0.0:
        for j in range(columns):
            rows[A + j], rows[V + j] = shaft * rows[THETA + j], shaft * rows[W + j]


@compiled
def backwards(rows: Array, columns: int, factors: Array, k: int) -> None:
    """Multiply columns of a flat matrix (n,) by the transpose of what `forwards` multiplies by."""
    found = _read(factors, k)
    w0, w1, w2, w3, w4, w5, w6, w7, w8, w9, w10 = found[:11]
    v0, v1, v2, v3, v4, v5, z0, z1, h0, h1, t0, t1, dt, shaft = found[11:]
    if shaft > 0.0:
        for j in range(columns):
            rows[THETA + j] += shaft * rows[A + j]
            rows[W + j] += shaft * rows[V + j]
            rows[A + j] = rows[V + j] = 0.0
    for j in range(columns):
        angle, z, h, a, t = rows[THETA + j], rows[Z + j], rows[H + j], rows[A + j], rows[T + j]
        w, v = rows[W + j] + dt * angle, rows[V + j] + dt * a
        rows[THETA + j] = angle + w0 * w + v0 * v
        rows[W + j] = w1 * w + v1 * v + z1 * z + h1 * h
        rows[Z + j], rows[H + j] = w2 * w + z0 * z, w3 * w + h0 * h
        rows[A + j] = a + w4 * w + v2 * v
        rows[V + j] = w5 * w + v3 * v + t1 * t
        rows[T + j] = v4 * v + t0 * t
        rows[S + j] += w6 * w
        rows[C + j] += w7 * w
        rows[L + j] += w8 * w
        rows[N + j] += w9 * w
        rows[M + j] += w10 * w + v5 * v
