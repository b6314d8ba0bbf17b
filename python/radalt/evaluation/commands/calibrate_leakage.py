"""Leakage calibration: measure the transmitter leakage of a scene's installation without a return, and store it.

    .venv/bin/python flowgraphs/calibrate_leakage.py --scene leakage --out results/leakage.yaml

A scene uses the file by the key segmenter.leakage_calibration: results/leakage.yaml (docs/leakage.md).
Needs no GNU Radio.
"""

from collections.abc import Sequence

from ..engine.options import Parser, command, number, path

PROGRAM, COMMAND = "calibrate_leakage", "calibrate-leakage"


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    parser.option("--scene", "YAML file, or a shipped scene", default="leakage")
    parser.option("--frames", "averaged", number(int, 20, 100_000), 400)
    parser.option("--out", "file of the calibration", path, required=True)
    return parser


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Measure and store; returns 0, or 2 after one line about what does not fit."""
    args = _parser().parse_args(argv)

    from ...core.scene import load_scene
    from ...core.timing.leakage_file import store_leakage
    from ..radios.leakage_calibration import calibrate_leakage

    found = calibrate_leakage(load_scene(args.scene), args.frames)
    print(f"{store_leakage(found, args.out)}: installation delay {found.installation_delay_m:.2f} m")
    return 0
