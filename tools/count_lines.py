#!/usr/bin/env python3
"""Lines of Python in the package, in the tests and in training with tools; `make count`. Exits with 1 above a ceiling.

A ceiling is the count when it was last lowered: it only falls, to the target.
"""

import argparse
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CEILINGS = {"python": 43750, "tests": 22500, "training tools": 5800}
TARGETS = {"python": 38000, "tests": 18500, "training tools": 6500}


def counts() -> dict[str, int]:
    """Lines by folders, blank lines and comments included."""
    files = {folders: [p for f in folders.split() for p in (ROOT / f).rglob("*.py")] for folders in CEILINGS}
    return {folders: sum(len(p.read_bytes().splitlines()) for p in found) for folders, found in files.items()}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--lower", action="store_true", help="set the ceilings to the counts that are below them"
    )
    lower, found = parser.parse_args().lower, counts()
    for folders, count in found.items():
        print(f"{count:6} lines in {folders}: at most {CEILINGS[folders]}, target {TARGETS[folders]}")
    if lower:
        fallen = str({f: min(CEILINGS[f], count) for f, count in found.items()}).replace("'", '"')
        text = Path(__file__).read_text(encoding="utf-8")
        Path(__file__).write_text(
            re.sub(r"(?m)^CEILINGS = .*$", f"CEILINGS = {fallen}", text), encoding="utf-8"
        )
    raise SystemExit(any(count > CEILINGS[folders] for folders, count in found.items()))
