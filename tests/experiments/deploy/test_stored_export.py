"""Learned tables taken away and read back: by a C compiler, a drive's rules, pandas, scipy."""

import json
import math
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.io import loadmat

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import RunFileError, UsageError
from rigtool.experiments.deploy import drive_formats as texts
from rigtool.experiments.deploy.c_header import comment, header, identifier
from rigtool.experiments.deploy.position_map import TURN, position_map
from rigtool.experiments.deploy.stored_export import MAP_FORMATS, chosen_format, export_table
from rigtool.experiments.learning.learned_table import COULOMB, VISCOUS, LearnedTable
from rigtool.experiments.learning.rows import Amplitudes
from rigtool.experiments.learning.stored_table import (
    learned_table_from,
    period_results,
    tables_of,
)
from rigtool.experiments.torque_per_ampere import constant_result, torque_per_ampere
from rigtool.quantity import Quantity
from rigtool.runfile import RunWriter, open_run
from tests.control import test_lookup_table
from tests.experiments.deploy.periodic_tables import cogging, turning

FIXTURES = Path(__file__).parents[2] / "fixtures"
needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler cc")

HOST = """
#include <stdio.h>
#include "NAME.h"
int main(void)
{
    float position, speed;
    while (scanf("%f %f", &position, &speed) == 2)
        printf("%.9g %d\\n", NAME_torque(position, speed), NAME_covers(position, speed));
    return 0;
}
"""


def taken(
    table, u=None, *, unit="N m", quantity="torque", friction=None, band_speed=None, constant=None
):
    """Return a learned table as the run file would give it."""
    u = np.full(table.torque.shape, 1e-5) if u is None else u
    return LearnedTable(
        table=table,
        u=u,
        quantity=quantity,
        unit=unit,
        friction=friction or {},
        band_hz=100.0,
        band_speed=band_speed,
        origin=(
            "Rig bench; learned on 2026-01-02, rigtool 0.1.0.",
            "File t.h5, content sha256 ab.",
        ),
        constant=constant,
    )


def compiled(folder, name, text, position, speed):
    """Compile a header strictly and return what it computes at these points."""
    (folder / f"{name}.h").write_text(text)
    (folder / "host.c").write_text(HOST.replace("NAME", name))
    strict = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
    subprocess.run(
        ["cc", *strict, "host.c", "-lm", "-o", "host"], cwd=folder, check=True, timeout=60
    )
    lines = "".join(
        f"{p!r} {v!r}\n" for p, v in zip(position.tolist(), speed.tolist(), strict=True)
    )
    done = subprocess.run(
        [folder / "host"], input=lines, capture_output=True, text=True, check=True, timeout=60
    )
    values = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
    return values[:, 0], values[:, 1].astype(bool)


def float_loss(table, position):
    """Return what 4-byte arithmetic may be off by: rounding of values, and of the position."""
    peak = np.abs(table.torque).max()
    steepest = np.abs(np.diff(table.torque, axis=1)).max() / np.diff(table.position).min()
    return 2**-20 * peak + 2**-22 * np.abs(position).max() * steepest


LOST = r"largest (\S+) N m, rms"


@needs_compiler
@pytest.mark.parametrize("short", [False, True])
@pytest.mark.parametrize("keep", [slice(None), slice(3, None), slice(0, 3)])
def test_the_header_computes_what_the_table_says(tmp_path, short, keep):
    table = test_lookup_table.table()
    table = test_lookup_table.table(speed=table.speed[keep], torque=table.torque[keep])
    text, lost = header(taken(table), "limited", short=short)
    random = np.random.default_rng(1)
    low, high = table.position[[0, -1]]
    position = random.uniform(low - 0.05, high + 0.05, 3000).astype(np.float32).astype(float)
    speed = random.uniform(-25, 25, 3000).astype(np.float32).astype(float)
    found, covered = compiled(tmp_path, "limited", text, position, speed)
    stated = float(re.search(LOST, lost)[1])
    expected = table.evaluate(position, speed)
    # The stated loss has two digits.
    bound = 1.05 * stated * 1.3 + float_loss(table, position)
    assert np.abs(found - expected).max() < bound
    if short:
        assert np.abs(found - expected).max() > stated / 3
        assert stated < 1e-4 * np.abs(table.torque).max()
    edge = np.minimum(np.abs(position - low), np.abs(position - high)) < 1e-5
    np.testing.assert_array_equal(covered[~edge], table.covers(position, speed)[~edge])


