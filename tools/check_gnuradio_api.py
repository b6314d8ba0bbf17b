#!/usr/bin/env python3
"""Check that a release of GNU Radio has everything that the module uses. Reads a git clone; needs no GNU Radio.

    git clone https://github.com/gnuradio/gnuradio
    tools/check_gnuradio_api.py gnuradio v3.10.1.0

Looked up are names of gnuradio's modules and of pmt, the gateway's methods of blocks, methods of radios, and the blocks
of the flowgraphs with their parameters. Exits with 1 after naming what is missing.
"""

from __future__ import annotations

import argparse
import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
RADIO = re.compile(
    r"(set|get)_(time|clock|samp|center|gain|antenna|start|mboard|usrp|sensor|command)\w*|issue_\w+"
)
OURS = ("radalt_", "variable", "import", "note", "parameter", "snippet", "epy_block", "options")


def module_names(tree: ast.AST) -> Iterator[tuple[str, str]]:
    """(module, name) of everything that a file imports from gnuradio and pmt."""
    modules = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == "gnuradio":
            modules |= {alias.asname or alias.name: alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("gnuradio."):
            package = node.module.split(".")[1]
            yield from ((package, alias.name) for alias in node.names if package != "radalt")
        elif isinstance(node, ast.Import) and any(alias.name == "pmt" for alias in node.names):
            modules["pmt"] = "pmt"
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            module = modules.get(node.value.id, "radalt")
            if module != "radalt":
                yield module, node.attr


def methods(tree: ast.AST, defined: set[str]) -> Iterator[tuple[str, str]]:
    """("gr", name) of methods called on self that the package does not define, ("uhd", name) of those of radios."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            name = node.func.attr
            on_self = isinstance(node.func.value, ast.Name) and node.func.value.id == "self"
            if name in defined:
                continue
            if RADIO.fullmatch(name):
                yield "uhd", name
            elif on_self:
                yield "gr", name


def used() -> set[tuple[str, str]]:
    """(module, name) of everything that the package, its programs and its flowgraphs use of GNU Radio."""
    files = [*(ROOT / "python/radalt").rglob("*.py"), *(ROOT / "flowgraphs").glob("*.py")]
    trees = {file: ast.parse(file.read_text()) for file in files}
    nodes = [node for tree in trees.values() for node in ast.walk(tree)]
    defined = {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    # attributes that are called, such as a callable given to the constructor
    defined |= {
        node.attr for node in nodes if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
    }
    wanted = set()
    for tree in trees.values():
        taken = set(module_names(tree))
        wanted |= taken
        block = any(module == "gr" and name.endswith("_block") for module, name in taken)
        wanted |= {found for found in methods(tree, defined) if found[0] == "uhd" or block}
    for file in (ROOT / "flowgraphs").glob("*.grc"):
        # `- name: ...`, `  id: ...`, `  parameters:` and its keys, as GNU Radio Companion writes them
        for block, parameters in re.findall(
            r"^  id: (\w+)\n  parameters:\n((?:    .*\n|\n)+)", file.read_text(), re.M
        ):
            if not block.startswith(OURS) or block.startswith("variable_qtgui"):
                wanted.add(("block", block))
                keys = set(re.findall(r"^    (\w+):", parameters, re.M)) - COMMON
                wanted |= {("block", f"{block}:{key}") for key in keys if not block.startswith("uhd_")}
    return wanted


# parameters that GNU Radio Companion adds to every block
COMMON = {"affinity", "alias", "comment", "maxoutbuf", "minoutbuf", "value", "gui_hint"}


def main() -> int:
    """Look everything up; returns 0 if all is there."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("clone", help="git clone of gnuradio/gnuradio")
    parser.add_argument("release", help="tag, such as v3.10.1.0")
    args = parser.parse_args()
    clone, release = args.clone, args.release

    def git(*arguments: str) -> str:
        done = subprocess.run(["git", "-C", clone, *arguments], capture_output=True, text=True, check=False)
        return done.stdout

    if not git("rev-parse", "--verify", f"{release}^{{commit}}"):
        print(f"check_gnuradio_api: no release {release} in {clone}", file=sys.stderr)
        return 2
    # names: all words of the Python side and its bindings; runtime modules and pmt live in gnuradio-runtime
    words: dict[str, set[str]] = {}

    def vocabulary(module: str) -> set[str]:
        folders = ["gnuradio-runtime/python"] if module in ("gr", "pmt") else [f"gr-{module}/python"]
        folders = ["grc"] if module == "grc" else folders
        if module not in words:
            words[module] = set(
                git("grep", "-hoE", r"[A-Za-z_][A-Za-z_0-9]*", release, "--", *folders).split()
            )
        return words[module]

    descriptions: dict[str, str] = {}

    def description(block: str) -> str:
        if block not in descriptions:
            path = git("grep", "-lE", f"^id: {block}$", release, "--", "*.block.yml").strip()
            descriptions[block] = git("show", path) if path else ""
        return descriptions[block]

    def there(module: str, name: str) -> bool:
        if module != "block":
            return name in vocabulary(module)
        block, _, parameter = name.partition(":")
        if block.startswith("uhd_usrp_"):  # written by a script, which the build runs
            return bool(git("grep", "-l", "^id: uhd_usrp_", release, "--", "gr-uhd/grc"))
        return re.search(rf"id: ['\"]?{parameter or block}['\"]?$", description(block), re.M) is not None

    wanted = sorted(used())
    missing = [f"{module}: {name}" for module, name in wanted if not there(module, name)]
    # GNU Radio Companion ignores parameters that a description does not have: shown, but no failure
    ignored = [line for line in missing if line.count(":") == 2]
    for line in missing:
        what = "ignored by" if line in ignored else "not in"
        print(f"{what} GNU Radio {release}: {line}")
    print(
        f"GNU Radio {release}: {len(wanted)} looked up, {len(missing) - len(ignored)} missing, {len(ignored)} ignored"
    )
    return 1 if len(missing) > len(ignored) else 0


if __name__ == "__main__":
    sys.exit(main())
