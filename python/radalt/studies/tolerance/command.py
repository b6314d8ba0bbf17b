"""The interference power in dBm at which an altimeter stops being usable, and the margin to 14 CFR 91.220.

.venv/bin/python flowgraphs/tolerance_eval.py  # the default grid, into results/tolerance_eval
.venv/bin/python flowgraphs/tolerance_eval.py --interferers nr10 --altitudes-ft 200 --seeds 1
.venv/bin/python flowgraphs/tolerance_eval.py --profile poor --interferers nr100_3930 --decompose --out results/why
"""

import argparse
from collections.abc import Sequence
from typing import Any

from ...evaluation.engine.options import Parser, number
from ...evaluation.engine.shell import StudyCommand
from ...evaluation.engine.study import Study

PROGRAM, COMMAND = "tolerance_eval", "tolerance"
PROFILES = "careful,typical,poor"
INTERFERERS = "nr100_3750,nr100_3930,nr100_4050,nr100_4100,nr100_4140,nr10"


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
    parser.option(
        "--profile",
        f"altimeters with commas: YAML files, or names of flowgraphs/altimeters (default: {PROFILES})",
        _list,
        _list(PROFILES),
    )
    parser.option("--interferers", f"with commas (default: {INTERFERERS})", _list, _list(INTERFERERS))
    # not `--methods`: these work behind the IF filter, and the study says so of the others
    parser.option("--method", "with commas (default: none)", _list, ("none",))
    parser.option(
        "--altitudes-ft",
        "with commas; each altimeter up to its span (default: 200,500,1000,2500,5000,7000)",
        _feet,
        (200.0, 500.0, 1000.0, 2500.0, 5000.0, 7000.0),
    )
    parser.option(
        "--outputs",
        "outputs per trial; 98 %% at 95 %% confidence needs 149 without a fault",
        number(int, 20, 100_000),
        40,
    )
    parser.option("--seeds", "realisations", number(int, 1, 100), 1)
    words = "the first of them; the shipped altimeters were fitted on 1"
    parser.option("--seed", words, number(int, 1, 10_000), 2)
    parser.option(
        "--ground",
        "a point at the loop loss of diffuse ground, as a test set shows it, or diffuse ground (default: point)",
        default="point",
        choices=("point", "diffuse"),
    )
    parser.option(
        "--approach",
        "fly past base stations instead: a YAML file such as flowgraphs/approaches/glide_path.yaml",
        default="",
    )
    parser.flag(
        "--decompose",
        "interferers outside the band also with each mechanism alone or off, those in it without compression",
    )


def _study(args: argparse.Namespace, parser: Parser) -> Study:
    if args.approach:
        from .approach import ApproachStudy, load_approach

        if args.decompose or args.method != ("none",) or args.ground != "point":
            parser.error(
                "--approach flies without mitigation, over a point, with all mechanisms; leave the others out"
            )
        return ApproachStudy(args.profile, *load_approach(args.approach), args.outputs)
    from .study import ToleranceStudy

    return ToleranceStudy(
        args.profile, args.interferers, args.method, args.altitudes_ft, args.outputs, args.seeds, args.ground,
        args.decompose, args.seed,
    )  # fmt: skip


def _describe(rows: Sequence[dict[str, Any]]) -> str:
    """A measured point in a line."""
    if not rows:
        return "no altitude within the span"
    first = rows[0]
    if "along_m" in first:
        return f"{first['profile']}, {first['along_m']:g} m: {first['power_dbm']:.1f} dBm, failed: {first['failed']}"
    found = ", ".join(
        f"{r['altitude_ft']:g} ft {'not broken' if r['first'] == 'none' else r['first']}"
        if r.get("break_dbm") is None else
        f"{r['altitude_ft']:g} ft {r['break_dbm']:+.1f} dBm ({r['first'].split()[0]})"
        for r in rows
    )  # fmt: skip
    return (
        ", ".join(str(first[k]) for k in ("profile", "mechanisms", "interferer", "method", "seed"))
        + f": {found}"
    )


SHELL = StudyCommand(PROGRAM, __name__, _arguments, _study, _describe, time_limit_s=1800.0)
main, _parser = SHELL.main, SHELL.parser