@needs_compiler
@pytest.mark.parametrize("short", [False, True])
def test_the_header_of_a_whole_turn_is_periodic(tmp_path, short):
    table, u = turning(500, start=0.3)
    text, _ = header(taken(table, u), "turn", short=short)
    random = np.random.default_rng(2)
    position = random.uniform(-20, 20, 3000).astype(np.float32).astype(float)
    position[:4] = [0.3, 0.3 - 1e-6, 0.3 + TURN, -1e-7]
    speed = random.uniform(-7, 7, 3000).astype(np.float32).astype(float)
    found, covered = compiled(tmp_path, "turn", text, position, speed)
    bound = float_loss(table, position) + (2e-4 * np.abs(table.torque).max() if short else 0)
    assert np.abs(found - table.evaluate(position, speed)).max() < bound
    np.testing.assert_array_equal(covered, np.abs(speed) <= 6 * (1 + 1e-6))


@needs_compiler
def test_the_header_survives_what_is_no_number(tmp_path):
    text, _ = header(taken(turning(500)[0]), "turn", short=False)
    odd = np.array([np.nan, np.inf, -np.inf, 1e30, 1.0, 1.0, 1.0])
    found, _ = compiled(
        tmp_path, "turn", text, odd, np.array([2, 2, 2, 2, np.nan, np.inf, -np.inf])
    )
    assert np.isfinite(found).all()
    assert found[0] == found[4] == 0
    assert np.abs(found).max() < 5e-3


def test_the_header_says_what_must_be_known(tmp_path):
    friction = {
        COULOMB: Quantity(2.3e-3, "N m", 0.0),
        VISCOUS: Quantity(5.3e-5, "N m s/rad", 0.0),
    }
    text, lost = header(taken(turning(500)[0], friction=friction), "t", short=False)
    head = text.partition("*/")[0]
    for part in ("N m", "rad/s", "bilinear", "Periodic over 6.28318531 rad", "sha256 ab", lost):
        assert part in head
    assert "0.0023 N m * tanh(v) + 5.3e-05 N m s/rad * v" in head
    assert "#define T_COULOMB 0.0023" in text
    assert "#define T_VISCOUS 5.3e-05f" in text


@pytest.mark.parametrize(
    ("stem", "expected"),
    [
        ("table", "table"),
        ("Table B-2", "table_b_2"),
        ("7th", "table_7th"),
        ("__x__", "x"),
        ("ü", "table"),
    ],
)
def test_names_become_identifiers(stem, expected):
    assert identifier(stem) == expected


def test_nothing_ends_the_comment_early():
    text = comment(["rig */ int x; /*", "two\nlines"])
    assert text.count("*/") == 1
    assert text.endswith("*/")


# -- drives


def test_a_moteus_table_is_what_the_drive_adds_up():
    turn = position_map(*turning(), 2.0).scaled(1 / 0.045)
    text, lost = texts.moteus(taken(turning()[0]), turn)
    assert f"# Lost: {lost}." in text
    lines = [line.split() for line in text.splitlines() if not line.startswith("#")]
    assert lines[0][0] == "motor.cogging_dq_scale"
    scale = float(lines[0][1])
    assert [name for name, _ in lines[1:]] == [f"motor.cogging_dq_comp.{i}" for i in range(1024)]
    codes = np.array([int(code) for _, code in lines[1:]])
    assert -128 <= codes.min() <= codes.max() <= 127
    angle = np.arange(1024) * TURN / 1024
    # Rounded: off by half a code, not by a whole one.
    off = codes * scale - cogging(angle) / 0.045
    assert np.abs(off).max() <= scale / 2 * 1.01
    assert abs(off.mean()) < scale / 10


