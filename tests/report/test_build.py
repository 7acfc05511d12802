import itertools
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from rigtool.errors import RunFileError, UsageError
from rigtool.report.build import build_report
from rigtool.report.formats import csv_table
from rigtool.report.tables import force_table, results_table
from rigtool.runfile import RunWriter
from rigtool.runfile.provenance import seal

FIXTURES = Path(__file__).parents[1] / "fixtures"

COMMANDS = (
    "calibrate-kt",
    "stribeck",
    "fft-ripple",
    "identify-plant",
    "ilc-learn",
    "measure-force",
)


def cells(table, key):
    index = [column.key for column in table.columns].index(key)
    return [row[index].text for row in table.rows]


def test_table_8_stands_beside_the_published_one(make, open_all):
    (run,) = open_all(make("measure-force"))
    table = force_table(run, "force")
    assert table.name == "table-8-force"
    assert cells(table, "applied_force") == ["60", "250", "1000", "2000", "2500"]
    assert cells(table, "applied_torque") == ["1.2", "5", "20", "40", "50"]
    assert cells(table, "mean_torque") == [
        "1.30(10)",
        "5.35(10)",
        "22.40(10)",
        "44.70(10)",
        "55.00(10)",
    ]
    assert cells(table, "mean_torque_published") == ["1.3", "5.35", "22.4", "44.7", "55"]
    assert cells(table, "std_torque") == cells(table, "std_torque_published")
    assert cells(table, "error_torque_published") == ["+0.1", "+0.35", "+2.4", "+4.7", "+5"]
    assert cells(table, "error_percent_published") == ["+8", "+7", "+12", "+12", "+10"]


def test_table_9_is_that_of_the_pulley(make, open_all):
    (run,) = open_all(make("measure-force", sets=("rig.attachment=pulley",)))
    table = force_table(run, "pulley")
    assert table.title.startswith("Table 9.")
    assert cells(table, "error_percent_published") == ["+7", "-2", "+4", "-4", "-3"]
    assert cells(table, "error_torque") == ["+0.06", "-0.08", "+0.50", "-1.20", "-1.00"]


def test_a_corrected_run_shows_table_8_three_times(make, open_all, no_figures):
    (run,) = open_all(make("measure-force", sets=("measure_force.correction=full",)))
    tables = build_report([run]).force_tables
    assert [table.name for table in tables] == [
        "table-8-three-times-measure-force",
        "table-8-measure-force-full",
        "table-8-measure-force-none",
    ]
    three = tables[0]
    assert cells(three, "mean_torque_published") == ["1.3", "5.35", "22.4", "44.7", "55"]
    assert cells(three, "error_percent_none") == ["+8.0", "+7.0", "+12.0", "+12.0", "+10.0"]
    assert cells(three, "mean_torque_full")[:2] == ["1.20(10)", "5.01(10)"]
    assert cells(three, "error_percent_full") == ["+0.2", "+0.2", "+0.2", "+0.2", "–"]
    # The largest load was not learned: no number stands where there is none.
    assert cells(tables[1], "mean_torque")[-1] == "–"
    assert cells(tables[2], "mean_torque")[-1] == "55.00(10)"
    assert "whole strokes" in tables[1].note
    assert "nan" not in csv_table(three).lower()


def test_results_stand_beside_published_ones_with_their_section(make, open_all):
    (run,) = open_all(make("calibrate-kt"))
    table = results_table(run, "kt")
    assert cells(table, "value") == ["45.800(20)", "-0.1160(10)", "1"]
    assert cells(table, "unit") == ["mN m/A", "%/K", ""]
    assert cells(table, "published") == ["45.8", "-0.116", "–"]
    assert cells(table, "section") == ["7.1.1", "7.1.1", "–"]
    assert cells(table, "reason") == ["", "", "taken as given"]
    assert "torque_constant,0.0458,2e-05,N m/A,0.0458,7.1.1," in csv_table(table)


def test_a_run_without_loads_has_no_force_table(make, open_all):
    (run,) = open_all(make("calibrate-kt"))
    with pytest.raises(RunFileError, match="has no table 'loads'"):
        force_table(run, "kt")


