"""docs/python.md: its examples print what they show, on the stored runs."""

import doctest
import re
import shutil
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "python.md"


def test_the_examples_print_what_they_show(tmp_path, monkeypatch):
    for name in ("kt", "friction"):
        shutil.copy(ROOT / "tests" / "fixtures" / f"{name}.h5", tmp_path)
    shutil.copytree(ROOT / "recipes", tmp_path / "recipes")
    monkeypatch.chdir(tmp_path)
    text = "\n".join(
        re.findall(r"^```pycon\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    )
    page = doctest.DocTestParser().get_doctest(text, {}, PAGE.name, str(PAGE), 0)
    said = []
    done = doctest.DocTestRunner(verbose=False).run(page, out=said.append)
    assert done.attempted >= 15
    assert done.failed == 0, "".join(said)


def test_every_function_is_in_its_table():
    from rigtool import api

    functions = {name for name in api.__all__ if name.islower()} - {"open"}
    assert set(re.findall(r"^\| `rigtool\.(\w+)` \|", PAGE.read_text(), re.MULTILINE)) == functions
