#!/usr/bin/env python3
"""Which small mistakes do the tests find, and on which constants does a result depend? `make mutants` prints a table.

    .venv/bin/python tools/mutants.py altimeter:120 gate
    .venv/bin/python tools/mutants.py --constants summed_block qpsk/settings

Negates a comparison, swaps + and -, or swaps `and` and `or` within a function, one at a time, and runs the tests that
call the function, the cheapest first. A survivor is a missing test, a dear one that was left out, or a change on which
no result depends. RADALT_MUTANTS_S is the time it takes, s (default 3600), RADALT_MUTANTS_SEED the seed of the order.

With --constants each number at the top of a module, or in settings there, is set to twice, half, 100 times its value
and 0, until one of these tests fails, in a fork; programs that a test starts are not mutated. What none notices goes.
"""

from __future__ import annotations

import argparse
import ast
import atexit
import dataclasses
import functools
import gc
import json
import os
import random
import re
import resource
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path
from types import CodeType, FunctionType, ModuleType

import pytest
from _tool import FLOWGRAPHS

from radalt.evaluation.results.proportion import wilson_interval

ROOT, CORE = FLOWGRAPHS.parent, FLOWGRAPHS.parent / "python/radalt/core"
LIMIT_S = float(os.environ.get("RADALT_MUTANTS_S", 3600))
TESTS_S = float(os.environ.get("RADALT_MUTANTS_TESTS_S", 10))  # CPU time of a mutant's tests, unmutated, s
CPU_S = 5 * TESTS_S  # CPU time after which a mutant's tests have no end, at any load of the machine, s
NAMES = "altimeter", "cfar", "channel", "summed_detector", "timing", "tracker_parts"
TESTS = [f"tests/test_{name}.py" for name in NAMES]
FACTORS = (2.0, 0.5, 100.0, 0.0)  # of constants
SEED = int(os.environ.get("RADALT_MUTANTS_SEED", 1))  # of the order: a short time is a sample of all modules
OTHER = {ast.Lt: ast.GtE, ast.Gt: ast.LtE, ast.Eq: ast.NotEq, ast.Is: ast.IsNot, ast.In: ast.NotIn}
OTHER |= {ast.Add: ast.Sub, ast.And: ast.Or}
OTHER |= {b: a for a, b in OTHER.items()}


def sites(tree: ast.Module) -> list[tuple[ast.expr, int]]:
    """Expressions that can be mutated, with the lines of their functions: in a comparison the first operator."""
    found = {}
    for f in ast.walk(tree):  # from outside inwards
        if isinstance(f, ast.FunctionDef):
            found |= {n: f.lineno for line in f.body for n in ast.walk(line)}
    return [
        (n, line)
        for n, line in found.items()
        if type(n.ops[0] if isinstance(n, ast.Compare) else getattr(n, "op", 0)) in OTHER
    ]


def mutate(node: ast.expr) -> None:
    """Swap the operator of an expression."""
    if isinstance(node, ast.Compare):
        node.ops[0] = OTHER[type(node.ops[0])]()
    else:
        node.op = OTHER[type(node.op)]()


def put(tree: ast.Module, file: Path, **names: object) -> None:
    """Give the functions of an imported module the code of another tree, and the module more names."""
    codes, todo = {}, [compile(tree, str(file), "exec")]
    while todo:
        code = todo.pop()
        codes[code.co_name, code.co_firstlineno] = code
        todo += [inner for inner in code.co_consts if isinstance(inner, CodeType)]
    for function in gc.get_objects():
        if isinstance(function, FunctionType) and function.__code__.co_filename == str(file):
            function.__code__ = codes[function.__code__.co_name, function.__code__.co_firstlineno]
            function.__globals__.update(names)


