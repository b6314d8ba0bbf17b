"""Impairments between an ideal emitter and the radar: amplifier, continuous fading, oscillators.

Each is a key of an interferer in a scene and off by default. `ImpairedEmitter` applies them before placement, so SIR
and overlap hold as for every emitter. Fading and sample clock offset are one time-variant filter: its responses at a
few Chebyshev nodes of a block are applied in the frequency domain, and the outputs are interpolated in time.
"""

import dataclasses
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy import fft

from ..parsing import Settings, build, plain, setting
from ..waveform import exp_cycles
from .amplifier import AmplifiedEmitter, Amplifier
from .emitters import NamedEmitter
from .multipath import FadingChannel
from .placement import Emitter
from .transmission import InFrames, Signal, begin, in_drawn_blocks

# Guard on either side of a block, samples, for the tails of fractional delays; the outer half is tapered.
_GUARD = 128
_TAPER = np.hanning(_GUARD + 2)[1 : _GUARD // 2 + 1]
_BLOCK = 1 << 14  # longest block of the filter, samples: its FFTs stay in the second-level cache
_INTERPOLATION = 3e-4  # largest amplitude error of the interpolation in time: -70 dB, below every EVM
# Step at which phase noise is drawn, times 2 pi bandwidth, rad: between steps the rms is 1 % too low.
_STEP_RAD = 0.06
_DRAWN = 1024  # numbers of phase noise drawn at once


@dataclass(frozen=True, kw_only=True)
class PhaseNoise(Settings, where="phase_noise"):
    """Phase noise of the two oscillators together: a Gaussian process of first order (Lorentzian spectrum).

    Its autocorrelation is rms^2 exp(-2 pi bandwidth |t|), as behind a phase-locked loop of that bandwidth.
    """

    rms_deg: float = setting(1.0, 0.0, 60.0)
    """Root mean square; 1 degree alone is an EVM of 1.7 %."""
    bandwidth_hz: float = setting(10e3, 1.0, 1e6)
    """One-sided 3 dB bandwidth."""

    def begin(self, rate_hz: float, rng: np.random.Generator) -> Signal:
        """Draw the process: its phase in cycles as a function of time."""
        step = max(1, int(_STEP_RAD * rate_hz / (2 * np.pi * self.bandwidth_hz)))  # samples between nodes
        decay = 2 * np.pi * self.bandwidth_hz * step / rate_hz
        kept, memory = np.exp(-decay), int(np.ceil(16.0 / decay))  # what is left out of the past: exp(-16)
        scale = self.rms_deg / 360.0 * np.sqrt(1.0 - kept**2)
        drawn = in_drawn_blocks(lambda own: own.standard_normal(_DRAWN) * scale, _DRAWN, rng, keep=4)

        def cycles(first: int, count: int) -> np.ndarray:
            from scipy import signal  # see core/fir.py

            oldest, within = divmod(first, step)
            number = (within + count - 1) // step + 2
            nodes = signal.lfilter([1.0], [1.0, -kept], drawn(oldest - memory, memory + number))[memory:]
            steps = np.diff(nodes)
            # nodes are evenly spaced, so lines between them are rows of an outer product
            lines = nodes[:-1, None] + steps[:, None] * (np.arange(step) / step)
            return lines.ravel()[within : within + count]

        return cycles


@dataclass(frozen=True, kw_only=True)
class Oscillator(Settings, where="oscillator"):
    """Carrier frequency offset and sample clock offset of the emitter against the radar."""

    carrier_offset_hz: float = setting(0.0, -1e5, 1e5)
    """Carrier frequency offset."""
    clock_ppm: float = setting(0.0, -100.0, 100.0)
    """Sample clock offset; positive where the emitter's clock is faster."""


@dataclass(frozen=True, kw_only=True)
class Impairments:
    """Impairments of one emitter, in the order of the signal path; None leaves one out."""

    amplifier: Amplifier | None = None
    """Power amplifier of the transmitter, by Rapp's model, without conversion of amplitude to phase."""
    fading: FadingChannel | None = None
    """Multipath, continuous from frame to frame in a jammer's stream; the SIR of a free-running emitter holds in the
    mean over a channel that moves, else in every frame."""
    oscillator: Oscillator | None = None
    """Carrier frequency offset and sample clock offset against the radar."""
    phase_noise: PhaseNoise | None = None
    """Phase noise of both oscillators together, Gaussian with a Lorentzian spectrum."""

    @property
    def words(self) -> tuple[str, ...]:
        """Names of the impairments, for headings."""
        names = []
        if self.amplifier is not None:
            names.append(f"amplifier {self.amplifier.backoff_db:g} dB backed off")
        if self.fading is not None:
            names.append(f"fading {self.fading.profile}, {self.fading.doppler_hz:g} Hz")
        if self.oscillator is not None:
            offset = self.oscillator
            names.append(f"{offset.carrier_offset_hz:g} Hz and {offset.clock_ppm:g} ppm off")
        if self.phase_noise is not None:
            names.append(f"phase noise {self.phase_noise.rms_deg:g} degrees")
        return tuple(names)


KEYS = tuple(field.name for field in dataclasses.fields(Impairments))


@dataclass(frozen=True, kw_only=True)
class ImpairedEmitter(NamedEmitter):
    """An emitter with impairments: emitter protocol, mean power 1 in the long run.

    `samples` draws the channel and the oscillators anew. `JammerStream` keeps them continuous.

    >>> ImpairedEmitter(emitter=NrEmitter(), effects=Impairments(phase_noise=PhaseNoise()))  # doctest: +SKIP
    """

    emitter: Emitter
    effects: Impairments

    @property
    def unit_power(self) -> bool:
        """Whether its mean power is 1 without being measured: a draw of a channel that does not move has its own."""
        return self.effects.fading is None or self.effects.fading.doppler_hz > 0

    @property
    def label(self) -> str:
        """See `NamedEmitter.label`: that of the ideal emitter."""
        return self.emitter.label

    def title(self, band_hz: float) -> str:
        """See `NamedEmitter.title`: with the effects."""
        return ", ".join((self.emitter.title(band_hz), *self.effects.words))

    @property
    def stated_sir_db(self) -> float | None:
        """Level by the ideal emitter's link budget; the impairments do not change it."""
        return self.emitter.stated_sir_db

    @property
    def always_in_window(self) -> bool:
        """Whether the emitter draws windows in which it is received."""
        return getattr(self.emitter, "always_in_window", False)

    def notes(self, rate_hz: float) -> tuple[str, ...]:
        """Notes of the emitter itself."""
        return self.emitter.notes(rate_hz)

    @property
    def source(self) -> Emitter:
        """The emitter behind its amplifier, if it has one."""
        if self.effects.amplifier is None:
            return self.emitter
        return AmplifiedEmitter(emitter=self.emitter, amplifier=self.effects.amplifier)

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """(count,) complex128 at `rate_hz`; see `Emitter`."""
        return Path(self, count).samples(count, rate_hz, rng)

    def begin(self, rate_hz: float, rng: np.random.Generator) -> Signal:
        """Draw channel and oscillators, and a transmission of the emitter; SIR before fading."""
        moving = _Moving(self.effects, rate_hz, rng)
        sent = begin(self.source, rate_hz, rng)
        return lambda first, count: moving.received(sent, first, count)


class Path(InFrames):
    """Channel and oscillators that go on, of an emitter that is drawn anew in every frame: emitter protocol.

    The emitter is an `ImpairedEmitter`.
    """

    _moving: "_Moving | None" = None

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """See `Emitter`; the next call is for the next frame."""
        if self._moving is None:
            self._moving = _Moving(self.emitter.effects, rate_hz, rng)
        moving, source = self._moving, self.emitter.source
        first = self._next_first()
        start, before, after = moving.span(first, count)
        # the emission has to lie inside the frame, not in the filter's margins
        if self.emitter.always_in_window:
            window = np.pad(source.samples(count, rate_hz, rng), (before, after))
        else:
            window = source.samples(before + count + after, rate_hz, rng)

        def sent(at: int, number: int) -> np.ndarray:
            return window[at - start : at - start + number]

        blocks = range(first, first + count, _BLOCK)
        received = [moving.received(sent, at, min(_BLOCK, first + count - at)) for at in blocks]
        return received[0] if len(received) == 1 else np.concatenate(received)


class _Moving:
    """Fading, sample clock, carrier and phase noise: one draw of them, by absolute time."""

    def __init__(self, effects: Impairments, rate_hz: float, rng: np.random.Generator) -> None:
        self._filter = _MovingFilter(effects, rate_hz, rng)
        self._step = effects.oscillator.carrier_offset_hz / rate_hz if effects.oscillator else 0.0
        self._noise = None if effects.phase_noise is None else effects.phase_noise.begin(rate_hz, rng)
        self.span = self._filter.span

    def received(self, sent: Signal, first: int, count: int) -> np.ndarray:
        """(count,) received samples from number ``first`` on."""
        start, before, after = self.span(first, count)
        part = sent(start, before + count + after)
        part = self._filter.apply(part, first, count) if self._filter.moves else part
        cycles = None if self._noise is None else self._noise(first, count)
        if self._step:
            offset = np.mod(first * self._step, 1.0) + self._step * np.arange(count)
            cycles = offset if cycles is None else cycles + offset
        if cycles is None:
            return part
        # after reduction to one cycle, single precision has a phase error of 1e-7, at a fifth of the time
        return part * exp_cycles((cycles - np.rint(cycles)).astype(np.float32))


class _MovingFilter:
    """Fading and sample clock offset as one time-variant filter: one draw of the channel, by absolute time."""

    def __init__(self, effects: Impairments, rate_hz: float, rng: np.random.Generator) -> None:
        self._channel, self._rate_hz = effects.fading, rate_hz
        self._slip = 1e-6 * effects.oscillator.clock_ppm if effects.oscillator else 0.0
        self._paths = None if self._channel is None else self._channel.draw(rng)
        self.moves = bool(self._slip) or self._paths is not None

    def span(self, first: int, count: int) -> tuple[int, int, int]:
        """First input sample of a block of ``count`` output samples, and the extra samples before and after them."""
        if not self.moves:
            return first, 0, 0
        delay = 0.0 if self._channel is None else self._channel.delays_s.max() * self._rate_hz
        before = int(np.ceil(delay)) + _GUARD
        # a block of its ends may begin and end a sample apart
        slip = int(np.ceil(abs(self._slip) * count)) + 2
        return int(np.floor(first * (1.0 + self._slip))) - before - slip, before + slip, _GUARD + slip

    def apply(self, sent: np.ndarray, first: int, count: int) -> np.ndarray:
        """(count,) received samples from number ``first`` on; ``sent`` covers the input given by `span`."""
        start, before, _ = self.span(first, count)
        sent = sent.astype(np.complex64)  # rounding at -130 dB
        sent[: _TAPER.size] *= _TAPER
        sent[-_TAPER.size :] *= _TAPER[::-1]
        swing = np.pi * abs(self._slip) * count / 2
        if self._channel is not None:
            swing += np.pi * self._channel.doppler_hz * count / self._rate_hz
        at, weights = _nodes(_order(swing), count)
        size = fft.next_fast_len(sent.size)
        spectrum = fft.fft(sent, size, overwrite_x=True)
        # in place from here on: allocating every product would take most of the time
        if self._paths is not None:
            gains = self._paths.gains((first + at) / self._rate_hz).astype(np.complex64)
            product = gains @ _delays(self._channel, self._rate_hz, size)
            product *= spectrum
        else:
            product = np.tile(spectrum, (at.size, 1))
        if self._slip:
            ahead = (first + at) * (1.0 + self._slip) - (start + before) - at
            response = _shifts(ahead / size, size // 2 + 1)
            product[:, : size // 2 + 1] *= response
            product[:, size // 2 + 1 :] *= response[:, (size - 1) // 2 : 0 : -1].conj()
        filtered = fft.ifft(product, axis=1, overwrite_x=True)[:, before : before + count]
        filtered *= weights
        return filtered.sum(axis=0).astype(np.complex128)


def _order(swing_rad: float) -> int:
    """Number of nodes that interpolates a phase swing of +/- ``swing_rad`` to an error of `_INTERPOLATION`."""
    order, error = 1, swing_rad
    while error > _INTERPOLATION:
        order += 1
        error *= swing_rad / (2 * order)
    return order


@lru_cache(maxsize=32)
def _nodes(order: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Chebyshev nodes (order,) in samples of a block, and the weights (order, count) that interpolate from them."""
    x = np.cos(np.pi * (np.arange(order) + 0.5) / order)
    n = 2.0 * np.arange(count) / max(count - 1, 1) - 1.0
    # discrete orthogonality: f = sum_m c_m T_m, c_m = (2 - [m = 0]) / order sum_k f(x_k) T_m(x_k)
    degree = np.arange(order)[:, None]
    scale = np.where(degree == 0, 1.0, 2.0) / order
    weights = np.cos(degree * np.arccos(x)).T @ (scale * np.cos(degree * np.arccos(n)))
    return (x + 1.0) * (max(count - 1, 1) / 2.0), weights.astype(np.float32)


def _shifts(cycles: np.ndarray, count: int) -> np.ndarray:
    """(k, count) complex64 exp(j 2 pi cycles_k n): products of coarse and fine steps, as in `sum_of_waves`."""
    block = int(np.ceil(np.sqrt(count)))
    fine = exp_cycles(cycles[:, None] * np.arange(block))
    coarse = exp_cycles(cycles[:, None] * (block * np.arange(-(-count // block))))
    return (coarse[:, :, None] * fine[:, None, :]).reshape(cycles.size, -1)[:, :count]


@lru_cache(maxsize=8)
def _delays(channel: FadingChannel, rate_hz: float, size: int) -> np.ndarray:
    """(taps, size) frequency responses of the channel's delays."""
    cycles = -channel.delays_s[:, None] * rate_hz * fft.fftfreq(size)
    return exp_cycles(cycles)


def impaired(emitter: Emitter, data: dict[str, Any], where: str) -> Emitter:
    """The emitter with the impairments named in an interferer's mapping; unchanged without any.

    Raises `ValueError`: one line with key, value and what is allowed.
    """
    named = {key: data[key] for key in KEYS if data.get(key) is not None}
    return ImpairedEmitter(emitter=emitter, effects=build(Impairments, named, where)) if named else emitter


def parts(emitter: Emitter) -> tuple[Emitter, dict[str, Any]]:
    """The ideal emitter, and the impairments as plain mappings: the arguments of `impaired`."""
    if not isinstance(emitter, ImpairedEmitter):
        return emitter, {}
    return emitter.emitter, {key: value for key, value in plain(emitter.effects).items() if value is not None}
