"""Slopes of staircases, fitted once for all plateaus of the same numbers.

Most calibrations that tests analyse are copies of one stored run, and the fit takes as long as the
rest of its analysis several times over.
"""

import hashlib
import pickle

from rigtool.experiments.torque_constant import temperature_fit

fit_staircases = temperature_fit.fit_staircases
_slopes = {}


def fit_once(plateaus):
    """Do as `fit_staircases`; of plateaus that were fitted before, return a copy."""
    numbers = hashlib.sha256(pickle.dumps(plateaus)).digest()
    if numbers not in _slopes:
        _slopes[numbers] = pickle.dumps(fit_staircases(plateaus))
    return pickle.loads(_slopes[numbers])
