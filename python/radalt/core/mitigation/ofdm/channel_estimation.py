"""Channel estimation: blind from fourth powers, then least squares from soft decisions.

Least squares with soft decisions: ``h = sum w y conj(E s) / sum w E|s|^2`` over the elements that share h. Three models
share it differently: *static*, one channel for the frame; *moving*, a parabola over the frame; *tile*, one gain and
slope for twelve subcarriers of a half slot, about as precoding has it.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from .arrays import block_sums, median, moving_average, moving_sum, power
from .common_phase import axes_phases
from .equaliser import ElementGrid
from .numerology import Numerology
from .settings import OfdmSettings

_BLOCK = 12  # subcarriers, TS 38.211 clause 4.4.4.1
_AXES_BLOCK = 25  # subcarriers whose fourth powers are summed before their sign is judged
_WIDTHS = (9, 17, 33, 65, 129, 257)  # subcarriers over which the blind channel may be averaged


def level_in_use(
    raw: np.ndarray, free: np.ndarray, numerology: Numerology, settings: OfdmSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Power per subcarrier where something is sent, (K,) float32, and which subcarriers are in use, (K,) bool."""
    share = moving_average(free.astype(np.float32), _BLOCK)
    blocks = moving_average(power(raw) * free, _BLOCK)
    blocks *= (share > 0.4) / np.maximum(share, np.float32(1e-3))
    occupied = blocks > settings.occupied * blocks.max(axis=0)
    mean = (blocks * occupied).sum(axis=0) / np.maximum(occupied.sum(axis=0), 1)
    level = moving_average(mean.astype(np.float32), 5)
    top = median(level[level > 0.1 * level.max()]) if level.max() > 0 else np.float32(1)
    return np.maximum(level, np.float32(1e-6) * top), level > settings.in_use * top


def fourth_powers(elements: np.ndarray, level: np.ndarray, trust: np.ndarray) -> np.ndarray:
    """(L, K) complex64 ``z^4 / (|z|^2 + 0.05)`` of elements over the square root of their level.

    Its phase is four times the channel's plus half a turn: points of QPSK and QAM stand on the diagonals. Silence and
    other weak elements do not count.
    """
    z = elements * (1 / np.sqrt(level))
    size = power(z)
    z *= z
    z *= z
    # of a tone or a DC offset no more counts than of the outermost points
    z *= (trust & (size > 0.1)) / np.maximum(size + np.float32(0.05), size * size * np.float32(0.4))
    return z


@dataclass(frozen=True)
class ChannelStart:
    """What the iterative receiver begins with."""

    channel: np.ndarray  # (1, K) or (L, K) complex64, up to a quarter turn per subcarrier
    used: np.ndarray  # (K,) bool: subcarriers in use
    phase: np.ndarray  # (L, 1) complex64 factors that bring all symbols to one phase
    model: str  # of the channel: "static", "moving" or "tile"
    noise: np.ndarray | None = None  # (L, K) float32; unknown if None


def blind_channel(grid: ElementGrid, free: np.ndarray, model: str, settings: OfdmSettings) -> ChannelStart:
    """First channel of a frame for one of the three models, from fourth powers."""
    num = grid.numerology
    y = grid.raw * grid.ramp
    level, used = grid.level or level_in_use(y, free, num, settings)
    fourth = fourth_powers(y, level, free & used)
    pairs = (fourth[1:] * fourth[:-1].conj()).sum(axis=1)
    turn = np.append(0, np.cumsum(np.angle(pairs)))
    fourth = fourth * np.exp(-1j * turn).astype(np.complex64)[:, None]
    slope = float(np.angle((fourth[:, 1:] * fourth[:, :-1].conj()).sum()))
    # the phases of unit steps: one short exponential
    flat = fourth * np.exp(-1j * slope * np.arange(num.useful)).astype(np.complex64)
    if model == "static":
        mean = flat.sum(axis=0)
        edge = np.arange(0, num.useful, _AXES_BLOCK)
        width = np.diff(np.append(edge, num.useful))
        for _ in range(3):
            c = np.add.reduceat(flat * moving_average(mean, _AXES_BLOCK).conj(), edge, axis=1)
            own = axes_phases(c)
            back = np.exp(-1j * own).astype(np.complex64)[:, None]
            sign = np.where((c * back).real < 0, np.float32(-1), np.float32(1))
            flat = flat * back * np.repeat(sign, width, axis=1)
            turn = turn + own
            mean = flat.sum(axis=0)
        mean = _widest(mean)[None]
    elif model == "moving":
        mean = ndimage.uniform_filter(flat, (5, 17), mode="nearest")
    else:
        mean = _tiles(flat, np.abs(flat) + np.float32(1e-6), grid, slopes=False)
    middle = len(mean) // 2
    angle = np.angle(mean).astype(np.float64)
    if model != "tile":  # quarter turns between tiles do not matter
        angle[middle] = np.unwrap(angle[middle])
        for step in (1, -1):
            for row in range(middle + step, len(mean) if step > 0 else -1, step):
                angle[row] = angle[row - step] + np.angle(mean[row] * mean[row - step].conj())
    angle = (angle + slope * np.arange(num.useful) - np.pi) / 4
    gain = (np.sqrt(level) * np.exp(1j * angle)).astype(np.complex64)
    return ChannelStart(gain, used, np.exp(-0.25j * turn).astype(np.complex64)[:, None], model)


