"""Trees that tests share are those of the file, and no test changes those of another."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from rigtool.errors import RunFileError
from rigtool.runfile import open_run, tree
from tests.read_once import read_tree

KT = Path(__file__).parent / "fixtures" / "kt.h5"


def same(first, second):
    """Assert that two trees hold the same, down to types and the order of members."""
    assert list(first.groups) == list(second.groups)
    assert list(first.values) == list(second.values)
    assert repr(first.attributes) == repr(second.attributes)
    for name, one in first.values.items():
        other = second.values[name]
        assert (one.path, one.kind, one.shape) == (other.path, other.kind, other.shape)
        assert repr(one.attributes) == repr(other.attributes)
        np.testing.assert_array_equal(one.value, other.value)
    for name, group in first.groups.items():
        same(group, second.groups[name])


def test_what_a_test_changes_stays_its_own():
    with open_run(KT) as run:
        name, table = next(iter(run.tables.items()))
        column = next(iter(table.columns))
        table[column][:] = -1.0
    with open_run(KT) as again, again._file.use() as file:
        assert np.all(again.tables[name][column] != -1.0)
        assert tree.read_tree is not read_tree
        same(tree.read_tree(file), read_tree(file))


def test_other_bytes_of_the_same_name_are_read_anew(tmp_path):
    path = shutil.copy(KT, tmp_path / "kt.h5")
    with open_run(path):
        pass
    content = bytearray(KT.read_bytes())
    place = content.index(b"calibrate-kt")
    content[place] ^= 1
    Path(path).write_bytes(content)
    with pytest.raises(RunFileError):
        open_run(path)