def forked(before: Callable[[], None], *arguments: str, plugin: object = None) -> tuple[int, str]:
    """Status and output of pytest in a fork of this process, after a call."""
    with tempfile.TemporaryFile("w+") as out:
        if not (pid := os.fork()):
            for number in (1, 2):
                os.dup2(out.fileno(), number)
            atexit.register(os._exit, 2)  # GNU Radio's own end waits for threads that a fork lacks
            before()
            os._exit(pytest.main(["-q", "-pno:cacheprovider", *arguments], plugins=[plugin]))
        status = os.waitpid(pid, 0)[1]
        out.seek(0)
        return status, out.read()


class Calls:
    """Pytest plugin that writes CPU time and called functions of each test that passes into a file."""

    def __init__(self, file: Path) -> None:
        self.file, self.ran, self.calls, self.bad = file, set(), {}, set()

    def watch(self, files: Iterable[Path]) -> None:
        """Let the functions of imported modules say that they run: threads of GNU Radio see no profiler."""
        for file in files:
            tree = ast.parse(file.read_text())
            for f in ast.walk(tree):
                if isinstance(f, ast.FunctionDef):
                    f.body.insert(0, ast.parse(f"_ran.add(({file.stem!r}, {f.lineno}))").body[0])
            put(ast.fix_missing_locations(tree), file, _ran=self.ran)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> object:
        """Note what ran until the test's end, its fixtures included."""
        self.ran.clear()
        begun = time.process_time()
        result = yield
        self.calls[item.nodeid] = time.process_time() - begun, sorted(self.ran)
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Forget a test that fails."""
        self.bad |= {report.nodeid} if report.failed else set()

    def pytest_sessionfinish(self) -> None:
        """Write what passed."""
        self.file.write_text(json.dumps({t: c for t, c in self.calls.items() if t not in self.bad}))


def calls_of(files: Iterable[Path], tests: Iterable[str]) -> dict[tuple[str, int], list[str]]:
    """Tests by the functions, as module and line, that they call, the cheapest first, `TESTS_S` together."""
    with tempfile.TemporaryDirectory() as folder:
        calls = Calls(Path(folder) / "calls.json")
        forked(lambda: calls.watch(files), *tests, plugin=calls)
        known = json.loads(calls.file.read_text())
    out, spent = defaultdict(list), Counter()
    for test, (cpu_s, functions) in sorted(known.items(), key=lambda entry: entry[1][0]):
        for function in map(tuple, functions):
            spent[function] += cpu_s
            if spent[function] < TESTS_S:
                out[function].append(test)
    return out


def killer(tests: list[str], change: Callable[[], None]) -> str | None:
    """The first of these tests that fails after a change, empty if none does; None if they have no end."""

    def mutant() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (int(CPU_S), int(CPU_S)))
        change()

    status, said = forked(mutant, "-x", *tests)
    found = re.findall(r"^(?:FAILED|ERROR) (tests/.*?)(?: - .*)?$", said, re.MULTILINE)
    return found[0] if found else None if status else ""


@functools.cache
def sound(test: str) -> bool:
    """Whether a test passes without a mutation, a second time: the machine may be slower now."""
    return not forked(lambda: None, test)[0]


def noticed(tests: list[str], change: Callable[[], None]) -> str | None:
    """`killer`, but of tests that fail for no other reason."""
    found = killer(tests, change) if tests else ""
    return None if found and not sound(found) else found


def constants(file: Path, files: list[Path], calls: dict[tuple[str, int], list[str]]) -> None:
    """Print what notices a change of each number at the top of a module, and of settings there."""
    trees, module = {f: ast.parse(f.read_text()) for f in files}, module_of(file)
    targets = [t for n in trees[file].body if isinstance(n, ast.Assign) for t in ast.walk(n.targets[0])]
    own = {t.id: getattr(module, t.id) for t in targets if isinstance(t, ast.Name)}
    held = [(s, *field) for s in own.values() if dataclasses.is_dataclass(s) for field in vars(s).items()]
    for holder, name, value in [*held, *((module, *number) for number in own.items())]:
        if type(value).__name__ not in ("int", "float", "float32"):
            continue
        alike = [m for m in map(module_of, files) if getattr(m, name, None) is value]
        holders = alike if holder is module else [holder]
        using = [
            (f.stem, n.lineno)
            for f in files
            if holder is not module or module_of(f) in holders
            for n in ast.walk(trees[f])
            if isinstance(n, ast.FunctionDef)
            and name in {getattr(x, key, "") for x in ast.walk(n) for key in ("id", "attr")}
        ]
        tests = list(dict.fromkeys(test for function in using for test in calls[function]))

        def change(factor: float, name: str = name, value: float = value, holders: list = holders) -> None:
            for each in holders:
                vars(each)[name] = type(value)(value * factor)

        found = ((factor, noticed(tests, functools.partial(change, factor))) for factor in FACTORS)
        factor, test = next(((k, t) for k, t in found if t != ""), (None, ""))
        said = "SURVIVED" if factor is None else f"x {factor:g}: {(test or 'no end').rpartition('::')[2]}"
        print(f"{file.stem}.{name} = {value:g} ({len(tests)} tests): {said}", flush=True)


def module_of(file: Path) -> ModuleType | None:
    """The imported module of a file of the package."""
    return sys.modules.get(".".join(file.relative_to(ROOT / "python").with_suffix("").parts))


def main() -> None:
    """Mutate until the time is over; prints every mutant, and how many of each module were killed."""
    rooms = ("altimeter", "timing", "tracker", "channel", "radio", "mitigation")
    files = [f for room in rooms for f in sorted((CORE / room).rglob("*.py"))]
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("modules", nargs="*", metavar="MODULE[:LINE]", help="all without")
    parser.add_argument("--tests", nargs="+", metavar="FILE", default=TESTS, help="default: %(default)s")
    parser.add_argument("--constants", action="store_true", help="change the constants of whole modules")
    args = parser.parse_args()
    wanted = set(args.modules)
    named = {f: {f.stem, f"{f.parent.name}/{f.stem}"} for f in files}  # two modules are settings
    if unknown := {name.partition(":")[0] for name in wanted} - set().union(*named.values()):
        parser.error(f"no module {min(unknown)}: one of {', '.join(f.stem for f in files)}")
    todo = [
        (f, number)
        for f in files
        for number, (node, _) in enumerate(sites(ast.parse(f.read_text())))
        if not wanted or (named[f] | {f"{name}:{node.lineno}" for name in named[f]}) & wanted
    ]
    random.Random(SEED).shuffle(todo)
    end = time.monotonic() + LIMIT_S
    os.chdir(ROOT)
    pytest.main(["-qq", "--collect-only", *args.tests])
    if args.constants:
        files = [f for f in files if module_of(f)]
        calls = calls_of(files, args.tests)
        for file in (f for f in files if named[f] & wanted):
            constants(file, files, calls)
        return
    calls = calls_of({f for f, _ in todo}, args.tests)
    killed, survived = Counter(), Counter()
    for file, number in todo:
        if time.monotonic() > end:
            break
        tree = ast.parse(file.read_text())
        node, function = sites(tree)[number]
        where = f"{file.name}:{node.lineno}: {ast.unparse(node)}"
        mutate(node)
        mine = calls[file.stem, function]
        found = noticed(mine, functools.partial(put, tree, file))
        said = "no end  " if found is None else "killed  " if found else "SURVIVED"
        print(said, where[:120], found or f"{len(mine)} tests", flush=True)
        killed[file.name] += bool(found)
        survived[file.name] += found == ""
    for name in sorted(killed):
        print(f"{name:28} {killed[name]:5} of {killed[name] + survived[name]:5} killed")
    count = killed.total() + survived.total()
    low, high = wilson_interval(killed.total(), count)
    print(f"{killed.total()} of {count} killed, 95 % interval {100 * low:.0f} to {100 * high:.0f} %")


if __name__ == "__main__":
    main()
