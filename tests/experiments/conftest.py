"""What the tests of several procedures give their commands."""

import pytest

from tests.experiments.virtual_runs import COULOMB, VISCOUS, write_kt, write_results


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def kt(folder):
    return write_kt(folder)


@pytest.fixture(scope="module")
def friction(folder):
    constants = {"coulomb_friction": (COULOMB, "N m"), "viscous_friction": (VISCOUS, "N m s/rad")}
    return write_results(folder / "friction.h5", "stribeck", **constants)
