"""Every method beside none on recordings of waveforms that this module does not generate.

    .venv/bin/python flowgraphs/make_recording.py --from dvbt
    PYTHONPATH=python .venv/bin/python training/evaluate_foreign.py results/dvbt.sigmf-meta

Point returns at 3-1500 m and up to 10 m/s, SNR 10 dB, the same frames for all methods. A method may have a declared Pd
of at most 0.03 below none at any SIR, and no lower sum over the SIRs; exits with 1 otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from evaluate import Scenes

from radalt.core.interference.emitters.recording import RecordingEmitter
from radalt.core.waveform import Waveform
from radalt.evaluation.engine import options
from radalt.evaluation.results.chain import Chain
from radalt.evaluation.results.score import score_frames
from radalt.evaluation.results.table import table

PROGRAM = "evaluate_foreign"
# without the paper's LMS, whose output carries no altitude
METHODS = ("whitening", "linear_prediction", "blanking", "ofdm_cancel", "qpsk_cancel", "tcae", "hybrid")
# without mitigation altitudes are lost between the second and the last
SIRS_DB = (-16.0, -20.0, -22.0, -24.0, -26.0, -28.0, -30.0, -34.0)
MOST_BELOW = 0.03  # of declared Pd; two standard deviations of the difference of 400 paired frames


def scored(
    file: Path, overlap: float, methods: Sequence[str], frames: int, seed: int
) -> dict[str, np.ndarray]:
    """Pd and share of wrong and valid altitudes, (2, SIRs), by method, none first."""
    emitter = RecordingEmitter(file=str(file))
    scenes = Scenes.draw(Waveform(), frames, seed)
    out = {name: np.zeros((2, len(SIRS_DB))) for name in ("none", *methods)}
    for k, sir_db in enumerate(SIRS_DB):
        received = scenes.with_interference([emitter], overlap, sir_db, seed)
        for name, rates in out.items():
            results, _ = Chain(name, name).results(received, scenes.waveform)
            score = score_frames(results, scenes.altitude_m)
            rates[:, k] = score.pd, score.wrong / score.trials
    return out


def judged(found: dict[str, np.ndarray]) -> list[str]:
    """Methods below none by more than `MOST_BELOW` at an SIR, or in sum by more than chance."""
    chance = MOST_BELOW * np.sqrt(len(SIRS_DB))
    behind = {name: rates[0] - found["none"][0] for name, rates in found.items()}
    return [name for name, d in behind.items() if d.min() < -MOST_BELOW or d.sum() < -chance]


@options.command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Print a table per recording; returns 0, 1 if a method is below none, 2 after one line about an error."""
    parser = options.Parser(PROGRAM, __doc__)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE.sigmf-meta")
    parser.add_argument("--methods", default=",".join(METHODS), help="comma-separated")
    parser.add_argument(
        "--overlap", type=options.number(float, 0, 1), default=1.0, help="default: %(default)s"
    )
    parser.add_argument("--frames", type=options.number(int, 1, 100_000), default=400, help="per SIR")
    parser.add_argument("--seed", type=options.number(int, 0, 2**31), default=54, help="default: %(default)s")
    args = parser.parse_args(argv)
    methods = tuple(name for name in args.methods.split(",") if name and name != "none")
    strange = next((name for name in methods if name not in METHODS), None)
    if strange is not None:
        parser.error(f"--methods holds {strange!r}; known: {', '.join(METHODS)}")
    below = []
    for file in args.files:
        try:
            found = scored(file, args.overlap, methods, args.frames, args.seed)
        except ValueError as error:
            parser.error(str(error))
        lines = [
            [name, *(f"{pd:.3f}" for pd in rates[0]), f"{(rates[0] - found['none'][0]).min():+.3f}",
             f"{(rates[0] - found['none'][0]).sum():+.3f}", f"{rates[1].max():.3f}"]
            for name, rates in found.items()
        ]  # fmt: skip
        sirs = [f"{sir:g} dB" for sir in SIRS_DB]
        print(f"\n{file.stem}, overlap {args.overlap:g}, {args.frames} frames per SIR: declared Pd\n")
        print(
            table(["method", *sirs, "least over none", "sum over none", "most wrong and valid"], lines),
            flush=True,
        )
        below += [f"{name} on {file.stem}" for name in judged(found)]
    if below:
        print(f"\nbelow none: {', '.join(below)}")
    return 1 if below else 0


if __name__ == "__main__":
    raise SystemExit(main())
