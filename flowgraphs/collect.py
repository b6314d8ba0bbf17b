#!/usr/bin/env python3
"""The command `radalt collect`, from the source tree: python/radalt/evaluation/commands/collect.py."""

import _startup  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path
from radalt.evaluation.commands.collect import main

if __name__ == "__main__":
    raise SystemExit(main())
