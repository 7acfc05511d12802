"""The figure that opens a report, and reports of other rigs than the thesis's."""

import numpy as np
import pytest

from rigtool.report.build import build_report
from rigtool.report.figures import PLOTS


def bars(axes):
    """Points and half lengths of the error bars of each container."""
    found = []
    for container in axes.containers:
        line, _, (segments,) = container
        ends = np.array(segments.get_segments())
        found.append((line.get_xydata(), (ends[:, 1, 1] - ends[:, 0, 1]) / 2))
    return found


def test_the_readings_are_drawn_with_twice_their_uncertainty(make, open_all):
    (run,) = open_all(make("measure-force"))
    above, below = PLOTS[100].draw(run).axes
    ((points, half),) = bars(above)
    np.testing.assert_allclose(points[:, 0], [1.2, 5, 20, 40, 50], rtol=1e-9)
    np.testing.assert_allclose(points[:, 1], [1.3, 5.35, 22.4, 44.7, 55], rtol=1e-9)
    np.testing.assert_allclose(half, 0.2, rtol=1e-6)
    ((points, half),) = bars(below)
    np.testing.assert_allclose(points[:, 1], [8, 7, 12, 12, 10], rtol=1e-9)
    np.testing.assert_allclose(half, 20 / np.array([1.2, 5, 20, 40, 50]), rtol=1e-6)
    band = below.patches[0].get_extents().transformed(below.transData.inverted())
    assert (band.y0, band.y1) == pytest.approx((-5, 5), rel=1e-6)


def test_a_corrected_run_shows_both(make, open_all):
    (run,) = open_all(make("measure-force", sets=("measure_force.correction=full",)))
    above, _ = PLOTS[100].draw(run).axes
    labels = above.get_legend_handles_labels()[1]
    assert {"without correction, k = 2", "correction full, k = 2"} <= set(labels)
    (uncorrected, _), (corrected, _) = bars(above)
    assert len(uncorrected) == 5
    assert len(corrected) == 4  # the largest load was not learned


def test_another_rig_has_no_published_values_nor_numbers_of_the_thesis(make, open_all, no_figures):
    runs = open_all(make("measure-force", sets=("rig.name=left-bench",)))
    report = build_report(runs)
    assert report.title == "Force from motor current: left-bench"
    assert not report.compared
    (table,) = report.force_tables
    assert (table.name, table.title) == (
        "loads-measure-force",
        "Measured against applied torque (measure-force)",
    )
    for one in (table, *report.results):
        assert not [c.key for c in one.columns if "published" in c.key or c.key == "section"]
        assert all(len(row) == len(one.columns) for row in one.rows)


@pytest.mark.parametrize(
    ("commands", "title"),
    [
        (("calibrate-kt",), "Torque constant: briaire-2006"),
        (("stribeck", "calibrate-kt"), "Torque constant and friction: briaire-2006"),
        (("ilc-learn", "measure-force"), "Force from motor current: briaire-2006"),
    ],
)
def test_the_title_states_what_the_report_holds(commands, title, make, open_all, no_figures):
    assert build_report(open_all(*map(make, commands))).title == title


def test_figures_of_another_rig_are_not_called_by_numbers_of_the_thesis(make, open_all):
    report = build_report(open_all(make("calibrate-kt", sets=("rig.name=left-bench",))))
    first, second = report.pictures
    assert first.title.startswith("Torque constant")
    assert second.title.startswith("Residuals of the torque constant")
