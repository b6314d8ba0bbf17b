"""Write a SigMF recording for scenes: a synthetic 5G downlink, or a transmitter of GNU Radio.

The downlink, for scenes/recorded.yaml, is as received by one antenna: idle resource blocks, two transmit antennas with
independent data on the same subcarriers, multipath from each, and receiver noise. ``--from`` runs a transmitter of GNU
Radio instead, for the scene of its name: DVB-T, DVB-T2, ATSC, DVB-S2 or OFDM packets. Both are simulated.

.venv/bin/python flowgraphs/make_recording.py
.venv/bin/python flowgraphs/ota_eval.py --sim --scene recorded
.venv/bin/python flowgraphs/make_recording.py --from dvbt
.venv/bin/python flowgraphs/ota_eval.py --sim --scene dvbt
.venv/bin/python flowgraphs/make_recording.py --antennas 1 --snr-db 20 --out results/one_antenna.sigmf-meta
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from ...core.interference.effects import ImpairedEmitter, Impairments
from ...core.interference.emitters import NamedEmitter
from ...core.interference.emitters.nr import frame_samples
from ...core.interference.multipath import FadingChannel
from ...core.interference.nr_config import NrConfig
from ...core.interference.transmission import Signal
from ..engine.options import MAX_SEED, Parser, check_ours, command, number, path
from ..transmitters import TRANSMITTERS, transmit

PROGRAM, COMMAND = "make_recording", "make-recording"

AUTHOR = "gr-radalt, make_recording.py"
FRAMES = 5  # length of the downlink, radio frames of 10 ms
BANDWIDTH_HZ = 10e6  # channel bandwidth: wider than the default sweep's 7.5 MHz
RATE_HZ = NrConfig(channel_bandwidth_hz=BANDWIDTH_HZ).sample_rate_hz
SECOND_DB = -6.0  # power of the second antenna's data over the first's: assumed
CREST = 5.0  # full scale over the RMS: OFDM exceeds 14 dB in one sample of 10^11
DOWNLINK = "nr"
SECONDS = 0.1  # length of a transmitter's recording
DOWNLINK_SNR_DB = 8.0  # noise of the downlink: usual for a recording at the edge of a cell


@dataclass(frozen=True, eq=False)
class _Looped(NamedEmitter):
    """Emitter that repeats its samples."""

    unit_power: ClassVar[bool] = True
    sent: np.ndarray

    def begin(self, rate_hz: float, rng: np.random.Generator) -> Signal:
        return lambda first, count: self.sent.take(np.arange(first, first + count), mode="wrap")


def received(antennas: int, load: float, snr_db: float, seed: int) -> np.ndarray:
    """(n,) complex128, mean power 1: antennas through independent channels (EVA), and noise."""
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
        path = Impairments(fading=FadingChannel(profile="EVA"))
        total = total + ImpairedEmitter(emitter=_Looped(sent), effects=path).begin(RATE_HZ, rng)(0, sent.size)
    return noisy(total / np.sqrt(np.mean(np.abs(total) ** 2)), snr_db, rng)


def noisy(samples: np.ndarray, snr_db: float, rng: np.random.Generator) -> np.ndarray:
    """(n,) complex128, mean power 1: samples of mean power 1 plus white noise."""
    noise = rng.standard_normal((samples.size, 2)).view(np.complex128)[:, 0]
    total = samples + np.sqrt(0.5 * 10 ** (-snr_db / 10)) * noise
    return total / np.sqrt(np.mean(np.abs(total) ** 2))


def write(meta: Path, samples: np.ndarray, rate_hz: float, description: str) -> None:
    """Write the recording as ``ci16_le`` next to its metadata."""
    meta.parent.mkdir(parents=True, exist_ok=True)
    rails = np.clip(np.rint(samples.view(np.float64) * (32767 / CREST)), -32768, 32767)
    rails.astype("<i2").tofile(meta.with_suffix(".sigmf-data"))
    head = {
        "core:datatype": "ci16_le",
        "core:sample_rate": rate_hz,
        "core:version": "1.0.0",
        "core:author": AUTHOR,
        "core:description": description,
        "core:license": "https://creativecommons.org/publicdomain/zero/1.0/",
    }
    text = {"global": head, "captures": [{"core:sample_start": 0}], "annotations": []}
    meta.write_text(json.dumps(text, indent=2) + "\n")


def _parser() -> Parser:
    parser = Parser("make_recording", __doc__)
    parser.option("--from", "", default=DOWNLINK, choices=(DOWNLINK, *TRANSMITTERS), dest="source")
    parser.option(
        "--out", "default: results/recorded.sigmf-meta, or results/NAME.sigmf-meta with --from NAME", path
    )
    parser.option("--antennas", "transmit antennas of the downlink", int, 2, choices=(1, 2))
    parser.option("--load", "fraction of the downlink's resource blocks in use", number(float, 0, 1), 0.7)
    parser.option(
        "--snr-db",
        f"SNR in the recording's rate (default: {DOWNLINK_SNR_DB:g} for {DOWNLINK}, no noise for the others)",
        number(float, -20, 60),
    )
    parser.option("--seed", "", number(int, 0, MAX_SEED), 1)
    return parser


@command("make_recording")
def main(argv: Sequence[str] | None = None) -> int:
    """Write the recording; returns 0, or 2 after one line about an error."""
    parser = _parser()
    args = parser.parse_args(argv)
    out = args.out or Path("results") / f"{'recorded' if args.source == DOWNLINK else args.source}.sigmf-meta"
    if out.suffix != ".sigmf-meta":
        parser.error(f"--out is {out.name[:60]!r}; it has to end in .sigmf-meta")
    check_ours(out, AUTHOR)
    if not out.exists():
        check_ours(out.with_suffix(".sigmf-data"), AUTHOR)
    snr_db = args.snr_db
    if args.source == DOWNLINK:
        snr_db = DOWNLINK_SNR_DB if snr_db is None else snr_db
        samples, rate_hz = received(args.antennas, args.load, snr_db, args.seed), RATE_HZ
        description = f"SYNTHETIC 10 MHz downlink, {args.antennas} antennas"
    else:
        one = TRANSMITTERS[args.source]
        samples, rate_hz = transmit(args.source, SECONDS, args.seed), one.rate_hz
        if snr_db is not None:
            samples = noisy(samples, snr_db, np.random.default_rng(args.seed))
        description = f"SYNTHETIC {one.title}, by GNU Radio's own blocks"
    write(out, samples, rate_hz, description if snr_db is None else f"{description}, SNR {snr_db:g} dB")
    print(out)
    return 0
