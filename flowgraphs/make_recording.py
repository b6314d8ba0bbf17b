#!/usr/bin/env python3
"""The command `radalt make-recording`, from the source tree: python/radalt/evaluation/commands/make_recording.py."""

import _startup  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path
from radalt.evaluation.commands.make_recording import main

if __name__ == "__main__":
    raise SystemExit(main())
