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

from ..parsing import build, check_range, plain
from ..waveform import exp_cycles
from .amplifier import AmplifiedEmitter, Amplifier
from .emitters import NamedEmitter
from .multipath import FadedEmitter, FadingChannel, faded
from .placement import Emitter

# Guard on either side of a block, samples, for the tails of fractional delays; the outer half is tapered.
_GUARD = 128
_TAPER = np.hanning(_GUARD + 2)[1 : _GUARD // 2 + 1]
_BLOCK = 1 << 14  # longest block of the filter, samples: its FFTs stay in the second-level cache
_INTERPOLATION = 3e-4  # largest amplitude error of the interpolation in time: -70 dB, below every EVM
# Step at which phase noise is drawn, times 2 pi bandwidth, rad: between steps the rms is 1 % too low.
_STEP_RAD = 0.06
WINDOW_FRAMES = 40  # window of an emitter without a period, frames: 2.4 MB


@dataclass(frozen=True, kw_only=True)
class PhaseNoise:
    """Phase noise of the two oscillators together: a Gaussian process of first order (Lorentzian spectrum).

    Its autocorrelation is rms^2 exp(-2 pi bandwidth |t|), as behind a phase-locked loop of that bandwidth.

    Parameters
    ----------
    rms_deg : float
        0..60 degrees; 1 degree alone is an EVM of 1.7 %.
    bandwidth_hz : float
        One-sided 3 dB bandwidth, 1..1e6.
    """

    rms_deg: float = 1.0
    bandwidth_hz: float = 10e3

    def __post_init__(self) -> None:
        check_range("phase_noise", self, rms_deg=(0.0, 60.0), bandwidth_hz=(1.0, 1e6))

    def cycles(self, count: int, rate_hz: float, last: float | None, rng: np.random.Generator) -> np.ndarray:
        """(count + 1,) phases in cycles from ``last`` on (None: drawn); the last one begins the next block."""
        steps = max(1, int(np.ceil(count * 2 * np.pi * self.bandwidth_hz / (_STEP_RAD * rate_hz))))
        steps = min(steps, count)
        kept = np.exp(-2 * np.pi * self.bandwidth_hz * count / (steps * rate_hz))
        drawn = rng.standard_normal(steps + 1) * (self.rms_deg / 360.0 * np.sqrt(1.0 - kept**2))
        drawn[0] = drawn[0] / np.sqrt(1.0 - kept**2) if last is None else last
        from scipy import signal  # see core/fir.py

        nodes = signal.lfilter([1.0], [1.0, -kept], drawn)
        before, part = _between(count, steps)
        return nodes[before] + part * np.diff(nodes)[before]


@dataclass(frozen=True, kw_only=True)
class Oscillator:
    """Carrier frequency offset and sample clock offset of the emitter against the radar.

    Parameters
    ----------
    carrier_offset_hz : float
        Carrier frequency offset, -1e5..1e5.
    clock_ppm : float
        Sample clock offset, -100..100; positive where the emitter's clock is faster.
    """

    carrier_offset_hz: float = 0.0
    clock_ppm: float = 0.0

    def __post_init__(self) -> None:
        check_range("oscillator", self, carrier_offset_hz=(-1e5, 1e5), clock_ppm=(-100.0, 100.0))


@dataclass(frozen=True, kw_only=True)
class Impairments:
    """Impairments of one emitter, in the order of the signal path; None leaves one out.

    Parameters
    ----------
    amplifier : Amplifier or None
        power amplifier of the transmitter, by Rapp's model, without conversion of amplitude to phase
    fading : FadingChannel or None
        multipath, continuous from frame to frame in a jammer's stream; the SIR of a free-running emitter holds in the
        mean over the fading, else in every frame
    oscillator : Oscillator or None
        carrier frequency offset and sample clock offset against the radar
    phase_noise : PhaseNoise or None
        phase noise of both oscillators together, Gaussian with a Lorentzian spectrum
    """

    amplifier: Amplifier | None = None
    fading: FadingChannel | None = None
    oscillator: Oscillator | None = None
    phase_noise: PhaseNoise | None = None

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

    `samples` draws the channel and the oscillators anew. `JammerStream` keeps them continuous by a `Running`.

    >>> ImpairedEmitter(emitter=NrEmitter(), effects=Impairments(phase_noise=PhaseNoise()))  # doctest: +SKIP
    """

    emitter: Emitter
    effects: Impairments

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
        return Running(self, count).samples(count, rate_hz, rng)


class Running:
    """An impaired emitter whose channel and oscillators are continuous from call to call: emitter protocol.

    Parameters
    ----------
    emitter : ImpairedEmitter
    frame_samples : int
        Samples between the starts of two calls.
    steady : bool
        The emitter, too, is continuous, with constant gain: its SIR, before fading, holds over its period or 40 frames.
        Otherwise every call draws an independent window of the emitter.
    """

    def __init__(self, emitter: ImpairedEmitter, frame_samples: int, *, steady: bool = False) -> None:
        self.emitter, self.frame_samples, self.steady = emitter, frame_samples, steady
        self._first = 0  # first sample of the next call, by the radar's clock
        self._filter: _MovingFilter | None = None
        self._held, self._held_from = np.empty(0, dtype=np.complex128), 0
        self._window: np.ndarray | None = None
        self._phase: float | None = None

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """See `Emitter`; ``count`` is at most ``frame_samples`` if ``steady``."""
        if self._filter is None:
            self._filter = _MovingFilter(self.emitter.effects, rate_hz, rng)
        out = np.concatenate(
            [self._block(at, min(_BLOCK, count - at), count, rate_hz, rng) for at in range(0, count, _BLOCK)]
        )
        self._first += self.frame_samples
        if not self.steady:
            self._held = self._held[:0]
        return out

    def write(self, span: np.ndarray, mean_power: float, rate_hz: float, rng: np.random.Generator) -> bool:
        """See `Emitter`: with constant gain if ``steady``, else nothing is written."""
        if self.steady:
            part = self.samples(span.size, rate_hz, rng)
            np.multiply(part, np.sqrt(mean_power), out=span, casting="same_kind")
        return self.steady

    def _block(self, at: int, count: int, whole: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """Samples ``at`` to ``at + count`` of a call of ``whole`` samples."""
        moving, first = self._filter, self._first + at
        start, before, after = moving.span(first, count)
        rest = before, whole - at, moving.span(self._first, whole)[2]
        part = self._sent(start, before + count + after, rest, rate_hz, rng)
        part = moving.apply(part, first, count) if moving.moves else part.copy()
        phase = self._cycles(first, count, rate_hz, rng)
        if phase is not None:
            # after reduction to one cycle, single precision has a phase error of 1e-7, at a fifth of the time
            part *= exp_cycles((phase - np.rint(phase)).astype(np.float32))
        return part

    def _cycles(self, first: int, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray | None:
        """(count,) phase in cycles of carrier offset and phase noise together."""
        offset, noise = self.emitter.effects.oscillator, self.emitter.effects.phase_noise
        total = None
        if offset is not None and offset.carrier_offset_hz:
            step = offset.carrier_offset_hz / rate_hz
            total = np.mod(first * step, 1.0) + step * np.arange(count)
        if noise is not None:
            drawn = noise.cycles(count, rate_hz, self._phase, rng)
            self._phase = drawn[-1]
            total = drawn[:-1] if total is None else total + drawn[:-1]
        return total

    def _sent(
        self, start: int, count: int, rest: tuple[int, int, int], rate_hz: float, rng: np.random.Generator
    ) -> np.ndarray:
        """``count`` transmitted samples, from number ``start`` on.

        ``rest`` counts the samples that this call needs from ``start`` on: before, inside and after the call.
        """
        if not self._held.size:
            self._held_from = start
        self._held = self._held[start - self._held_from :]
        self._held_from = start
        while self._held.size < count:
            if self.steady:
                more = self._next_window(rate_hz, rng)
            elif (
                self.emitter.always_in_window
            ):  # the emission has to lie inside the call, not in the filter's margins
                before, inside, after = rest
                more = np.pad(self.emitter.source.samples(inside, rate_hz, rng), (before, after))
            else:
                more = self.emitter.source.samples(sum(rest), rate_hz, rng)
            self._held = np.concatenate([self._held, more]) if self._held.size else more
        return self._held[:count]

    def _next_window(self, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """A period of the emitter, or `WINDOW_FRAMES` frames of one without a period, at unit mean power."""
        source = self.emitter.source
        period_s = getattr(source, "period_s", 0.0)
        if self._window is None or not period_s:
            count = round(period_s * rate_hz) if period_s else WINDOW_FRAMES * self.frame_samples
            self._window = source.samples(count, rate_hz, rng)
            power = np.vdot(self._window, self._window).real / count
            self._window = self._window / np.sqrt(power) if power > 0 else self._window
        elif cycles := (getattr(source, "carrier_hz", 0.0) * period_s) % 1.0:
            self._window = self._window * np.exp(2j * np.pi * cycles)
        return self._window


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
        slip = int(np.ceil(abs(self._slip) * count)) + 1
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


@lru_cache(maxsize=32)
def _between(count: int, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """(count + 1,) index of the node before each sample, and its position between nodes, for ``steps`` even steps."""
    at = np.arange(count + 1) * (steps / count)
    before = np.minimum(at.astype(np.intp), steps - 1)
    return before, at - before


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
    """The emitter with the impairments and the multipath named in an interferer's mapping; unchanged without any.

    Raises
    ------
    ValueError
        One line with key, value and what is allowed.
    """
    named = {key: data[key] for key in KEYS if data.get(key) is not None}
    multipath = data.get("multipath")
    if multipath is not None and "fading" in named:
        raise ValueError(
            f"{where} has multipath and fading; give one: fading is continuous from frame to frame"
        )
    if named:
        emitter = ImpairedEmitter(emitter=emitter, effects=build(Impairments, named, where))
    return emitter if multipath is None else faded(emitter, multipath, f"{where}.multipath")


def parts(emitter: Emitter) -> tuple[Emitter, dict[str, Any]]:
    """The ideal emitter, and the impairments as plain mappings: the arguments of `impaired`."""
    keys: dict[str, Any] = {}
    if isinstance(emitter, FadedEmitter):
        keys["multipath"], emitter = plain(emitter.channel), emitter.emitter
    if isinstance(emitter, ImpairedEmitter):
        keys |= {key: value for key, value in plain(emitter.effects).items() if value is not None}
        emitter = emitter.emitter
    return emitter, keys
