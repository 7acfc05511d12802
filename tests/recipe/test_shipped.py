"""Recipes that come with the program, from a checkout and from an installed wheel."""

import importlib.metadata

import pytest

import rigtool.recipe.shipped as shipped
from rigtool.cli import main
from rigtool.recipe import load_recipe


def copied(*arguments) -> int:
    with pytest.raises(SystemExit) as caught:
        main(["recipe", *map(str, arguments)])
    return caught.value.code or 0


def test_the_recipe_of_the_thesis_is_among_them_and_loads(tmp_path):
    assert {"briaire-2006", "import/mis-tool"} <= set(shipped.shipped_recipes())
    assert copied("briaire-2006", "-o", tmp_path / "rig.toml") == 0
    recipe, _ = load_recipe(tmp_path / "rig.toml", [])
    assert recipe.rig.source == "virtual"


def test_the_list_states_what_each_describes(capsys):
    assert copied() == 0
    shown = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert list(shown) == list(shipped.shipped_recipes())
    assert shown["briaire-2006"] == "The rig of E. Briaire"
    assert shown["import/odrive-slow"] == "One slow turn of a hobby motor"


def test_a_file_that_exists_stays(tmp_path, capsys):
    path = tmp_path / "rig.toml"
    path.write_text("mine")
    assert copied("briaire-2006", "-o", path) == 2
    assert "exists" in capsys.readouterr().err
    assert path.read_text() == "mine"
    assert copied("briaire-2006", "-o", path, "--overwrite") == 0
    assert path.read_text() != "mine"


@pytest.mark.parametrize(
    ("name", "folder", "message"),
    [("nonsense", ".", "no recipe nonsense"), ("briaire-2006", "no", "does not exist")],
)
def test_what_cannot_be_copied(tmp_path, capsys, name, folder, message):
    assert copied(name, "-o", tmp_path / folder / "rig.toml") == 2
    assert message in capsys.readouterr().err


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


def test_firmware_comes_with_the_recipe_of_an_own_target(tmp_path, capsys):
    folder = tmp_path / "new" / "firmware"
    assert copied("own-target", "--firmware", folder, "-o", tmp_path / "rig.toml") == 0
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["port_example.c", "rigtool_loop.c", "rigtool_target.c", "rigtool_target.h"]
    assert (tmp_path / "rig.toml").exists()
    (folder / "port_example.c").write_text("mine")
    (folder / "rigtool_loop.c").unlink()
    assert copied("own-target", "--firmware", folder) == 2
    assert "port_example.c" in capsys.readouterr().err
    assert not (folder / "rigtool_loop.c").exists()  # all of it, or nothing
    assert copied("own-target", "--firmware", folder, "--overwrite") == 0
    assert "board_encoder" in (folder / "port_example.c").read_text()


def test_an_output_that_cannot_be_written_is_found_before_anything_is(tmp_path, capsys):
    (tmp_path / "rig.toml").write_text("mine")
    folder = tmp_path / "firmware"
    assert copied("own-target", "--firmware", folder, "-o", tmp_path / "rig.toml") == 2
    assert not folder.exists()
    assert copied("-o", tmp_path / "other.toml") == 2
    assert "give the NAME" in capsys.readouterr().err


def test_firmware_belongs_to_one_recipe_and_into_a_folder(tmp_path, capsys):
    assert copied("moteus-r4", "--firmware", tmp_path) == 2
    assert "rigtool recipe own-target --firmware" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    assert copied("own-target", "--firmware", tmp_path / "file") == 2
    assert "cannot be made" in capsys.readouterr().err
