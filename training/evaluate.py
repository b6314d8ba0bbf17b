"""Evidence for the TCAE: every method on the same held-out frames, over SIR, overlap and interferer.

    PYTHONPATH=python .venv/bin/python training/evaluate.py --out results/tcae
    PYTHONPATH=python .venv/bin/python training/evaluate.py --trials 0    # without the sweep over SIR

Runs in the runtime environment, without PyTorch. A point is one interferer at one overlap, down to the SIR where every
method has failed: two SIRs with Pd below 0.3. --resume completes a stopped run.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from configs import SceneConfig
from data import return_parts
from evaluate_report import IDEAL, PAPER_CASE, break_points, write_report

from radalt.core.interference import Interferer, QpskEmitter, ToneEmitter, interference_frames
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.evm import TYPICAL
from radalt.core.returns.point import point_return
from radalt.core.waveform import Waveform
from radalt.evaluation.engine import command, options
from radalt.evaluation.engine.chain_study import ChainStudy
from radalt.evaluation.engine.study import Point, Run
from radalt.evaluation.results.chain import Chain
from radalt.evaluation.results.folder import RunFolder
from radalt.evaluation.results.rows import Columns
from radalt.evaluation.results.score import SCORE_COLUMNS, score_frames

PROGRAM = "evaluate"
ROOT = Path(__file__).resolve().parent.parent
SEED = 31_415_926  # no training configuration uses it
FIRST_DRAW = 22_700  # lower draws are not held out: methods were developed on their frames
SNR_DB = 10.0  # as in the other studies of single frames
FAILED_PD = 0.3  # Pd below which a method has failed; after two such SIRs of a case it is not run further
SIRS_DB = tuple(float(sir) for sir in np.arange(0.0, -62.6, -2.5))
OVERLAPS = (0.3, 0.6, 1.0)
# SIR at which interference and noise together are at the paper's SINR of -15 dB
PAPER_SIR_DB = float(-10.0 * np.log10(10.0**1.5 - 10.0 ** (-SNR_DB / 10.0)))
OTHER_RETURNS = (("clean", None), ("qpsk_shaped", -30.0), ("qpsk_rectangular_delayed", -27.5), ("nr5", -30.0))
# returns by the number of their scenes: points (in the sweep, and in special cases), points with 1 to 3 echoes (6 to
# 25 dB down, 5 to 120 m behind), extended ground
RETURNS = (None, None, SceneConfig(multipath=1.0, extended=0.0), SceneConfig(multipath=0.0, extended=1.0))
CLASSICAL = (
    *("none", "lms", "lms_reference_input", "nlms", "nlms_predictor"),
    *("whitening", "linear_prediction", "blanking", "ofdm_cancel", "qpsk_cancel", "hybrid"),
)
NETWORKS = {"fc": "fc.onnx", "cnn": "cnn.onnx", "paper": "paper.onnx", "compact": "tcae.onnx"}
# `cnn` takes a quarter of a second per frame, an hour and a half for the sweep (training/cards.py --time)
STANDARD = (*CLASSICAL, *(name for name in NETWORKS if name != "cnn"))
COLUMNS = Columns(
    ("interferer", "overlap", "sir_db", "method", *SCORE_COLUMNS, "diverged_frames"),
    text=frozenset({"interferer", "method"}),
    whole=frozenset({"trials", "detections", "correct", "forced", "frames_lost", "wrong_far"})
    | {"diverged_frames"},
)


def emitters(evm: float | str = 0.0) -> dict[str, list[object]]:
    """Interferer families; NR payload seeds differ from those of the training bank."""
    nr5 = NrEmitter(seed=99, cell_id=321, frame_count=2, evm=evm)
    nr10 = NrEmitter(channel_bandwidth_hz=10e6, seed=98, cell_id=123, frame_count=2, evm=evm)
    rectangular = QpskEmitter(evm=evm)
    return {
        "tones": [ToneEmitter(5)],
        "qpsk_rectangular": [rectangular],
        "qpsk_rectangular_delayed": [Delayed(rectangular)],
        "qpsk_shaped": [QpskEmitter(pulse="rrc", evm=evm)],
        "nr5": [nr5],
        "nr10": [nr10],
        "mixture": [ToneEmitter(3), rectangular, nr5],  # equal powers, each gated on its own
    }


def sent(name: str) -> list[object]:
    """Emitters by the name in rows: with typical EVM, or ideal if it ends in `IDEAL`."""
    return emitters(0.0 if name.endswith(IDEAL) else TYPICAL)[name.removesuffix(IDEAL)]


@dataclass(frozen=True)
class Delayed:
    """An emitter behind a random fractional sample delay, which makes its envelope vary."""

    emitter: object

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """See `radalt.core.interference.placement.Emitter`; 64 samples at each end, with edge effects, are cut off."""
        longer = self.emitter.samples(count + 128, rate_hz, rng)
        delay = np.exp(-2j * np.pi * np.fft.fftfreq(longer.size) * rng.uniform(-0.5, 0.5))
        return np.fft.ifft(np.fft.fft(longer) * delay)[64 : 64 + count]


@dataclass(frozen=True)
class Scenes:
    """(n, N) complex64 frames of returns and noise, and their (n,) altitudes in metres."""

    waveform: Waveform
    altitude_m: np.ndarray
    frames: np.ndarray

    @classmethod
    def draw(cls, waveform: Waveform, trials: int, seed: int, ground: SceneConfig | None = None) -> Scenes:
        """Returns at 3 to 1500 m and up to 10 m/s, at `SNR_DB`: points, or as ``ground`` draws them.

        The altitude is that of the nearest part of a return.
        """
        rng = np.random.default_rng([SEED, seed])
        altitude_m = rng.uniform(3.0, 1500.0, trials)
        speed = rng.uniform(-10, 10, trials)
        if ground is None:
            frames = point_return(
                waveform, altitude_m, vertical_speed_m_per_s=speed, phase_cycles=rng.random(trials)
            )
        else:
            rows = []
            for altitude, v in zip(altitude_m, speed, strict=True):
                excess_m, amplitude = return_parts(ground, rng)
                rows.append(amplitude @ point_return(waveform, altitude + excess_m, vertical_speed_m_per_s=v))
            frames = np.stack(rows)
            frames /= np.sqrt(np.mean(np.abs(frames) ** 2, axis=1, keepdims=True))
        noise = rng.standard_normal((trials, frames.shape[1], 2)).view(np.complex128)[..., 0]
        frames = frames + np.sqrt(0.5 * 10.0 ** (-SNR_DB / 10.0)) * noise
        return cls(waveform, altitude_m, frames.astype(np.complex64))

    def with_interference(self, parts: list[object], overlap: float, sir_db: float, seed: int) -> np.ndarray:
        """(n, N) complex64: the frames with the emitters' sum at exactly ``sir_db``."""
        rng = np.random.default_rng([SEED, seed, round(-10 * sir_db) % 2**32, round(1000 * overlap)])
        interferers = [Interferer(emitter, 0.0, overlap) for emitter in parts]
        extra = interference_frames(
            interferers,
            self.frames.shape[0],
            self.frames.shape[1],
            self.waveform.rate_hz,
            rng,
            total_sir_db=sir_db,
        )
        return (self.frames + extra).astype(np.complex64)


