#!/usr/bin/env python3
"""The command `radalt eval`, from the source tree: python/radalt/evaluation/commands/eval.py."""

import _startup  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path
from radalt.evaluation.commands.eval import main

if __name__ == "__main__":
    raise SystemExit(main())
