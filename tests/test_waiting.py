"""No test waits without an end: the helpers keep their limits, and every call that can hang states one."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import end_of, wait_for, written

PROGRAM = "import sys; print('a last word', file=sys.stderr, flush=True); {}"


def start(rest):
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(rest)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_what_does_not_come_is_named_at_the_limit_and_leaves_no_process():
    process = start("import time; time.sleep(600)")
    with pytest.raises(AssertionError, match="the first row: not within 0.5 s"):
        wait_for(lambda: False, "the first row", process=process, limit_s=0.5)
    assert process.poll() is not None


def test_a_process_that_ends_without_it_is_told_at_once_with_its_last_words(tmp_path):
    with pytest.raises(AssertionError, match="rows.csv: its process has ended\na last word"):
        wait_for(written(tmp_path / "rows.csv"), "rows.csv", process=start("sys.exit(3)"))


def test_a_process_that_does_not_end_is_killed_and_named():
    process = start("import time; time.sleep(600)")
    with pytest.raises(AssertionError, match="has not ended within 2 s\na last word"):
        end_of(process, limit_s=2.0)
    assert process.poll() is not None


def unlimited(tree: ast.AST) -> list[str]:
    """Calls of a module that wait for a process or a thread, and say nowhere for how long."""
    found = []
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        name = ast.unparse(call.func)
        alone = not call.args and not call.keywords
        waits = name in ("subprocess.run", "subprocess.check_output") or name.endswith(".communicate")
        if (waits and "timeout" not in {k.arg for k in call.keywords}) or (
            alone and name.endswith((".wait", ".join"))
        ):
            found.append(f"line {call.lineno}: {ast.unparse(call)[:80]}")
    return found


def test_every_wait_of_the_tests_has_a_limit():
    """Else the watchdog ends all tests of the process, and no one learns which wait it was."""
    files = sorted(Path(__file__).parent.glob("*.py"))
    found = {file.name: unlimited(ast.parse(file.read_text(encoding="utf-8"))) for file in files}
    assert {name: calls for name, calls in found.items() if calls} == {}