def test_an_odrive_map_has_the_middles_of_its_cells():
    turn = position_map(*turning(), 2.0)
    text, _ = texts.odrive(taken(turning()[0]), turn, as_json=False)
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    assert lines[0] == "index,torque [N m]"
    values = np.array([float(line.split(",")[1]) for line in lines[1:]])
    # The table's chords are off by up to h^2/8 of its curvature, 0.2 mN m at order 28.
    np.testing.assert_allclose(
        values, cogging((np.arange(3600) + 0.5) * TURN / 3600), rtol=0, atol=1e-7
    )
    same = json.loads(texts.odrive(taken(turning()[0]), turn, as_json=True)[0])
    assert same["torque"] == values.tolist()
    assert same["unit"] == "N m"
    assert same["loss"]["largest"] > 0


def test_fourier_coefficients_rebuild_the_map():
    table, u = turning(noise=1e-5)
    turn = position_map(table, u, 2.0)
    document = json.loads(texts.fourier(taken(table, u), turn, as_json=True)[0])
    assert document["examined"] == int(100 * TURN / 2)
    # learned at one speed: its orders are those of the map at every other speed
    at_one = taken(table, u, band_speed=5.0)
    document_of_one = json.loads(texts.fourier(at_one, turn, as_json=True)[0])
    assert document_of_one["examined"] == int(100 * TURN / 5)
    angle = turn.start + np.arange(4000) * TURN / 4000
    rebuilt = sum(
        a * np.cos(n * angle + p)
        for n, a, p in zip(document["order"], document["amplitude"], document["phase"], strict=True)
    )
    off = rebuilt - turn.values
    assert np.abs(off).max() == pytest.approx(document["loss"]["largest"], rel=1e-9, abs=0)
    assert min(document["amplitude_u"]) > 0
    text, _ = texts.fourier(taken(table, u), turn, as_json=False)
    rows = [line.split(",") for line in text.splitlines() if not line.startswith("#")]
    assert rows[0][1] == "amplitude [N m]"
    assert [float(row[1]) for row in rows[1:]] == document["amplitude"]


# -- whole runs


@pytest.fixture(scope="module")
def tables():
    with open_run(FIXTURES / "tables.h5") as run:
        yield run


def take_away(run, path, wanted=None, **options):
    chosen = chosen_format(run, path, options.pop("part", None), wanted)
    settings = {"speed": None, "kt": None, "overwrite": False, **options}
    return export_table(run, path, chosen, **settings)


def check_rows(tables, position, speed, torque):
    """Compare rows by speed and position with the stored table, low speeds between."""
    lookup, amplitude = tables.table("lookup"), tables.table("amplitude")
    np.testing.assert_array_equal(position, lookup["position"])
    for v, row in zip(lookup["speed"], lookup["torque"], strict=True):
        np.testing.assert_array_equal(torque[list(speed).index(v)], row)
    low = list(speed).index(amplitude["low_speed"][1])
    np.testing.assert_allclose(
        torque[low], amplitude["amplitude"][1] * torque[low + 1], rtol=1e-15, atol=0
    )
    assert not torque[list(speed).index(0)].any()


def test_csv_is_read_back_whole(tables, tmp_path):
    remarks = take_away(tables, tmp_path / "t.csv")
    assert remarks == ("lost nothing: 8-byte numbers, as they were learned",)
    frame = pd.read_csv(tmp_path / "t.csv", comment="#", dtype=str).map(float)  # exact
    wide = frame.pivot(index="speed [rad/s]", columns="position [rad]", values="torque [N m]")
    check_rows(tables, wide.columns.to_numpy(), wide.index.to_list(), wide.to_numpy())
    assert (frame["u [N m]"] >= 0).all()


def test_json_is_read_back_whole(tables, tmp_path):
    take_away(tables, tmp_path / "t.json")
    found = json.loads((tmp_path / "t.json").read_text())
    check_rows(
        tables,
        found["position"]["values"],
        found["speed"]["values"],
        np.array(found["torque"]["values"]),
    )
    assert found["torque"]["unit"] == "N m"
    assert found["period"] is None
    assert any(tables.content_sha256 in line for line in found["description"])
    assert found["loss"]["largest"] == 0


