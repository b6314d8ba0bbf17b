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
    parser.add_argument(
        "--scene", default="leakage", help="YAML file, or a shipped scene (default: %(default)s)"
    )
    parser.add_argument(
        "--frames", type=number(int, 20, 100_000), default=400, help="averaged (default: %(default)s)"
    )
    parser.add_argument("--out", type=path, required=True, help="file of the calibration")
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
