"""Recorder exports of EPOS Studio, recognised by themselves."""

import numpy as np
import pytest

from rigtool.errors import RunFileError
from rigtool.recipe.mapping import parse_mapping
from rigtool.runfile import open_run
from rigtool.runfile.importers import import_files

HEAD = """Date:;2020-07-08 21:11:37
Firmware Version:;0x0120;0x6150;0x0000;0x0000
EPOS Studio Version:;3.6.1.0
Index:;0x30D3;0x30D2;0x6064;0x1234
Subindex:;0x01;0x01;0x00;0x00
Max. samples:;500
Recorded samples:;5
Sampling period:;6.400
Scale:;0;True;2.000;-159.000;151.000;167.000
;Velocity actual value averaged;Torque actual value averaged;Position actual value;Bus Voltage
ms;rpm;%;inc;V
"""
ROWS = ["0.000;60;50.0;0;24", "6.400;59;25.0;4;24", "12.800;60;25;8;24", "19.200;60;25;12;24"]
ROWS.append("25.600;-60;-10;16;23.5")
RATED = 'mapping = 1\n[rig]\nname = "drive"\nrated_torque = 0.01\n'


def write(path, head=HEAD, rows=ROWS, end="\r\n"):
    path.write_bytes((head + "\n".join(rows)).replace("\n", "\r\n").encode() + end.encode())
    return path


def take(path, text=None, **options):
    output = path.with_suffix(".h5")
    mapping = None if text is None else (parse_mapping(text), text)
    import_files([str(path)], str(output), mapping, **options)
    with open_run(output) as run:
        recording = run.recording("imported")
        return recording.units, {name: recording.read(name) for name in recording.units}, run


def test_the_header_says_what_is_there(tmp_path):
    units, signals, run = take(write(tmp_path / "n2.csv"))
    assert units == {
        "time": "s",
        "speed": "rad/s",
        "relative_torque": "1",
        "encoder": "count",
        "bus_voltage": "V",
    }
    assert run.rig == "n2"
    np.testing.assert_allclose(signals["time"], np.arange(5) * 6.4e-3, rtol=1e-15, atol=0)
    assert signals["speed"][4] == pytest.approx(-2 * np.pi, rel=1e-15, abs=0)
    assert signals["relative_torque"][0] == 0.5
    assert signals["bus_voltage"][4] == 23.5


@pytest.mark.parametrize("skip", [False, True])
def test_a_file_with_two_recordings_states_where_the_second_begins(tmp_path, skip):
    two = write(tmp_path / "two.csv", HEAD, [*ROWS, *HEAD.splitlines(), *ROWS])
    with pytest.raises(RunFileError, match=r"line 17: another recording begins here.* its own"):
        take(two, skip_bad=skip)
    assert not two.with_suffix(".h5").exists()


def test_the_rated_torque_turns_percent_into_torque(tmp_path):
    units, signals, run = take(write(tmp_path / "n2.csv"), RATED)
    assert units["torque"] == "N m"
    assert run.rig == "drive"
    np.testing.assert_allclose(signals["torque"][[0, 4]], [5e-3, -1e-3], rtol=1e-14, atol=0)


def test_signals_of_a_mapping_are_taken_by_name(tmp_path):
    text = RATED + (
        '[signals]\ntime = { column = "time", unit = "ms" }\n'
        'current = { column = "Torque actual value averaged", unit = "A", scale = 0.02 }\n'
    )
    units, signals, _ = take(write(tmp_path / "n2.csv"), text)
    assert units == {"time": "s", "current": "A"}
    assert signals["current"][0] == 1.0


def test_a_comma_as_decimal_mark(tmp_path):
    rows = [row.replace(".", ",") for row in ROWS]
    _, signals, _ = take(write(tmp_path / "n2.csv", rows=rows))
    assert signals["time"][1] == pytest.approx(6.4e-3, rel=1e-15, abs=0)


def test_a_file_that_a_spreadsheet_saved_and_a_person_edited(tmp_path):
    """Empty cells on all lines, a remark behind a sample: numbers stay, the remark is named."""
    head = "".join(f"{line},,\n" for line in HEAD.splitlines())
    rows = [f"{row},," for row in ROWS]
    rows[1] += "was -8,9"
    rows[2] = rows[2].replace(",,", ";;touched")
    source = write(tmp_path / "n2.csv", head=head, rows=rows)
    _, signals, run = take(source)
    _, plain, _ = take(write(tmp_path / "plain.csv"))
    for name, values in plain.items():
        np.testing.assert_array_equal(signals[name], values)
    assert "line 13: remark 'was -8,9' left out" in run.notes
    assert "line 14: remark 'touched' left out" in run.notes


