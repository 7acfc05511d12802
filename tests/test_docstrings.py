"""Docstrings say what a caller must know: errors that are raised, shapes of arrays, sources."""

import ast
import re

from tests.house import MODULES, NUMERICS, parsed, place

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


def test_errors_are_named():
    unnamed = [
        f"{place(path)}: {function.name} raises {name}, its docstring does not say so"
        for path in EXPLAINED
        for function, text, _ in public(parsed(path))
        for name in sorted(raised(function))
        if name.split(".")[-1] not in text
    ]
    assert unnamed == []


def takes_arrays(function):
    arguments = [*function.args.args, *function.args.kwonlyargs]
    annotations = [ast.unparse(a.annotation) for a in arguments if a.annotation]
    return any(a in ("Array", "ArrayLike", "ComplexArray") for a in annotations)


def test_shapes_of_arrays_are_given():
    unknown = [
        f"{place(path)}: {function.name} takes arrays of an unknown shape"
        for path in NUMERICS
        for function, text, module in public(parsed(path))
        if takes_arrays(function) and not (SHAPE.search(text) or SHAPE.search(module))
    ]
    assert unknown == []


def test_an_analysis_says_where_its_method_is_from():
    """A section of the thesis in brackets, a publication with its year, or what it computes."""
    without = []
    for path in NUMERICS:
        documented = " ".join(
            ast.get_docstring(node) or ""
            for node in ast.walk(parsed(path))
            if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef)
        )
        source = re.search(r"\[[\dA-Z].*?\]|\(?[12][09]\d\d\b|Fig\. \d|eq\. |=", documented)
        if not source and path.name not in ("checks.py", "compiled.py"):
            without.append(f"{place(path)}: neither an equation nor a source")
    assert without == []