@lru_cache(maxsize=4)
def scenes_of(trials: int, number: int) -> Scenes:
    """Scenes that points share, made once per process."""
    return Scenes.draw(Waveform(), trials, FIRST_DRAW + number, RETURNS[number])


@dataclass(frozen=True)
class CasePoint(Point):
    """One interferer (of `emitters`, or ``clean``) at one overlap.

    ``sirs_db`` falls, and is empty without interference. ``scenes`` and ``draw`` seed the returns and the interference.
    """

    interferer: str = "clean"
    overlap: float = 0.0
    sirs_db: tuple[float, ...] = ()
    scenes: int = 0
    draw: int = 0


@dataclass(frozen=True)
class MethodStudy(ChainStudy):
    """Every method on the same frames.

    ``trials`` is the number of frames per SIR of the sweep, ``special_trials`` that of the clean scene, the paper's
    case and other returns; 0 leaves them out. ``kinds`` are the emitters of the sweep: typical, ideal or both.
    """

    chains: tuple[Chain, ...]
    trials: int = 60
    special_trials: int = 200
    kinds: tuple[str, ...] = (TYPICAL,)

    tables: ClassVar[Mapping[str, Columns]] = {"rows": COLUMNS}
    published: ClassVar[Mapping[str, str]] = {
        "report.md": "tcae_comparison.md",
        "rows.csv": "data/tcae_comparison.csv",
        "pd.png": "figures/tcae_pd.png",
    }

    def check(self) -> None:
        """See `Study`; raises `MitigationError` where a model does not fit."""
        for chain in self.chains:
            chain.build(Waveform())

    def head(self) -> dict[str, Any]:
        """See `Study`."""
        files = {chain.label: chain.model for chain in self.chains if chain.model}
        return {
            "seed": [SEED, FIRST_DRAW],
            "snr_db": SNR_DB,
            "methods": [chain.label for chain in self.chains],
            "trials": self.trials,
            "special_trials": self.special_trials,
            "emitters": list(self.kinds),
            "models": {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()},
        }

    def points(self) -> list[CasePoint]:
        """The clean scene, the paper's case, other returns, then the sweep."""
        n, swept = self.special_trials, self.trials * len(SIRS_DB)
        special = [
            CasePoint("clean", n, scenes=1),
            CasePoint(
                PAPER_CASE, n, "rows", f"qpsk_rectangular{IDEAL}", 1.0, (PAPER_SIR_DB,), scenes=1, draw=90
            ),
        ] + [
            CasePoint(
                f"{name}, {ground}", n, "rows", name, 1.0, () if sir is None else (sir,), number, draw=91
            )
            for number, ground in ((2, "multipath"), (3, "extended"))
            for name, sir in OTHER_RETURNS
        ]
        sweep = [
            CasePoint(f"{name}, overlap {rho:g}", swept, "rows", name, rho, SIRS_DB, draw=case)
            for kind in self.kinds
            for case, name in enumerate(f"{name}{IDEAL * (kind == 'ideal')}" for name in emitters())
            for rho in OVERLAPS
            # tones have no symbols, so both kinds are the same
            if kind == self.kinds[0] or not name.startswith("tones")
        ]
        return (special if n else []) + (sweep if swept else [])

    def measure(self, point: CasePoint) -> list[dict[str, Any]]:
        """Rows by SIR and method; a method is not run further after two SIRs with Pd below 0.3."""
        swept = len(point.sirs_db) > 1
        scenes = scenes_of(self.trials if swept else self.special_trials, point.scenes)
        failures = dict.fromkeys(self.chains, 0)
        rows = []
        for sir_db in point.sirs_db or (None,):
            frames = scenes.frames
            if sir_db is not None:
                parts = sent(point.interferer)
                frames = scenes.with_interference(parts, point.overlap, sir_db, FIRST_DRAW + point.draw)
            for chain in [c for c, count in failures.items() if count < 2]:
                results, method = chain.results(frames, scenes.waveform)
                found = score_frames(results, scenes.altitude_m)
                failures[chain] = failures[chain] + 1 if found.pd < FAILED_PD else 0
                about = (point.interferer if swept else point.name, point.overlap, sir_db, chain.label)
                row = dict(zip(COLUMNS.names, about, strict=False)) | found.row()
                rows.append(row | {"diverged_frames": method.diverged_frames})
            if min(failures.values()) >= 2:
                break
        return rows

    def report(self, folder: RunFolder, rows: Mapping[str, list[dict[str, Any]]], run: Run) -> Path:
        """See `evaluate_report.write_report`."""
        return write_report(folder, rows["rows"], folder.head["methods"], run)