def test_the_order_of_the_files_does_not_matter(make, open_all, no_figures):
    runs = open_all(*(make(command) for command in ("measure-force", "calibrate-kt", "ilc-learn")))
    first, *others = (build_report(order) for order in itertools.permutations(runs))
    assert all(report == first for report in others)
    assert [origin.command for origin in first.origins] == [
        "calibrate-kt",
        "ilc-learn",
        "measure-force",
    ]


def test_every_figure_of_the_thesis_is_there(make, open_all, unrendered):
    report = build_report(open_all(*map(make, COMMANDS)))
    numbers = [20, *range(22, 29), 30, 32, 34, 35, 39, 40, 41, 50, 56, *range(58, 64), 76, 100, 107]
    assert [picture.number for picture in report.pictures] == numbers


def test_figures_of_the_plant_are_drawn_to_the_end(make, open_all):
    """Those of the other commands are in the report of the README's chain."""
    report = build_report(open_all(make("identify-plant")))
    assert report.pictures
    for picture in report.pictures:
        assert picture.png.startswith(b"\x89PNG")
        assert picture.svg.startswith("<?xml")
        assert len(picture.svg) < 300_000


def test_only_figures_whose_tables_are_there(make, open_all, tmp_path):
    with RunWriter(tmp_path / "empty.h5", command="measure-force") as writer:
        writer.finish({}, {})
    report = build_report(open_all(make("calibrate-kt"), tmp_path / "empty.h5"))
    assert [picture.number for picture in report.pictures] == [20, 107]
    assert report.force_tables == ()
    assert any("holds signals but no results" in warning for warning in report.warnings)


def test_two_runs_of_a_kind_are_told_apart_by_their_names(make, open_all, no_figures):
    report = build_report(
        open_all(
            make("measure-force", "inside"),
            make("measure-force", "outside", sets=("rig.attachment=pulley",)),
            make("measure-force", "inside", folder="elsewhere", sets=("virtual.seed=2",)),
        )
    )
    assert sorted(origin.label for origin in report.origins) == ["inside", "inside-2", "outside"]
    names = [table.name for table in report.force_tables]
    assert len(set(names)) == 3
    assert len({picture.name for picture in report.pictures}) == len(report.pictures)


def test_one_file_twice_is_refused(make, open_all, no_figures):
    path = make("calibrate-kt")
    other_name = path.with_name("other.h5")
    other_name.hardlink_to(path)
    for name in (path.parent / "." / path.name, other_name):
        with pytest.raises(UsageError, match="given twice"):
            build_report(open_all(path, name))


def test_warnings_about_runs_that_do_not_belong_together(make, open_all, no_figures):
    kt = make("calibrate-kt")
    other = make("calibrate-kt", "other", sets=("rig.name=another-rig",))
    force = make("measure-force", inputs=(kt,), notes=("something to know",))
    report = build_report(open_all(kt, force))
    assert report.warnings == ()
    assert report.remarks == (("measure-force", ("something to know",)),)
    report = build_report(open_all(other, force))
    assert "These runs come from 2 rigs: another-rig, briaire-2006." in report.warnings
    assert any("is not the one shown here (other)" in warning for warning in report.warnings)


def test_a_unit_that_was_edited_is_not_shown(tmp_path, open_all, unrendered):
    """Labels of figures and tables of loads state units: another one is left out, or refused."""

    def edited(name, table, column):
        path = tmp_path / f"{name}.h5"
        shutil.copyfile(FIXTURES / f"{name}.h5", path)
        with h5py.File(path, "r+") as file:
            file[f"entry/tables/{table}/{column}"].attrs["units"] = np.bytes_("kg")
            for digest in ("content_sha256", "record_sha256"):
                del file["entry/provenance"][digest]
            seal(file)
        return path

    (run,) = open_all(edited("kt", "linearity", "current"))
    whole = build_report(open_all(FIXTURES / "kt.h5"))
    report = build_report([run])
    assert whole.warnings == ()
    assert len(report.pictures) < len(whole.pictures)
    assert any("is in 'kg', not in 'A'" in warning for warning in report.warnings)
    (run,) = open_all(edited("force", "loads", "mean_torque"))
    with pytest.raises(RunFileError, match="mean_torque of table loads is in 'kg'"):
        build_report([run])
