#!/usr/bin/env python3
"""The command `radalt error-vs-runtime`, from the source tree: python/radalt/studies/runtime/command.py."""

import _startup  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path
from radalt.studies.runtime.command import main

if __name__ == "__main__":
    raise SystemExit(main())
