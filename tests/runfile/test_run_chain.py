"""Verifying chains of runs, and comparing runs."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from rigtool.errors import RunFileError
from rigtool.quantity import Quantity
from rigtool.runfile import Column, RunWriter, Table, open_run, provenance
from rigtool.runfile.comparison import Tolerance, differences
from rigtool.runfile.objects import make_group, make_text
from rigtool.runfile.verification import ChainLink, verify
from tests.runfile.whole_run import RESULTS, SPECS, TABLES, samples, write


def chain(folder: Path) -> Path:
    """Write raw.h5 -> middle.h5 -> last.h5, raw.h5 also an input of last.h5."""
    raw = write(folder / "raw.h5", size=9000)
    middle = write(folder / "middle.h5", inputs=(raw,), recordings=())
    return write(folder / "last.h5", inputs=(middle, raw), recordings=())


def problems(links: list[ChainLink]) -> dict[str, str]:
    return {link.path.name: link.problem for link in links if link.problem}


def test_a_whole_chain(tmp_path):
    links = verify(chain(tmp_path))
    assert [(link.path.name, link.depth) for link in links] == [
        ("last.h5", 0),
        ("middle.h5", 1),
        ("raw.h5", 2),
        ("raw.h5", 1),
    ]
    assert problems(links) == {}


def test_a_chain_that_moved_together(tmp_path):
    (tmp_path / "here").mkdir()
    last = chain(tmp_path / "here")
    (tmp_path / "here").rename(tmp_path / "there")
    assert problems(verify(tmp_path / "there" / last.name)) == {}


def test_a_lost_input(tmp_path):
    last = chain(tmp_path)
    (tmp_path / "raw.h5").unlink()
    assert set(problems(verify(last))) == {"raw.h5"}
    assert "not there" in problems(verify(last))["raw.h5"]


def test_an_input_made_anew_with_the_same_content(tmp_path):
    last = chain(tmp_path)
    write(tmp_path / "raw.h5", size=9000, seed=99, overwrite=True)
    links = verify(last)
    assert problems(links) == {}
    assert {link.path.name for link in links if link.remark} == {"raw.h5"}


def test_another_run_under_the_name_of_an_input(tmp_path):
    last = chain(tmp_path)
    write(tmp_path / "raw.h5", size=8999, overwrite=True)
    assert "another run" in problems(verify(last))["raw.h5"]


def test_damage_that_only_reading_everything_finds(tmp_path):
    path = write(tmp_path / "raw.h5", size=9000)
    with h5py.File(path, "r") as file:
        chunk = file["entry/recordings/sweep/time"].id.get_chunk_info(0)
    data = bytearray(path.read_bytes())
    data[chunk.byte_offset + 100] ^= 1
    path.write_bytes(data)
    open_run(path).close()
    assert "damaged" in problems(verify(path))["raw.h5"]


def test_samples_that_were_exchanged_behind_the_checksums(tmp_path):
    path = write(tmp_path / "raw.h5", size=9000)
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        file["entry/recordings/sweep/current"][5] = 1.0
    open_run(path).close()
    assert "sweep/current do not fit" in problems(verify(path))["raw.h5"]


def test_a_file_that_names_itself_does_not_lead_round_in_circles(tmp_path):
    last = chain(tmp_path)
    with h5py.File(last, "r+", libver=("v110", "v110")) as file:
        group = file["entry/provenance"]
        for name in ("content_sha256", "record_sha256"):
            del group[name]
        del group["inputs"]
        fields = {"path": str(last), "command": "x", "sha256": "0", "content_sha256": "0"}
        parent = make_group(group, "inputs", "NXcollection")
        for number in range(5):
            item = make_group(parent, f"{number:04d}", "NXcollection")
            for name, value in fields.items():
                make_text(item, name, value)
        provenance.seal(file)
    links = verify(last)
    assert len(links) == 6
    assert "another run" in problems(links)["last.h5"]


def test_a_missing_file(tmp_path):
    assert "no such file" in problems(verify(tmp_path / "x.h5"))["x.h5"]


def lines(a: Path, b: Path, relative: float = 0.0, absolute: float = 0.0) -> list[str]:
    with open_run(a) as one, open_run(b) as other:
        return list(differences(one, other, Tolerance(relative, absolute)))


def changed(folder: Path, **what) -> Path:
    """Write the run with everything, changed in one respect."""
    signals = samples(9000)
    results, tables = dict(RESULTS), dict(TABLES)
    what.get("signals", lambda _: None)(signals)
    what.get("results", lambda _: None)(results)
    what.get("tables", lambda _: None)(tables)
    path = folder / "changed.h5"
    arguments = {"command": what.get("command", "stribeck"), "recipe": None, "recipe_text": None}
    with RunWriter(path, recordings=SPECS, **arguments) as out:
        for name, block in signals.items():
            out.append(name, block)
        out.finish(results, tables)
    return path


def another_column(tables: dict[str, Table]) -> None:
    values = np.array([2.4e-3, np.nan, 6e-3])
    columns = dict(TABLES["breakaway"].columns) | {"positive": Column(values, "N m")}
    tables["breakaway"] = Table(("position",), columns, "positive", "")


def test_an_analysis_differs_in_results_and_tables_only(tmp_path):
    first, other = write(tmp_path / "a.h5", size=100), write(tmp_path / "o.h5", size=101)
    again = write(tmp_path / "again.h5", inputs=(first,), recordings=())
    with open_run(first) as a, open_run(again) as b, open_run(other) as o:
        assert list(differences(a, b, Tolerance())) == []
        assert list(differences(b, a, Tolerance())) == []
        assert "recordings/sweep: only in the first" in differences(o, b, Tolerance())


def test_tables_that_were_forgotten_are_read_again(tmp_path):
    with open_run(write(tmp_path / "a.h5", size=100)) as run:
        before = run.tables
        run.forget_tables()
        assert run.tables is not before
        assert list(run.tables) == list(before)
        for name, table in before.items():
            for column in table.columns:
                np.testing.assert_array_equal(run.tables[name][column], table[column])


def test_a_run_does_not_differ_from_itself(tmp_path):
    path = write(tmp_path / "a.h5", size=9000)
    assert lines(path, path) == []
    assert lines(path, changed(tmp_path)) == []


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        ({"command": "fft-ripple"}, "command: stribeck | fft-ripple"),
        (
            {"results": lambda r: r.update(torque_constant=Quantity(0.0459, "N m/A", 3e-5, 12.0))},
            "results/torque_constant: 45.800(40) mN m/A | 45.900(30) mN m/A  "
            "(2 standard uncertainties of the difference)",
        ),
        (
            {"results": lambda r: r.update(torque_constant=Quantity(0.0458, "V s", 4e-5, 12.0))},
            "results/torque_constant: unit N m/A | V s",
        ),
        (
            {"results": lambda r: r.update(torque_constant=Quantity(0.0458, "N m/A", 3e-5, 12.0))},
            "results/torque_constant: standard uncertainty 4e-05 N m/A | 3e-05 N m/A",
        ),
        ({"results": lambda r: r.pop("arm_length")}, "results/arm_length: only in the first"),
        (
            {"results": lambda r: r.update(new=Quantity(1.0, "1", 1.0))},
            "results/new: only in the second",
        ),
        (
            {"tables": another_column},
            "tables/breakaway/positive: 1 of 3 values differ, by up to 0.001 N m",
        ),
        ({"tables": lambda t: t.pop("breakaway")}, "tables/breakaway: only in the first"),
        (
            {"signals": lambda s: s["holds"]["torque"].__setitem__(slice(3), 1e3)},
            "recordings/holds/torque: 3 of 9000 values differ, by up to 1e+03 N m",
        ),
    ],
)
def test_each_difference_is_reported(tmp_path, what, expected):
    path = write(tmp_path / "a.h5", size=9000)
    found = lines(path, changed(tmp_path, **what))
    assert expected in found
    assert len(found) <= 2


def test_of_runs_of_different_commands_the_rest_is_counted(tmp_path):
    def another(results):
        value = results.pop("arm_length")
        results |= {"new": value, "newer": value}

    path = write(tmp_path / "a.h5", size=9000)
    other = changed(tmp_path, command="fft-ripple", results=another)
    common = len(RESULTS) - 1
    assert lines(path, other) == [
        "command: stribeck | fft-ripple",
        f"results: 1 only in the first, 2 only in the second, {common} in both",
    ]


def test_runs_of_different_length(tmp_path):
    a, b = write(tmp_path / "a.h5", size=9000), write(tmp_path / "b.h5", size=9001)
    assert lines(a, b) == [
        "recordings/sweep: 9000 samples | 9001",
        "recordings/holds: 9000 samples | 9001",
    ]


def test_tolerances(tmp_path):
    path = write(tmp_path / "a.h5", size=9000)
    other = changed(tmp_path, signals=lambda s: s["holds"]["torque"].__iadd__(1e-9))
    assert len(lines(path, other)) == 1
    assert lines(path, other, absolute=1.01e-9) == []
    assert len(lines(path, other, absolute=0.99e-9)) == 1


numbers = st.floats(allow_nan=True, allow_infinity=True)


@given(hnp.arrays("f8", 5, elements=numbers), hnp.arrays("f8", 5, elements=numbers))
def test_agreement_does_not_depend_on_the_order(a, b):
    tolerance = Tolerance(1e-6, 1e-12)
    np.testing.assert_array_equal(tolerance.beyond(a, b), tolerance.beyond(b, a))
    assert not Tolerance().beyond(a, a).any()
    assert (Tolerance().beyond(a, b) == ~((a == b) | (np.isnan(a) & np.isnan(b)))).all()


def test_comparing_with_something_else(tmp_path):
    (tmp_path / "x.h5").write_text("x")
    with pytest.raises(RunFileError):
        lines(write(tmp_path / "a.h5", size=10), tmp_path / "x.h5")
