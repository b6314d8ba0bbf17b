"""The second receive channel of the simulated radio: another antenna, the same LO and sample clock."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..parsing import Settings, setting
from ..waveform import Waveform, exp_cycles
from .noise import ReceiverNoise

# Noise of a converter in steps per rail, rms: 11 of 12 bits are effective, and what is below a step does not vanish
_CONVERTER_NOISE = 0.5
# full scale over the input's rms while interference lasts: gains are set for the scene, 12 dB
_HEADROOM = 4.0
_RIPPLE_S = 200e-9  # delay of the reflection that makes the ripple, s: in 20 m of cable, to and fro
_MOST_DELAY_S = 1e-5  # largest delay between antennas or of an echo, s: 3 km


@dataclass(frozen=True, kw_only=True)
class Direction(Settings, where="auxiliary.directions"):
    """How the two antennas receive an emitter."""

    gain_db: float = 6.0
    """Power in the second channel over that in the first."""
    delay_s: float = setting(3e-9, -_MOST_DELAY_S, _MOST_DELAY_S)
    """Delay of the second channel against the first."""
    phase_deg: float | None = None
    """Phase of the second channel against the first; None draws it. An emitter in the return's direction has
    ``gain_db`` of minus the isolation, ``delay_s`` 0 and ``phase_deg`` 0."""
    doppler_hz: float = setting(0.0, -1e4, 1e4)
    """Frequency difference of the second channel against the first."""
    echo_db: float | None = None
    """Power of a second path over the first, in both channels, each with its own phase; None for no second path."""
    echo_s: float = setting(500e-9, 0.0, _MOST_DELAY_S)
    """Delay of the second path."""


@dataclass(frozen=True, kw_only=True)
class AuxiliarySettings(Settings, where="auxiliary"):
    """A second receive channel that is coherent with the first, as simulated; with radios, that it is there."""

    directions: tuple[Direction, ...] = (Direction(),)
    """One for every interferer, in their order; a single one is that of all."""
    isolation_db: float = setting(20.0, -20.0, 100.0)
    """How much weaker the second channel receives the return."""
    noise_db: float = 0.0
    """Noise of the second channel over the first's."""
    ripple_db: float = setting(0.2, 0.0, 6.0)
    """Peak of the ripple over the band by which the channels differ for interference."""
    image_db: float | None = -50.0
    """Power of the image in either channel, with a phase of its own; None for none."""
    third_order_db: float | None = -60.0
    """Third-order product of a tone of full scale in either channel, over the tone; None for none."""
    adc_bits: int = setting(12, 0, 16)
    """Resolution of both converters, whose own noise is half a step; 0 for none."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.directions:
            raise ValueError("auxiliary.directions is empty; give one, or leave the key out")


class AuxiliaryReceiver:
    """What the second channel receives, frame by frame, and the front ends of both.

    ``interference``: mean power from each direction in the first channel while it lasts, over the return's;
    ``noise``: noise power of the first channel over the return's.
    """

    def __init__(
        self,
        waveform: Waveform,
        settings: AuxiliarySettings,
        interference: tuple[float, ...],
        noise: float,
        seed: int,
    ) -> None:
        self.settings, self._waveform = settings, waveform
        self.directions = settings.directions
        rng = np.random.default_rng([seed, 0xA0C])
        drawn = exp_cycles(rng.random((len(self.directions) + 1, 4)), np.complex128)
        self._phases, self._front_ends = drawn[:-1], drawn[-1].reshape(2, 2)
        n = waveform.samples_per_frame
        self._noise, *self._converters = (ReceiverNoise(n, [seed, 0x402, k]) for k in range(3))
        self.noise = noise * 10 ** (settings.noise_db / 10)
        gains = [10 ** (direction.gain_db / 10) for direction in self.directions]
        second = sum(gain * power for gain, power in zip(gains, interference, strict=False))
        leak = 10 ** (-settings.isolation_db / 10)
        powers = np.array([1.0 + sum(interference) + noise, leak + second + self.noise])
        self._full_scale = np.sqrt(powers) * _HEADROOM

    @property
    def reach_s(self) -> tuple[float, float]:
        """Least and largest delay against the first channel, in seconds."""
        delays = [d.delay_s for d in self.directions]
        return min(0.0, *delays), max(0.0, *delays) + max(d.echo_s for d in self.directions) + _RIPPLE_S

    def skip(self, frames: int) -> None:
        """Go on as after so many frames."""
        for noise in (self._noise, *self._converters):
            noise.skip(frames)

    def receive(
        self, block: int, echo: np.ndarray, read: Callable[[int, float], np.ndarray] | None
    ) -> tuple[np.ndarray | float, np.ndarray]:
        """Interference of the first channel and signal of the second without noise, (1, N) each, in frame ``block``.

        ``echo`` is the return, ``read(k, seconds)`` interference from direction ``k`` delayed further, if there is any.
        """
        first: np.ndarray | float = 0.0
        second = 10 ** (-self.settings.isolation_db / 20) * np.atleast_2d(echo)
        seconds = self._waveform.sample_times_s + block * self._waveform.sweep_s
        ripple = 10 ** (self.settings.ripple_db / 20) - 1
        for k, (direction, phases) in enumerate(zip(self.directions, self._phases, strict=True)):
            if read is None:
                break
            phase = phases[0] if direction.phase_deg is None else np.exp(1j * np.deg2rad(direction.phase_deg))
            gain = 10 ** (direction.gain_db / 20) * phase * exp_cycles(direction.doppler_hz * seconds)
            late = direction.delay_s
            mine, theirs = read(k, 0.0), read(k, late) + ripple * phases[3] * read(k, late + _RIPPLE_S)
            if direction.echo_db is not None:
                level = 10 ** (direction.echo_db / 20)
                direct = 1 / np.sqrt(1 + 10 ** (direction.echo_db / 10))  # the SIR is that of both paths
                mine = direct * (mine + level * phases[1] * read(k, direction.echo_s))
                theirs = direct * (theirs + level * phases[2] * read(k, late + direction.echo_s))
            first, second = first + mine, second + gain * theirs
        return first, second

    def finish(self, out: np.ndarray, channel: int, gain: float = 1.0) -> None:
        """Noise of the second channel, then the front end of either, in place; ``gain`` is the amplitude so far."""
        s, full_scale = self.settings, self._full_scale[channel] * gain
        if channel and self.noise:
            self._noise.add(out, self.noise * gain**2)
        phases = self._front_ends[channel]
        if s.third_order_db is not None:
            product = 10 ** (s.third_order_db / 20) / full_scale**2 * phases[0]
            out += np.complex64(product) * out * (out.real**2 + out.imag**2)
        if s.image_db is not None:
            out += np.complex64(10 ** (s.image_db / 20) * phases[1]) * out.conj()
        if s.adc_bits:
            step = full_scale / 2 ** (s.adc_bits - 1)
            self._converters[channel].add(out, 2 * (_CONVERTER_NOISE * step) ** 2)
            convert(out, s.adc_bits, full_scale)


def convert(out: np.ndarray, bits: int, full_scale: float) -> None:
    """Quantise and clip both rails of complex64 samples in place; ``full_scale`` is the amplitude of a rail."""
    rails = out.view(np.float32)
    step = np.float32(full_scale / 2 ** (bits - 1))
    top = 2 ** (bits - 1) - 1
    # one bit is mid-rise, since a mid-tread converter has a level at zero; from two bits on mid-tread
    levels = np.sign(rails) * 0.5 if bits == 1 else np.clip(np.rint(rails / step), -top - 1, top)
    rails[:] = levels * step
