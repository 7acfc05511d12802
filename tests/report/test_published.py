import pytest

from rigtool.report.published import published_accuracy, published_table, published_value


def test_tables_8_and_9_agree_with_themselves():
    # error = mean - applied, in the digits that the thesis prints
    for attachment in ("instrument", "pulley"):
        columns = published_table(attachment).columns
        for applied, mean, error, percent in zip(
            columns["applied_torque"],
            columns["mean_torque"],
            columns["error_torque"],
            columns["error_percent"],
            strict=True,
        ):
            assert mean - applied == pytest.approx(error, rel=0, abs=0.06e-3)
            assert 100 * error / applied == pytest.approx(percent, abs=0.9)


def test_applied_torque_is_force_times_arm():
    for attachment, arm in (("instrument", 0.020), ("pulley", 0.014)):
        columns = published_table(attachment).columns
        for force, torque in zip(columns["applied_force"], columns["applied_torque"], strict=True):
            assert force * arm == pytest.approx(torque, rel=1e-9)


def test_table_numbers():
    assert (published_table("instrument").number, published_table("pulley").number) == (8, 9)


def test_a_row_is_found_by_force_and_torque():
    table = published_table("instrument")
    row = table.row(1.0, 20e-3)
    assert row is not None
    assert row["mean_torque"] == pytest.approx(22.4e-3, rel=1e-12)
    assert table.row(1.0, 14e-3) is None  # the same force on another arm
    assert table.row(1.5, 30e-3) is None
    assert table.row(0.0, 0.0) is None


def test_values_belong_to_an_attachment():
    found = published_value("measure-force", "lifting_torque", "instrument")
    assert found is not None
    assert (found.value, found.section) == (pytest.approx(65e-3, rel=1e-9), "8.2, Fig. 63")
    assert published_value("measure-force", "lifting_torque", "pulley") is None
    assert published_value("stribeck", "coulomb_friction", "pulley") is not None
    assert published_value("stribeck", "no_such_result", None) is None
    assert published_value("no-such-command", "x", None) is None


def test_the_errors_of_one_instrument_are_not_shown_for_another():
    rig = "MRDLab tool characterization, Maryland, left jaw"
    everywhere = published_accuracy(rig, {"Tool_4_Maryland_L_2"})
    assert "folder" not in {key for row in everywhere for key in row}
    assert len(everywhere) < len(published_accuracy(rig, {"Tool_4_Maryland_L_4"}))
    assert published_accuracy("another rig", {"Tool_4_Maryland_L_4"}) == []
