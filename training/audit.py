"""Parameter table of an exported model, read from the ONNX file itself.

    .venv-train/bin/python training/audit.py models/paper.onnx

Weights are the initialisers that `export.py` names in ``radalt_weights``; constants of the graph (sweep tables, DFT
matrices) are listed separately. Narrow storage (``.float16``, ``.int8``) counts by elements; scales are no parameters.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from pathlib import Path

import onnx

__all__ = ["parameter_table"]

_GROUPS = {"compress": "dense, encoder side", "expand": "dense, decoder side"}


def parameter_table(path: Path) -> tuple[dict[str, int], int]:
    """Trainable parameters by top-level part of the network, and elements of all other constants."""
    model = onnx.load(str(path))
    properties = {entry.key: entry.value for entry in model.metadata_props}
    names = set(properties["radalt_weights"].split(","))
    parts: Counter[str] = Counter()
    constants = 0
    for tensor in model.graph.initializer:
        name = tensor.name.removesuffix(".float16").removesuffix(".int8")
        if name in names:
            parts[name.split(".")[0]] += math.prod(tensor.dims)
        elif not tensor.name.endswith(".scale"):
            constants += math.prod(tensor.dims)
    return dict(parts), constants


def main() -> None:
    """Print the tables of the given files."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("models", type=Path, nargs="+")
    for path in parser.parse_args().models:
        parts, constants = parameter_table(path)
        print(path)
        for part, count in parts.items():
            print(f"  {_GROUPS.get(part, part):24}{count:>12,}")
        print(f"  {'trainable parameters':24}{sum(parts.values()):>12,}")
        print(f"  {'constants of the graph':24}{constants:>12,}")


if __name__ == "__main__":
    main()
