"""What a session makes of errors of the numerics."""

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.running.session import solvable


@solvable()
def fit():
    try:
        np.linalg.pinv(np.full((3, 3), np.nan))
    except np.linalg.LinAlgError as error:
        error.add_note("the samples are kept")
        raise


def test_equations_without_a_solution_are_signals_without_a_result():
    with pytest.raises(InsufficientDataError, match="SVD did not converge") as caught:
        fit()
    assert caught.value.__notes__ == ["the samples are kept"]
