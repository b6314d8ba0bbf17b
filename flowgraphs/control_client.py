#!/usr/bin/env python3
"""The command `radalt control`, from the source tree: python/radalt/evaluation/commands/control.py."""

import _startup  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path
from radalt.evaluation.commands.control import main

if __name__ == "__main__":
    raise SystemExit(main())
