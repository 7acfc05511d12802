"""A map of the turn learned from imported runs, and held-out runs compared with it."""

import math
from pathlib import Path

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError, RunFileError, UsageError
from rigtool.experiments.learning.check import procedure as ilc_check
from rigtool.experiments.learning.check.procedure import PROCEDURE as ILC_CHECK
from rigtool.experiments.learning.imported import _Row, _steadied
from rigtool.experiments.learning.procedure import PROCEDURE as ILC_LEARN
from rigtool.experiments.learning.stored_table import learned_table_from, lookup_table_from
from rigtool.experiments.ripple.orders import HIGHEST_ORDER, NEIGHBOURING_ORDERS, Spectrum
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.quantity import Quantity
from rigtool.recipe.mapping import load_mapping, parse_mapping
from rigtool.runfile import RunWriter, open_run
from rigtool.runfile.importers import import_files
from tests.experiments.imported_runs import ORDERS, SLOW, crossed, slow_turn, take
from tests.unchanged import require_unchanged

ROOT = Path(__file__).parents[3]
COGGING = ROOT / ".." / "shared" / "data" / "odrive-cogging" / "analysis" / "cogging_torque"
needs_data = pytest.mark.skipif(
    not COGGING.is_dir(), reason="the public data sets are not beside the repository"
)
FIXTURES = ROOT / "tests" / "fixtures"
OPTIONS = CommonOptions(overwrite=True)


def learn(sources, output, **inputs):
    return run_command(ILC_LEARN, list(map(str, sources)), output, options=OPTIONS, inputs=inputs)


def check(sources, tables, output, **inputs):
    with open_run(tables) as opened:
        inputs["tables"] = opened
        return run_command(
            ILC_CHECK, list(map(str, sources)), output, options=OPTIONS, inputs=inputs
        )


def turned(seed, part, **options):
    """A turn of a rig whose index was found elsewhere."""
    arrays = slow_turn(seed, 0, **options)
    return {**arrays, "q": np.mod(arrays["q"] + part * 8192, 8192)}


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """Return a folder, imported runs by name, and the map learned from two of them."""
    folder = tmp_path_factory.mktemp("learned")
    files = {f"off_{n}": slow_turn(n, 0) for n in range(4)}
    files |= {"on_0": slow_turn(10, 0.8), "off_slipped": turned(11, 0.5)}
    files |= {"off_fast": slow_turn(12, 0, speed=0.3)}
    other = slow_turn(13, 0)
    angle = other["q"] / 8192
    other["i"] = 0.8 * np.cos(2 * np.pi * 6 * angle) + 0.3 * np.cos(2 * np.pi * 11 * angle)
    files["off_other"] = other
    paths = dict(zip(files, take(folder, SLOW, files), strict=True))
    outcome = learn([paths["off_0"], paths["off_1"]], folder / "map.h5")
    return folder, paths, outcome


@pytest.mark.parametrize("option", ["friction", "plant"])
def test_options_of_the_bench_are_refused(option):
    with pytest.raises(UsageError, match=f"--{option}: is of the bench's own rig"):
        ILC_LEARN.analyse_imported([], **{option: object()})


@pytest.mark.parametrize("count", [1, 7, 20, 21, 40])
def test_noise_floors_of_few_orders_are_steadied_among_themselves(count):
    steadied = _steadied(np.full(count, 2.0))
    np.testing.assert_allclose(steadied, np.full(count, 2.0), rtol=1e-12, atol=0)


def test_no_other_number_has_changed(rig):
    require_unchanged("imported-map", rig[2])


