"""Emitters as functions of time: a transmitter that goes on from frame to frame.

An emitter's ``begin(rate_hz, rng)`` draws a transmission and returns its `Signal`. One without ``begin`` is known by
windows only: windows of `WINDOW` samples follow each other, each drawn anew.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

Signal = Callable[[int, int], np.ndarray]  # (first, count) -> (count,) complex128 samples, numbers first ...

WINDOW = 300_000  # samples of a window drawn anew, and of the stretch in which the mean power is measured: 40 frames
_BLOCK = 1 << 14  # samples made at once, on a fixed grid: every chunk is cut from the same blocks


def in_blocks(make: Callable[[int], np.ndarray], size: int, keep: int = 2) -> Signal:
    """A signal cut from blocks of ``size`` elements, block ``k`` being ``make(k)``; the last ``keep`` stay."""
    block = lru_cache(maxsize=keep)(make)

    def signal(first: int, count: int) -> np.ndarray:
        blocks = range(first // size, (first + count - 1) // size + 1)
        cut = [block(k)[max(first - k * size, 0) : first + count - k * size] for k in blocks]
        return cut[0] if len(cut) == 1 else np.concatenate(cut)

    return signal


def in_drawn_blocks(
    make: Callable[[np.random.Generator], np.ndarray], size: int, rng: np.random.Generator, keep: int = 2
) -> Signal:
    """As `in_blocks`, each block from a generator of its own, so that any can be made first."""
    seed = int(rng.integers(1 << 63))
    return in_blocks(lambda k: make(np.random.default_rng([seed, k % (1 << 64)])), size, keep)


def begin(emitter: object, rate_hz: float, rng: np.random.Generator) -> Signal:
    """A transmission of the emitter, of mean power 1 in the long run; a silent one stays silent."""
    if hasattr(emitter, "begin"):
        signal = emitter.begin(rate_hz, rng)
        if getattr(emitter, "unit_power", False):
            return signal
        pieces = (signal(first, _BLOCK) for first in range(0, WINDOW, _BLOCK))
        gain = _unit_gain(np.mean([np.vdot(piece, piece).real for piece in pieces]) / _BLOCK)
        return lambda first, count: signal(first, count) * gain

    def window(drawn: np.random.Generator) -> np.ndarray:
        samples = emitter.samples(WINDOW, rate_hz, drawn)
        return samples * _unit_gain(np.vdot(samples, samples).real / WINDOW)

    return in_drawn_blocks(window, WINDOW, rng)


def _unit_gain(power: float) -> float:
    return 1.0 / np.sqrt(power) if power > 0 else 1.0


class InFrames:
    """Place of the next samples of an emitter that goes on from frame to frame.

    ``frame_samples``: samples between the starts of two frames.
    """

    def __init__(self, emitter: object, frame_samples: int) -> None:
        self.emitter, self.frame_samples = emitter, frame_samples
        self.frame_index = 0  # of the next frame
        self._within = 0

    def seek(self, first: int) -> None:
        """The next samples are those from ``first`` within the frame on."""
        self._within = first

    def _next_first(self) -> int:
        """Number of the first sample wanted; the next call is for the next frame."""
        first = self.frame_index * self.frame_samples + self._within
        self.frame_index, self._within = self.frame_index + 1, 0
        return first


class Transmission(InFrames):
    """A transmitter that goes on from frame to frame: emitter protocol.

    Its samples depend on the draw at its first call and on their numbers only, whatever was asked for before. Symbols,
    carrier phase, timing and fading run on while it is gated off. With ``steady`` the gain is constant and the SIR
    holds in the long run, before fading; otherwise every frame is scaled to the SIR.
    """

    def __init__(self, emitter: object, frame_samples: int, *, steady: bool = False) -> None:
        super().__init__(emitter, frame_samples)
        self.steady = steady
        self._signal: Signal | None = None

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """See `Emitter`; the next call is for the next frame."""
        first = self._next_first()
        # a burst takes its own time, not that of blocks
        if count < self.frame_samples and self._signal is not None:
            return self._begun(first, count)
        return self.at(first, count, rate_hz, rng)

    def at(self, first: int, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """(count,) complex128 samples from number ``first`` on, at unit mean power; ``rng`` is for the first call."""
        if self._signal is None:
            signal = self._begun = begin(self.emitter, rate_hz, rng)
            self._signal = in_blocks(lambda k: signal(k * _BLOCK, _BLOCK), _BLOCK)
        return self._signal(first, count)
