#!/usr/bin/env python3
"""The command `radalt first-light`, from the source tree: python/radalt/evaluation/commands/first_light.py."""

import _startup  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path
from radalt.evaluation.commands.first_light import main

if __name__ == "__main__":
    raise SystemExit(main())
