"""Delimited text: what is good comes in exactly, what is bad is named by its line."""

import csv
import gzip
import json

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.errors import RunFileError, UsageError
from rigtool.recipe.mapping import parse_mapping
from rigtool.runfile import open_run
from rigtool.runfile.importers import import_files
from rigtool.runfile.importers.marks import fields_of
from rigtool.runfile.importers.preview import preview
from rigtool.runfile.importers.text import read_text
from tests.runfile.importers.mappings import ROWS, TEXT, columns, lines, mapping, take


def read(path, name):
    with open_run(path) as run:
        return run.recording("imported").read(name)


def write(path, text_lines, end="\n"):
    path.write_text("\n".join(text_lines) + end)
    return path


def test_values_become_si(tmp_path):
    source = write(tmp_path / "a.csv", ["% made by hand", *lines()])
    take(source, tmp_path / "a.h5")
    time, encoder, current = columns()
    with open_run(tmp_path / "a.h5") as run:
        assert (run.command, run.rig, run.recipe) == ("import", "bench", None)
        assert run.provenance["source"] == str(source)
        assert run.provenance["mapping"] == TEXT
        assert run.result("lines_left_out").value == 0
        recording = run.recording("imported")
        assert recording.units == {"time": "s", "encoder": "count", "current": "A"}
        assert recording.condition("torque_constant") == 0.045
        np.testing.assert_allclose(recording.read("time"), time / 1000, rtol=1e-15, atol=0)
        np.testing.assert_array_equal(recording.read("encoder"), encoder)
        expected = -(10 * current + 2) / 1000
        np.testing.assert_allclose(recording.read("current"), expected, rtol=1e-14, atol=0)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_files_of_all_systems(tmp_path, end, packed, encoding):
    data = (end.join(["% µ", *lines()]) + end).encode(encoding)
    source = tmp_path / ("a.TXT.gz" if packed else "a.TXT")
    source.write_bytes(gzip.compress(data) if packed else data)
    take(source, tmp_path / "a.h5")
    np.testing.assert_array_equal(read(tmp_path / "a.h5", "encoder"), columns()[1])


def test_what_pandas_writes(tmp_path):
    """Another program's output, columns by name and in another order."""
    time, encoder, current = columns()
    frame = pd.DataFrame({"i / mA": current, "t": time, "note": "x", "q": encoder})
    frame.to_csv(tmp_path / "a.csv", index=False)
    text = TEXT
    for number, name in enumerate(("t", "q", "i / mA"), start=1):
        text = text.replace(f"column = {number}", f'column = "{name}"')
    take(tmp_path / "a.csv", tmp_path / "a.h5", text)
    expected = -(10 * current + 2) / 1000
    np.testing.assert_allclose(read(tmp_path / "a.h5", "current"), expected, rtol=1e-14, atol=0)


@pytest.mark.parametrize(
    ("delimiter", "decimal", "mark"), [(";", ",", ";"), ("\t", ".", "\\t"), ("  ", ".", None)]
)
def test_other_delimiters_and_decimal_marks(tmp_path, delimiter, decimal, mark):
    rows = [
        delimiter.join(field.replace(".", decimal) for field in line.split(",")) for line in lines()
    ]
    source = write(tmp_path / "a.dat", rows)
    key = f'delimiter = "{mark or "whitespace"}"\ndecimal = "{decimal}"\n'
    take(source, tmp_path / "a.h5", TEXT.replace("[file]\n", f"[file]\n{key}"))
    np.testing.assert_array_equal(read(tmp_path / "a.h5", "encoder"), columns()[1])


def test_a_sampling_rate_instead_of_a_time_column(tmp_path):
    rows = lines()
    rows[10] = "broken"
    source = write(tmp_path / "a.csv", rows)
    text = TEXT.replace('time = { column = 1, unit = "ms" }\n', "")
    text = text.replace("[file]\n", "[file]\nsampling_rate_hz = 500\n")
    take(source, tmp_path / "a.h5", text, skip_bad=True)
    expected = np.delete(np.arange(ROWS) / 500, 10)
    np.testing.assert_allclose(read(tmp_path / "a.h5", "time"), expected, rtol=1e-15, atol=0)


