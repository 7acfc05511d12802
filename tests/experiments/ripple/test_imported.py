"""`fft-ripple` on imported runs: synthetic ones with known ripple, and the public data set."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError, RunFileError, UsageError
from rigtool.experiments.ripple import imported
from rigtool.experiments.ripple.imported import (
    _notes,
    _pairs,
    _reduction_table,
    _reduction_text,
    _results,
    _spectrum_table,
    _turning,
    _unpaired,
    _waveform_table,
)
from rigtool.experiments.ripple.imported_groups import RepeatedRuns
from rigtool.experiments.ripple.imported_turns import reduction
from rigtool.experiments.ripple.orders import remove_offset, spectrum
from rigtool.experiments.ripple.procedure import PROCEDURE as FFT_RIPPLE
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.recipe.mapping import load_mapping, parse_mapping
from rigtool.runfile import open_run
from rigtool.runfile.importers import import_files
from tests.experiments.imported_runs import COUNTS, SLOW, crossed, slow_turn, take
from tests.experiments.ripple.fine import FINE
from tests.unchanged import require_unchanged

ROOT = Path(__file__).parents[3]
COGGING = ROOT / ".." / "shared" / "data" / "odrive-cogging" / "analysis" / "cogging_torque"
FIXTURES = ROOT / "tests" / "fixtures"
needs_data = pytest.mark.skipif(
    not COGGING.is_dir(), reason="the public data sets are not beside the repository"
)

MAP = """mapping = 1
[rig]
name = "maps"
[map]
signal = "current"
unit = "A"
missing = 0
"""


def analyse(sources, output, *overrides, **inputs):
    options = CommonOptions(overwrite=True, overrides=overrides)
    return run_command(
        FFT_RIPPLE, [str(source) for source in sources], str(output), options=options, inputs=inputs
    )


@pytest.fixture(scope="module")
def turns(tmp_path_factory):
    folder = tmp_path_factory.mktemp("turns")
    files = {f"off_{n}": slow_turn(n, 0) for n in range(3)}
    files |= {f"on_{n}": slow_turn(10 + n, 0.8) for n in range(3)}
    return folder, take(folder, SLOW, files)


def test_orders_and_by_how_much_each_was_reduced(turns):
    folder, paths = turns
    outcome = analyse(paths, folder / "ripple.h5")
    results = outcome.results
    assert results["strongest_order"].value == 7
    for order, amplitude in ((7, 0.8), (14, 0.2), (28, 0.2)):
        found = results[f"order_{order}_amplitude"]
        assert found.unit == "A"
        assert found.dof == 4  # both parts of three means
        assert found.value == pytest.approx(amplitude, rel=0.05, abs=0)
        reduced = results[f"order_{order}_motion_reduction"]
        assert reduced.value == pytest.approx(0.8, rel=0, abs=0.03)
        assert results[f"order_{order}_current_reduction"].value == pytest.approx(0, abs=0.05)
    assert any("compensation 1 against 0" in note for note in outcome.notes)
    assert any("irregular time axis" in note for note in outcome.notes)
    require_unchanged("imported-turns", outcome)
    with open_run(folder / "ripple.h5") as run:
        assert (run.command, run.rig) == ("fft-ripple", "slow")
        assert len(run.provenance["inputs"]) == 6
        assert run.table("reduction").shape == (1, 440)


def test_one_irregular_time_axis_is_noted(tmp_path):
    irregular, regular = slow_turn(1, 0), slow_turn(2, 0)
    time = np.linspace(*regular["t"][[0, -1]], len(regular["t"]))
    turned = np.unwrap(regular["q"], period=COUNTS)
    regular["q"] = np.interp(time, regular["t"], turned) % COUNTS
    regular["i"], regular["t"] = np.interp(time, regular["t"], regular["i"]), time
    paths = take(tmp_path, SLOW, {"off_0": irregular, "off_1": regular})
    for sources, noted in ((paths, True), (paths[1:], False)):
        notes = analyse(sources, tmp_path / "r.h5").notes
        assert any("irregular time axis" in note for note in notes) == noted


def test_one_condition_alone_has_orders_and_nothing_to_compare(turns):
    folder, paths = turns
    outcome = analyse(paths[:3], folder / "off.h5")
    assert outcome.results["strongest_order"].value == 7
    assert "reduction" not in outcome.tables
    assert not any(name.endswith("reduction") for name in outcome.results)


def test_one_turn_says_that_nothing_repeats(turns):
    folder, paths = turns
    outcome = analyse(paths[:1], folder / "one.h5")
    assert outcome.results["strongest_order"].value == 7
    assert any("one turn, so the repeatable part is unknown" in note for note in outcome.notes)


def test_a_torque_constant_makes_torque_of_current(tmp_path):
    text = SLOW.replace("[rig]", "[rig]\ntorque_constant = 0.5\ntorque_constant_u = 0.01")
    paths = take(tmp_path, text, {"off_0": slow_turn(1, 0), "off_1": slow_turn(2, 0)})
    found = analyse(paths, tmp_path / "r.h5").results["order_7_amplitude"]
    assert found.unit == "N m"
    assert found.value == pytest.approx(0.4, rel=0.05, abs=0)


def test_ripple_of_the_speed_alone_at_few_samples_a_turn(tmp_path):
    random = np.random.default_rng(4)
    time = np.arange(8000) * 1e-3
    angle = 2 * np.pi * 7.3 * time
    speed = 46 + 0.8 * np.cos(6 * angle + 0.3) + random.normal(0, 0.2, len(time))
    text = SLOW.replace('{ column = "i", unit = "A" }', '{ column = "i", unit = "rad/s" }')
    text = text.replace("current =", "speed =")
    arrays = {"t": time, "q": np.mod(angle / (2 * np.pi) * 8192, 8192), "i": speed}
    outcome = analyse(take(tmp_path, text, {"off_0": arrays}), tmp_path / "r.h5")
    found = outcome.results["order_6_amplitude"]
    assert found.unit == "rad/s"
    assert abs(found.value - 0.8) < 3 * found.u
    assert found.u < 0.01
    assert any("58 turns" in note for note in outcome.notes)


def test_groups_of_one_speed_that_was_asked_for_are_compared(tmp_path):
    """14 % apart in speed: by set point they are a pair, without one a note states why not."""
    turns = {"off_0": slow_turn(1, 0), "off_1": slow_turn(2, 0), "on_0": slow_turn(3, 0.8, 0.114)}
    for arrays in turns.values():
        arrays["w"] = np.full(len(arrays["t"]), 0.65)
    outcome = analyse(take(tmp_path, SLOW, turns), tmp_path / "r.h5")
    assert "reduction" not in outcome.tables
    assert any("are not compared" in note for note in outcome.notes)
    asked = SLOW.replace("[[cond", 'speed_setpoint = { column = "w", unit = "rad/s" }\n[[cond')
    (tmp_path / "asked").mkdir()
    outcome = analyse(take(tmp_path / "asked", asked, turns), tmp_path / "r.h5")
    reduced = outcome.results["order_7_motion_reduction"]
    assert reduced.value == pytest.approx(0.8, rel=0, abs=0.05)


def test_sources_that_do_not_go_together(turns, tmp_path):
    _, paths = turns
    np.save(tmp_path / "map.npy", np.arange(1.0, 65))
    mapped = str(tmp_path / "map.h5")
    import_files([str(tmp_path / "map.npy")], mapped, (parse_mapping(MAP), MAP))
    with pytest.raises(UsageError, match="give one kind"):
        analyse([paths[0], mapped], tmp_path / "r.h5")
    with pytest.raises(UsageError, match="two or more"):
        analyse([mapped], tmp_path / "r.h5")
    with pytest.raises(UsageError, match="no recipe"):
        analyse(paths, tmp_path / "r.h5", "fft_ripple.revolutions=3")
    other = take(tmp_path, SLOW.replace("8192", "4096"), {"off_0": slow_turn(1, 0)})
    with pytest.raises(UsageError, match=r"encoder_counts 4096.*one rig"):
        analyse([*paths, *other], tmp_path / "r.h5")
    analyse(paths, tmp_path / "ripple.h5")
    with pytest.raises(RunFileError, match="was written by fft-ripple"):
        analyse([paths[0], tmp_path / "ripple.h5"], tmp_path / "r.h5")
    assert not (tmp_path / "r.h5").exists()


def test_a_linear_axis_has_no_turns(tmp_path):
    text = SLOW.replace("[rig]", '[rig]\naxis = "linear"')
    paths = take(tmp_path, text, {"off_0": slow_turn(1, 0)})
    with pytest.raises(UsageError, match="linear axis"):
        analyse(paths, tmp_path / "r.h5")


def test_a_turned_map_is_reported(tmp_path):
    random = np.random.default_rng(1)
    angle = np.arange(256) * 2 * np.pi / 256
    order = np.arange(1, 20)
    amplitude, phase = random.exponential(size=19), random.uniform(-3, 3, 19)
    whole = np.cos(np.multiply.outer(angle, order) + phase) @ amplitude
    sources = []
    for name, turned in (("a", 0), ("b", 0), ("c", 128)):
        np.save(tmp_path / f"{name}.npy", np.roll(whole, turned) + random.normal(0, 0.05, 256))
        sources.append(str(tmp_path / f"{name}.npy"))
    np.save(tmp_path / "d.npy", random.normal(size=256))
    mapping = (parse_mapping(MAP), MAP)
    import_files([*sources, str(tmp_path / "d.npy")], str(tmp_path / "maps"), mapping)
    outcome = analyse([tmp_path / "maps" / f"{n}.h5" for n in "abcd"], tmp_path / "m.h5")
    shift = outcome.results["shift_c"]
    assert abs(abs(shift.value) - np.pi) < 5 * shift.u
    verdicts = {note[0]: note for note in outcome.notes if note[1] == ":"}
    assert "shifted by half a turn" in verdicts["c"]
    assert "another map" in verdicts["d"]
    assert sum("the same map (" in note for note in verdicts.values()) == 1
    require_unchanged("imported-maps", outcome)


@needs_data
def test_cogging_of_the_odrive_set(tmp_path):
    """The orders that its author names; compensation shows in the motion, not in the current."""
    mapping = load_mapping(ROOT / "recipes" / "import" / "odrive-slow.toml")
    for folder in ("slow2", "slow2_slower"):
        import_files([str(COGGING / folder)], str(tmp_path / folder), mapping)
    fast = analyse(sorted((tmp_path / "slow2").iterdir()), tmp_path / "fast.h5")
    slow = analyse(sorted((tmp_path / "slow2_slower").iterdir()), tmp_path / "slow.h5")
    for outcome in (fast, slow):
        results = outcome.results
        assert results["strongest_order"].value == 7
        for order in (7, 14, 28, 12, 36):
            assert 0.75 < results[f"order_{order}_motion_reduction"].value < 1
            assert abs(results[f"order_{order}_current_reduction"].value) < 0.2


@needs_data
def test_map_c_of_the_odrive_set_is_shifted_by_half_a_turn(tmp_path):
    mapping = load_mapping(ROOT / "recipes" / "import" / "odrive-map.toml")
    import_files([str(COGGING / "coggingmap_0")], str(tmp_path / "maps"), mapping)
    names = [f"cogging_measure_final_{trial}_16" for trial in "abcd"]
    outcome = analyse([tmp_path / "maps" / f"{name}.h5" for name in names], tmp_path / "m.h5")
    shifted = [note for note in outcome.notes if "shifted" in note]
    assert len(shifted) == 1
    assert shifted[0].startswith(f"{names[2]}: the same map, shifted by half a turn")
    assert abs(outcome.results[f"shift_{names[2]}"].value) == pytest.approx(np.pi, abs=0.01)


SYNCHRONOUS = """mapping = 1
[rig]
name = "test bench"
[signals]
time = { column = "t", unit = "s" }
torque = { column = "f", unit = "mN m" }
[[conditions]]
name = "constant_speed"
value = 1000
unit = "rpm"
[[conditions]]
name = "compensation"
column = "c"
"""


def test_torque_alone_at_a_stated_speed_and_orders_that_are_not_told_apart(tmp_path):
    """60 samples a turn show order 36 as 24; compensation is switched on in the same file."""
    time = np.arange(12000) * 1e-3
    angle, on = 2 * np.pi * time * 1000 / 60, (time > 6).astype(float)
    torque = 5 + (1 - 0.5 * on) * np.cos(6 * angle) + 0.3 * np.cos(36 * angle + 1)
    torque += np.random.default_rng(4).normal(0, 0.02, len(time))
    paths = take(tmp_path, SYNCHRONOUS, {"a": {"t": time, "f": torque, "c": on}})
    outcome = analyse(paths, tmp_path / "r.h5")
    results = outcome.results
    assert results["order_6_torque_reduction"].value == pytest.approx(0.5, rel=0, abs=0.01)
    assert not any("motion" in name for name in results)
    alias = results["order_24_amplitude"]
    assert alias.u > 0.5 * alias.value
    assert any("not separated: 1 from 59" in note for note in outcome.notes)
    assert any("the speed was stated; refined" in note for note in outcome.notes)
    table = outcome.tables["imported_spectrum"]
    assert table["alias"][0, 23] in (36, 84)
    assert np.isnan(table["deviation"]).all()
    require_unchanged("imported-alias", outcome)


CROSSED = """mapping = 1
[rig]
name = "the bench"
encoder_counts = 4000
[signals]
time = { column = "time [s]", unit = "s" }
current = { column = "current_setpoint [A]", unit = "A" }
encoder = { column = "encoder [count]", unit = "count" }
"""


def test_orders_of_the_bench_are_the_same_as_an_import(tmp_path):
    """At 1.3 rad/s, where the loop answers all that is asked for; without the set point."""
    paths = crossed(tmp_path, FIXTURES / "ripple.h5", ["torque_000"], CROSSED)
    with open_run(FIXTURES / "kt.h5") as kt, open_run(FIXTURES / "ripple.h5") as stored:
        found = analyse(paths, tmp_path / "ripple.h5", kt=kt).results
        bench = stored.tables["torque_spectrum"].columns
        for order in (1, 2, 3, 4, 6):
            there = [bench[name].values[0][order - 1] for name in ("amplitude", "u")]
            here = found[f"order_{order}_amplitude"]
            assert abs(here.value - there[0]) < 2 * np.hypot(here.u, there[1])
            assert 0.3 < here.u / there[1] < 3


def group(speed, setpoint=None, turns=3, leak=(), **conditions):
    """Return a group of turns with orders 2 and 5, less of them with compensation."""
    angle = 2 * np.pi * (np.arange(500) + 0.5) / 500
    part = 1 - 0.8 * conditions.get("compensation", 0.0)
    noise = 1e-3 * np.random.default_rng(turns).standard_normal((turns, 500))
    wave = part * (0.5 * np.cos(2 * angle) + 0.2 * np.cos(5 * angle)) + noise
    leaks = np.zeros(20)
    leaks[list(leak)] = 0.9
    own = RepeatedRuns(
        conditions, speed, 1, 3.0 + wave, 0.1 * wave, 20, float(turns), FINE,
        np.arange(20.0) + 40, leaks, moved=not leak, setpoint=setpoint,
    )  # fmt: skip
    for name, rows in (("torque", own.torque), ("deviation", own.deviation)):
        own.spectra[name] = spectrum(remove_offset(rows, FINE), 20)
    return own


@pytest.mark.parametrize(
    ("speeds", "asked", "paired", "noted"),
    [
        ((2.0, 2.19), None, True, False),
        ((2.0, 2.21), None, False, True),
        ((2.0, 2.59), None, False, True),
        ((2.0, 2.61), None, False, False),
        ((2.0, -2.0), None, False, False),
        ((2.0, 2.59), (2.2, 2.201), True, False),
        ((2.0, 2.05), (2.2, 2.21), False, True),
    ],
)
def test_groups_of_one_speed_are_compared_and_others_that_may_be_are_noted(
    speeds, asked, paired, noted
):
    first, second = asked or (None, None)
    groups = [
        group(speeds[0], first, compensation=0.0, load=1.0),
        group(speeds[1], second, compensation=1.0, load=1.0),
    ]
    assert [(low is groups[0], name) for low, _, name in _pairs(groups)] == (
        [(True, "compensation")] if paired else []
    )
    assert len(_unpaired(groups)) == noted
    if noted:
        assert f"they turn at {speeds[0]:.4g} and {speeds[1]:.4g} rad/s" in _unpaired(groups)[0]
    apart = [groups[0], group(speeds[1], second, compensation=1.0, load=2.0)]
    assert _pairs(apart) == []
    assert _unpaired(apart) == []


def test_results_are_of_the_pair_with_most_turns_and_other_conditions_off():
    groups = [
        group(2.0, compensation=0.0, load=1.0, turns=9),
        group(2.0, compensation=1.0, load=1.0, turns=9),
        group(2.0, compensation=0.0, load=0.0, turns=9),
        group(2.0, compensation=1.0, load=0.0, turns=9),
        group(2.0, compensation=0.0, load=3.0, turns=12),
        group(2.0, compensation=1.0, load=3.0, turns=4),
    ]
    (low, high, name), *_ = pairs = _pairs(groups)
    assert (groups.index(low), groups.index(high), name) == (2, 3, "compensation")
    named = [name for *_, name in pairs]
    assert named.index("load") == 2  # the mapping's first condition comes first
    effort = SimpleNamespace(unit="A", name="current")
    found = _results(groups, pairs, effort)
    assert found["strongest_order"].value == 2
    for order, amplitude in ((2, 0.5), (5, 0.2)):
        own = found[f"order_{order}_amplitude"]
        assert own.value == pytest.approx(amplitude, rel=0.01)
        assert own.dof == 16
        # of 1 mA in 500 cells and nine turns, in two parts
        assert own.u == pytest.approx(1e-3 * np.sqrt(2 / 500 / 9), rel=0.5)
        for what in ("motion", "current"):
            assert found[f"order_{order}_{what}_reduction"].value == pytest.approx(0.8, abs=0.01)
    assert _results(groups[4:5], [], effort)["order_2_amplitude"].dof == 22
    assert _results([group(2.0, turns=1)], [], effort)["order_2_amplitude"].dof is None


def test_parts_of_a_file_without_turns_are_left_out_and_whole_files_refused(monkeypatch):
    def turns(recording, kt, positions):
        if recording.short:
            raise InsufficientDataError("a part of a turn")
        return recording.name.upper()

    def part(name, short):
        return SimpleNamespace(name=name, path="a.h5", short=short)

    monkeypatch.setattr(imported, "turns_of", turns)
    parts = [part("imported_a", False), part("imported_b", True), part("imported_c", False)]
    found = _turning(parts, None, 500)
    assert found == ([parts[0], parts[2]], ["IMPORTED_A", "IMPORTED_C"], ["a.h5, imported_b"])
    with pytest.raises(InsufficientDataError):
        _turning(parts[1:2], None, 500)
    with pytest.raises(InsufficientDataError):
        _turning([parts[0], part("imported", True)], None, 500)


def test_reductions_are_listed_of_orders_that_the_reference_shows():
    low, high = group(2.0, compensation=0.0), group(2.0, compensation=1.0)
    motion, torque = _reduction_text(low, high, "current").split("; ")
    for text, name in ((motion, "motion"), (torque, "current")):
        head, factors = text.split(", order by order, ")
        assert head == f"ripple of the {name} times"
        found = [each.split(": ") for each in factors.split(", ")]
        assert [order for order, _ in found][:2] == ["2", "5"]
        np.testing.assert_allclose([float(factor) for _, factor in found[:2]], 0.2, atol=0.01)


def test_notes_count_turns_and_name_what_is_not_separated():
    groups = [group(2.0, turns=1), group(2.0, leak=range(1, 9), turns=3, compensation=1.0)]
    turns = [SimpleNamespace(settled=0.25), SimpleNamespace(settled=0.0)]
    notes = _notes(groups, _pairs(groups), turns, 20, "current")
    assert notes[0] == "settling was left out at the start, up to 0.25 s of a run"
    assert notes[1] == "the samples around the turn resolve orders up to 20"
    assert notes[2].startswith("group 0 (2 rad/s; 1 run, 1 turn): strongest orders 2, 5")
    assert notes[3].startswith("group 0 is one turn, so the repeatable part is unknown")
    assert notes[4].startswith("group 1 (compensation 1, 2 rad/s; 1 run, 3 turns)")
    assert (
        "group 1: the speed was stated; refined by the orders of the torque it is 2 rad" in notes[5]
    )
    shown = ", ".join(f"{order} from {order + 39}" for order in range(2, 8))
    assert f"not separated: {shown} and 2 more;" in notes[6]
    assert notes[7] == "the results are of group 1"


def test_tables_hold_the_groups_their_orders_and_means():
    made = [group(2.0, compensation=0.0), group(3.0, turns=5, compensation=1.0, leak=(4,))]
    table, waves = _spectrum_table(made, "N m"), _waveform_table(made, "N m")
    for own in (table, waves):
        assert own["group"].tolist() == [0, 1]
        assert own["speed"].tolist() == [2.0, 3.0]
        assert own["turns"].tolist() == [3.0, 5.0]
        assert own["compensation"].tolist() == [0.0, 1.0]
    np.testing.assert_array_equal(table["order"], np.arange(1, 21))
    for n, one in enumerate(made):
        torque, deviation = one.spectra["torque"], one.spectra["deviation"]
        for name, values in (
            ("amplitude", torque.amplitude),
            ("phase", torque.phase),
            ("noise_floor", torque.noise_floor),
            ("u", one.u),
            ("dof", one.dof),
            ("alias", one.alias),
        ):
            np.testing.assert_array_equal(table[name][n], values, err_msg=name)
        for name, values in (
            ("deviation", deviation.amplitude),
            ("deviation_phase", deviation.phase),
            ("deviation_noise_floor", deviation.noise_floor),
        ):
            # a speed that was only stated shows no motion
            expected = np.full(20, np.nan) if n else values
            np.testing.assert_array_equal(table[name][n], expected, err_msg=name)
        np.testing.assert_allclose(waves["ripple"][n], one.torque.mean(axis=0))
        mean = np.full(500, np.nan) if n else one.deviation.mean(axis=0)
        np.testing.assert_allclose(waves["deviation"][n], mean)
    np.testing.assert_allclose(waves["position"], 2 * np.pi * (np.arange(500) + 0.5) / 500)
    assert table.columns["deviation"].unit == waves.columns["deviation"].unit == "rad"
    low, high = made
    found = _reduction_table([(low, high, "compensation")], 20)
    assert found["pair"].tolist() == [0]
    np.testing.assert_array_equal(found["order"], np.arange(1, 21))
    for name, quantity in (("reduction", "deviation"), ("torque_reduction", "torque")):
        values, u = reduction(low.spectra[quantity], high.spectra[quantity])
        np.testing.assert_array_equal(found[name][0], values)
        np.testing.assert_array_equal(found[f"{name}_u"][0], u)
    assert found["torque_reduction"][0][1] == pytest.approx(0.8, abs=0.01)
