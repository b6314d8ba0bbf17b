"""No test waits without an end: the helpers keep their limits, and every call that can hang states one."""

import ast
from pathlib import Path


def unlimited(tree: ast.AST) -> list[str]:
    """Calls of a module that wait for a process or a thread, and say nowhere for how long."""
    found = []
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        name = ast.unparse(call.func)
        alone = not call.args and not call.keywords
        waits = name in ("subprocess.run", "subprocess.check_output") or name.endswith(".communicate")
        limited = "timeout" in {k.arg for k in call.keywords}
        if (waits and not limited) or (alone and name.endswith((".wait", ".join"))):
            found.append(f"line {call.lineno}: {ast.unparse(call)[:80]}")
    return found


def test_every_wait_of_the_tests_has_a_limit():
    """Else the watchdog ends all tests of the process, and no one learns which wait it was."""
    files = sorted(Path(__file__).parent.glob("*.py"))
    found = {file.name: unlimited(ast.parse(file.read_text(encoding="utf-8"))) for file in files}
    assert {name: calls for name, calls in found.items() if calls} == {}
