"""Noise of the elements: the likeliest before any decision, then from what decisions leave."""

import numpy as np

from .arrays import block_sums, median, moving_sum, spread
from .numerology import Numerology
from .settings import OfdmSettings
from .soft_demapper import SoftDemapper

_SAMPLED = 7  # decimation of resource blocks in the first noise estimate


def first_noise(
    z: np.ndarray,
    t: np.ndarray,
    segments: np.ndarray,
    demapper: SoftDemapper,
    block: int,
    settings: OfdmSettings,
) -> np.float32:
    """Noise over channel power of greatest likelihood on the grid, for all elements in one call."""
    some, known = (
        np.ascontiguousarray(x.reshape(len(x), -1, block)[:, ::_SAMPLED]).reshape(len(x), -1) for x in (z, t)
    )
    tried = 10 ** (np.array(settings.noise_grid_db, dtype=np.float32) / 10)
    count, length = len(tried), len(some)
    many = (np.arange(count)[:, None] * length + segments).ravel()
    noise = np.repeat(tried, length)[:, None] * np.ones(some.shape[1], np.float32)
    nats = demapper.evidence(np.tile(some, (count, 1)), noise, np.tile(known, (count, 1)), many)
    return tried[int((nats.reshape(count, length, -1) * known).sum(axis=(1, 2)).argmax())]


def noise_of(
    error: np.ndarray, t: np.ndarray, h2: np.ndarray, numerology: Numerology, settings: OfdmSettings
) -> np.ndarray:
    """(L, K) float32 noise: of a subcarrier over time, raised where a region of a symbol has more."""
    block = numerology.block
    known = block_sums(t, block)
    sums = block_sums(error * t, block)
    near = numerology.blocks(9)
    total = moving_sum(known.sum(axis=0), near)
    sub = moving_sum(sums.sum(axis=0), near) / np.maximum(total, np.float32(0.1))
    sub = np.where(total > 0, sub, median(sub[total > 0]) if (total > 0).any() else np.float32(1e-6))
    excess = np.minimum(sums / np.maximum(sub, 1e-20), 50 * known)
    around = numerology.blocks(21)
    many = moving_sum(known, around)
    region = moving_sum(excess, around) / np.maximum(many, np.float32(0.02))
    few = many < 0.15 * around * block  # there the whole symbol counts
    of_symbol = excess.sum(axis=1, keepdims=True) / np.maximum(
        known.sum(axis=1, keepdims=True), np.float32(0.02)
    )
    region = np.where(few, of_symbol, region)
    noise = sub * np.where(region > settings.uneven_region, region, 1)
    return np.maximum(spread(noise.astype(np.float32), block), np.float32(1e-7) * median(h2))
