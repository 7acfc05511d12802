"""Which faults in the numerics the tests of a room see: seeded mutations, one at a time.

    .venv/bin/python benchmarks/mutations.py [--count 60] [--seed 1] [--within experiments/friction]
                                             [--only NUMBER ...] [--list]

Each mutation changes one place in a function of `rigtool/quantity.py`, `rigtool/numerics`,
`rigtool/control` or a room of `rigtool/experiments`, drawn from all such places alike: an operator,
comparison, number, default, slice or function name; `abs` and its like taken away; a statement
removed; a condition that always holds or never; arguments, entries of a tuple or values of a table
exchanged; a named argument left out; a sign of what is returned (`variants`). It is made in a copy
of the tree; the tests of the file run first, then those of its room, then others that import it, by
themselves, by what they share or by a module of an experiment that they name, and last
`tests/test_fixtures.py`, where commands analyse stored runs.
A mutation that all of them pass survives. Not changed are named limits at the top of a module,
which are a judgement, texts of messages, and annotations (R. A. DeMillo, R. J. Lipton, F. G.
Sayward, Computer 11(4), 34, 1978).
"""

from __future__ import annotations

import argparse
import ast
import copy
import difflib
import multiprocessing
import os
import random
import re
import resource
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

# what tests import from elsewhere is imported once, for all of them
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
import h5py  # noqa: F401
import hypothesis  # noqa: F401
import numba
import pydantic  # noqa: F401
import pytest
import scipy.linalg
import scipy.optimize
import scipy.signal  # noqa: F401

ROOT = Path(__file__).parents[1]
NOT_NUMERICS = ("experiments/running/", "experiments/deploy/")
OPERATORS: dict[type, tuple[type, ...]] = {
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.Pow: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.MatMult: (ast.Mult,),
    ast.Mod: (ast.Mult,),
    ast.Lt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
}
PAIRS = (
    ("min", "max"),
    ("argmin", "argmax"),
    ("minimum", "maximum"),
    ("sin", "cos"),
    ("mean", "sum"),
    ("real", "imag"),
    ("any", "all"),
    ("floor", "ceil"),
    ("median", "mean"),
    ("std", "var"),
)
NAMES = {a: b for pair in PAIRS for a, b in (pair[::-1], pair)}
REMOVED = ("abs", "sqrt", "square", "sorted", "round", "cumsum", "nan_to_num", "conj", "unwrap")
"""Functions of one argument that may be left out."""
COMMUTE = ("min", "max", "minimum", "maximum", "hypot", "array_equal", "zip", "isinstance")
BREAK = ("getattr", "zeros", "full", "empty", "range", "reshape")
"""Functions whose arguments in another order are the same, and those that then break down."""
TIMEOUT, PROCESSOR_TIME, MEMORY = 1200, 400, 8 << 30
"""Seconds, seconds and bytes beyond which tests count as failed: a loop without an end."""


@dataclass(frozen=True)
class Mutation:
    """One change: the file below `rigtool`, its line, the whole mutated text, and before, after."""

    place: str
    line: int
    text: str
    before: str
    after: str


