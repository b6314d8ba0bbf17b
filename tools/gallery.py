#!/usr/bin/env python3
"""Spectrogram gallery of the interference of every shipped scene: docs/interference_gallery.png.

.venv/bin/python tools/gallery.py --out docs/interference_gallery.png --seed 1
"""

from __future__ import annotations

import _tool  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path

import dataclasses
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from radalt.core.interference.placement import interference_frames
from radalt.core.returns.point import point_return
from radalt.core.scene import Scene, load_scene
from radalt.evaluation.commands import make_recording
from radalt.evaluation.engine.options import MAX_SEED, Parser, check_ours, command, number, path
from radalt.evaluation.transmitters import TRANSMITTERS, transmit

PANELS = (
    ("paper_qpsk", "QPSK, ideal,\nrectangular pulses"),
    ("qpsk_shaped", "QPSK,\nroot raised cosine"),
    ("tones", "five tones"),
    ("nr5", "5G, 5 MHz"),
    ("nr10", "5G, 10 MHz"),
    ("nr_as_sent", "5G, 20 MHz, TDD,\nmoving channel"),
    ("mixture", "5G, QPSK, tones,\npulsed radar"),
    ("fmcw", "another altimeter"),
    ("faa_mask", "14 CFR 91.220(b)\nmask, 200 ft"),
    ("dvbt", "DVB-T\nby GNU Radio"),
    ("atsc", "ATSC television\nby GNU Radio"),
    ("dvbs2", "DVB-S2\nby GNU Radio"),
)
TITLE = "Interference gallery of gr-radalt"  # in the file's metadata
SIR_DB = -20.0  # at which return and interference are both seen
WINDOW = 128  # samples of a short-time transform: 17 us


def spectrogram_db(samples: np.ndarray) -> np.ndarray:
    """(WINDOW, columns) power of a Hann-windowed short-time transform in dB, frequency rising, hop of an eighth."""
    views = np.lib.stride_tricks.sliding_window_view(samples, WINDOW)[:: WINDOW // 8]
    plane = np.fft.fftshift(np.fft.fft(views * np.hanning(WINDOW), axis=1), axes=1)
    return 10.0 * np.log10(np.abs(plane.T) ** 2 + 1e-12)


def with_recording(scene: Scene, folder: Path, seed: int) -> Scene:
    """The scene with its recording, if it plays one, made in a folder."""
    if scene.name not in TRANSMITTERS:
        return scene
    (one,) = scene.interference
    meta, transmitter = folder / f"{scene.name}.sigmf-meta", TRANSMITTERS[scene.name]
    make_recording.write(meta, transmit(scene.name, 0.01, seed), transmitter.rate_hz, transmitter.title)
    emitter = dataclasses.replace(one.emitter, file=str(meta))
    return dataclasses.replace(scene, interference=(dataclasses.replace(one, emitter=emitter),))


def received(scene: Scene, seed: int) -> np.ndarray:
    """(2 N,) two sweeps: return from 200 m, interference at 60 % overlap, noise of the scene."""
    w = scene.waveform
    rng = np.random.default_rng(seed)
    point = scene.at(overlap=0.6, sir_db=SIR_DB)
    frames = point_return(w, np.full(2, 200.0)) + interference_frames(
        point.interference, 2, w.samples_per_frame, w.rate_hz, rng, total_sir_db=point.total_sir_db
    )
    amplitude = 10.0 ** (-scene.channel.snr_db / 20.0) / np.sqrt(2.0)
    noise = rng.standard_normal((2, *frames.shape)) * amplitude
    return (frames + noise[0] + 1j * noise[1]).ravel()


def draw(path: Path, seed: int) -> None:
    """All panels into one PNG."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    path.parent.mkdir(parents=True, exist_ok=True)  # first: drawing takes seconds
    figure, axes = plt.subplots(4, 3, figsize=(5.6, 7.4), sharex=True, sharey=True, constrained_layout=True)
    for axis, (name, title) in zip(axes.flat, PANELS, strict=True):
        with tempfile.TemporaryDirectory() as folder:
            scene = with_recording(load_scene(name), Path(folder), seed)
            plane = spectrogram_db(received(scene, seed))
        half = scene.waveform.rate_hz / 2e6
        image = axis.imshow(
            plane,
            origin="lower",
            aspect="auto",
            extent=(0.0, 2.0 * scene.waveform.sweep_s * 1e3, -half, half),
            vmin=0.0,
            vmax=55.0,
            cmap="cividis",
            interpolation="nearest",
        )
        axis.set_title(title, fontsize=9)
    for axis in axes[:, 0]:
        axis.set_ylabel("frequency / MHz")
    for axis in axes[-1]:
        axis.set_xlabel("time / ms")
    figure.colorbar(image, ax=axes, label="power / dB", shrink=0.9, pad=0.01)
    figure.suptitle(
        f"Two sweeps: return of 200 m (the triangle),\ninterference at SIR {SIR_DB:g} dB, overlap 0.6, half-limit EVM",
        fontsize=10,
    )
    figure.savefig(path, dpi=180, metadata={"Title": TITLE})


def _parser() -> Parser:
    root = Path(__file__).resolve().parent.parent
    parser = Parser("gallery", __doc__)
    add = parser.add_argument
    add(
        "--out",
        type=path,
        default=root / "docs" / "interference_gallery.png",
        help="PNG, SVG or PDF (default: docs/interference_gallery.png)",
    )
    add("--seed", type=number(int, 0, MAX_SEED), default=1, help="default: %(default)s")
    return parser


@command("gallery")
def main(argv: Sequence[str] | None = None) -> int:
    """Draw the gallery; returns 0, or 2 after one line about an error."""
    parser = _parser()
    options = parser.parse_args(argv)
    if options.out.suffix not in (".png", ".svg", ".pdf"):
        parser.error(f"--out is {str(options.out)[-60:]!r}; it has to end in .png, .svg or .pdf")
    check_ours(options.out, TITLE)
    draw(options.out, options.seed)
    print(options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