def _widest(mean: np.ndarray) -> np.ndarray:
    """(K,) mean fourth powers, averaged over as many subcarriers as least squares error allows."""
    noise = float(np.mean(power(mean[1:] - mean[:-1])) / 2)
    near = moving_average(mean, 5)
    best, least = near, np.inf
    for n in _WIDTHS:
        wide = moving_average(mean, n)
        error = max(float(np.mean(power(wide - near))) - noise * (1 / 5 - 1 / n), 0.0) + noise / n
        if error < least:
            best, least = wide, error
    return best


def estimate_channel(
    agreement: np.ndarray,
    weight: np.ndarray,
    grid: ElementGrid,
    model: str,
    *,
    wide: bool = False,
    prior: tuple[np.ndarray, np.float32] | None = None,
    bound: np.ndarray | None = None,
) -> np.ndarray:
    """Channel by least squares, (1, K) complex64 for the static model and (L, K) for the others.

    - ``agreement`` (L, K) complex64: ``w y conj(E s)``, w the inverse noise and 0 where an element is not trusted
    - ``weight`` (L, K) float32: ``w E|s|^2``
    - ``model``: "static", "moving" or "tile"
    - ``wide``: whether to average over 15 subcarriers, as long as many decisions are wrong
    - ``prior`` ((K,) complex64, float32) or None: channel of the iteration before and its weight, for subcarriers
      in which hardly anything is sent
    - ``bound`` (1, K) or (L, K) float32 or None: modulus of the blind channel; the estimate stays within 0.4 and
      2.5 times that. Where silence is decided, least squares would let the channel run away.
    """
    k = np.arange(agreement.shape[1])
    whole = agreement.sum(axis=0)
    slope = float(np.angle(np.vdot(whole[:-1], whole[1:])))
    flat = np.exp(-1j * slope * k).astype(np.complex64)
    if model == "static":
        width = 15 if wide else 3
        total, norm = whole * flat, weight.sum(axis=0)
        if prior is not None:
            total = total + prior[1] * prior[0] * flat
            norm = norm + prior[1]
        h = (moving_average(total, width) / np.maximum(moving_average(norm, width), np.float32(1e-9)))[None]
    elif model == "moving":
        h = _moving(agreement * flat, weight, grid, 16 if wide else 8)
    else:
        h = _tiles(agreement * flat, weight, grid)
    h = h * flat.conj()
    if bound is not None:
        size = np.abs(h)
        h = h * (np.clip(size, 0.4 * bound, 2.5 * bound) / np.maximum(size, np.float32(1e-9)))
    return h.astype(np.complex64, copy=False)


def _moving(agreement: np.ndarray, weight: np.ndarray, grid: ElementGrid, width: int) -> np.ndarray:
    """Parabola over the frame, from some ``width`` subcarriers around each; linear between blocks of them."""
    count, block = len(agreement), grid.numerology.block
    t = ((np.arange(count) - (count - 1) / 2) / count * 2).astype(np.float32)
    powers = t ** np.arange(5, dtype=np.float32)[:, None]
    first = (powers[:3] @ agreement.view(np.float32)).view(np.complex64)
    around = 2 * (width // block // 2) + 1
    first = moving_sum(block_sums(first, block), around)
    moments = moving_sum(block_sums(powers @ weight, block), around)
    gram = moments[np.add.outer(np.arange(3), np.arange(3))].transpose(2, 0, 1)
    gram = gram + (1e-4 * np.maximum(moments[0], 1e-9))[:, None, None] * np.eye(3, dtype=np.float32)
    terms = np.linalg.solve(gram, first.T[..., None])[..., 0]  # (blocks, 3)
    at = (np.arange(agreement.shape[1]) - (block - 1) / 2) / block
    low = np.clip(np.floor(at).astype(int), 0, len(terms) - 2)
    part = np.clip(at - low, 0, 1).astype(np.float32)[:, None]
    terms = (1 - part) * terms[low] + part * terms[low + 1]
    return powers[:3].T @ terms.T.astype(np.complex64)


def _tiles(
    agreement: np.ndarray, weight: np.ndarray, grid: ElementGrid, *, slopes: bool = True
) -> np.ndarray:
    """(L, K): one complex gain and slope per twelve subcarriers and half slot."""
    count = agreement.shape[1]
    edge = np.arange(0, count, _BLOCK)
    a, b = (np.add.reduceat(x, grid.segments, axis=0) for x in (agreement, weight))
    width = np.diff(np.append(edge, count))
    x = (np.arange(count) - np.repeat(edge + (width - 1) / 2, width)).astype(np.float32)
    norm = np.maximum(np.add.reduceat(b, edge, axis=1), np.float32(1e-6))
    gain = np.repeat(np.add.reduceat(a, edge, axis=1) / norm, width, axis=1)
    if slopes:
        second = np.add.reduceat(b * x * x, edge, axis=1) + np.float32(1e-6)
        tilt = np.add.reduceat((a - gain * b) * x, edge, axis=1) / second
        gain = gain + np.repeat(tilt, width, axis=1) * x
    return gain[grid.segment].astype(np.complex64, copy=False)
