"""Pictures for docs/tcae.md: an interferer on 26.7 % of the band, before and after; beat spectra; training curves.

PYTHONPATH=python .venv/bin/python training/figures.py --out docs/figures
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import numpy as np
from curves import draw as draw_curves
from evaluate_report import beat_spectra, before_after
from matplotlib import pyplot as plt

from radalt.core.interference import Interferer, QpskEmitter, interference_frame
from radalt.core.mitigation import create
from radalt.core.returns.point import point_return
from radalt.core.waveform import Waveform
from radalt.evaluation.engine import options

ROOT = Path(__file__).resolve().parent.parent
ALTITUDE_M = 300.0


def interfered(waveform: Waveform, pulse: str, sir_db: float, overlap: float) -> np.ndarray:
    """(N,) complex64: a return at 300 m, SNR 10 dB, under QPSK on 26.7 % of the band."""
    rng = np.random.default_rng(2026)
    clean = point_return(waveform, np.array([ALTITUDE_M]))[0]
    noise = np.sqrt(0.05) * rng.standard_normal((clean.size, 2)).view(np.complex128)[:, 0]
    emitter = QpskEmitter(bandwidth_hz=0.267 * waveform.bandwidth_hz, pulse=pulse)
    extra = interference_frame(Interferer(emitter, sir_db, overlap), clean.size, waveform.rate_hz, rng)
    return (clean + noise + extra).astype(np.complex64)


def through_networks(
    waveform: Waveform, received: np.ndarray, models: dict[str, str]
) -> dict[str, np.ndarray]:
    """The frame behind networks {label: file below models/}, whose outputs are not checked."""
    files = {label: ROOT / "models" / f"{name}.onnx" for label, name in models.items()}
    return {
        label: create("tcae", waveform, model=file, shift_check=False).process(received)
        for label, file in files.items()
    }


def draw_before_after(path: Path, pulse: str, sir_db: float, overlap: float) -> None:
    """Received, whitened, blanked, paper and compact."""
    waveform = Waveform()
    received = interfered(waveform, pulse, sir_db, overlap)
    frames = {"received": received}
    for name in ("whitening", "blanking"):
        frames[name] = create(name, waveform).process(received)
    frames |= through_networks(waveform, received, {"TCAE paper": "paper", "TCAE compact": "tcae"})
    name = {"rectangular": "rectangular", "rrc": "root-raised-cosine"}[pulse]
    title = f"QPSK ({name}) on 26.7 % of the band, SIR {sir_db:g} dB, overlap {overlap:g}"
    before_after(path, waveform, frames, title)


def draw_beats(path: Path) -> None:
    """Beat spectra behind the paper's three networks and what ships, in the paper's case."""
    waveform = Waveform()
    received = interfered(waveform, "rectangular", -15.0, 1.0)
    models = {"fc": "fc", "cnn": "cnn", "paper": "paper", "compact": "tcae"}
    frames = {"received": received} | through_networks(waveform, received, models)
    beat_spectra(path, waveform, frames, ALTITUDE_M, "QPSK (rectangular), whole frame, SIR -15 dB")


def draw_training(path: Path, logs: list[Path]) -> None:
    """Validation loss of several runs over examples."""
    colours = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
    figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
    for log, colour, dash in zip(logs, colours, ("-", "--", "-.", ":", "-", "--", ":"), strict=False):
        with log.open(newline="") as file:
            rows = list(csv.DictReader(file))
        axis.plot(
            [int(row["examples"]) / 1000 for row in rows],
            [float(row["validation_loss"]) for row in rows],
            dash,
            color=colour,
            marker="o",
            ms=3,
            label=log.stem.removeprefix("compare_"),
        )
    axis.set(xlabel="examples / 1000", ylabel="validation loss")
    if len(logs) > 1:
        figure.legend(loc="outside right upper")  # curves run through every corner
    axis.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
    plt.close(figure)


@options.command("figures")
def main(argv: Sequence[str] | None = None) -> int:
    """Draw all; returns 0, or 2 after one line about what does not fit."""
    parser = options.Parser("figures", __doc__)
    parser.add_argument(
        "--out", type=options.path, default=ROOT / "docs" / "figures", help="folder (default: docs/figures)"
    )
    out = parser.parse_args(argv).out
    out.mkdir(parents=True, exist_ok=True)
    draw_before_after(out / "tcae_before_after_shaped.png", "rrc", -20.0, 1.0)
    draw_before_after(out / "tcae_before_after_burst.png", "rectangular", -20.0, 0.4)
    draw_beats(out / "tcae_beats.png")
    logs = ROOT / "training" / "logs"
    draw_training(out / "tcae_compare.png", sorted(logs.glob("compare_*.csv")))
    parts = (
        "compact_first",
        "compact_deep",
        "compact_heard",
        "compact_lean",
        "compact_crowded",
        "compact_ground",
    )
    draw_training(out / "tcae_compact.png", [logs / f"{part}.csv" for part in (*parts, "compact")])
    draw_training(out / "tcae_any_sweep.png", [logs / "any_sweep.csv"])
    draw_curves(out / "tcae_paper.png", logs, ("paper", "fc", "cnn"))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