def variants(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what may stand in the place of a node."""
    match node:
        case ast.BinOp() | ast.AugAssign() | ast.BoolOp():
            for kind in OPERATORS.get(type(node.op), ()):
                yield changed(node, op=kind())
        case ast.Compare():
            for kind in OPERATORS[type(node.ops[0])]:
                yield changed(node, ops=[kind(), *node.ops[1:]])
        case ast.UnaryOp(op=ast.USub() | ast.Not()):
            yield node.operand
        case ast.Constant(value=bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(value=int(value)):
            yield ast.Constant(value + 1)
        case ast.Constant(value=float(value)):
            yield ast.Constant(value * 1.5 or 1.0)
        case ast.Attribute() if node.attr in NAMES:
            yield changed(node, attr=NAMES[node.attr])
        case ast.Call():
            yield from _variants_of_call(node)
        case ast.Slice():
            for side in ("lower", "upper"):
                bound = getattr(node, side)
                if bound is not None:
                    yield changed(node, **{side: None})
                    if not isinstance(bound, ast.Constant):
                        yield changed(node, **{side: ast.BinOp(bound, ast.Add(), ast.Constant(1))})
        case ast.Tuple(ctx=ast.Load()):
            yield from (changed(node, elts=elts) for elts in exchanged(node.elts))
        case ast.Dict(keys=keys) if all(keys):
            yield from (changed(node, values=values) for values in exchanged(node.values))
    match node:  # statements and conditions
        case ast.If() | ast.IfExp():
            yield from (changed(node, test=ast.Constant(held)) for held in (True, False))
        case ast.While():
            yield changed(node, test=ast.Constant(False))
        case ast.comprehension(ifs=[_, *others]):
            yield changed(node, ifs=others)
        case ast.For():
            yield changed(node, iter=ast.Tuple([], ast.Load()))
        case ast.Return(value=ast.BinOp() | ast.Name() as returned):
            yield changed(node, value=ast.UnaryOp(ast.USub(), returned))
        case ast.Continue():
            yield ast.Break()
        case ast.Break():
            yield ast.Continue()
        case ast.AugAssign() | ast.Expr(value=ast.Call()):
            yield ast.Pass()
        case ast.Assign(targets=[target]) if not isinstance(target, ast.Name) or any(
            isinstance(used, ast.Name) and used.id == target.id for used in ast.walk(node.value)
        ):  # not the first of a name, without which all breaks down
            yield ast.Pass()


def _variants_of_call(node: ast.Call) -> Iterator[ast.AST]:
    called = getattr(node.func, "attr", getattr(node.func, "id", ""))
    if isinstance(node.func, ast.Name) and called in NAMES:
        yield changed(node, func=ast.Name(NAMES[called], ast.Load()))
    if called in REMOVED and node.args:
        yield node.args[0]
    if called not in COMMUTE + BREAK:
        yield from (changed(node, args=args) for args in exchanged(node.args))
    for values in exchanged([keyword.value for keyword in node.keywords]):
        pairs = zip(node.keywords, values, strict=True)
        yield changed(node, keywords=[changed(keyword, value=value) for keyword, value in pairs])
    for left_out in node.keywords:
        if left_out.arg != "strict":
            yield changed(node, keywords=[one for one in node.keywords if one is not left_out])


def exchanged(items: list) -> Iterator[list]:
    """Yield a list with each two neighbours that differ exchanged."""
    for n in range(len(items) - 1):
        one, other = items[n : n + 2]
        if one and other and ast.dump(one) != ast.dump(other):
            yield [*items[:n], other, one, *items[n + 2 :]]


def changed(node: ast.AST, **fields: object) -> ast.AST:
    """Return a copy of a node with other fields."""
    new = copy.copy(node)
    for name, value in fields.items():
        setattr(new, name, value)
    return new


def sites(tree: ast.AST) -> Iterator[tuple[ast.AST, str, int | None, ast.AST]]:
    """Yield (parent, field, index, what stands there then) for each change within functions."""

    def walk(node: ast.AST, inside: bool) -> Iterator[tuple[ast.AST, str, int | None, ast.AST]]:
        inside = inside or isinstance(node, ast.FunctionDef)
        for field, value in ast.iter_fields(node):
            if field in ("annotation", "returns", "decorator_list"):
                continue
            children = value if isinstance(value, list) else [value]
            for n, child in enumerate(children):
                if not isinstance(child, ast.AST) or isinstance(child, ast.Raise | ast.JoinedStr):
                    continue
                if getattr(node, "arg", None) == "strict":  # of zip: a check of the program itself
                    continue
                if inside:
                    index = n if isinstance(value, list) else None
                    yield from ((node, field, index, new) for new in variants(child))
                yield from walk(child, inside)

    yield from walk(tree, False)


def drawn(seed: int, count: int, within: tuple[str, ...] = ("",)) -> list[Mutation]:
    """Return `count` mutations, drawn from all places alike in files whose paths begin so."""
    files = [ROOT / "rigtool" / "quantity.py"] + [
        path
        for folder in ("numerics", "control", "experiments")
        for path in sorted((ROOT / "rigtool" / folder).rglob("*.py"))
        if not path.relative_to(ROOT / "rigtool").as_posix().startswith(NOT_NUMERICS)
    ]
    places = [
        (path, n)
        for path in files
        if path.relative_to(ROOT / "rigtool").as_posix().startswith(within)
        for n in range(sum(1 for _ in sites(ast.parse(path.read_text(encoding="utf-8")))))
    ]
    return [mutation(*chosen) for chosen in random.Random(seed).sample(places, count)]


def mutation(path: Path, number: int) -> Mutation:
    """Return the mutation of one place, by its number in the file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    whole = ast.unparse(tree).splitlines()
    parent, field, index, new = list(sites(tree))[number]
    old = getattr(parent, field) if index is None else getattr(parent, field)[index]
    line = next(n.lineno for n in (old, *ast.walk(old), parent) if hasattr(n, "lineno"))
    if index is None:
        setattr(parent, field, new)
    else:
        getattr(parent, field)[index] = new
    text, place = ast.unparse(tree), path.relative_to(ROOT / "rigtool").as_posix()
    different = [
        row for row in difflib.ndiff(whole, text.splitlines()) if row.startswith(("-", "+"))
    ]
    before, after = (
        "\n".join(row[2:].strip() for row in different if row[0] == sign) for sign in "-+"
    )
    return Mutation(place, line, text, before, after)


def tests_of(place: str, tree: Path) -> list[str]:
    """Return the tests of a file below `rigtool`, then others that name it, then those of its room,
    those that import it by what tests share, those that name a module of an experiment which
    imports it, and stored runs that commands analyse again."""
    file = Path("tests", place)
    own, room = file.with_name(f"test_{file.name}"), file.parent
    while not any((tree / room).glob("test_*.py")):
        room = room.parent
    here = {path.relative_to(tree) for path in (tree / room).glob("test_*.py")}
    naming, importing = _importing(place, tree)
    using = _of_users(place, tree)
    stored = {Path("tests/test_fixtures.py")}
    groups = [{own} if (tree / own).exists() else set(), naming, here, importing, using, stored]
    return [
        " ".join(map(str, sorted(group.difference(*groups[:n]))))
        for n, group in enumerate(groups)
        if group.difference(*groups[:n])
    ]


def _importing(place: str, tree: Path) -> tuple[set[Path], set[Path]]:
    """Return the tests that import a file below `rigtool`, and those that share what does."""
    texts = {p.relative_to(tree): p.read_text("utf-8") for p in (tree / "tests").rglob("*.py")}
    names = {"rigtool." + _dotted(Path(place))}
    found: list[set[Path]] = []
    while names:
        using = {path for path, text in texts.items() if any(name in text for name in names)}
        names = {_dotted(path) for path in using.difference(*found) if not _is_test(path)}
        found.append(using)
    tests = [{path for path in using if _is_test(path)} for using in found]
    return tests[0], set().union(*tests)


def _of_users(place: str, tree: Path) -> set[Path]:
    """Return the tests that name a module of an experiment which imports a file below `rigtool`."""
    own, modules = "rigtool." + _dotted(Path(place)), (tree / "rigtool/experiments").rglob("*.py")
    users = {
        _dotted(m.relative_to(tree)) for m in modules if f"{own} import" in m.read_text("utf-8")
    }
    tests = {p.relative_to(tree): p.read_text("utf-8") for p in (tree / "tests").rglob("test_*.py")}
    return {path for path, text in tests.items() if any(f"{name} import" in text for name in users)}


def _is_test(path: Path) -> bool:
    return path.name.startswith("test_")


def _dotted(path: Path) -> str:
    return ".".join(path.with_suffix("").parts)


def verdict(found: Mutation, tree: Path) -> str:
    """Run the tests of a mutation in a copy of the tree, put the file back, and return what saw it;
    nothing where all tests pass."""
    file = tree / "rigtool" / found.place
    whole, stat = file.read_bytes(), file.stat()
    file.write_text(found.text, encoding="utf-8")
    # a mutation's machine code must not replace that of the tree, which the next ones use
    kept = tree.parent / ("mutated" if "@compiled" in found.text else "unchanged")
    try:
        return next(
            filter(None, (failed(one, tree, kept) for one in tests_of(found.place, tree))), ""
        )
    finally:
        file.write_bytes(whole)
        os.utime(file, ns=(stat.st_atime_ns, stat.st_mtime_ns))
        shutil.rmtree(tree.parent / "mutated", ignore_errors=True)


def failed(tests: str, tree: Path, machine_code: Path) -> str:
    """Return what failed in a copy of the tree; numba keeps its code in a folder."""
    printed = tree.parent / "printed"
    process = multiprocessing.get_context("fork").Process(
        target=_run, args=(tests.split(), tree, machine_code, printed)
    )
    process.start()
    process.join(TIMEOUT)
    if process.is_alive():
        process.kill()
        process.join()
    if process.exitcode in (0, 5):  # 5: no test left there
        return ""
    seen = re.search("^(?:FAILED|ERROR) (.*?)(?: - |$)", printed.read_text(), re.MULTILINE)
    return seen.group(1) if seen else f"an end with {process.exitcode}"


def _run(tests: list[str], tree: Path, machine_code: Path, printed: Path) -> None:
    """Run tests in a copy of the tree, in a process that has what they import from elsewhere."""
    os.chdir(tree)
    os.environ["NUMBA_CACHE_DIR"] = str(machine_code)
    numba.core.config.reload_config()
    resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR_TIME, PROCESSOR_TIME))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for stream in (1, 2):
        os.dup2(os.open(printed, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), stream)
    options = ["-x", "-q", "-n", "0", "--tb=no", "--assert=plain", "-p", "no:cacheprovider"]
    options += ["-m", "not real_time and not thorough", "--hypothesis-profile", "first failure"]
    sys.path.insert(0, str(tree))
    sys.exit(pytest.main([*options, *tests]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=60, help="mutations drawn")
    parser.add_argument("--seed", type=int, default=1, help="of the draw")
    parser.add_argument("--within", nargs="+", default=[""], help="files or rooms below rigtool")
    parser.add_argument("--only", type=int, nargs="+", help="numbers of mutations to try")
    parser.add_argument("--list", action="store_true", help="show the mutations, try none")
    asked = parser.parse_args()
    mutations = drawn(asked.seed, asked.count, tuple(asked.within))
    survived = 0
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        if not asked.list:
            shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".venv", ".git", "build"))
            if seen := failed("tests/test_quantity.py", tree, tree.parent / "unchanged"):
                sys.exit(f"fails without a mutation: {seen}")
        for number, found in enumerate(mutations, 1):
            if asked.only and number not in asked.only:
                continue
            seen = "" if asked.list else verdict(found, tree)
            survived += not seen
            state = "" if asked.list else "killed " if seen else "SURVIVED "
            print(f"{number:3} {state}{found.place}:{found.line} {seen}".rstrip(), flush=True)
            if not seen:
                print(f"    - {found.before}\n    + {found.after}", flush=True)
    print(f"{survived} {'listed' if asked.list else 'survived'}")


if __name__ == "__main__":
    main()