def test_a_mapping_states_the_marks_of_an_export(tmp_path):
    rows = [row.replace(";", "|") + " # seen" for row in ROWS]
    text = RATED + '[file]\ndelimiter = "|"\ncomment = "#"\n'
    _, signals, _ = take(write(tmp_path / "n2.csv", rows=rows), text)
    assert signals["encoder"].tolist() == [0, 4, 8, 12, 16]


def test_a_header_that_was_damaged_is_named_by_its_line(tmp_path):
    source = write(tmp_path / "n2.csv", head=HEAD.replace("0x30D2;", "torque;"))
    with pytest.raises(RunFileError, match=r"n2.csv, line 4: .* are no objects"):
        take(source)


def test_a_file_that_ends_early_is_reported_by_its_header(tmp_path):
    source = write(tmp_path / "n2.csv", rows=ROWS[:3])
    with pytest.raises(RunFileError, match="line 14: the file ends here, 2 of 5 recorded samples"):
        take(source)
    _, signals, run = take(source, skip_bad=True)
    assert len(signals["time"]) == 3
    assert run.result("lines_left_out").value == 0
    assert any("2 of 5 recorded samples are missing" in note for note in run.notes)


def test_a_file_that_ends_within_a_line(tmp_path):
    rows = [*ROWS[:-1], ROWS[-1].rpartition(";")[0] + ";2"]
    _, signals, run = take(write(tmp_path / "n2.csv", rows=rows, end=""))
    assert len(signals["time"]) == len(ROWS) - 1
    assert any("line 16: the file ends within this line" in note for note in run.notes)


def test_a_speed_in_a_unit_of_another_axis_is_none_of_the_motor(tmp_path):
    units, _, _ = take(write(tmp_path / "a.csv", HEAD.replace("ms;rpm;", "ms;mm/s;")))
    assert units["velocity_actual_value_averaged"] == "m/s"


@pytest.mark.parametrize(
    ("head", "message"),
    [
        (HEAD.partition("\n;")[0] + "\n", "without names and units"),
        (HEAD.replace("ms;rpm;%;inc;V", "ms;rpm;%;inc"), "4 units for 5 columns"),
        (HEAD.replace("\nms;", "\nfurlong;"), "'furlong', an unknown unit"),
        (HEAD.replace("rpm;%;inc;V", "a;b;c;e"), "no channel in a known unit"),
    ],
)
def test_a_damaged_header(tmp_path, head, message):
    with pytest.raises(RunFileError, match=message):
        take(write(tmp_path / "n2.csv", head=head))


def commas(text):
    return text.replace(";", ",")


def cells(text):
    return "\n".join(line + ";;" for line in text.split("\n"))


def quoted(text):
    return "\n".join('"' + line.replace('"', '""') + '",,' for line in text.split("\n"))


def without_objects(text):
    return "\n".join(line for line in text.split("\n") if not line.startswith("Index"))


@pytest.mark.parametrize("edit", [commas, cells, quoted, without_objects])
def test_what_a_spreadsheet_makes_of_an_export_is_undone(tmp_path, edit):
    """Commas for semicolons, empty cells, whole lines in quotes; and no line of objects."""
    plain = take(write(tmp_path / "plain.csv"))[1]
    whole = edit(HEAD + "\n".join(ROWS)).removesuffix("\n")
    units, found, _ = take(write(tmp_path / "edited.csv", whole, []))
    assert {"speed", "relative_torque", "encoder"} <= units.keys()
    for name, values in plain.items():
        np.testing.assert_array_equal(found[name], values)


def test_a_column_in_an_unknown_unit_is_left_out_and_said(tmp_path):
    path = write(tmp_path / "a.csv", HEAD.replace("inc;V", "inc;bar"))
    done = import_files([str(path)], str(tmp_path / "a.h5"), None).done[0]
    assert any("channel 'Bus Voltage' is in 'bar'" in note for note in done.notes)
    with open_run(tmp_path / "a.h5") as run:
        assert "bus_voltage" not in run.recording("imported").units


def test_times_in_another_unit_than_the_line_of_units_states(tmp_path):
    rows = [f"{float(row.split(';')[0]) / 1000};{row.partition(';')[2]}" for row in ROWS]
    with pytest.raises(RunFileError, match=r"rise by 6.4e-06 s, its header states a period of 0"):
        take(write(tmp_path / "a.csv", rows=rows))