def test_the_map_is_what_repeats(rig):
    folder, _, outcome = rig
    for order, amplitude, _ in ORDERS:
        found = outcome.results[f"order_{order}_amplitude"]
        # The rig's current follows its own motion, which ripples, too.
        assert found.value == pytest.approx(amplitude, rel=0.05, abs=0)
        assert found.unit == "A"
    with open_run(folder / "map.h5") as run:
        # two repeats: one degree of freedom of the mean, two of each order
        dof = run.tables["lookup"].columns["dof"].values
        assert np.all(dof >= 1)
        assert np.all(dof <= 2 * 100)
        learned = learned_table_from(run)
        assert learned.unit == "A"
        assert learned.table.period == pytest.approx(2 * np.pi, rel=1e-12, abs=0)
        angle = learned.table.position
        expected = sum(a * np.cos(k * angle + p) for k, a, p in ORDERS)
        off = learned.table.torque[0] - expected
        assert np.sqrt(np.mean((off - off.mean()) ** 2)) < 0.05
        with pytest.raises(RunFileError, match="holds A, not torque: learn it with --kt"):
            lookup_table_from(run)


def test_a_held_out_run_fits_and_little_is_left(rig):
    folder, paths, _ = rig
    outcome = check([paths["off_2"]], folder / "map.h5", folder / "check.h5")
    results = outcome.results
    assert ilc_check.fits(outcome)
    assert results["removed"].value > 0.95
    for order, *_ in ORDERS:
        removed = results[f"order_{order}_removed"]
        assert removed.value == pytest.approx(1, rel=0, abs=4 * removed.u + 0.01)
        assert 0 < removed.u < 0.1
    assert abs(results["table_shift"].value) < 5 * results["table_shift"].u
    assert "1 turn of 1 run at" in outcome.notes[0]
    both = check([paths["off_2"], paths["off_3"]], folder / "map.h5", folder / "check.h5")
    assert both.results["mean_current_change"].u is not None
    require_unchanged("imported-map-check", both)


def test_a_slipped_index_is_reported(rig):
    folder, paths, _ = rig
    outcome = check([paths["off_slipped"]], folder / "map.h5", folder / "check.h5")
    assert not ilc_check.fits(outcome)
    assert "the same map, shifted by" in outcome.notes[0]
    require_unchanged("imported-map-slipped", outcome)
    # ORDERS hold 7, 14 and 28: a seventh of a turn looks like none, and half a turn turns the 7
    # alone around.
    shift = outcome.results["table_shift"]
    assert abs(math.remainder(shift.value - np.pi, 2 * np.pi / 7)) < 2e-3
    assert abs(shift.value) < np.pi / 7 + 0.01
    assert outcome.results["order_7_removed"].value < -0.5
    assert outcome.results["order_14_removed"].value > 0.8


def test_another_pattern_is_no_shift(rig):
    folder, paths, _ = rig
    outcome = check([paths["off_other"]], folder / "map.h5", folder / "check.h5")
    assert not ilc_check.fits(outcome)
    assert "a shift is not enough" in outcome.notes[0]


def test_torque_with_a_calibration(rig):
    folder, paths, _ = rig
    kt = folder / "kt.h5"
    with RunWriter(kt, command="calibrate-kt") as writer:
        constant = {"torque_constant_mean": Quantity(0.05, "N m/A", 1e-4)}
        writer.finish({**constant, "amplifier_gain": Quantity(1.0, "1", 0.0)}, {})
    with open_run(kt) as opened:
        learn([paths["off_0"], paths["off_1"]], folder / "torque.h5", kt=opened)
        check([paths["off_2"]], folder / "torque.h5", folder / "check.h5", kt=opened)
    with open_run(folder / "torque.h5") as run:
        table = lookup_table_from(run)
        assert np.ptp(table.torque) == pytest.approx(0.05 * 2, rel=0.3, abs=0)
    with pytest.raises(UsageError, match=r"holds N m, the runs hold A.*with --kt"):
        check([paths["off_2"]], folder / "torque.h5", folder / "no.h5")


