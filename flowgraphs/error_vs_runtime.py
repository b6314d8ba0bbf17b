#!/usr/bin/env python3
"""A command until 0.3.0: says by which list it is replaced."""

import _startup  # isort: skip  # noqa: F401 - first: the package on the path
from radalt.evaluation.programs import moved

if __name__ == "__main__":
    raise SystemExit(moved("error-vs-runtime"))
