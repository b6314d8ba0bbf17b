"""A recording as an interferer: shifted into the band and placed like every emitter."""

import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

import numpy as np

from ...parsing import LARGEST, InputError, check_file, setting, shown
from ...raw_file import RawFile, open_raw
from ...sigmf_file import SigmfFile, open_sigmf
from ...waveform import read_only
from ..own_noise import MOST_DB, prefix_snr_db
from ..receiver_filter import rate_ratio, repeated, resample_periodic
from ..transmission import Signal
from . import NamedEmitter, register

_MOST_S = 1.0  # longest part of a recording in use, s: 120 MB at 7.5 MS/s
_MOST_BYTES = 1 << 40  # largest file, bytes: five hours at 7.5 MS/s, complex64
_MOST_UP = 16  # largest oversampling for the frequency shift: beyond it the offset is a mistake of the scene
_RATES_HZ = (1e3, 1e9)  # sample rates that are read, Hz
_REMEDY = "name another file, or make one by radalt make-recording"
# Smallest share of the power that is signal: ten times the receiver filter's stop band (80 dB).
_FOLDED = 1e-7


@register
@dataclass(frozen=True, kw_only=True)
class RecordingEmitter(NamedEmitter):
    """Samples of a file behind the radar's receiver filter: emitter protocol, mean power 1.

    The file is opened and checked when samples are first needed. It contains the noise of its receiver, which
    demodulation cannot remove; an estimate of it is a note of the report, next to licence, author and description.
    """

    scene_name: ClassVar[str] = "recording"
    unit_power: ClassVar[bool] = True

    file: str = ""
    """A ``.sigmf-meta`` or archive of one complex channel; NumPy's ``.npy``, complex or real of shape (n, 2), with
    ``rate_hz``; a WAV of two channels, I and Q; or raw samples, with ``rate_hz`` and ``datatype``."""
    offset_hz: float = setting(0.0, -LARGEST, LARGEST)
    """Frequency shift: the recording's centre relative to the radar's afterwards. Rounded to a whole number of cycles
    over ``seconds``."""
    start_s: float = setting(0.0, 0.0, LARGEST)
    """Start of the part of the file in use."""
    seconds: float = setting(0.1, 1e-4, _MOST_S)
    """Length of that part, which repeats."""
    rate_hz: float | None = setting(None, *_RATES_HZ)
    """Sample rate; SigMF and WAV state theirs."""
    datatype: str = ""
    """Format of raw samples as in SigMF: ``cf32_le``, ``ci16_le``, ``ci8``, ``cu8``."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.file:
            raise ValueError("recording.file is missing; name a .sigmf-meta file, or raw samples")

    @property
    def label(self) -> str:
        """See `NamedEmitter.label`: with the file's name."""
        return "recording_" + re.sub(r"[^A-Za-z0-9.-]+", "-", Path(self.file).stem)

    def title(self, band_hz: float) -> str:
        """See `NamedEmitter.title`."""
        return f"recording {Path(self.file).stem}"

    def notes(self, rate_hz: float) -> tuple[str, ...]:
        """Origin and licence by the metadata, and the noise of the recording (`prefix_snr_db`)."""
        name = Path(self.file).name
        try:
            opened = _open(self)
            snr_db = prefix_snr_db(self.load(rate_hz), rate_hz)
        except ValueError:  # `samples` raises it
            return ()
        said = ((word, opened.head.get(f"core:{word}")) for word in ("license", "author", "description"))
        above = "above the recording's noise (coherence of its prefix)"
        if snr_db is None:
            noise = f"{name}: no OFDM found, so its noise is not known"
        elif snr_db == MOST_DB:
            noise = f"{name}: OFDM {snr_db:.0f} dB or more {above}"
        else:
            noise = (
                f"{name}: OFDM {snr_db:.1f} dB {above}; "
                f"demodulation gains at most {10 * np.log10(1 + 10 ** (snr_db / 10)):.1f} dB"
            )
        return (*opened.notes, *(f"{name}: {word} {shown(text)}" for word, text in said if text), noise)

    def load(self, rate_hz: float) -> np.ndarray:
        """The part in use behind the receiver's filter, at ``rate_hz``: (n,) complex128, mean power 1, read-only."""
        return _received(self, float(rate_hz))

    def begin(self, rate_hz: float, rng: np.random.Generator) -> Signal:
        """Draw a transmission: random start and phase; the part in use repeats."""
        return repeated(self.load(rate_hz), 0.0, rng)


def _open(emitter: RecordingEmitter) -> SigmfFile | RawFile:
    """The file; raises ValueError."""
    path = Path(emitter.file)
    try:
        check_file(path, most_bytes=_MOST_BYTES, what="recording.file", remedy=_REMEDY)
        bare = not (emitter.datatype or emitter.rate_hz or path.suffix.lower() == ".wav")
        if bare and (".sigmf" in path.name or path.with_suffix(".sigmf-meta").is_file()):
            return open_sigmf(path)
        if ".sigmf" in path.name and not path.name.endswith("-data"):
            raise InputError(f"{path}: SigMF states rate and type; leave out rate_hz and datatype")
        return open_raw(path, emitter.datatype, emitter.rate_hz)
    except InputError as error:
        raise ValueError(f"recording.file: {error}") from None


@lru_cache(maxsize=4)
def _received(emitter: RecordingEmitter, rate_hz: float) -> np.ndarray:
    """The part of the file in use, filtered, shifted and at the radar's rate, mean power 1; read-only."""
    recording = _open(emitter)
    source_hz = recording.rate_hz
    if not _RATES_HZ[0] <= source_hz <= _RATES_HZ[1]:
        raise ValueError(f"recording.file {emitter.file} has the rate {shown(source_hz)}; 1e3..1e9 is read")
    ratio = rate_ratio(rate_hz, source_hz)
    first = round(emitter.start_s * source_hz)
    count = min(round(emitter.seconds * source_hz), recording.sample_count - first)
    count -= count % ratio.denominator
    if count < ratio.denominator or count < 16:
        raise ValueError(
            f"recording.start_s is {emitter.start_s:g}, and {emitter.file} lasts "
            f"{recording.sample_count / source_hz:g} s; start earlier"
        )
    samples = recording.read(first, count).astype(np.complex128)
    if not (np.isfinite(samples.view(np.float64)).all() and samples.any()):
        raise ValueError(f"recording.file {emitter.file} is not finite, or zeros alone; start elsewhere")
    # oversample so that the shifted signal does not alias
    up = int(np.ceil((2 * abs(emitter.offset_hz) + source_hz) / source_hz))
    if up > _MOST_UP:
        raise ValueError(
            f"recording.offset_hz {emitter.offset_hz:g} is far beyond the file's rate {source_hz:g}; "
            f"at most {(_MOST_UP - 1) * source_hz / 2:g}"
        )
    if up > 1:
        from scipy import signal  # see core/fir.py

        samples = signal.resample(samples, up * count)
    if emitter.offset_hz:
        cycles = round(emitter.offset_hz * count / source_hz)
        samples = samples * np.exp(
            2j * np.pi * (np.arange(samples.size) * cycles % samples.size) / samples.size
        )
    received = resample_periodic(samples, up * source_hz, rate_hz)
    power = np.vdot(received, received).real / received.size
    if not power > _FOLDED * np.vdot(samples, samples).real / samples.size:
        raise ValueError(
            f"recording.offset_hz {emitter.offset_hz:g} leaves nothing of {emitter.file} in the radar's band; "
            f"keep it within {rate_hz / 2:g} of what was recorded"
        )
    return read_only(received / np.sqrt(power))
