"""A carrier of QPSK with noise of its own, in which single points are misread: their mean, given what was received."""

from __future__ import annotations

import numpy as np

from .acquisition import Grid
from .channel_fit import fit, sums
from .lattice import FAINT, box, middle, power
from .numerology import Numerology
from .upright import true_up

__all__ = ["mean_model", "mean_points"]

_ROUNDS = 3
_NOISE = 0.2  # of the received power, at first
_RAILS = np.sqrt(np.array([0.5, 1.0], dtype=np.float32))  # of QPSK, and of QPSK 3 dB up
_SHARES = np.array([0.1, 0.8, 0.1], dtype=np.float32)  # of silence, QPSK, and QPSK 3 dB up
_LEAST = np.float32(0.01)  # such share among an element's neighbours
_NEIGHBOURS = 7  # every second subcarrier: pilots stand in every second one
_WIDTH = 5  # subcarriers a channel is averaged over
_MAY_HELP = 2.0  # times, a weak return's signal to noise ratio at first; QAM and noise have 1.9
_HELPS = 4.5  # the same in the end


def mean_model(
    grid: Grid, clear: np.ndarray, numerology: Numerology, least: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Symbols and phases (L, K) as in `Grid`, finer, and the carrier's mean in them (L, K) complex64.

    None where subtracting that mean raises the signal to noise ratio of a weak return less than ``least`` times. What
    is received, less the mean of what was sent given what was received, is the noise's power times the gradient of the
    logarithm of the density: for a weak return in interference without memory no other function is better (Kassam,
    Signal Detection in Non-Gaussian Noise, 1988).
    Channel, noise and shares of silence and QPSK are estimated from the ``clear`` (L, K) elements, in turns.
    """
    symbols, phase, channel = grid.symbols, grid.phase, grid.channel
    trusted = clear & grid.used
    told = np.count_nonzero(trusted)
    if not told:
        return None
    times = np.zeros(len(symbols), dtype=np.float32)
    noise = _NOISE * middle(power(channel[grid.used]))
    own = float((power(symbols) * trusted).sum())
    shares = _SHARES[:, None, None]
    for number in range(_ROUNDS):
        spread = noise / np.maximum(power(channel), np.float32(1e-3 * noise))
        mean, scatter, found = mean_points(symbols / channel, spread, shares)
        model = channel * mean
        # by how much a weak return is kept, and what is left beside it
        kept = 1 - float((scatter / spread * trusted).sum()) / told
        left = float((power(symbols - model) * trusted).sum())
        last = number == _ROUNDS - 1
        if kept * kept * own < (max(_HELPS, least) if last else _MAY_HELP) * left:
            return None
        if last:
            break
        agreement = symbols * model.conj() * trusted
        turn, _, _ = true_up(agreement, numerology)
        symbols, agreement, phase = symbols * turn, agreement * turn, phase * turn
        weight = power(channel) * (power(mean) + scatter)
        factor = fit(*sums(agreement, weight * trusted, times, 0), 0, _WIDTH)[0]
        left = power(symbols - model * factor) + power(channel) * scatter
        channel = channel * factor
        noise = float((left * trusted).sum()) / told
        shares = np.empty_like(found)
        for parity in (0, 1):
            shares[..., parity::2] = box(np.ascontiguousarray(found[..., parity::2]), _NEIGHBOURS)
        np.maximum(shares, _LEAST, out=shares)
    model[:, ~grid.used] = 0
    return symbols, phase, model


def mean_points(
    values: np.ndarray, spread: np.ndarray, shares: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean of the points given (L, K) values with noise of power ``spread`` (K,), the points' variance about it, and
    the probabilities of silence, QPSK and QPSK 3 dB up, (3, L, K); ``shares`` are these before anything was received.
    """
    rails = np.stack([values.real, values.imag])
    sizes = np.abs(rails)
    likely, means = [np.zeros(values.shape, dtype=np.float32)], [np.complex64(0)]
    for rail in _RAILS:
        # two points per rail: their likelihood is a hyperbolic cosine, their mean a hyperbolic tangent
        size = sizes * (2 * rail / spread)
        other = np.exp(-2 * size)
        more = other + 1
        likely.append((size + np.log(0.5 * more)).sum(axis=0) - 2 * rail * rail / spread)
        slope = np.copysign(rail * (1 - other) / more, rails)
        means.append(slope[0] + 1j * slope[1])
    found = np.stack(likely)
    found -= found.max(axis=0)
    found = np.exp(found) * shares
    found /= np.maximum(found.sum(axis=0), FAINT)
    mean = found[1] * means[1] + found[2] * means[2]
    square = 2 * (found[1] * _RAILS[0] ** 2 + found[2] * _RAILS[1] ** 2)
    return mean, square - power(mean), found
