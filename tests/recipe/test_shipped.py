"""Recipes that come with the program, from a checkout and from an installed wheel."""

import importlib.metadata

import pytest

import rigtool.recipe.shipped as shipped
from rigtool.errors import UsageError
from rigtool.recipe import load_recipe


def test_the_recipe_of_the_thesis_is_among_them_and_loads(tmp_path):
    assert {"briaire-2006", "import/mis-tool"} <= set(shipped.shipped_recipes())
    shipped.copy_recipe("briaire-2006", str(tmp_path / "rig.toml"))
    recipe, _ = load_recipe(tmp_path / "rig.toml", [])
    assert recipe.rig.source == "virtual"


def test_a_file_that_exists_stays(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text("mine")
    with pytest.raises(UsageError, match="exists"):
        shipped.copy_recipe("briaire-2006", str(path))
    assert path.read_text() == "mine"
    shipped.copy_recipe("briaire-2006", str(path), overwrite=True)
    assert path.read_text() != "mine"


@pytest.mark.parametrize(
    ("name", "folder", "message"),
    [("nonsense", ".", "no recipe nonsense .* briaire-2006"), ("briaire-2006", "no", "written")],
)
def test_what_cannot_be_copied(tmp_path, name, folder, message):
    with pytest.raises(UsageError, match=message):
        shipped.copy_recipe(name, str(tmp_path / folder / "rig.toml"))


def test_an_installed_wheel_knows_where_pip_put_them(tmp_path, monkeypatch):
    monkeypatch.setattr(shipped, "__file__", str(tmp_path / "a" / "b" / "c.py"))
    stored = tmp_path / "share" / "rigtool" / "recipes" / "import" / "x.toml"
    stored.parent.mkdir(parents=True)
    (tmp_path / "lib").mkdir()
    stored.write_text("text")

    class Installed:
        files = (
            importlib.metadata.PackagePath("../share/rigtool/recipes/import/x.toml"),
            importlib.metadata.PackagePath("rigtool/cli/recipe.py"),
        )

    for file in Installed.files:
        file.dist = Installed
    Installed.locate_file = staticmethod(lambda path: tmp_path / "lib" / path)
    monkeypatch.setattr(shipped, "distribution", lambda name: Installed)
    assert set(shipped.shipped_recipes()) == {"import/x"}
    assert shipped.shipped_recipe("import/x") == "text"
