#!/usr/bin/env python3
"""Which small mistakes in the receiver, the channel and the radio do the tests find? `make mutants` prints a table.

Negates a comparison, swaps + and -, or swaps `and` and `or`, one at a time, in a copy of the tree, and runs the test
files that import the module. A survivor is a missing test, or a change on which no result depends. RADALT_MUTANTS_S is
the time it takes, s (default 3600).
"""

from __future__ import annotations

import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from _tool import FLOWGRAPHS

ROOT, CORE = FLOWGRAPHS.parent, FLOWGRAPHS.parent / "python/radalt/core"
LIMIT_S = float(os.environ.get("RADALT_MUTANTS_S", 3600))
MOST_FILES = (
    3  # test files of a mutant, those that name the module most often: others take minutes and kill few
)
SEED = 1  # of the order, in which the files are mixed: a short time is a sample of all
OPPOSITE = {ast.Lt: ast.GtE, ast.Gt: ast.LtE, ast.Eq: ast.NotEq, ast.Is: ast.IsNot, ast.In: ast.NotIn}
OPPOSITE |= {ast.Add: ast.Sub, ast.And: ast.Or}
SWAP = OPPOSITE | {other: one for one, other in OPPOSITE.items()}


def operator(node: ast.AST) -> ast.AST | None:
    """The operator of an expression, the first of a comparison's; None without."""
    return node.ops[0] if isinstance(node, ast.Compare) else getattr(node, "op", None)


def sites(tree: ast.Module) -> list[ast.AST]:
    """Expressions whose operator can be swapped."""
    return [node for node in ast.walk(tree) if type(operator(node)) in SWAP]


def mutated(text: str, number: int) -> tuple[str, str]:
    """The module with one operator swapped, and that expression with its line."""
    tree = ast.parse(text)
    node = sites(tree)[number]
    other = SWAP[type(operator(node))]()
    if isinstance(node, ast.Compare):
        node.ops[0] = other
    else:
        node.op = other
    return ast.unparse(tree), f"{node.lineno}: {ast.unparse(node)}"


def tests_of(file: Path) -> list[str]:
    """Test files that import a module or, without one, a neighbour that imports it."""
    texts = {p.name: p.read_text() for p in sorted((ROOT / "tests").glob("test_*.py"))}
    near = [p.stem for p in file.parent.glob("*.py") if f"from .{file.stem} import" in p.read_text()]
    for stems in ([file.stem], near):
        lines = tuple(f"from radalt.core.{file.parent.name}.{stem} import" for stem in stems)
        found = [name for name, text in texts.items() if any(line in text for line in lines)]
        if found:
            return sorted(found, key=lambda name: -texts[name].count(file.stem))[:MOST_FILES]
    return []


def passes(tree: Path, tests: list[str], limit_s: float) -> bool:
    """Whether tests pass in the copy; what does not end has failed."""
    command = [sys.executable, *"-m pytest -qx -p no:cacheprovider".split(), *(f"tests/{t}" for t in tests)]
    try:
        done = subprocess.run(command, cwd=tree, capture_output=True, timeout=limit_s, check=False)
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def left_out(folder: str, names: list[str]) -> list[str]:
    """What no test reads: hidden files, and at the root what runs have made."""
    return [n for n in names if n.startswith(".") or (folder == str(ROOT) and n in ("build", "results"))]


def main() -> None:
    """Mutate until the time is over; prints every mutant, and how many of each file were killed."""
    files = [f for folder in ("receiver", "channel", "radio") for f in sorted((CORE / folder).glob("*.py"))]
    todo = [(f, k) for f in files if tests_of(f) for k in range(len(sites(ast.parse(f.read_text()))))]
    random.Random(SEED).shuffle(todo)
    tried, killed = Counter(), Counter()
    whole_s: dict[Path, float] = {}  # time of a file's tests without a mutation
    end = time.monotonic() + LIMIT_S
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(ROOT, tree, symlinks=True, ignore=left_out)
        for file, number in todo:
            tests, copy, begun = tests_of(file), tree / file.relative_to(ROOT), time.monotonic()
            if begun > end:
                break
            if file not in whole_s:
                if not passes(tree, tests, LIMIT_S):
                    sys.exit(f"mutants: {', '.join(tests)} fail without a mutation")
                whole_s[file] = time.monotonic() - begun
            text, where = mutated(file.read_text(), number)
            copy.write_text(text)
            survived = passes(tree, tests, 3 * whole_s[file])
            copy.write_text(file.read_text())
            print("SURVIVED" if survived else "killed  ", f"{file.name}:{where}"[:150], flush=True)
            tried.update((file.name, "all"))
            killed.update(() if survived else (file.name, "all"))
    print(f"\n{'file':28} mutants killed, of {len(todo)} mutants")
    for name, count in sorted(tried.items()):
        print(f"{name:28} {count:7} {killed[name]:6}")


if __name__ == "__main__":
    main()
