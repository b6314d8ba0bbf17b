"""Normalisation and dither of frames for a network's input."""

import math

import numpy as np

NORMALISATIONS = ("joint_peak", "per_channel_peak", "joint_rms", "none")
_TINY = float(np.finfo(np.float32).tiny)
_SAFE_ENERGY = (1e-20, 1e30)  # sums of squares of a frame within which float32 keeps its digits
# Steps per unit amplitude at which a frame's first samples choose its dither: noise 70 dB below the frame changes them.
_FINE = 2.0**14
_DRAW = ((1, 31, 1021, 7919), (4099, 127, 257, 2053))  # weights of the first samples of I and Q


class InputScaler:
    """Writes complex frames into a network's real input, normalised and dithered.

    ``normalisation``: one of `NORMALISATIONS`; ``samples``: samples of a frame inside the network; ``dither_db``:
    white noise relative to the frame's power.
    """

    def __init__(self, normalisation: str, samples: int, dither_db: float | None) -> None:
        self.normalisation, self._samples = normalisation, samples
        self._dither = None if dither_db is None else _dither(samples, dither_db)

    def fill(self, rails: np.ndarray, frame: np.ndarray) -> float | np.ndarray:
        """Normalise a frame (N,) into rails (2, N) and add the dither; returns the factor that undoes the scale.

        It is 0 for a frame of zeros, for which a network may put out a signal.
        """
        rails[0], rails[1] = frame.real, frame.imag
        level = _level(rails)
        if level == 0.0 or math.isnan(level):
            rails[:] = 0.0
            return 0.0 * self._scale(rails, 1.0)
        scale = self._scale(rails, level)
        rails /= scale
        if self._dither is not None:
            dither = self._dither_of(rails)
            if self.normalisation != "joint_rms":  # the frame has no unit power
                dither = dither * np.sqrt(2.0 * np.mean(rails**2))
            rails += dither
        return scale

    def _dither_of(self, rails: np.ndarray) -> np.ndarray:
        """(2, N) dither for a normalised frame, from a start that the frame's own noise chooses.

        If it were the same in every frame, its highest spectral cells would be lines that stay for seconds.
        """
        first = rails[:, : len(_DRAW[0])].tolist()  # plain numbers: arrays so short take five times as long
        start = sum(
            draw * round(_FINE * value)
            for draws, values in zip(_DRAW, first, strict=True)
            for draw, value in zip(draws, values, strict=False)
        )
        start %= self._samples
        return self._dither[:, start : start + self._samples]

    def _scale(self, rails: np.ndarray, level: float) -> float | np.ndarray:
        """Scalar, (1, 1), or (2, 1) where I and Q differ: what a frame (2, N) is divided by before the network."""
        if self.normalisation == "none":
            return 1.0
        if self.normalisation == "joint_rms":
            return level
        peak = np.maximum(rails.max(axis=1, keepdims=True), -rails.min(axis=1, keepdims=True))
        if self.normalisation == "joint_peak":
            peak = peak.max(keepdims=True)
        return np.where(peak >= _TINY, peak, np.float32(1))


def _level(rails: np.ndarray) -> float:
    """Root mean square magnitude of a frame (2, N) float32; 0 where it is zero or denormal, NaN where not finite.

    Squares in float32, in one pass; a frame whose squares leave its range is scaled by its peak first.
    """
    flat = rails.reshape(-1)
    energy, peak = float(np.einsum("i,i", flat, flat)), 1.0
    if not _SAFE_ENERGY[0] < energy < _SAFE_ENERGY[1]:
        peak = float(np.abs(flat).max())
        if peak < _TINY:
            return 0.0
        if not math.isfinite(peak):
            return math.nan
        flat = flat / peak
        energy = float(np.einsum("i,i", flat, flat))
    return peak * math.sqrt(energy / rails.shape[1])


def _dither(samples: int, level_db: float) -> np.ndarray:
    """(2, 2 samples) float32 white noise of a fixed seed, complex power ``level_db``, twice the same."""
    noise = np.random.default_rng(0x7CAE).standard_normal((2, samples))
    return np.tile((noise * 10.0 ** (level_db / 20.0) / np.sqrt(2.0)).astype(np.float32), 2)