def test_a_counter_that_overflows_goes_on(tmp_path):
    truth = np.cumsum(np.r_[np.full(40, 300.0), np.full(40, -300.0)])
    rows = [f"{k},{value % 4096},0" for k, value in enumerate(truth)]
    source = write(tmp_path / "a.csv", rows)
    text = TEXT.replace('column = 2, unit = "count"', 'column = 2, unit = "count", wraps_at = 4096')
    take(source, tmp_path / "a.h5", text)
    np.testing.assert_array_equal(read(tmp_path / "a.h5", "encoder"), truth)


def damaged(kind):
    """Lines with one fault, the number of the faulty line, and what is said of it."""
    rows = lines()
    if kind == "text":
        rows[20] = "40,x12,0.1"
        return rows, "\n", 21, "column 2 holds 'x12', no number"
    if kind == "empty":
        rows[20] = "40,,0.1"
        return rows, "\n", 21, "column 2 holds '', no number"
    if kind == "nan":
        rows[20] = "40,nan,0.1"
        return rows, "\n", 21, "column 2 holds 'nan', no number"
    if kind == "cut":
        rows[20] = "40,137"
        return rows, "\n", 21, "has 2 fields, the others have 3"
    if kind == "joined":
        rows[20] = rows[20] + rows[21]
        return rows, "\n", 21, "has 5 fields, the others have 3"
    if kind == "backwards":
        rows[20] = "3.0,137,0.1"
        return rows, "\n", 21, "time does not rise"
    if kind == "again":
        rows[20] = "38.0,137,0.1"
        return rows, "\n", 21, "time does not rise: 0.038 s after 0.038 s"
    assert kind == "end"
    rows[-1] = rows[-1].rpartition(",")[0]
    return rows, "", ROWS, "has 2 fields, the others have 3"


KINDS = ("text", "empty", "nan", "cut", "joined", "backwards", "again", "end")


def test_decimal_commas_between_commas_are_named(tmp_path):
    source = write(tmp_path / "a.csv", ["ms,angle,mA", *(f"{k},0,{k}7,0,1" for k in range(40))])
    text = TEXT.replace("column = 1", 'column = "ms"')
    with pytest.raises(RunFileError, match="decimal commas, which need another delimiter"):
        take(source, tmp_path / "a.h5", text)


COUNTED = ["ms,angle,mA", *(f"{k},{k * 7},1,{k % 10}" for k in range(40))]
DIVIDED = {
    "fewer names": COUNTED,
    "names and units": [COUNTED[0], "ms,rad,mA", *COUNTED[1:]],
    "zeros": [f"{k},{k * 7},0,{k:02d}" for k in range(40)],
    "minus": [f"{k},{k * 7},-0,{k % 10}" for k in range(40)],
    "thousands": ["t i m", *(f"{k} {k * 7} {k + 1} {200 + k},5" for k in range(40))],
}


@pytest.mark.parametrize("rows", DIVIDED.values(), ids=DIVIDED)
def test_numbers_that_the_delimiter_divides_are_refused(tmp_path, rows):
    """Columns by number are there in any case: digits behind a decimal comma look like a column."""
    source = write(tmp_path / "a.csv", rows)
    with pytest.raises(RunFileError, match="seems to divide numbers as well") as caught:
        take(source, tmp_path / "a.h5")
    assert 'state decimal = "."' in str(caught.value)
    assert not (tmp_path / "a.h5").exists()


@pytest.mark.parametrize(
    "rows",
    [
        ["written by hand, on a day", *(f"{k},{k * 7},0.5,0{k % 10}" for k in range(40))],
        [f"{k:02d},{k * 7},1,{k:02d}" for k in range(40)],
        ["title,of,it", *(f"{k},{k * 7},1.5,-{k % 10}" for k in range(40))],
    ],
    ids=["points", "padded", "signs"],
)
def test_columns_without_a_name_stay_columns(tmp_path, rows):
    take(write(tmp_path / "a.csv", rows), tmp_path / "a.h5")
    np.testing.assert_array_equal(read(tmp_path / "a.h5", "encoder"), 7.0 * np.arange(40))


