"""docs/run-file-format.md lists what is in a file, and nothing that is not."""

import re
from pathlib import Path

import h5py

from rigtool.runfile import schema

DOCUMENT = Path(__file__).parents[2] / "docs" / "run-file-format.md"
HDF5_OWN = {"CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST"}


def rows(heading: str) -> list[list[str]]:
    text = DOCUMENT.read_text().partition(f"## {heading}\n")[2].partition("\n## ")[0]
    lines = [line for line in text.splitlines() if line.startswith("|")][2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def pattern(path: str) -> re.Pattern[str]:
    return re.compile(re.sub(r"[A-Z]+(?![a-z])", r"[A-Za-z0-9_]+", path.strip("`")))


def kind(node: h5py.Group | h5py.Dataset) -> str:
    if isinstance(node, h5py.Group):
        return "group"
    return "text" if h5py.check_string_dtype(node.dtype) else node.dtype.str[1:]


def everything(path: Path) -> dict[str, h5py.Group | h5py.Dataset]:
    file = h5py.File(path, "r")
    found = {"/": file["/"]}
    file.visititems(lambda name, node: found.update({f"/{name}": node}))
    return found


def attribute_type(node: h5py.Group | h5py.Dataset, name: str) -> str:
    attribute = node.attrs.get_id(name)
    text = h5py.check_string_dtype(attribute.dtype) is not None
    return ("text" if text else attribute.dtype.str[1:]) + ("[]" if attribute.shape else "")


def test_every_object_is_in_the_document_with_its_type(run_path):
    listed = [(pattern(row[0]), row[2].split(", ")) for row in rows("Objects")]
    for path, node in everything(run_path).items():
        # The most special line counts: `conditions` is also a possible name of a channel.
        kinds = [kinds for regex, kinds in listed if regex.fullmatch(path)]
        assert kinds, f"{path} is not in the document"
        assert any(kind(node) in item for item in kinds), (path, kind(node))


def test_every_attribute_is_in_the_document_with_its_type(run_path):
    listed = [
        (re.compile(".*") if "every" in row[0] else pattern(row[0]), pattern(row[1]), row[2])
        for row in rows("Attributes")
    ]
    for path, node in everything(run_path).items():
        for name in set(node.attrs) - HDF5_OWN:
            types = [t for r, n, t in listed if r.fullmatch(path) and n.fullmatch(name)]
            assert types, f"attribute {name} of {path} is not in the document"
            short = re.sub(r"\[\d+\]", "[]", types[0])
            assert attribute_type(node, name) == short, (path, name)


def test_everything_in_the_document_is_in_a_file(run_path):
    found = everything(run_path)
    for path, *_ in rows("Objects"):
        assert any(pattern(path).fullmatch(item) for item in found), path
    for path, name, *_ in rows("Attributes"):
        regex = re.compile(".*") if "every" in path else pattern(path)
        names = {key for item, node in found.items() if regex.fullmatch(item) for key in node.attrs}
        assert any(pattern(name).fullmatch(item) for item in names), (path, name)


def test_the_version_written_heads_the_version_history():
    assert [row[0] for row in rows("Versions")][-1] == schema.version_text()
    assert f"version **{schema.version_text()}**" in DOCUMENT.read_text()
