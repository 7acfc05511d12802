"""Imported runs of synthetic rigs, for tests of what analyses them."""

import numpy as np

from rigtool.recipe.mapping import parse_mapping
from rigtool.runfile import open_run
from rigtool.runfile.export import export
from rigtool.runfile.importers import import_files

ORDERS = ((7, 0.8, 0.3), (14, 0.2, 1.0), (28, 0.2, -1.0))
COUNTS = 8192

SLOW = f"""mapping = 1
[rig]
name = "slow"
encoder_counts = {COUNTS}
[signals]
time = {{ column = "t", unit = "s" }}
encoder = {{ column = "q", unit = "count", wraps_at = {COUNTS} }}
current = {{ column = "i", unit = "A" }}
[[conditions]]
name = "compensation"
pattern = '^(on|off)'
values = {{ off = 0, on = 1 }}
"""


def take(folder, text, files):
    """Import arrays by file name (without ending), each a dict by column; return the paths."""
    (folder / "raw").mkdir()
    for name, arrays in files.items():
        np.savez(folder / "raw" / f"{name}.npz", **arrays)
    import_files([str(folder / "raw")], str(folder / "runs"), (parse_mapping(text), text))
    return [str(folder / "runs" / f"{name}.h5") for name in files]


def slow_turn(seed, reduced, speed=0.1, noise=0.01):
    """A turn whose motion is rippled at the orders, less so by the factor `reduced`."""
    random = np.random.default_rng(seed)
    time = np.cumsum(random.uniform(0.8, 1.2, 4400))
    time *= 1 / speed / time[-1]
    angle = random.uniform(0, 1) + speed * time
    ripple = sum(a * np.sin(2 * np.pi * k * angle + p) for k, a, p in ORDERS)
    moved = angle + 2e-3 * (1 - reduced) * ripple
    current = sum(a * np.cos(2 * np.pi * k * moved + p) for k, a, p in ORDERS)
    current += random.normal(0, noise, len(time))
    return {"t": time, "q": np.mod(moved * COUNTS, COUNTS), "i": current}


def crossed(folder, run, parts, text):
    """Export parts of the bench's run as CSV and import them; return the paths."""
    (folder / "raw").mkdir()
    for part in parts:
        with open_run(run) as stored:
            export(stored, folder / "raw" / f"{part}.csv", f"recordings/{part}", overwrite=False)
    import_files([str(folder / "raw")], str(folder / "runs"), (parse_mapping(text), text))
    return [str(folder / "runs" / f"{part}.h5") for part in parts]
