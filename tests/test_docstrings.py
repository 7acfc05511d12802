"""Docstrings say what a caller must know: errors that are raised, shapes of arrays, sources."""

import ast
import re

import pytest

from tests.house import MODULES, NUMERICS, place

EXPLAINED = [path for path in MODULES if "cli" not in path.parts]  # help, for users
SHAPE = re.compile(r"\([a-z0-9.]+,( ?[a-z0-9 +*/-]+)*\)|\(\.\.\., \w+\)")
"""(n,), (m, n), (..., n), (m, p - 1)."""


def public(tree):
    """Yield public functions and methods, each with the docstrings that hold for it."""
    module = ast.get_docstring(tree) or ""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield node, ast.get_docstring(node) or "", module
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            own = ast.get_docstring(node) or ""
            for item in node.body:
                if isinstance(item, ast.FunctionDef) and (
                    not item.name.startswith("_") or item.name in ("__init__", "__post_init__")
                ):
                    yield item, f"{own}\n{ast.get_docstring(item) or ''}", module


def raised(function):
    """Return the names of the errors that a function raises itself."""
    names = set()
    for node in ast.walk(function):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            called = node.exc.func
            names.add(called.id if isinstance(called, ast.Name) else ast.unparse(called))
    return {name for name in names if name[0].isupper() and name not in INTERNAL}


INTERNAL = {"AssertionError", "NotImplementedError", "KeyboardInterrupt"}


@pytest.mark.parametrize("path", EXPLAINED, ids=place)
def test_errors_are_named(path):
    tree = ast.parse(path.read_text())
    for function, text, _ in public(tree):
        missing = {name for name in raised(function) if name.split(".")[-1] not in text}
        assert not missing, f"{path.name}: {function.name} raises {missing}, its docstring does not"


@pytest.mark.parametrize("path", NUMERICS, ids=place)
def test_shapes_of_arrays_are_given(path):
    tree = ast.parse(path.read_text())
    for function, text, module in public(tree):
        arguments = [*function.args.args, *function.args.kwonlyargs]
        annotations = [ast.unparse(a.annotation) for a in arguments if a.annotation]
        if any(a in ("Array", "ArrayLike", "ComplexArray") for a in annotations):
            where = f"{path.name}: {function.name} takes arrays"
            assert SHAPE.search(text) or SHAPE.search(module), f"{where} of an unknown shape"


@pytest.mark.parametrize("path", NUMERICS, ids=place)
def test_an_analysis_says_where_its_method_is_from(path):
    """A section of the thesis in brackets, a publication with its year, or what it computes."""
    text = path.read_text()
    documented = " ".join(
        ast.get_docstring(node) or ""
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef)
    )
    if path.name not in ("checks.py", "compiled.py"):
        source = re.search(r"\[[\dA-Z].*?\]|\(?[12][09]\d\d\b|Fig\. \d|eq\. |=", documented)
        assert source, f"{path.name}: neither an equation nor a source"
