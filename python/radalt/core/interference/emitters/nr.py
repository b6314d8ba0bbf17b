"""5G NR downlink as an interferer: OFDM (TS 38.211 clause 5.3.1), reception at the radar's rate, emitter.

The carrier is generated at its native rate (or a multiple, where its offset needs it) and shifted to its offset. It is
then filtered as in a receiver, resampled by polyphase filters and cached. Windows are cut from the cache.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ...parsing import LARGEST, setting
from ...waveform import read_only
from ..evm import evm_title
from ..nr_config import SUBCARRIER_SPACING_HZ, NrConfig
from ..nr_grid import resource_grid, transmitted
from ..receiver_filter import repeated, resample_periodic
from ..transmission import Signal
from . import NamedEmitter, register

if TYPE_CHECKING:
    from ..amplifier import Amplifier

FRAME_SECONDS = 10e-3  # radio frame, TS 38.211 clause 4.3.1
_AMPLIFIED = 4  # rate of the amplifier over the native rate: products up to the seventh order alias outside the carrier
# symbols of 15 kHz spacing in 0.5 ms, after which the long cyclic prefix comes again
HALF_SUBFRAME_SYMBOLS = 7


def cyclic_prefix_lengths(fft_length: int, spacing_hz: float = SUBCARRIER_SPACING_HZ) -> np.ndarray:
    """Normal cyclic prefix of the symbols of 0.5 ms in samples, clause 5.3.1: (7,) int, or (14,) of 30 kHz.

    144 kappa T_c 2^-mu, and 16 kappa T_c more in the first; kappa T_c is one sample at 30.72 MHz. ``fft_length`` is a
    multiple of 128 (whole samples).
    """
    step = round(spacing_hz / SUBCARRIER_SPACING_HZ)
    lengths = np.full(HALF_SUBFRAME_SYMBOLS * step, 144 * fft_length // 2048)
    lengths[0] += 16 * step * fft_length // 2048
    return lengths


def ofdm_modulate(
    values: np.ndarray, fft_length: int, spacing_hz: float = SUBCARRIER_SPACING_HZ
) -> np.ndarray:
    """CP-OFDM, TS 38.211 clause 5.3.1: s(t) = sum_k a_k exp(j 2 pi (k - N_sc/2) df (t - N_CP T_c - t_start)).

    ``values`` (subcarriers, symbols) are whole slots from the start of a subframe on; ``fft_length``, a multiple of
    128, is rate / spacing. Returns complex128 (15 fft_length per slot of 15 kHz,), whose mean power is the sum of
    |a_k|^2.
    """
    subcarriers, symbols = values.shape
    spectrum = np.zeros((symbols, fft_length), dtype=np.complex128)
    half = subcarriers // 2
    spectrum[:, : subcarriers - half] = values[half:].T
    spectrum[:, fft_length - half :] = values[:half].T
    useful = np.fft.ifft(spectrum, axis=1) * fft_length
    # One gather adds the prefixes of the symbols of each half subframe: sample n of symbol l is
    # useful sample (n - N_CP,l) mod N.
    prefix = cyclic_prefix_lengths(fft_length, spacing_hz)
    gather = [
        number * fft_length + np.mod(np.arange(-length, fft_length), fft_length)
        for number, length in enumerate(prefix)
    ]
    return useful.reshape(-1, prefix.size * fft_length)[:, np.concatenate(gather)].ravel()


def frame_samples(config: NrConfig, fft_length: int | None = None) -> np.ndarray:
    """All `frame_count` frames of a carrier at spacing * fft_length (native rate if None), frame 0 first.

    Returns complex128 (10 ms of each,), unscaled (see `ofdm_modulate`); payload by seed.
    """
    rng = np.random.default_rng(config.seed)
    length = config.fft_length if fft_length is None else fft_length
    # a generator of its own, so that the payload equals the ideal carrier's
    errors = np.random.default_rng([config.seed, 0xE7])
    frames = [
        ofdm_modulate(transmitted(resource_grid(config, rng), errors), length, config.subcarrier_spacing_hz)
        for _ in range(config.frame_count)
    ]
    return np.concatenate(frames)


@register
@dataclass(frozen=True, kw_only=True)
class NrEmitter(NamedEmitter, NrConfig):
    """An NR downlink carrier behind the radar's receiver filter: emitter protocol.

    A transmission has a uniform start and carrier phase in a cached signal of `frame_count` frames that repeats
    without a seam. Mean power over that signal is 1 after the filter.
    """

    scene_name: ClassVar[str] = "nr"
    unit_power: ClassVar[bool] = True

    carrier_hz: float = setting(0.0, -LARGEST, LARGEST)
    """Offset of the NR carrier's centre from the radar's centre frequency."""

    @property
    def label(self) -> str:
        """See `NamedEmitter.label`: with the channel bandwidth in MHz."""
        return f"{self.scene_name}{self.channel_bandwidth_hz / 1e6:g}"

    def title(self, band_hz: float) -> str:
        """See `NamedEmitter.title`."""
        return f"5G NR, {self.channel_bandwidth_hz / 1e6:g} MHz, {evm_title(self.evm)}"

    def begin(self, rate_hz: float, rng: np.random.Generator) -> Signal:
        """Draw a transmission: random start and phase, mean power 1 over its period.

        Raises ValueError if the carrier lies outside the receiver's band or the rate is no small ratio of the native
        rate and a multiple of 100 Hz.
        """
        signal, residual_hz = self.period(rate_hz)
        return repeated(signal, residual_hz / rate_hz, rng)

    def period(self, rate_hz: float, amplifier: "Amplifier | None" = None) -> tuple[np.ndarray, float]:
        """One period of the received signal, for streaming: (frame_count * 10 ms * rate,) complex128, and Hz.

        The array (read-only, cached, unit mean power) repeats without a seam. It holds the carrier at a multiple of
        100 Hz; the second value, within +-50 Hz, is the remaining shift. An ``amplifier`` acts on the transmitted
        signal, at four times the carrier's rate or more. Raises as `begin`.
        """
        return _received(self, float(rate_hz), amplifier)


def _internal_fft_length(emitter: NrEmitter, rate_hz: float) -> int:
    """FFT length at which aliases of the shifted carrier stay outside the receiver's band."""
    need_hz = abs(emitter.carrier_hz) + emitter.sample_rate_hz / 2 + rate_hz / 2
    length = emitter.fft_length
    while length * emitter.subcarrier_spacing_hz < need_hz:
        length *= 2
    return length