def test_runs_that_do_not_go_together(rig):
    folder, paths, _ = rig
    output = folder / "no.h5"
    with pytest.raises(UsageError, match="of different conditions"):
        learn([paths["off_0"], paths["off_1"], paths["on_0"]], output)
    with pytest.raises(InsufficientDataError, match=r"one turn at compensation 0.*two runs"):
        learn([paths["off_0"]], output)
    with pytest.raises(InsufficientDataError, match=r"nearest speed that was learned is 0\.6283"):
        check([paths["off_fast"]], folder / "map.h5", output)
    with pytest.raises(UsageError, match="check one after the other"):
        check([paths["off_2"], paths["on_0"]], folder / "map.h5", output)
    with open_run(folder / "map.h5") as some, pytest.raises(UsageError, match="--friction"):
        learn([paths["off_0"], paths["off_1"]], output, friction=some)
    with pytest.raises(UsageError, match="holds N m, the runs hold A"):
        check([paths["off_2"]], ROOT / "tests" / "fixtures" / "tables.h5", output)
    linear = folder / "linear"
    linear.mkdir()
    axis = take(linear, SLOW.replace("[rig]", '[rig]\naxis = "linear"'), {"off_0": slow_turn(0, 0)})
    with pytest.raises(UsageError, match="linear axis"):
        learn(axis, output)
    assert not output.exists()


def test_runs_of_noise_teach_nothing(tmp_path):
    files = {}
    for n in range(2):
        arrays = slow_turn(n, 1)
        random = np.random.default_rng(100 + n)
        files[f"off_{n}"] = {**arrays, "i": random.normal(0, 0.1, len(arrays["i"]))}
    with pytest.raises(InsufficientDataError, match="no order of rotation exceeds"):
        learn(take(tmp_path, SLOW, files), tmp_path / "no.h5")


@needs_data
def test_the_odrive_set_learned_and_held_out(tmp_path):
    """As docs/odrive-cogging.md shows it."""
    mapping = load_mapping(ROOT / "recipes" / "import" / "odrive-slow.toml")
    import_files([str(COGGING / "slow2")], str(tmp_path / "runs"), mapping)
    runs = [tmp_path / "runs" / f"nocomp_{n}.h5" for n in range(3)]
    learn(runs[:2], tmp_path / "map.h5")
    outcome = check(runs[2:], tmp_path / "map.h5", tmp_path / "check.h5")
    results = outcome.results
    assert ilc_check.fits(outcome)
    assert results["removed"].value == pytest.approx(0.973, rel=0, abs=0.01)
    # The record has noise and the start of the motion, which the mean over the turn has not.
    assert results["record_variance_removed"].value == pytest.approx(0.856, rel=0, abs=0.01)
    for order in (7, 14, 28, 12, 36):
        removed = results[f"order_{order}_removed"]
        assert removed.value > 0.95
        assert removed.u < 0.02
    assert abs(results["table_shift"].value) < 1e-3
    compensated = check(
        sorted((tmp_path / "runs").glob("comp_*.h5")), tmp_path / "map.h5", tmp_path / "check.h5"
    )
    assert 0.7 < compensated.results["removed"].value < 0.8


MAP = """mapping = 1
[rig]
name = "slow"
[map]
signal = "current"
unit = "A"
"""


def mapped(folder, waves):
    """Import maps of 720 values around the turn; return their paths."""
    (folder / "maps").mkdir()
    for name, values in waves.items():
        np.save(folder / "maps" / f"{name}.npy", values)
    import_files([str(folder / "maps")], str(folder / "runs"), (parse_mapping(MAP), MAP))
    return {name: str(folder / "runs" / f"{name}.h5") for name in waves}


def test_maps_are_learned_and_hold_at_any_speed(rig, tmp_path):
    """Two maps of the rig that `slow_turn` is, and one of another motor."""
    angle, random = np.arange(720) * (2 * np.pi / 720), np.random.default_rng(5)
    wave = sum(a * np.cos(k * angle + p) for k, a, p in ORDERS)
    waves = {name: wave + 0.1 + random.normal(0, 0.02, 720) for name in "ab"}
    paths = mapped(tmp_path, {**waves, "other": np.cos(5 * angle)})
    outcome = learn([paths["a"], paths["b"]], tmp_path / "map.h5")
    for order, amplitude, _ in ORDERS:
        found = outcome.results[f"order_{order}_amplitude"]
        assert abs(found.value - amplitude) < 4 * found.u
    assert outcome.results["learned_mean"].value == pytest.approx(0.1, rel=0, abs=5e-3)
    differs = np.fft.rfft(waves["a"] - waves["b"])[1 : HIGHEST_ORDER + 1] * (2 / 720)
    scatter = outcome.results["non_repeatable_rms"].value  # of two, with one degree of freedom
    assert scatter == pytest.approx(np.linalg.norm(differs) / 2, rel=1e-3, abs=0)
    checked = check([rig[1]["off_2"]], tmp_path / "map.h5", tmp_path / "check.h5")
    assert checked.results["table_fits"].value == 1
    with pytest.raises(InsufficientDataError, match=r"other.h5 is another map than"):
        learn(paths.values(), tmp_path / "none.h5")


