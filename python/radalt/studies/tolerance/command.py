"""The interference power in dBm at which an altimeter stops being usable, and the margin to 14 CFR 91.220.

.venv/bin/python flowgraphs/tolerance_eval.py  # the default grid, into results/tolerance_eval
.venv/bin/python flowgraphs/tolerance_eval.py --interferers nr10 --altitudes-ft 200 --outputs 40 --seeds 1
.venv/bin/python flowgraphs/tolerance_eval.py --profile counter --altitudes-ft 200,1000 --method none --out results/old
"""

import argparse
from collections.abc import Sequence
from typing import Any

from ...evaluation.engine.options import Parser, number
from ...evaluation.engine.shell import StudyCommand
from ...evaluation.engine.study import Study

PROGRAM, COMMAND = "tolerance_eval", "tolerance"
INTERFERERS = "white_noise,tone,nr10,altimeter,equal_locked,equal_drifting,white_noise_others"


def _list(text: str) -> tuple[str, ...]:
    """Words with commas, each once."""
    words = [word.strip() for word in text.split(",") if word.strip()]
    if not words or len(set(words)) < len(words):
        raise argparse.ArgumentTypeError(f"it is {text[:40]!r}; name each once, with commas")
    return tuple(words)


def _feet(text: str) -> tuple[float, ...]:
    """Altitudes in feet with commas, each once."""
    feet = tuple(number(float, 10.0, 20_000.0)(word) for word in _list(text))
    _list(",".join(map(str, feet)))  # 200 and 200.0 are one
    return feet


def _arguments(parser: Parser) -> None:
    add = parser.add_argument
    add(
        "--profile",
        default="fmcw_150mhz",
        help="altimeter: a YAML file, or a name of flowgraphs/altimeters (default: %(default)s)",
    )
    add("--interferers", type=_list, default=_list(INTERFERERS), help=f"with commas (default: {INTERFERERS})")
    # not `--methods`: these work behind the IF filter, and the study says so of the others
    add("--method", type=_list, default=("none", "blanking"), help="with commas (default: none,blanking)")
    add(
        "--altitudes-ft",
        type=_feet,
        default=(50.0, 200.0, 1000.0, 5000.0),
        help="with commas (default: 50,200,1000,5000)",
    )
    add(
        "--outputs",
        type=number(int, 20, 100_000),
        default=150,
        help="outputs per trial; 98 %% at 95 %% confidence needs 149 without a fault (default: %(default)s)",
    )
    add("--seeds", type=number(int, 1, 100), default=3, help="realisations (default: %(default)s)")
    add(
        "--ground",
        choices=("point", "diffuse"),
        default="point",
        help="a point at the loop loss of diffuse ground, as a test set shows it, or diffuse ground (default: point)",
    )


def _study(args: argparse.Namespace, parser: Parser) -> Study:
    from .study import ToleranceStudy

    return ToleranceStudy(
        args.profile, args.interferers, args.method, args.altitudes_ft, args.outputs, args.seeds, args.ground
    )


def _describe(rows: Sequence[dict[str, Any]]) -> str:
    """A measured point in a line."""
    first = rows[0]
    found = ", ".join(
        f"{r['altitude_ft']:g} ft {'not broken' if r['first'] == 'none' else r['first']}"
        if r.get("break_dbm") is None else
        f"{r['altitude_ft']:g} ft {r['break_dbm']:+.1f} dBm ({r['first'].split()[0]})"
        for r in rows
    )  # fmt: skip
    return f"{first['interferer']}, {first['method']}, seed {first['seed']}: {found}"


SHELL = StudyCommand(PROGRAM, __name__, _arguments, _study, _describe, time_limit_s=1800.0)
main, _parser = SHELL.main, SHELL.parser
