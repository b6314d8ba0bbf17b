"""Two files of weights on the same frames: right, wrong and valid, and the error without interference.

    PYTHONPATH=python .venv/bin/python training/compare_weights.py models/tcae.onnx mine.onnx
    PYTHONPATH=python .venv/bin/python training/compare_weights.py models/any_sweep.onnx mine.onnx --sweeps 1M,3M,10M

Typical transmitters, SNR 10 dB, SIR -15 to -60 dB in all cases of `evaluate_sweeps.py`, networks as they are: without
shift check. Without interference the altitudes are 300, 900 and 1,500 m. Runs in the runtime environment.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from evaluate import SNR_DB, Scenes
from evaluate_sweeps import OVERLAPS, SWEEPS, correct_limit_m, emitters

from radalt.core.mitigation import MitigationError
from radalt.core.returns.point import point_return
from radalt.evaluation.engine import options
from radalt.evaluation.results.chain import Chain
from radalt.evaluation.results.rows import Columns
from radalt.evaluation.results.score import score_frames

SIRS_DB = (-15.0, -22.5, -30.0, -37.5, -45.0, -52.5, -60.0)
ALTITUDES_M = (300.0, 900.0, 1500.0)
CLEAN_FRAMES = 200  # per altitude
COLUMNS = Columns(
    ("sweep", "interferer", "overlap", "sir_db", "altitude_m", "weights")
    + ("trials", "correct", "wrong", "rmse_forced_m"),
    text=frozenset({"sweep", "interferer", "weights"}),
    whole=frozenset({"trials", "correct", "wrong"}),
)
Row = dict[str, Any]


def _row(chain: Chain, sweep: str, frames: np.ndarray, truth_m: np.ndarray, **about: object) -> Row:
    results, _ = chain.results(frames, SWEEPS[sweep])
    right = np.abs(results["altitude_m"] - truth_m) < correct_limit_m(SWEEPS[sweep])
    right &= results["valid"]
    return dict.fromkeys(COLUMNS.names) | {
        "sweep": sweep,
        "weights": chain.label,
        **about,
        "trials": len(frames),
        "correct": int(right.sum()),
        "wrong": int((results["valid"] & ~right).sum()),
        "rmse_forced_m": score_frames(results, truth_m).row()["rmse_forced_m"],
    }


def rows_of(chains: Sequence[Chain], sweep: str, trials: int, draw: int) -> Iterator[Row]:
    """Rows of one sweep: ``clean`` by altitude, then every interferer, overlap and SIR."""
    waveform, rng = SWEEPS[sweep], np.random.default_rng([draw, 1])
    for altitude_m in ALTITUDES_M:
        truth_m = np.full(CLEAN_FRAMES, altitude_m)
        frames = point_return(waveform, truth_m, phase_cycles=rng.random(CLEAN_FRAMES))
        noise = rng.standard_normal((*frames.shape, 2)).view(complex)[..., 0]
        frames = (frames + np.sqrt(0.5 * 10 ** (-SNR_DB / 10)) * noise).astype(np.complex64)
        for chain in chains:
            yield _row(chain, sweep, frames, truth_m, interferer="clean", altitude_m=altitude_m)
    scenes = Scenes.draw(waveform, trials, draw)
    for name, parts in emitters(waveform).items():
        for overlap in OVERLAPS:
            for sir_db in SIRS_DB:
                frames = scenes.with_interference(parts, overlap, sir_db, draw)
                about = {"interferer": name, "overlap": overlap, "sir_db": sir_db}
                for chain in chains:
                    yield _row(chain, sweep, frames, scenes.altitude_m, **about)


@options.command("compare_weights")
def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print; returns 0, or 2 after one line about an error."""
    parser = options.Parser("compare_weights", __doc__)
    add, count = parser.add_argument, options.number(int, 1, 100_000)
    add("files", nargs=2, type=options.path, metavar="FILE.onnx")
    add("--sweeps", default="own", help=f"comma-separated, of {', '.join(SWEEPS)}")
    add("--trials", type=count, default=60, help="frames per case and SIR")
    add("--draw", type=count, default=51_002, help="seed; default: %(default)s")
    add("--out", type=options.path, help="CSV for every row")
    args = parser.parse_args(argv)
    names = options.names_of(parser, "--sweeps", args.sweeps, SWEEPS)
    free = (("shift_check", False), ("skip_white", False))
    chains = [Chain.of_model(Path(f), f"{f.parent.name}/{f.stem}", options=free) for f in args.files]
    if chains[0].label == chains[1].label:
        parser.error(f"both files are {chains[0].label}.onnx; move one to a folder of another name")
    try:
        rows = [row for name in names for row in rows_of(chains, name, args.trials, args.draw)]
    except MitigationError as error:
        parser.error(str(error))
    for chain in chains:
        mine = [r for r in rows if r["weights"] == chain.label]
        played = [r for r in mine if r["interferer"] != "clean"]
        right, wrong, trials = (sum(r[key] for r in played) for key in ("correct", "wrong", "trials"))
        errors = ", ".join(
            f"{r['sweep']} {r['altitude_m']:g} m {r['rmse_forced_m']:.4f} m"
            for r in mine
            if r["interferer"] == "clean"
        )
        print(f"{chain.label}: right {right} of {trials}, wrong and valid {wrong}; clean RMSE {errors}")
    if args.out:
        args.out.write_text(COLUMNS.csv(rows), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
