#!/usr/bin/env python3
"""Which small mistakes in the receiver, the channel and the radio do the tests find? `make mutants` prints a table.

Negates a comparison, swaps + and -, or swaps `and` and `or`, one at a time, in a copy of the tree, and runs the test
files that import the module. A survivor is a missing test, or a change on which no result depends. RADALT_MUTANTS_S is
the time it takes, s (default 3600); arguments are the modules to mutate, all without.
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
import time
from collections import Counter
from pathlib import Path

from _tool import FLOWGRAPHS

ROOT, CORE = FLOWGRAPHS.parent, FLOWGRAPHS.parent / "python/radalt/core"
LIMIT_S = float(os.environ.get("RADALT_MUTANTS_S", 3600))
MOST_FILES = (
    3  # test files of a mutant, those that name the module most often: others take minutes and kill few
)
SEED = 1  # of the order, in which the modules are mixed: a short time is a sample of all
OTHER = {ast.Lt: ast.GtE, ast.Gt: ast.LtE, ast.Eq: ast.NotEq, ast.Is: ast.IsNot, ast.In: ast.NotIn}
OTHER |= {ast.Add: ast.Sub, ast.And: ast.Or}
OTHER |= {b: a for a, b in OTHER.items()}


def sites(tree: ast.Module) -> list[ast.expr]:
    """Expressions that can be mutated: in a comparison the first operator."""
    return [
        n
        for n in ast.walk(tree)
        if type(n.ops[0] if isinstance(n, ast.Compare) else getattr(n, "op", 0)) in OTHER
    ]


def mutated(text: str, number: int) -> tuple[str, str]:
    """The module with one operator swapped, and that expression with its line."""
    tree = ast.parse(text)
    node = sites(tree)[number]
    if isinstance(node, ast.Compare):
        node.ops[0] = OTHER[type(node.ops[0])]()
    else:
        node.op = OTHER[type(node.op)]()
    return ast.unparse(tree), f"{node.lineno}: {ast.unparse(node)}"


def tests_of(file: Path) -> list[str]:
    """Test files that import a module or, without one, a neighbour that imports it."""
    texts = {f"tests/{p.name}": p.read_text() for p in sorted((ROOT / "tests").glob("test_*.py"))}
    near = [p.stem for p in file.parent.glob("*.py") if f"from .{file.stem} import" in p.read_text()]
    for stems in ([file.stem], near):
        lines = [f"from radalt.core.{file.parent.name}.{stem} import" for stem in stems]
        found = [name for name, text in texts.items() if any(line in text for line in lines)]
        if found:
            return sorted(found, key=lambda name: -texts[name].count(file.stem))[:MOST_FILES]
    return []


def passes(tree: Path, tests: list[str], limit_s: float) -> bool:
    """Whether tests pass in the copy; what does not end has failed."""
    command = [sys.executable, "-m", "pytest", "-qx", "-pno:cacheprovider", *tests]
    try:
        return not subprocess.run(command, cwd=tree, capture_output=True, timeout=limit_s).returncode
    except subprocess.TimeoutExpired:
        return False


def main() -> None:
    """Mutate until the time is over; prints every mutant, and how many of each module were killed."""
    files = [f for folder in ("receiver", "channel", "radio") for f in sorted((CORE / folder).glob("*.py"))]
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("modules", nargs="*", metavar="MODULE", help="all without")
    wanted = parser.parse_args().modules
    if unknown := set(wanted) - {f.stem for f in files}:
        parser.error(f"no module {min(unknown)}: one of {', '.join(f.stem for f in files)}")
    files = [f for f in files if tests_of(f) and (f.stem in wanted or not wanted)]
    todo = [(f, k) for f in files for k in range(len(sites(ast.parse(f.read_text()))))]
    random.Random(SEED).shuffle(todo)
    tried, killed, whole_s, end = Counter(), Counter(), {}, time.monotonic() + LIMIT_S
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(
            ROOT, tree, symlinks=True, ignore=shutil.ignore_patterns(".*", "build", "*.sigmf-data")
        )
        for file, number in todo:
            tests, copy, begun = tests_of(file), tree / file.relative_to(ROOT), time.monotonic()
            if begun > end:
                break
            if file not in whole_s:  # time of the module's tests without a mutation
                if not passes(tree, tests, LIMIT_S):
                    sys.exit(f"mutants: {', '.join(tests)} fail without a mutation, or take longer")
                whole_s[file] = time.monotonic() - begun
            text, where = mutated(file.read_text(), number)
            copy.write_text(text)
            survived = passes(tree, tests, 3 * whole_s[file])
            copy.write_text(file.read_text())
            print("SURVIVED" if survived else "killed  ", f"{file.name}:{where}"[:150], flush=True)
            tried.update((file.name, "all"))
            killed.update(() if survived else (file.name, "all"))
    for name, count in sorted(tried.items()):
        print(f"{name:28} {killed[name]:5} of {count:5} killed")


if __name__ == "__main__":
    main()
