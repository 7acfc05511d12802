"""Learned tables of a whole turn with known content."""

import numpy as np

from rigtool.control.lookup_table import LookupTable

TURN = 2 * np.pi
ORDERS = ((1, 0.4e-3, 0.3), (7, 0.8e-3, -1.2), (28, 0.2e-3, 2.0))
FRICTION = 2.3e-3


def cogging(angle, orders=ORDERS):
    return sum(a * np.cos(n * angle + p) for n, a, p in orders)


def turning(count=4000, start=0.0, noise=0.0, seed=1, speeds=(-6.0, -2.0, 2.0, 6.0)):
    """Return a table with cogging in all rows and friction of the speed's sign, and its u."""
    position = start + np.arange(count) * (TURN / count)
    random = np.random.default_rng(seed)
    rows = [cogging(position) + FRICTION * np.sign(v) for v in speeds]
    lowest = min(abs(v) for v in speeds)
    table = LookupTable(
        position=position,
        speed=np.array(speeds),
        torque=np.stack(rows) + noise * random.standard_normal((len(speeds), count)),
        low_speed=np.array([0.0, lowest / 2, lowest]),
        amplitude=np.array([0.0, 1.1, 1.0]),
        period=TURN,
    )
    return table, np.full(table.torque.shape, noise)