@lru_cache(maxsize=8)  # a period of a second is 120 MB
def _received(emitter: NrEmitter, rate_hz: float, amplifier: "Amplifier | None") -> tuple[np.ndarray, float]:
    """See `NrEmitter.period`."""
    reach_hz = rate_hz / 2 + emitter.occupied_bandwidth_hz / 2
    if abs(emitter.carrier_hz) >= reach_hz:
        raise ValueError(
            f"carrier_hz {emitter.carrier_hz:g} puts the NR carrier outside the receiver's band; "
            f"keep |carrier_hz| below {reach_hz:g}"
        )
    length = _internal_fft_length(emitter, rate_hz)
    if amplifier is not None:  # room for spectral regrowth
        length = max(length, _AMPLIFIED * emitter.fft_length)
    sent = frame_samples(emitter, length)
    sent_energy = np.vdot(sent, sent).real
    if sent_energy == 0.0:
        raise ValueError("the NR carrier sends nothing; give ssb_indices, or a load or pdcch_load above 0")
    if amplifier is not None:
        sent = amplifier.amplify(sent, sent_energy / sent.size)
    # Only multiples of 100 Hz repeat with the 10 ms frame; the rest (up to 50 Hz) is added to each window.
    steps = round(emitter.carrier_hz * FRAME_SECONDS)
    frame_length = sent.size // emitter.frame_count
    ramp = np.exp(2j * np.pi * (steps * np.arange(frame_length) % frame_length) / frame_length)
    shifted = (sent.reshape(-1, frame_length) * ramp).ravel()
    received = resample_periodic(shifted, length * emitter.subcarrier_spacing_hz, rate_hz)
    received = read_only(received / np.sqrt(np.vdot(received, received).real / received.size))
    return received, emitter.carrier_hz - steps / FRAME_SECONDS
