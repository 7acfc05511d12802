"""A virtual rig with known loads, learned once for all tests and all processes of a session."""

import os
import shutil

from rigtool.experiments.learning.procedure import PROCEDURE as ILC_LEARN
from tests.alone import alone
from tests.experiments.virtual_runs import RECIPE, run

KT = RECIPE.parents[1] / "tests" / "fixtures" / "kt.h5"
RIG = ("virtual.instrument.stiffness=0.13", "virtual.instrument.load_friction=0.2")
"""Softer than the thesis's, with more load friction."""

D = (
    "ilc_learn.implementation=D",
    "ilc_learn.speeds_rev_per_s=[2]",
    "ilc_learn.low_speeds_rev_per_s=[]",
    "ilc_learn.moves=3",
    "ilc_learn.loads.forces=[0.1, 0.7, 3]",
    "ilc_learn.loads.speeds_rev_per_s=[1, 2]",
    "ilc_learn.loads.cycles=12",
)


def learned_loads(tmp_path_factory, folder):
    """Return the path of the tables, copied into a folder; the first who asks learns them."""
    session = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        session = session.parent
    shared = session / "learned-loads.h5"
    with alone(session / "learned-loads.lock"):
        if not shared.exists():
            mine = tmp_path_factory.mktemp("learning") / "tables.h5"
            run(ILC_LEARN, RECIPE, mine, *RIG, *D, kt=KT)
            mine.rename(shared)
    return shutil.copy(shared, folder / "tables.h5")
