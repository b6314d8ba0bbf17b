"""Pictures for docs/tcae.md: beat spectra behind the networks, training curves.

PYTHONPATH=python .venv/bin/python training/figures.py --out docs/figures
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from curves import draw as draw_curves
from evaluate import NETWORKS
from evaluate_report import beat_spectra

from radalt.core.interference import Interferer, QpskEmitter, interference_frame
from radalt.core.mitigation import create
from radalt.core.returns.point import point_return
from radalt.core.waveform import Waveform
from radalt.evaluation.engine import options

ROOT = Path(__file__).resolve().parent.parent
ALTITUDE_M = 300.0


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
    beat_spectra(path, waveform, frames, ALTITUDE_M, "QPSK (rectangular), full overlap, SIR -15 dB")


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