def test_a_stated_decimal_mark_says_that_each_field_is_a_number(tmp_path):
    text = TEXT.replace("[file]", '[file]\ndecimal = "."')
    take(write(tmp_path / "a.csv", COUNTED), tmp_path / "a.h5", text)
    np.testing.assert_array_equal(read(tmp_path / "a.h5", "encoder"), 7.0 * np.arange(40))


@pytest.mark.parametrize("kind", KINDS)
def test_a_bad_line_is_named_and_nothing_is_written(tmp_path, kind):
    rows, end, number, message = damaged(kind)
    source = write(tmp_path / "a.csv", rows, end)
    with pytest.raises(RunFileError) as caught:
        take(source, tmp_path / "a.h5")
    assert f"{source}, line {number}: {message}" in str(caught.value)
    assert "--skip-bad-lines" in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


@pytest.mark.parametrize("kind", KINDS)
def test_bad_lines_are_skipped_on_demand_and_counted(tmp_path, kind):
    rows, end, number, _ = damaged(kind)
    source = write(tmp_path / "a.csv", rows, end)
    take(source, tmp_path / "a.h5", skip_bad=True)
    with open_run(tmp_path / "a.h5") as run:
        assert run.result("lines_left_out").value == 1
        assert any(f"line {number}: " in note for note in run.notes)
        encoder = run.recording("imported").read("encoder")
    np.testing.assert_array_equal(encoder, np.delete(columns()[1], number - 1))


def test_lines_are_counted_with_comments_and_empty_lines(tmp_path):
    rows = ["% one", "", "% two", *lines()]
    rows[13] = "20.0,1"
    with pytest.raises(RunFileError, match="line 14: has 2 fields"):
        take(write(tmp_path / "a.csv", rows), tmp_path / "a.h5")


def test_one_wrong_time_costs_one_line(tmp_path):
    """A time far in the future must not cost all that follows."""
    rows = lines()
    rows[5] = "9999999,32,0.1"
    take(write(tmp_path / "a.csv", rows), tmp_path / "a.h5", skip_bad=True)
    np.testing.assert_array_equal(read(tmp_path / "a.h5", "encoder"), np.delete(columns()[1], 5))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"% nothing\n", "holds no line of numbers"),
        (b"1,2\n3,4\n", "no column 3, only 2 columns"),
        (b"1,2,3\n", "at least 2 are needed"),
        (b"\x1f\x8b\x08garbage", "damaged gzip"),
        (b"\x00\xff" * 50, "has no column 2"),
        (bytes(range(1, 32)) * 9, "is no text"),
        (b"PAR1" + b"\x15\x04" * 50, "a Parquet file"),
    ],
)
def test_files_that_hold_nothing_of_use(tmp_path, content, message):
    (tmp_path / "a.csv").write_bytes(content)
    with pytest.raises(RunFileError, match=message):
        take(tmp_path / "a.csv", tmp_path / "a.h5")


def test_a_missing_name_is_reported_with_those_there(tmp_path):
    source = write(tmp_path / "a.csv", ["t,q,i", *lines()])
    text = TEXT.replace("column = 3", 'column = "amps"')
    with pytest.raises(RunFileError, match=r"no column 'amps', only t, q, i"):
        take(source, tmp_path / "a.h5", text)


