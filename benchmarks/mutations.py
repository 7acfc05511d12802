"""Which faults in the numerics the tests of a room see: seeded mutations, one at a time.

    .venv/bin/python benchmarks/mutations.py [--count 60] [--seed 1] [--within experiments/friction]
                                             [--only NUMBER ...] [--list]

Each mutation changes one operator, comparison, index, number or function name in the body of a
function of `rigtool/quantity.py`, `rigtool/numerics`, `rigtool/control` or a room of
`rigtool/experiments`, drawn from all such places alike. It is made in a copy of the tree; the tests
of the file run first, then those of its room, then others that import it, by themselves or by what
they share. A mutation that all of them pass survives. Not changed are named limits at the top of a
module, which are a judgement, texts of messages, and annotations (R. A. DeMillo, R. J. Lipton,
F. G. Sayward, Computer 11(4), 34, 1978).
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
NOT_NUMERICS = ("experiments/running/", "experiments/deploy/")
OPERATORS: dict[type, type] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.MatMult: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Lt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
NAMES = {
    "min": "max",
    "max": "min",
    "argmin": "argmax",
    "argmax": "argmin",
    "minimum": "maximum",
    "maximum": "minimum",
    "sin": "cos",
    "cos": "sin",
    "mean": "sum",
    "real": "imag",
    "imag": "real",
}
TIMEOUT = 1200
"""Seconds after which tests count as failed: the mutation made a loop endless."""


@dataclass(frozen=True)
class Mutation:
    """One change: the file below `rigtool`, its line, the whole mutated text, and before, after."""

    place: str
    line: int
    text: str
    before: str
    after: str


def changes(node: ast.AST) -> Iterator[tuple[str, object]]:
    """Yield (attribute, new value) for each way to mutate a node."""
    if isinstance(node, ast.BinOp | ast.AugAssign | ast.BoolOp) and type(node.op) in OPERATORS:
        yield "op", OPERATORS[type(node.op)]()
    elif isinstance(node, ast.Compare) and type(node.ops[0]) in OPERATORS:
        yield "ops", [OPERATORS[type(node.ops[0])](), *node.ops[1:]]
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield "op", ast.UAdd()
    elif isinstance(node, ast.Constant) and type(node.value) is int:
        yield "value", node.value + 1
    elif isinstance(node, ast.Constant) and type(node.value) is float:
        yield "value", node.value * 1.5 or 1.0
    elif isinstance(node, ast.Attribute) and node.attr in NAMES:
        yield "attr", NAMES[node.attr]


def sites(tree: ast.AST) -> Iterator[tuple[ast.AST, str, object]]:
    """Yield each place in the bodies of functions that a mutation may change."""

    def walk(node: ast.AST, inside: bool) -> Iterator[tuple[ast.AST, str, object]]:
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.AnnAssign | ast.arguments):
            return
        if inside:
            yield from ((node, name, new) for name, new in changes(node))
        inside = inside or isinstance(node, ast.FunctionDef)
        for child in ast.iter_child_nodes(node):
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
    statements = {
        id(child): node
        for node in ast.walk(tree)
        if isinstance(node, ast.stmt)
        for child in ast.walk(node)
        if not isinstance(node, ast.FunctionDef | ast.ClassDef | ast.With | ast.For | ast.If)
        or child is node
    }
    node, name, new = list(sites(tree))[number]
    shown = statements.get(id(node), node)
    before = ast.unparse(shown)
    setattr(node, name, new)
    after, place = ast.unparse(shown), path.relative_to(ROOT / "rigtool").as_posix()
    return Mutation(place, node.lineno, ast.unparse(tree), before, after)  # type: ignore[attr-defined]


def tests_of(place: str) -> list[str]:
    """Return the tests of a file below `rigtool`, then the others of its room, then others that
    import it."""
    file = Path("tests", place)
    own, room = file.with_name(f"test_{file.name}"), file.parent
    while not any((ROOT / room).glob("test_*.py")):
        room = room.parent
    here = {path.relative_to(ROOT) for path in (ROOT / room).glob("test_*.py")} - {own}
    groups = [[own] * (ROOT / own).exists(), sorted(here), sorted(_importing(place) - here - {own})]
    return [" ".join(map(str, group)) for group in groups if group]


def _importing(place: str) -> set[Path]:
    """Return the tests that import a file below `rigtool`, by themselves or by what they share."""
    texts = {p.relative_to(ROOT): p.read_text("utf-8") for p in (ROOT / "tests").rglob("*.py")}
    names, found = {"rigtool." + _dotted(Path(place))}, set[Path]()
    while names:
        using = {path for path, text in texts.items() if any(name in text for name in names)}
        names = {_dotted(path) for path in using - found if not path.name.startswith("test_")}
        found |= using
    return {path for path in found if path.name.startswith("test_")}


def _dotted(path: Path) -> str:
    return ".".join(path.with_suffix("").parts)


def survives(found: Mutation, copy: Path) -> bool:
    """Run the tests of a mutation in a copy of the tree, and put the file back."""
    file = copy / "rigtool" / found.place
    whole = file.read_bytes()
    file.write_text(found.text, encoding="utf-8")
    # numba keeps the machine code of what calls a function when only that function's file changes
    kept = copy.parent / ("mutated" if "@compiled" in found.text else "unchanged")
    try:
        return all(passes(tests, copy, kept) for tests in tests_of(found.place))
    finally:
        file.write_bytes(whole)
        shutil.rmtree(copy.parent / "mutated", ignore_errors=True)


def passes(tests: str, copy: Path, machine_code: Path) -> bool:
    """Return whether tests pass in a copy of the tree; numba keeps its code in a folder."""
    options = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider", "-m", "not real_time"]
    try:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", *options, *tests.split()],
            cwd=copy,
            env={**os.environ, "NUMBA_CACHE_DIR": str(machine_code)},
            capture_output=True,
            timeout=TIMEOUT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode in (0, 5)  # 5: no test left there


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
        copy = Path(folder) / "tree"
        if not asked.list:
            shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".venv", ".git", "build"))
        for number, found in enumerate(mutations, 1):
            if asked.only and number not in asked.only:
                continue
            alive = not asked.list and survives(found, copy)
            survived += alive
            state = "" if asked.list else "SURVIVED " if alive else "killed "
            print(f"{number:3} {state}{found.place}:{found.line}", flush=True)
            if alive or asked.list:
                print(f"    - {found.before}\n    + {found.after}", flush=True)
    print(f"{survived} survived")


if __name__ == "__main__":
    main()