def test_matlab_is_read_back_whole(tables, tmp_path):
    take_away(tables, tmp_path / "t.mat", "table")
    found = loadmat(tmp_path / "t.mat", simplify_cells=True)
    check_rows(tables, found["position"], found["speed"].tolist(), found["torque"])
    assert math.isnan(found["period"])
    assert found["units"]["torque"] == "N m"


@needs_compiler
def test_the_header_of_a_stored_run(tables, tmp_path):
    take_away(tables, tmp_path / "tables.h")
    lookup, amplitude = tables.table("lookup"), tables.table("amplitude")
    table = LookupTable(
        lookup["position"],
        lookup["speed"],
        lookup["torque"],
        amplitude["low_speed"],
        amplitude["amplitude"],
    )
    random = np.random.default_rng(4)
    position = random.uniform(0.2, 2.5, 2000).astype(np.float32).astype(float)
    speed = random.uniform(-28, 28, 2000).astype(np.float32).astype(float)
    found, _ = compiled(tmp_path, "tables", (tmp_path / "tables.h").read_text(), position, speed)
    off = np.abs(found - table.evaluate(position, speed)).max()
    assert off < float_loss(table, position)


@pytest.mark.parametrize(
    ("name", "wanted", "options", "message"),
    [
        ("t.cfg", None, {}, "not a whole turn"),
        ("t.csv", "fourier", {}, "not a whole turn"),
        ("t.h", "table", {}, r"written as .csv or .json or .mat, not '.h'"),
        ("t", "c", {}, "written as .h, not 'without ending'"),
        ("t.h", None, {"part": "lookup"}, "leave one out"),
        ("t.h", None, {"speed": 3.0}, "--speed is for moteus, odrive, fourier"),
        ("t.json", None, {"kt": object()}, "--kt is for moteus"),
    ],
)
def test_what_does_not_go_together_is_refused(tables, tmp_path, name, wanted, options, message):
    with pytest.raises(UsageError, match=message):
        take_away(tables, tmp_path / name, wanted, **options)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_is_kept(tables, tmp_path):
    (tmp_path / "t.h").write_text("mine")
    with pytest.raises(UsageError, match="--overwrite"):
        take_away(tables, tmp_path / "t.h")
    assert (tmp_path / "t.h").read_text() == "mine"
    take_away(tables, tmp_path / "t.h", overwrite=True)
    assert "tables.h5" in (tmp_path / "t.h").read_text()


def test_the_runs_own_formats_stay_what_they_are(tables):
    assert chosen_format(tables, Path("a.mat"), None, None) is None
    assert chosen_format(tables, Path("a.nc"), None, None) is None
    assert chosen_format(tables, Path("a.csv"), "lookup", None) is None
    with open_run(FIXTURES / "friction.h5") as other:
        assert chosen_format(other, Path("a.csv"), None, None) is None


def test_another_run_holds_no_table(tmp_path):
    with open_run(FIXTURES / "friction.h5") as other, pytest.raises(RunFileError, match="stribeck"):
        take_away(other, tmp_path / "t.h")
    assert list(tmp_path.iterdir()) == []