BARE = parse_mapping('mapping = 1\n[rig]\nname = "x"\n[file]\ncomment = "%"\n')
finite = st.floats(allow_nan=False, allow_infinity=False)


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(finite, finite, finite), min_size=1, max_size=30))
def test_every_double_comes_in_exactly(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("exact") / "a.csv"
    write(path, [",".join(map(repr, row)) for row in rows])
    raw, _ = read_text(path, BARE, skip_bad=False, columns=[3, 1])
    np.testing.assert_array_equal(raw.columns[1], [row[0] for row in rows])
    np.testing.assert_array_equal(raw.columns[3], [row[2] for row in rows])


@settings(deadline=None, max_examples=150)
@given(st.data())
def test_no_damage_goes_in_unseen(tmp_path_factory, data):
    """Whatever is written over a good file: what comes in is a part of the good lines."""
    folder = tmp_path_factory.mktemp("damage")
    good = "\n".join(["% x", *lines(12)]) + "\n"
    start = data.draw(st.integers(0, len(good) - 1))
    count = data.draw(st.integers(0, 30))
    cut = data.draw(st.sampled_from(["", "x", "\n", ",", "nan", "\x00", "-", "e", '"', "1,2"]))
    (folder / "a.csv").write_text(good[:start] + cut + good[start + count :])
    known = dict(zip(good.split("\n")[1:], zip(*columns(12), strict=True), strict=False))
    try:
        raw, _ = read_text(folder / "a.csv", BARE, skip_bad=True, columns=[1, 2, 3])
    except RunFileError:
        return
    text = (folder / "a.csv").read_text().split("\n")
    for row, line in enumerate(raw.line):
        values = [raw.columns[column][row] for column in (1, 2, 3)]
        written = text[line - 1].partition("%")[0]
        expected = known.get(written) or [float(x.strip().strip('"')) for x in written.split(",")]
        assert values == list(expected)


@pytest.mark.parametrize(
    ("delimiter", "decimal"),
    [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), ("|", ","), ("   ", ".")],
)
def test_marks_that_the_mapping_leaves_to_the_lines(tmp_path, delimiter, decimal):
    rows = [row.replace(".", decimal) for row in (line.replace(",", ";") for line in lines())]
    source = write(tmp_path / "a.csv", [row.replace(";", delimiter) for row in rows])
    (done,) = take(source, tmp_path / "a.h5").done
    np.testing.assert_array_equal(read(tmp_path / "a.h5", "encoder"), columns()[1])
    assert any("as the lines show" in note for note in done.notes) == (delimiter + decimal != ",.")


def test_a_wrong_delimiter_gets_the_right_one_as_a_hint(tmp_path):
    source = write(tmp_path / "a.csv", [line.replace(",", ";") for line in lines()])
    text = TEXT.replace("[file]", '[file]\ndelimiter = ","')
    with pytest.raises(RunFileError, match=r"look like delimiter = ';' and decimal = '\.'"):
        take(source, tmp_path / "a.h5", text)


