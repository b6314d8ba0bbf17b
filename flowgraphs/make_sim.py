#!/usr/bin/env python3
"""Write ota_sim.grc: ota_b210.grc with its radios replaced by the simulated channel, and nothing else changed.

python flowgraphs/make_sim.py            # after every change of ota_b210.grc; a test fails until it is done
"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "python"))

from radalt.evaluation.flowgraph import load_grc, save_grc, simulate  # noqa: E402 - needs the path above


def main() -> None:
    """Rewrite the flowgraph beside this file."""
    target = HERE / "ota_sim.grc"
    save_grc(simulate(load_grc(HERE / "ota_b210.grc")), target)
    print(f"wrote {target.name}")


if __name__ == "__main__":
    main()
