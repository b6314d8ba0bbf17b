"""Evidence for the TCAE: every method on the same unseen frames, over SIR x overlap x interferer.

    PYTHONPATH=python .venv/bin/python training/evaluate.py --out results/tcae

Writes a report. Runs in the runtime environment, without PyTorch. A method is scored down to the SIR where it
has clearly failed; the break-point SIR is the lowest one with Pd(|error| < 5 m) of at least 0.9, interpolated
between the grid's points. Rows are appended as they are measured and a killed run resumes.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from data import SceneConfig, return_parts
from evaluate_report import break_point_db, write_report

from radalt.core.interference import Interferer, QpskEmitter, ToneEmitter, interference_frames
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.mitigation import Mitigation, create
from radalt.core.receiver.altimeter import Altimeter
from radalt.core.returns.point import point_return
from radalt.core.waveform import Waveform
from radalt.evaluation.results.score import wilson_interval

ROOT = Path(__file__).resolve().parent.parent
SEED = 31_415_926  # no training configuration uses it
SNR_DB = 10.0
TOLERANCE_M = 5.0
SIRS_DB = tuple(np.arange(0.0, -62.6, -2.5))
OVERLAPS = (0.3, 0.6, 1.0)
OTHER_RETURNS = (("clean", ""), ("qpsk_shaped", -30.0), ("qpsk_rectangular_delayed", -27.5), ("nr5", -30.0))
CLASSICAL = ("none", "lms", "lms_reference_input", "nlms", "whitening", "blanking")
NETWORKS = {"fc": "fc.onnx", "cnn": "cnn.onnx", "paper": "paper.onnx", "compact": "tcae.onnx"}
COLUMNS = (
    "interferer", "overlap", "sir_db", "method", "trials", "detected", "pd", "pd_low", "pd_high",
    "rmse_detected_m", "rmse_forced_m", "diverged_frames",
)  # fmt: skip


def emitters() -> dict[str, list[object]]:
    """Interferer families; NR payload seeds differ from those of the training bank."""
    nr5 = NrEmitter(seed=99, cell_id=321, frame_count=2)
    nr10 = NrEmitter(channel_bandwidth_hz=10e6, seed=98, cell_id=123, frame_count=2)
    rectangular = QpskEmitter()
    return {
        "tones": [ToneEmitter(5)],
        "qpsk_rectangular": [rectangular],
        "qpsk_rectangular_delayed": [Delayed(rectangular)],
        "qpsk_shaped": [QpskEmitter(pulse="rrc")],
        "nr5": [nr5],
        "nr10": [nr10],
        "mixture": [ToneEmitter(3), rectangular, nr5],  # equal powers, each gated on its own
    }


@dataclass(frozen=True)
class Delayed:
    """An emitter heard through a fractional sample delay, drawn anew: its envelope is no longer constant."""

    emitter: object

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """See `radalt.core.interference.placement.Emitter`; 64 samples on each side are thrown away."""
        longer = self.emitter.samples(count + 128, rate_hz, rng)
        turn = np.exp(-2j * np.pi * np.fft.fftfreq(longer.size) * rng.uniform(-0.5, 0.5))
        return np.fft.ifft(np.fft.fft(longer) * turn)[64 : 64 + count]


@dataclass(frozen=True)
class Scenes:
    """Clean frames with noise, and what they hold: (n,) altitudes in metres, (n, N) complex64."""

    waveform: Waveform
    altitude_m: np.ndarray
    frames: np.ndarray

    @classmethod
    def draw(cls, waveform: Waveform, trials: int, seed: int, ground: SceneConfig | None = None) -> Scenes:
        """Returns over 3-1500 m, up to 10 m/s, at the evaluation's SNR: points, or what ``ground`` says.

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
        rng = np.random.default_rng([SEED, seed, round(-10 * sir_db), round(1000 * overlap)])
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


