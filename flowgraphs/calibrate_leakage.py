#!/usr/bin/env python3
"""The command `radalt calibrate-leakage`: python/radalt/evaluation/commands/calibrate_leakage.py."""

import _startup  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path
from radalt.evaluation.commands.calibrate_leakage import main

if __name__ == "__main__":
    raise SystemExit(main())