def test_the_unit_that_a_drive_takes(tmp_path):
    """Current from torque needs a calibration, and only then may one be given."""
    from rigtool.experiments.deploy.stored_export import in_unit

    constant = {
        "torque_constant_mean": Quantity(0.045, "N m/A", 1e-5),
        "amplifier_gain": Quantity(1.02, "1", 1e-4),
    }
    per_ampere = 0.045 * 1.02  # of the set point, which is what a drive adds to
    path = tmp_path / "kt.h5"
    with RunWriter(path, command="calibrate-kt") as writer:
        writer.finish(constant, {})
    table, u = turning()
    turn = position_map(table, u, 2.0)
    torque, current = taken(table, u), taken(table, u, unit="A", quantity="current")
    with open_run(path) as kt:
        np.testing.assert_allclose(
            in_unit(turn, torque, "moteus", kt).values, turn.values / per_ampere, rtol=1e-12, atol=0
        )
        np.testing.assert_allclose(
            in_unit(turn, current, "odrive", kt).values,
            turn.values * per_ampere,
            rtol=1e-12,
            atol=0,
        )
        with pytest.raises(UsageError, match="leave it out"):
            in_unit(turn, torque, "odrive", kt)
    assert in_unit(turn, current, "moteus", None) is turn
    with pytest.raises(UsageError, match="--kt is missing: moteus takes A"):
        in_unit(turn, torque, "moteus", None)
    with pytest.raises(UsageError, match="holds 1, moteus takes A"):
        in_unit(turn, taken(table, u, unit="1"), "moteus", None)


def written(path, command, results, tables=None, inputs=()):
    with RunWriter(path, command=command, inputs=inputs) as writer:
        writer.finish(results, tables or {})
    return path


def calibration(folder, constant):
    """Write a calibration: an amplifier of gain 0.92, and a constant of the motor."""
    results = {
        "torque_constant_mean": Quantity(constant, "N m/A", 1e-5),
        "amplifier_gain": Quantity(0.92, "1", 1e-4),
    }
    return written(folder / f"kt-{constant * 1e3:g}.h5", "calibrate-kt", results)


def of_whole_turns(path, kt, *, states_constant):
    """Write a table of whole turns, learned with a calibration."""
    table, u = turning()
    tables = tables_of(
        table, u, Amplitudes.fading(table.low_speed[-1]), np.full(len(table.speed), np.inf)
    )
    results = period_results(table)
    if states_constant:
        results |= constant_result(torque_per_ampere(kt).value)
    return written(path, "ilc-learn", results, tables, [kt])


@pytest.mark.parametrize("ending", ["csv", "json"])
@pytest.mark.parametrize("wanted", ["moteus", "odrive", "fourier", "table", "c", "c-int16"])
def test_every_format_is_of_the_current_that_was_learned(tmp_path, wanted, ending):
    """Where N m are written, the line beside them says which current they are."""
    path = tmp_path / {"moteus": "t.cfg", "c": "t.h", "c-int16": "t.h"}.get(wanted, f"t.{ending}")
    speed = 2.0 if wanted in MAP_FORMATS else None
    with open_run(calibration(tmp_path, 0.045)) as kt:
        stored = of_whole_turns(tmp_path / "turning.h5", kt, states_constant=True)
    with open_run(stored) as run, open_run(calibration(tmp_path, 0.05)) as later:
        given = later if wanted == "moteus" else None
        notes = export_table(run, path, wanted, speed=speed, kt=given, overwrite=False)
        learned = learned_table_from(run)
        turn = position_map(learned.table, learned.u, 2.0)
    text = " ".join(path.read_text().replace("*", " ").split())
    assert "Torque over 0.0414 N m/A is the current set point that was learned." in text
    if wanted == "moteus":
        scale, *codes = (float(line.split()[1]) for line in path.read_text().splitlines()[-1025:])
        assert scale * max(map(abs, codes)) == pytest.approx(
            np.abs(turn.values).max() / (0.045 * 0.92), rel=0.01
        )
        assert any("kt-50.h5 states 46 mN m/A, which does not change them" in n for n in notes)


def test_an_older_table_goes_with_its_own_calibration_only(tmp_path):
    """Such a table does not state the constant of its currents."""
    with (
        open_run(calibration(tmp_path, 0.045)) as kt,
        open_run(calibration(tmp_path, 0.05)) as later,
    ):
        stored = of_whole_turns(tmp_path / "turning.h5", kt, states_constant=False)
        out = tmp_path / "t.cfg"
        with open_run(stored) as run:
            export_table(run, out, "moteus", speed=2.0, kt=kt, overwrite=False)
            with pytest.raises(UsageError, match=r"ilc-learn turning.h5 --kt kt-50.h5 -o"):
                export_table(run, out, "moteus", speed=2.0, kt=later, overwrite=True)