def test_one_map_has_the_noise_of_its_orders(tmp_path):
    angle, random = np.arange(720) * (2 * np.pi / 720), np.random.default_rng(6)
    paths = mapped(tmp_path, {"a": np.cos(7 * angle) + random.normal(0, 0.1, 720)})
    outcome = learn([paths["a"]], tmp_path / "map.h5")
    found = outcome.results["order_7_amplitude"]
    # Noise s of n values: an amplitude has u = s sqrt(2/n).
    assert found.u == pytest.approx(0.1 * math.sqrt(2 / 720), rel=0.4, abs=0)
    assert outcome.results["learned_mean"].u is None
    (tmp_path / "b").mkdir()
    noise = mapped(tmp_path / "b", {"noise": random.normal(0, 0.1, 720)})
    with pytest.raises(InsufficientDataError, match="no order of rotation exceeds"):
        learn([noise["noise"]], tmp_path / "none.h5")


CROSSED = """mapping = 1
[rig]
name = "the bench"
encoder_counts = 2000
[signals]
time = { column = "time [s]", unit = "s" }
current = { column = "current_setpoint [A]", unit = "A" }
encoder = { column = "encoder [count]", unit = "count", offset = OFFSET }
"""


@pytest.mark.parametrize(("counts", "fitting"), [(0, True), (50, False)])
def test_a_run_of_the_bench_has_the_verdict_of_the_bench_against_its_table(
    tmp_path, counts, fitting
):
    """Six turns scatter by half of the ripple: that is no misfit. Nine degrees are."""
    text = CROSSED.replace("OFFSET", str(counts))
    paths = crossed(tmp_path, FIXTURES / "turning.h5", ["learn_000"], text)
    with open_run(FIXTURES / "kt.h5") as kt:
        outcome = check(paths, FIXTURES / "turning.h5", tmp_path / "check.h5", kt=kt)
    shift = outcome.results["table_shift"]
    assert ilc_check.fits(outcome) == fitting
    assert abs(shift.value - counts * 2 * np.pi / 2000) < 2.5 * shift.u


@pytest.mark.parametrize("repeats", [1, 5])
def test_a_map_s_uncertainty_has_the_degrees_of_freedom_of_its_parts(repeats):
    """GUM G.4.1, over the mean and each order; of one turn, an order's noise is that of others."""
    floor = np.array([2e-3, 5e-3, 1e-3])
    amplitude = np.array([0.1, 0.2, 2e-3])  # the last one does not stand out
    spectrum = Spectrum(np.array([1, 2, 3]), amplitude, np.zeros(3), floor)
    means = 0.02 * np.random.default_rng(1).standard_normal(repeats)
    row = _Row.of(spectrum, means, None)
    dof = 2 * (repeats - 1) if repeats > 1 else 2 * 2 * NEIGHBOURING_ORDERS
    parts = [(u / math.sqrt(2), dof) for u in floor[:2]]
    if repeats > 1:
        parts.append((float(means.std(ddof=1)) / math.sqrt(repeats), repeats - 1))
    square = sum(u**2 for u, _ in parts)
    assert row.u == pytest.approx(math.sqrt(square), rel=1e-12)
    assert row.u_dof == pytest.approx(square**2 / sum(u**4 / n for u, n in parts), rel=1e-12)
