"""A virtual rig with known loads, learned once for all tests and all processes of a session."""

import os
import shutil

import pytest

from rigtool.cli import main
from tests.alone import alone
from tests.experiments.virtual_runs import RECIPE

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

LINE = "ilc-learn {recipe} --kt {kt} --implementation D -o {tables}"
"""What is typed, as the README shows it."""


def learned_loads(tmp_path_factory, path):
    """Copy the tables to a path, which is returned; the first who asks learns them."""
    session = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        session = session.parent
    shared = session / "learned-loads.h5"
    with alone(session / "learned-loads.lock"):
        if not shared.exists():
            mine = tmp_path_factory.mktemp("learning") / "tables.h5"
            settings = [part for setting in (*RIG, *D) for part in ("--set", setting)]
            line = LINE.format(recipe=RECIPE, kt=KT, tables=mine).split()
            with pytest.raises(SystemExit) as ended:
                main([*line, *settings])
            assert ended.value.code == 0
            mine.rename(shared)
    return shutil.copy(shared, path)