def score(
    altimeter: Altimeter, method: Mitigation, frames: np.ndarray, altitude_m: np.ndarray
) -> dict[str, object]:
    """Pd with its interval, RMSE over detections and over all frames with a forced decision."""
    method.reset()
    result = altimeter.process(method.process(frames))
    valid = result["valid"]
    error = result["altitude_m"] - altitude_m
    hits = int(np.sum(np.abs(error[valid]) < TOLERANCE_M))
    forced = result["forced_altitude_m"] - altitude_m
    # a frame without any decision (silent or diverged output) counts as if its altitude were read as zero
    forced = np.where(np.isfinite(forced), forced, -altitude_m)
    low, high = wilson_interval(hits, frames.shape[0])
    return {
        "trials": frames.shape[0],
        "detected": int(valid.sum()),
        "pd": hits / frames.shape[0],
        "pd_low": round(low, 4),
        "pd_high": round(high, 4),
        "rmse_detected_m": round(float(np.sqrt(np.mean(error[valid] ** 2))), 4) if valid.any() else "",
        "rmse_forced_m": round(float(np.sqrt(np.mean(forced**2))), 4),
        "diverged_frames": method.diverged_frames,
    }


def methods(waveform: Waveform, names: list[str], models: Path) -> dict[str, Mitigation]:
    """Fresh methods; networks by file below ``models``, as they are: nothing silences what they invent."""
    made = {}
    for name in names:
        made[name] = (
            create("tcae", waveform, model=models / NETWORKS[name], shift_check=False)
            if name in NETWORKS
            else create(name, waveform)
        )
    return made


class Rows:
    """The CSV of a run: what is there already, and appending."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: list[dict[str, str]] = []
        if path.is_file():
            with path.open(newline="") as file:
                self.rows = list(csv.DictReader(file))
        else:
            with path.open("w", newline="") as file:
                csv.DictWriter(file, COLUMNS).writeheader()

    def find(self, **key: object) -> dict[str, str] | None:
        """The row with these values, if it was measured."""
        wanted = {name: str(value) for name, value in key.items()}
        return next((r for r in self.rows if all(r[n] == v for n, v in wanted.items())), None)

    def add(self, row: dict[str, object]) -> dict[str, str]:
        """Append one row, at once."""
        text = {name: str(row[name]) for name in COLUMNS}
        with self.path.open("a", newline="") as file:
            csv.DictWriter(file, COLUMNS).writerow(text)
        self.rows.append(text)
        return text

    def pd(self, interferer: str, overlap: float, method: str) -> tuple[np.ndarray, np.ndarray]:
        """SIRs in decibels, falling, and Pd of one method in one case."""
        picked = [
            (float(r["sir_db"]), float(r["pd"]))
            for r in self.rows
            if r["interferer"] == interferer and float(r["overlap"]) == overlap and r["method"] == method
        ]
        picked.sort(reverse=True)
        return np.array([p[0] for p in picked]), np.array([p[1] for p in picked])


def sweep(rows: Rows, altimeter: Altimeter, made: dict[str, Mitigation], trials: int, say: Callable) -> None:
    """Measure what is missing; a method leaves a case after two points with Pd below 0.3."""
    waveform = altimeter.waveform
    scenes = Scenes.draw(waveform, trials, 0)
    for case, (name, parts) in enumerate(emitters().items()):
        for overlap in OVERLAPS:
            alive = dict.fromkeys(made, 0)
            for sir_db in SIRS_DB:
                frames = None
                for method in [m for m, failures in alive.items() if failures < 2]:
                    key = {"interferer": name, "overlap": overlap, "sir_db": float(sir_db), "method": method}
                    row = rows.find(**key)
                    if row is None:
                        if frames is None:
                            frames = scenes.with_interference(parts, overlap, float(sir_db), case)
                        row = rows.add(key | score(altimeter, made[method], frames, scenes.altitude_m))
                    alive[method] = alive[method] + 1 if float(row["pd"]) < 0.3 else 0
                if all(failures >= 2 for failures in alive.values()):
                    break
            say(f"{name} overlap {overlap}: " + ", ".join(_breaks(rows, name, overlap, list(made))))


def _breaks(rows: Rows, name: str, overlap: float, names: list[str]) -> list[str]:
    out = []
    for method in names:
        value, mark = break_point_db(*rows.pd(name, overlap, method))
        out.append(f"{method} {mark}{value:.1f}")
    return out


def clean_and_paper(rows: Rows, altimeter: Altimeter, made: dict[str, Mitigation], trials: int) -> None:
    """The clean scene, and the paper's case: rectangular QPSK over the whole frame at SINR -15 dB."""
    scenes = Scenes.draw(altimeter.waveform, trials, 1)
    noise = 10.0 ** (-SNR_DB / 10.0)
    sir_db = -10.0 * np.log10(10.0**1.5 - noise)  # SINR = 1 / (interference + noise)
    cases = {("clean", 0.0, ""): scenes.frames}
    key = ("qpsk_rectangular_sinr_-15", 1.0, round(float(sir_db), 3))
    cases[key] = scenes.with_interference(emitters()["qpsk_rectangular"], 1.0, float(sir_db), 90)
    for (name, overlap, sir), frames in cases.items():
        for method, one in made.items():
            row = {"interferer": name, "overlap": overlap, "sir_db": sir, "method": method}
            if rows.find(**row) is None:
                rows.add(row | score(altimeter, one, frames, scenes.altitude_m))


