"""Runs a generated flowgraph from the companion's Run button, with errors of one line.

    python -m radalt.evaluation.flowgraph.companion ota_sim.py [arguments of the flowgraph]

The flowgraphs use it in their option *Run Command*. Without it, a generated program prints a traceback for a wrong
scene or a missing radio, and ends with 0 when a block has failed.
"""

import runpy
import sys
from collections.abc import Sequence
from pathlib import Path

from ...blocks._guard import raised


def main(argv: Sequence[str] | None = None) -> int:
    """Run FILE as ``python FILE`` does; 2 after one line about wrong input, 1 after one about a failed block."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments:
        print(
            "usage: python -m radalt.evaluation.flowgraph.companion FLOWGRAPH.py [arguments]", file=sys.stderr
        )
        return 2
    name = Path(arguments[0]).stem
    sys.argv = arguments
    try:
        runpy.run_path(arguments[0], run_name="__main__")
    # errors of this package and of UHD; others keep their traceback
    except (ValueError, RuntimeError, OSError) as error:
        print(f"{name}: {' '.join(str(error).split())}", file=sys.stderr)  # UHD's have several lines
        return 2
    for error in raised:
        print(f"{name}: {error}", file=sys.stderr)
    return 1 if raised else 0


if __name__ == "__main__":
    sys.exit(main())
