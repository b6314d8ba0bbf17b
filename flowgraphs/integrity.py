#!/usr/bin/env python3
"""The command `radalt integrity`, from the source tree: python/radalt/studies/integrity/command.py."""

import _startup  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path
from radalt.studies.integrity.command import main

if __name__ == "__main__":
    raise SystemExit(main())
