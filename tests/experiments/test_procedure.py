"""Procedures as values: what each says of itself agrees with what it does."""

import pytest

from rigtool.experiments import dry_run
from rigtool.experiments.force.procedure import PROCEDURE as MEASURE_FORCE
from rigtool.experiments.friction.procedure import PROCEDURE as STRIBECK
from rigtool.experiments.learning.check.procedure import PROCEDURE as ILC_CHECK
from rigtool.experiments.learning.procedure import PROCEDURE as ILC_LEARN
from rigtool.experiments.plant.procedure import PROCEDURE as IDENTIFY_PLANT
from rigtool.experiments.ripple.procedure import PROCEDURE as FFT_RIPPLE
from rigtool.experiments.suspension.procedure import PROCEDURE as SUSPENSION
from rigtool.experiments.torque_constant.procedure import PROCEDURE as CALIBRATE_KT
from rigtool.recipe import load_recipe
from rigtool.runfile import open_run
from tests.experiments.virtual_runs import RECIPE
from tests.fixtures.make import HERE as FIXTURES

PULLEY = "rig.attachment=pulley"


@pytest.mark.parametrize(
    ("procedure", "overrides"),
    [
        (CALIBRATE_KT, ["calibrate_kt.record_every=160"]),
        (STRIBECK, ["stribeck.record_every=32"]),
        (FFT_RIPPLE, ["fft_ripple.record_every=16"]),
        (IDENTIFY_PLANT, []),
        (MEASURE_FORCE, ["measure_force.record_every=40"]),
        (SUSPENSION, []),
        (ILC_LEARN, []),
        (ILC_LEARN, ["ilc_learn.implementation=B", "ilc_learn.turning.record_every=5", PULLEY]),
        (ILC_LEARN, ["ilc_learn.implementation=standard"]),
        (ILC_CHECK, []),
    ],
    ids=lambda value: getattr(value, "command", None),
)
def test_samples_are_averaged_as_the_procedure_says(procedure, overrides, monkeypatch):
    """What a killed run may lose depends on it: a chunk of the file is about a second."""
    averaged = []

    class Rig(dry_run._Rehearsal):
        def perform(self, task):
            averaged.append(task.record_every)
            return super().perform(task)

    monkeypatch.setattr(dry_run, "_Rehearsal", Rig)
    recipe, _ = load_recipe(RECIPE, overrides)
    with open_run(FIXTURES / "kt.h5") as kt, open_run(FIXTURES / "tables.h5") as tables:
        inputs = {"kt": kt, "tables": tables}
        needed = {name: inputs[name] for name in procedure.needed}
        if procedure in (MEASURE_FORCE, ILC_CHECK):
            needed["tables"] = tables
        dry_run.rehearse(procedure, recipe, 0.045, needed)
    assert max(averaged) == procedure.record_every(recipe)
