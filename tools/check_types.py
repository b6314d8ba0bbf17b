#!/usr/bin/env python3
"""mypy over the package: no finding in what `import radalt` imports, and the number of findings elsewhere by folder.

.venv/bin/python tools/check_types.py          # make types
.venv/bin/python tools/check_types.py --list   # every finding

Modules that must have none are those of the overrides in pyproject.toml, checked strictly. Exits with 1 if one has.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FINDING = re.compile(r"^(python/(\S+)\.py):\d+: error: .*$", re.MULTILINE)


def strict() -> re.Pattern[str]:
    """Pattern of the modules that must have no finding."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    names = re.findall(
        r'^    "(radalt[\w.*]*)",?$', text[text.index("[[tool.mypy.overrides]]") :], re.MULTILINE
    )
    return re.compile("|".join(re.escape(name).replace(r"\.\*", r"(\..*)?") for name in names))


def main() -> int:
    """Run mypy and sort its findings."""
    summary, _, details = (__doc__ or "").partition("\n\n")
    parser = argparse.ArgumentParser(
        description=summary, epilog=details, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--list", action="store_true", help="print every finding")
    args = parser.parse_args()
    checked = ("python/radalt/core", "python/radalt/api.py", "python/radalt/__init__.py")
    command = [sys.executable, "-m", "mypy", *checked]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1):
        print(done.stdout + done.stderr, file=sys.stderr)
        return 2
    clean, wrong, left = strict(), [], Counter()
    for found in FINDING.finditer(done.stdout):
        module = found[2].replace("/", ".").removesuffix(".__init__")
        left["/".join(found[2].split("/")[:3])] += 1
        if clean.fullmatch(module):
            wrong.append(found[0])
    print("\n".join([found[0] for found in FINDING.finditer(done.stdout)] if args.list else wrong))
    print(f"{sum(left.values())} findings, {len(wrong)} of them in modules that must have none")
    for folder, count in sorted(left.items()):
        print(f"  {count:4} {folder}")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
