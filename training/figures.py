"""Pictures for docs/tcae.md: beat spectra behind the networks, training curves.

PYTHONPATH=python .venv/bin/python training/figures.py --out docs/figures
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import numpy as np
from curves import draw as draw_curves
from matplotlib import pyplot as plt

from radalt.core.altimeter.altimeter import AltimeterSettings, shared_altimeter
from radalt.core.interference import Interferer, QpskEmitter, interference_frame
from radalt.core.mitigation import create
from radalt.core.returns.point import point_return
from radalt.core.waveform import Waveform
from radalt.evaluation.engine import options

ROOT = Path(__file__).resolve().parent.parent
ALTITUDE_M = 300.0
NETWORKS = {"fc": "fc.onnx", "cnn": "cnn.onnx", "paper": "paper.onnx", "tcae": "tcae.onnx"}


def draw_beats(path: Path) -> None:
    """A return at 300 m, SNR 10 dB, under QPSK on 26.7 % of the band, behind networks whose outputs are not checked."""
    waveform, rng = Waveform(), np.random.default_rng(2026)
    clean = point_return(waveform, np.array([ALTITUDE_M]))[0]
    noise = np.sqrt(0.05) * rng.standard_normal((clean.size, 2)).view(np.complex128)[:, 0]
    emitter = QpskEmitter(bandwidth_hz=0.267 * waveform.bandwidth_hz)
    extra = interference_frame(Interferer(emitter, -15.0), clean.size, waveform.rate_hz, rng)
    frames = {"received": (clean + noise + extra).astype(np.complex64)}
    for label, name in NETWORKS.items():
        method = create("tcae", waveform, model=ROOT / "models" / name, shift_check=False)
        frames[label] = method.process(frames["received"])
    _beat_spectra(path, waveform, frames, ALTITUDE_M, "QPSK (rectangular), full overlap, SIR -15 dB")


def _beat_spectra(
    path: Path, waveform: Waveform, frames: dict[str, np.ndarray], altitude_m: float, title: str
) -> None:
    """Beat spectra of the altimeter, a panel per method; ``frames`` is {label: (N,) complex}."""
    altimeter = shared_altimeter(waveform, AltimeterSettings())
    rows = -(-len(frames) // 2)
    figure, axes = plt.subplots(
        rows, 2, figsize=(6, 1.9 * rows + 0.6), sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    for axis in axes.flat[len(frames) :]:
        axis.set_axis_off()
    for axis, (label, frame) in zip(axes.flat, frames.items(), strict=False):
        spectra = altimeter.spectra(frame[None])
        for half, dash, name in zip(spectra.power[0], ("-", ":"), ("up", "down"), strict=True):
            level_db = 10 * np.log10(np.maximum(half / spectra.power.max(), 1e-9))
            axis.plot(spectra.beat_hz / 1e3, level_db, dash, color="#0072B2", lw=1, label=name)
        true = axis.axvline(waveform.altitude_to_beat_hz(altitude_m) / 1e3, color="#D55E00", lw=0.8)
        axis.set(title=label, ylim=(-50, 3))
        axis.grid(alpha=0.3)
    true.set_label("true beat")
    figure.supxlabel("beat / kHz")
    figure.supylabel("dB of the peak")
    figure.legend(*axis.get_legend_handles_labels(), loc="lower right")
    figure.suptitle(title, fontsize=10)
    figure.savefig(path, dpi=150)
    plt.close(figure)


@options.command("figures")
def main(argv: Sequence[str] | None = None) -> int:
    """Draw all; returns 0, or 2 after one line about an error."""
    parser = options.Parser("figures", __doc__)
    parser.add_argument(
        "--out", type=options.path, default=ROOT / "docs" / "figures", help="folder (default: docs/figures)"
    )
    out = parser.parse_args(argv).out
    out.mkdir(parents=True, exist_ok=True)
    draw_beats(out / "tcae_beats.png")
    draw_curves(out / "tcae_paper.png", ROOT / "training" / "logs", ("paper", "fc", "cnn_normalised=cnn"))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
