"""Write a SigMF recording of a synthetic 5G downlink, with what an antenna hears of it, for scenes/recorded.yaml.

Idle resource blocks, two transmit antennas with data of their own on the same subcarriers, multipath from each, and the
noise of the receiver that recorded it. No samples of it were on the air.

.venv/bin/python flowgraphs/make_recording.py
.venv/bin/python flowgraphs/ota_eval.py --sim --scene recorded
.venv/bin/python flowgraphs/make_recording.py --antennas 1 --snr-db 20 --out results/one_antenna.sigmf-meta
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...core.interference.emitters.nr import FFT_LENGTHS, SUBCARRIER_SPACING_HZ, frame_samples
from ...core.interference.multipath import FadingChannel
from ...core.interference.nr_grid import NrConfig
from ..engine.options import MAX_SEED, Parser, command, number, path

PROGRAM, COMMAND = "make_recording", "make-recording"

FRAMES = 5  # of 10 ms
BANDWIDTH_HZ = 10e6
RATE_HZ = FFT_LENGTHS[BANDWIDTH_HZ] * SUBCARRIER_SPACING_HZ
SECOND_DB = -6.0  # the second antenna's data against the first's
CREST = 5.0  # full scale over the root mean square


def heard(antennas: int, load: float, snr_db: float, seed: int) -> np.ndarray:
    """(n,) complex128, mean power 1: the sum of the antennas through a channel each (EVA), and noise."""
    rng = np.random.default_rng(seed)
    total = 0.0
    for antenna in range(antennas):
        config = NrConfig(
            channel_bandwidth_hz=BANDWIDTH_HZ,
            cell_id=101,
            load=load,
            frame_count=FRAMES,
            seed=seed + antenna,
            ssb_indices=() if antenna else (0,),
        )
        sent = frame_samples(config)
        sent *= 10 ** (antenna * SECOND_DB / 20) / np.sqrt(np.mean(np.abs(sent) ** 2))
        total = total + FadingChannel(profile="EVA").apply(sent[None], RATE_HZ, rng)[0]
    total /= np.sqrt(np.mean(np.abs(total) ** 2))
    noise = rng.standard_normal((total.size, 2)).view(np.complex128)[:, 0]
    total += np.sqrt(0.5 * 10 ** (-snr_db / 10)) * noise
    return total / np.sqrt(np.mean(np.abs(total) ** 2))


def write(meta: Path, samples: np.ndarray, description: str) -> None:
    """The recording as ``ci16_le`` beside its metadata."""
    meta.parent.mkdir(parents=True, exist_ok=True)
    rails = np.clip(np.rint(samples.view(np.float64) * (32767 / CREST)), -32768, 32767)
    rails.astype("<i2").tofile(meta.with_suffix(".sigmf-data"))
    head = {
        "core:datatype": "ci16_le",
        "core:sample_rate": RATE_HZ,
        "core:version": "1.0.0",
        "core:author": "gr-radalt, make_recording.py",
        "core:description": description,
        "core:license": "https://creativecommons.org/publicdomain/zero/1.0/",
    }
    text = {"global": head, "captures": [{"core:sample_start": 0}], "annotations": []}
    meta.write_text(json.dumps(text, indent=2) + "\n")


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    add = parser.add_argument
    add("--out", type=path, default=Path("results/recorded.sigmf-meta"), help="default: %(default)s")
    add("--antennas", type=int, choices=(1, 2), default=2, help="transmit antennas (default: %(default)s)")
    add("--load", type=number(float, 0, 1), default=0.7, help="share of blocks in use (default: %(default)s)")
    add(
        "--snr-db", type=number(float, -20, 60), default=8.0, help="over its 15.36 MHz (default: %(default)s)"
    )
    add("--seed", type=number(int, 0, MAX_SEED), default=1, help="default: %(default)s")
    return parser


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Write it; returns 0, or 2 after one line about what does not fit."""
    parser = _parser()
    args = parser.parse_args(argv)
    if args.out.suffix != ".sigmf-meta":
        parser.error(f"--out is {args.out.name[:60]!r}; it has to end in .sigmf-meta")
    description = f"SYNTHETIC 10 MHz downlink, {args.antennas} antennas, SNR {args.snr_db:g} dB"
    write(args.out, heard(args.antennas, args.load, args.snr_db, args.seed), description)
    print(args.out)
    return 0
