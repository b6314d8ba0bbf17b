#!/usr/bin/env python3
"""Which small mistakes in the receiver, the channel and the radio do the tests find? `make mutants` prints a table.

Negates a comparison, swaps + and -, or swaps `and` and `or`, one at a time, in a copy of the tree, and runs the test
files that import the module. A survivor is a missing test, or a change on which no result depends. A test that fails
without a mutation, too, kills nothing; nor does a run without an end, which may be a slow machine: both are left out.
RADALT_MUTANTS_S is the time it takes, s (default 3600); arguments are modules, or lines of them, as altimeter:120.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from _tool import FLOWGRAPHS

from radalt.evaluation.results.proportion import wilson_interval

ROOT, CORE = FLOWGRAPHS.parent, FLOWGRAPHS.parent / "python/radalt/core"
LIMIT_S = float(os.environ.get("RADALT_MUTANTS_S", 3600))
MOST_FILES = (
    3  # test files of a mutant, those that name the module most often: others take minutes and kill few
)
CPU_S = 300  # of a process of the tests: some three times what the longest three files take, at any load of the machine
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


def failed(tree: Path, tests: list[str], *options: str) -> list[str] | None:
    """Tests that fail in the copy, or files of theirs; None if they do not end."""
    command = [sys.executable, "-m", "pytest", "-q", "-pno:cacheprovider", *options, *tests]
    done = subprocess.run(
        command,
        cwd=tree,
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S)),
    )
    found = re.findall(r"^(?:FAILED|ERROR) (tests/\w+\.py(?:::\w+)*)", done.stdout, re.MULTILINE)
    return found if found or not done.returncode else None


def main() -> None:
    """Mutate until the time is over; prints every mutant, and how many of each module were killed."""
    files = [f for folder in ("receiver", "channel", "radio") for f in sorted((CORE / folder).glob("*.py"))]
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("modules", nargs="*", metavar="MODULE", help="all without")
    wanted = parser.parse_args().modules
    if unknown := {name.partition(":")[0] for name in wanted} - {f.stem for f in files}:
        parser.error(f"no module {min(unknown)}: one of {', '.join(f.stem for f in files)}")
    todo = [
        (f, k)
        for f in files
        for k, node in enumerate(sites(ast.parse(f.read_text())))
        if tests_of(f) and (not wanted or {f.stem, f"{f.stem}:{node.lineno}"} & set(wanted))
    ]
    random.Random(SEED).shuffle(todo)
    survived, killers, end = Counter(), [], time.monotonic() + LIMIT_S
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(
            ROOT, tree, symlinks=True, ignore=shutil.ignore_patterns(".*", "build", "*.sigmf-data")
        )
        for file, number in todo:
            if time.monotonic() > end:
                break
            copy = tree / file.relative_to(ROOT)
            text, where = mutated(file.read_text(), number)
            copy.write_text(text)
            killer = failed(tree, tests_of(file), "-x")
            copy.write_text(file.read_text())
            said = "no end  " if killer is None else "killed  " if killer else "SURVIVED"
            print(said, f"{file.name}:{where}"[:150], *(killer or ())[:1], flush=True)
            survived.update([file.name] if killer == [] else ())
            killers += [(file.name, killer[0])] if killer else []
        # a file without a test's name could not be imported
        sound = sorted({test for _, test in killers if "::" in test})
        unsound = set(failed(tree, sound) or ()) if sound else set()
    killed = Counter(name for name, test in killers if test not in unsound)
    for name in sorted(killed | survived):
        print(f"{name:28} {killed[name]:5} of {killed[name] + survived[name]:5} killed")
    count = killed.total() + survived.total()
    low, high = wilson_interval(killed.total(), count)
    print(f"{killed.total()} of {count} killed, 95 % interval {100 * low:.0f} to {100 * high:.0f} %")
    print(f"fail without a mutation: {', '.join(unsound) or 'none'}")


if __name__ == "__main__":
    main()