def chain_of(name: str, models: Path) -> Chain:
    """Chain of a method in `CLASSICAL` or `NETWORKS`; networks without the shift test that silences inventions."""
    if name not in NETWORKS:
        return Chain(name, name, independent=name == "hybrid")
    return Chain.of_model(models / NETWORKS[name], name, options=(("shift_check", False),))


def describe(rows: Sequence[dict[str, Any]]) -> str:
    """A measured point in a line: break-points, or Pd where there is one SIR."""
    table = break_points(rows)
    if table:
        ((case, found),) = table.items()
        return f"{case[0]} overlap {case[1]:g}: " + ", ".join(f"{m} {b}" for m, b in found.items())
    return f"{rows[0]['interferer']}: Pd " + ", ".join(f"{r['method']} {r['pd']:.3g}" for r in rows)


@options.command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; returns 0, 2 after one line about an error, 130 when interrupted."""
    parser = options.Parser(PROGRAM, __doc__)
    options.add_options(parser, out=str(ROOT / "results" / "tcae"), time_limit_s=7200.0)
    parser.add_argument("--models", type=Path, default=ROOT / "models", help="folder of the networks' files")
    parser.add_argument("--methods", default=",".join(STANDARD), help="comma-separated; cnn, too, is known")
    parser.add_argument(
        "--emitters", default=TYPICAL, help="typical, ideal or typical,ideal (default: %(default)s)"
    )
    parser.add_argument("--trials", type=int, default=60, help="frames per SIR of the sweep; 0 leaves it out")
    parser.add_argument(
        "--clean-trials", type=int, default=200, help="frames of the clean scene and the other special cases"
    )
    args = parser.parse_args(argv)
    how = options.options_of(args, parser)
    names = tuple(dict.fromkeys(name.strip() for name in args.methods.split(",") if name.strip()))
    strange = next((name for name in names or ("",) if name not in (*CLASSICAL, *NETWORKS)), None)
    if strange is not None:
        parser.error(f"--methods holds {strange!r}; known: {', '.join([*CLASSICAL, *NETWORKS])}")
    kinds = tuple(dict.fromkeys(kind.strip() for kind in args.emitters.split(",")))
    strange = next((kind for kind in kinds if kind not in (TYPICAL, "ideal")), None)
    if strange is not None:
        parser.error(f"--emitters holds {strange!r}; known: typical, ideal")
    if min(args.trials, args.clean_trials) < 0 or not args.trials + args.clean_trials:
        parser.error(f"--trials is {args.trials}, --clean-trials {args.clean_trials}; 0 or above, not both 0")
    chains = tuple(chain_of(name, args.models.resolve()) for name in names)
    study = MethodStudy(chains, args.trials, args.clean_trials, kinds)
    return command.main(lambda: study, how, program=PROGRAM, dry_run=args.dry_run, describe=describe)


if __name__ == "__main__":
    raise SystemExit(main())