def other_returns(rows: Rows, altimeter: Altimeter, made: dict[str, Mitigation], trials: int) -> None:
    """Echoes (1-3, 6-25 dB down, 5-120 m behind) and extended ground, alone and with whole-frame interference."""
    grounds = {
        "multipath": SceneConfig(multipath=1.0, extended=0.0),
        "extended": SceneConfig(multipath=0.0, extended=1.0),
    }
    for number, (name, ground) in enumerate(grounds.items()):
        scenes = Scenes.draw(altimeter.waveform, trials, 2 + number, ground)
        for interferer, sir_db in OTHER_RETURNS:
            frames = scenes.frames
            if interferer != "clean":
                frames = scenes.with_interference(emitters()[interferer], 1.0, sir_db, 91)
            for method, one in made.items():
                row = {
                    "interferer": f"{interferer}, {name}",
                    "overlap": 1.0,
                    "sir_db": sir_db,
                    "method": method,
                }
                if rows.find(**row) is None:
                    rows.add(row | score(altimeter, one, frames, scenes.altitude_m))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "tcae")
    parser.add_argument("--models", type=Path, default=ROOT / "models")
    parser.add_argument("--methods", default=",".join([*CLASSICAL, *NETWORKS]), help="comma-separated")
    parser.add_argument("--trials", type=int, default=60)
    parser.add_argument("--clean-trials", type=int, default=200)
    args = parser.parse_args()
    names = [name for name in args.methods.split(",") if name]
    unknown = [name for name in names if name not in (*CLASSICAL, *NETWORKS)]
    if unknown:
        parser.error(f"unknown method {unknown[0]!r}; known: {', '.join([*CLASSICAL, *NETWORKS])}")
    args.out.mkdir(parents=True, exist_ok=True)
    altimeter = Altimeter(Waveform())
    made = methods(altimeter.waveform, names, args.models)
    rows = Rows(args.out / "rows.csv")
    start = time.monotonic()
    clean_and_paper(rows, altimeter, made, args.clean_trials)
    other_returns(rows, altimeter, made, args.clean_trials)
    sweep(rows, altimeter, made, args.trials, lambda text: print(text, flush=True))
    hashes = {
        n: hashlib.sha256((args.models / NETWORKS[n]).read_bytes()).hexdigest()
        for n in names
        if n in NETWORKS
    }
    write_report(
        args.out, rows, names, {"seed": SEED, "snr_db": SNR_DB, "trials": args.trials, "models": hashes}
    )
    print(f"{args.out / 'report.md'}: {len(rows.rows)} rows, {time.monotonic() - start:.0f} s")
    (args.out / "report.json").write_text(
        json.dumps(
            {"schema": 1, "seed": SEED, "snr_db": SNR_DB, "models": hashes, "rows": rows.rows}, indent=1
        )
    )


if __name__ == "__main__":
    main()