@pytest.mark.parametrize("start", [b"PK\x03\x04", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"])
def test_a_spreadsheet_is_recognised(tmp_path, start):
    (tmp_path / "a.csv").write_bytes(start + b"\x00" * 100)
    with pytest.raises(RunFileError, match="export it as CSV"):
        take(tmp_path / "a.csv", tmp_path / "a.h5")


def test_a_first_sample_that_is_none_is_left_out(tmp_path):
    """What a recorder had in memory before its first conversion; a fast start stays."""
    rows = [f"{2 * i},{7 * i},{1 + 0.01 * np.sin(i):.6f}" for i in range(ROWS)]
    source = write(tmp_path / "a.csv", ["0,0,-0.199", *rows[1:]])
    (done,) = take(source, tmp_path / "a.h5").done
    assert done.left_out == 1
    assert any("line 1: current" in note for note in done.notes)
    assert read(tmp_path / "a.h5", "encoder")[0] == 7
    growing = [f"{2 * i},{7 * i},{0.01 * (i + 1) ** 3:.6f}" for i in range(ROWS)]
    (done,) = take(write(tmp_path / "b.csv", growing), tmp_path / "b.h5").done
    assert done.left_out == 0


NAMED = """mapping = 1
[rig]
name = "bench"
[signals]
time = { column = "t", unit = "s" }
current = { column = "i", unit = "A" }
"""


@pytest.mark.parametrize(
    "text",
    [
        "t,i\n0,-1,\n1,-2,\n2,-3,\n",
        "t,i\n0,\u22121\n1,\u22122\n2,\u22123\n",
        "t,i\r\n0,-1\r\n1,-2\r\n2,-3\r\n\x1a",
        '"t","i"\n"0","-1"\n"1","-2"\n"2","-3"\n',
    ],
)
def test_what_other_programs_put_around_numbers(tmp_path, text):
    """A delimiter behind each line, a typeset minus sign, the end of a file for DOS, quotes."""
    (tmp_path / "a.csv").write_bytes(text.encode())
    take(tmp_path / "a.csv", tmp_path / "a.h5", NAMED)
    with open_run(tmp_path / "a.h5") as run:
        np.testing.assert_array_equal(run.recording("imported").read("current"), [-1, -2, -3])


SURE = ['"{},234.5"', "{}'234.5", "{}.234,5", "{}\u202f234,5", "{} 234,5"]
UNSURE = ['"{},234"', "{}.234"]


@pytest.mark.parametrize("number", SURE + UNSURE)
def test_marks_of_thousands(tmp_path, number):
    """They are read past where no decimal mark is like them; what may be one is no number."""
    delimiter = "," if '"' in number else ";"
    rows = (f"{n}{delimiter}{number.format(n + 1)}{delimiter}0,5\n" for n in range(9))
    (tmp_path / "a.csv").write_text("".join(row.replace(",0,5", ",0.5") for row in rows))
    text = NAMED.replace('"t"', "1").replace('"i"', "2")
    if number in UNSURE:
        with pytest.raises(RunFileError, match=r"column 2 holds '1[,.]234', no number"):
            take(tmp_path / "a.csv", tmp_path / "a.h5", text)
        return
    take(tmp_path / "a.csv", tmp_path / "a.h5", text)
    np.testing.assert_array_equal(
        read(tmp_path / "a.h5", "current"), np.arange(1, 10) * 1000 + 234.5
    )


@pytest.mark.parametrize(
    ("head", "count"),
    [
        ("t,i\n", 1),
        ("t,i\ns,A\n", 2),
        ("Oscilloscope\nmodel,7\n\nt,i\n", 3),
        ("# t,i\n", 1),
        ("'t','i'\n[s],[A]\n", 2),
    ],
)
def test_the_header_is_found_and_said(tmp_path, head, count):
    (tmp_path / "a.csv").write_text(f"{head}0,1\n1,2\n")
    (done,) = take(tmp_path / "a.csv", tmp_path / "a.h5", NAMED).done
    assert any(f"header_lines = {count}: state" in note for note in done.notes) == (count > 1)
    np.testing.assert_array_equal(read(tmp_path / "a.h5", "current"), [1, 2])
    for stated in range(count + 1):
        text = NAMED.replace("[signals]", f"[file]\nheader_lines = {stated}\n[signals]")
        if stated == count:
            take(tmp_path / "a.csv", tmp_path / "b.h5", text)
        else:
            with pytest.raises(RunFileError, match=r"state .*header_lines|no number"):
                take(tmp_path / "a.csv", tmp_path / "b.h5", text)


def test_a_damaged_first_line_is_no_header(tmp_path):
    text = NAMED.replace('"t"', "1").replace('"i"', "2")
    for damaged in ("0,x\n", "0\n", "x,0\n"):
        (tmp_path / "a.csv").write_text(f"{damaged}1,1\n2,2\n3,3\n")
        with pytest.raises(RunFileError, match="line 1: "):
            take(tmp_path / "a.csv", tmp_path / "a.h5", text)


def test_quotes_around_numbers_with_the_delimiter_as_decimal_mark(tmp_path):
    (tmp_path / "a.csv").write_text("".join(f'"{n},0","{n},5"\n' for n in range(5)))
    take(tmp_path / "a.csv", tmp_path / "a.h5", NAMED.replace('"t"', "1").replace('"i"', "2"))
    np.testing.assert_array_equal(read(tmp_path / "a.h5", "current"), np.arange(5) + 0.5)


def test_a_point_that_divides_thousands_is_no_decimal_mark(tmp_path):
    rows = "".join(f"{n},25;{n + 1}.500\n" for n in range(9))
    (tmp_path / "a.csv").write_text(rows)
    with pytest.raises(RunFileError, match=r"column 2 holds '1\.500', no number"):
        take(tmp_path / "a.csv", tmp_path / "a.h5", NAMED.replace('"t"', "1").replace('"i"', "2"))


@pytest.mark.parametrize("names", ["", "t,i\n"])
@pytest.mark.parametrize("start", [0.0, 5.0])
def test_several_recordings_of_one_file(tmp_path, names, start):
    """Time starts anew; names are repeated or not."""
    once = "".join(f"{start + 0.1 * n:.1f},{n}\n" for n in range(20))
    (tmp_path / "a.csv").write_text("t,i\n" + once + names + once + names + once)
    (done,) = take(tmp_path / "a.csv", tmp_path / "a.h5", NAMED).done
    assert any("time starts anew at line" in note for note in done.notes)
    with open_run(tmp_path / "a.h5") as run:
        recordings = run.recordings_named("imported_")
        assert len(recordings) == 3
        for recording in recordings:
            np.testing.assert_array_equal(recording.read("current"), np.arange(20))


def test_one_time_that_falls_back_starts_no_recording(tmp_path):
    rows = [f"{0.1 * n:.1f},{n}" for n in range(50)]
    rows[25] = "0.0,25"
    with pytest.raises(RunFileError, match="line 27: time does not rise"):
        take(write(tmp_path / "a.csv", ["t,i", *rows]), tmp_path / "a.h5", NAMED)


def test_a_quoted_field_longer_than_python_reads():
    line = '1,"' + "2" * csv.field_size_limit() + '"'
    assert [len(field) for field in fields_of(line, ",")] == [1, csv.field_size_limit() + 2]


def test_a_last_line_without_end(tmp_path):
    """It stays where its last field is as long as the others; else it may be cut short."""
    for last, kept in (("2,3.25", 3), ("2,3.2", 2)):
        (tmp_path / "a.csv").write_text(f"t,i\n0,1.25\n1,2.25\n{last}")
        (done,) = take(tmp_path / "a.csv", tmp_path / f"{kept}.h5", NAMED).done
        assert (done.samples, done.left_out) == (kept, 3 - kept)


@pytest.mark.parametrize(
    ("first", "second", "seconds"),
    [
        ("2021-03-04 23:59:59.500", "2021-03-05T00:00:00.750", 1.25),
        ("31.12.2020 23:59:59.5", "01.01.2021 00:00:01,5", 2.0),
        ("2/28/2021 11:59:59 PM", "3/1/2021 12:00:01 AM", 2.0),
        ("28/2/2021 1:00", "1/3/2021 1:00", None),
        ("23:59:59.9", "00:00:00.2", 0.3),
        ("2024-03-31T01:59:59.5+01:00", "2024-03-31T03:00:00+0200", 0.5),
        ("20240331T235959.5Z", "20240401T000000Z", 0.5),
    ],
)
def test_dates_and_clock_times(tmp_path, first, second, seconds):
    text = NAMED.replace('unit = "s"', 'unit = "date"')
    (tmp_path / "a.csv").write_text(f"t;i\n{first};1\n{second};2\n")
    if seconds is None:  # 28 is no month, 1/3 is the third of January
        with pytest.raises(RunFileError, match="time does not rise"):
            take(tmp_path / "a.csv", tmp_path / "a.h5", text)
        return
    take(tmp_path / "a.csv", tmp_path / "a.h5", text)
    np.testing.assert_allclose(read(tmp_path / "a.h5", "time"), [0, seconds], atol=1e-6)
    with pytest.raises(RunFileError, match='unit = "date"'):
        take(tmp_path / "a.csv", tmp_path / "b.h5", NAMED)


def test_a_name_that_may_be_a_slip_gets_a_note(tmp_path):
    (tmp_path / "a.csv").write_text("t,i\n0,1\n1,2\n")
    text = NAMED.replace("current =", "curent =")
    (done,) = take(tmp_path / "a.csv", tmp_path / "a.h5", text).done
    assert any("signal curent has no fixed meaning: if it is current" in n for n in done.notes)


LABELLED = [
    "t:{t},i:{i}",
    "t={t} i={i} state=OK",
    '{{"t": {t}, "i": {i}, "mode": "on"}}',
    "i(4): {i}, t(1): {t}",
    "{{'t': {t}, 'i': np.float64({i})}}",
    "{{<Register.t: 0>: {t}, <Register.i: 1>: {i}}}",
]


@pytest.mark.parametrize("line", LABELLED)
def test_lines_that_name_each_number(tmp_path, line):
    """What boards, loggers and JSON write, behind a greeting."""
    rows = "".join(line.format(t=n, i=n / 8 - 1) + "\n" for n in range(40))
    (tmp_path / "a.txt").write_text("Motor ready.\n" + rows)
    take(tmp_path / "a.txt", tmp_path / "a.h5", NAMED)
    np.testing.assert_array_equal(read(tmp_path / "a.h5", "current"), np.arange(40) / 8 - 1)
    lost = rows.replace(f"{5 / 8 - 1}", "")
    (tmp_path / "a.txt").write_text(lost)
    with pytest.raises(RunFileError, match="line 6: column"):
        take(tmp_path / "a.txt", tmp_path / "b.h5", NAMED)


@pytest.mark.parametrize(
    "head",
    [
        "Name;t;Name;i\nSampleTime[ms];1;SampleTime[ms];1\nOffset;0;Offset;0\n",
        "channel names:;t;;i\ndt:;0.1;;0.1\ndata:;;;\n",
    ],
)
def test_properties_of_channels_behind_their_names(tmp_path, head):
    """Recorders list numbers of each channel between its name and its samples."""
    (tmp_path / "a.csv").write_text(head + "".join(f"0;{n};0;{n + 1}\n" for n in range(9)))
    take(tmp_path / "a.csv", tmp_path / "a.h5", NAMED)
    np.testing.assert_array_equal(read(tmp_path / "a.h5", "current"), np.arange(9) + 1)


def test_a_delimiter_before_each_line_and_the_stamp_of_a_terminal(tmp_path):
    text = NAMED.replace('"t"', "2").replace('"i"', "3")
    (tmp_path / "a.txt").write_text("".join(f"\t{n}\t{n + 1}\n" for n in range(9)))
    take(tmp_path / "a.txt", tmp_path / "a.h5", text)
    (tmp_path / "b.txt").write_text("".join(f"10:00:0{n}.0 -> {n},{n + 1}\n" for n in range(9)))
    take(tmp_path / "b.txt", tmp_path / "b.h5", text)
    for name in "ab":
        np.testing.assert_array_equal(read(tmp_path / f"{name}.h5", "current"), np.arange(9) + 1)


def test_a_clock_that_overflows_is_named(tmp_path):
    rows = [f"{(2**16 - 150 + 10 * n) % 2**16},{n}\n" for n in range(30)]
    (tmp_path / "a.csv").write_text("t,i\n" + "".join(rows))
    (done,) = take(tmp_path / "a.csv", tmp_path / "a.h5", NAMED).done
    assert "time begins again at 65536: state wraps_at" in "".join(done.notes)
    assert np.ptp(read(tmp_path / "a.h5", "time")) == 290
    del rows[15]
    (tmp_path / "a.csv").write_text("t,i\n" + "".join(rows))
    (done,) = take(tmp_path / "a.csv", tmp_path / "b.h5", NAMED).done
    assert "if the clock overflows there, state wraps_at = 65536" in "".join(done.notes)


LONG = [f"{n};{name};A;{value:.3f}" for n in range(30) for name, value in (("i", n), ("x", -1))]


def test_one_column_that_names_the_signal_of_each_line(tmp_path):
    (tmp_path / "a.csv").write_text("\n".join(["t;name;unit;value", *LONG, ""]).replace(".", ","))
    take(tmp_path / "a.csv", tmp_path / "a.h5", NAMED)
    np.testing.assert_array_equal(read(tmp_path / "a.h5", "current"), np.arange(30))
    (tmp_path / "a.csv").write_text("\n".join(["t;name;unit;value", "0;i;A;off", *LONG]))
    with pytest.raises(RunFileError, match=r"line 2: column 4 holds 'off', no number"):
        take(tmp_path / "a.csv", tmp_path / "b.h5", NAMED)


@pytest.mark.parametrize(
    "document",
    [
        [{"t": n, "drive": {"i": n / 8}} for n in range(30)],
        {"log": {"t": list(range(30)), "i": [n / 8 for n in range(30)]}},
    ],
)
def test_documents_of_json(tmp_path, document):
    for name, indent in (("a", None), ("b", 1)):
        (tmp_path / f"{name}.json").write_text(json.dumps(document, indent=indent))
        take(tmp_path / f"{name}.json", tmp_path / f"{name}.h5", NAMED)
        np.testing.assert_array_equal(read(tmp_path / f"{name}.h5", "current"), np.arange(30) / 8)
    (tmp_path / "c.json").write_text(json.dumps(document).replace(" 0.5", " null"))
    with pytest.raises(RunFileError, match="sample 5: column 'i' is nan"):
        take(tmp_path / "c.json", tmp_path / "c.h5", NAMED)


def test_seconds_and_nanoseconds(tmp_path):
    """Stamps of ROS, to the nanosecond."""
    rows = "".join(f"{1700000000 + n // 4},{n % 4 * 250000001},{n}\n" for n in range(40))
    (tmp_path / "a.csv").write_text("sec,nanosec,i\n" + rows)
    text = NAMED.replace('column = "t"', 'column = "sec"')
    with pytest.raises(RunFileError, match="or `nanoseconds` of `time`"):
        take(tmp_path / "a.csv", tmp_path / "a.h5", text)
    text = text.replace('unit = "s"', 'unit = "s", nanoseconds = "nanosec"')
    take(tmp_path / "a.csv", tmp_path / "a.h5", text)
    expected = np.arange(40) // 4 + np.arange(40) % 4 * 0.250000001
    np.testing.assert_allclose(read(tmp_path / "a.h5", "time"), expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("field", "hint"), [("[1.5, 2]", "a list"), ("0x1F", "base 10"), ("1.5 A", "the unit out")]
)
def test_fields_that_only_others_read(tmp_path, field, hint):
    (tmp_path / "a.csv").write_text("t;i\n" + f"0;{field}\n" * 9)
    with pytest.raises(RunFileError, match=hint):
        take(tmp_path / "a.csv", tmp_path / "a.h5", NAMED)


@pytest.mark.parametrize(
    "sample",
    [
        "header:\n  secs: {t}\n  nsecs: 0\nposition: [{x}]\neffort: [{x}]\n---\n",
        "- time: {t}\n  position: {x}\n",
    ],
)
def test_samples_over_several_lines_are_refused_with_the_remedy(tmp_path, sample):
    source = tmp_path / "a.yaml"
    source.write_text("".join(sample.format(t=k, x=k / 8) for k in range(60)))
    with pytest.raises(RunFileError, match=r"several lines, as in YAML: .* topic echo --csv"):
        import_files([str(source)], str(tmp_path / "a.h5"), mapping())
    with pytest.raises(RunFileError, match="takes several lines"):
        preview([str(source)], None, False)
    assert not (tmp_path / "a.h5").exists()


@pytest.mark.parametrize(("unit", "raw"), [("degF", 77.0), ("°F", 77.0), ("K", 298.15)])
def test_temperatures_of_other_scales(tmp_path, unit, raw):
    text = f"""mapping = 1
[rig]
name = "bench"
[file]
sampling_rate_hz = 10
[signals]
temperature = {{ column = 1, unit = "{unit}" }}
[[conditions]]
name = "room"
unit = "{unit}"
value = {raw}
"""
    source = tmp_path / "a.csv"
    source.write_text(f"{raw}\n" * 20)
    import_files([str(source)], str(tmp_path / "a.h5"), mapping(text))
    with open_run(tmp_path / "a.h5") as run:
        recording = run.recording("imported")
        assert recording.read("temperature") == pytest.approx(25.0, rel=1e-12, abs=0)
        assert recording.condition("room") == pytest.approx(25.0, rel=1e-12, abs=0)


def test_a_folder_that_cannot_be_made_is_refused_as_any_output(tmp_path, monkeypatch):
    sources = [str(write(tmp_path / name, lines())) for name in ("a.csv", "b.csv")]
    monkeypatch.setattr("rigtool.runfile.outputs.os.access", lambda *_: False)
    with pytest.raises(UsageError, match=f"runs: the folder {tmp_path} cannot be written: choose"):
        import_files(sources, str(tmp_path / "runs"), mapping())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv", "b.csv"]
