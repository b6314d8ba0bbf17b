"""From a frame to OFDM symbols of known timing and phase, with nothing known of the emitter."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import fft, ndimage

from .carrier import course
from .lattice import BLOCK, FAINT, box, middle, power, unit
from .numerology import Numerology

__all__ = [
    "Grid",
    "Prefix",
    "acquire",
    "acquired",
    "find_prefix",
    "level_in_use",
    "retuned",
    "transforms",
]

_OCCUPIED = 0.35  # of the strongest block's power: less is silence between two users
_SMOOTH = 9  # subcarriers over which a first channel is averaged
_FAR = 41  # the same for a channel without long echoes
_AS_LARGE = 0.8  # of the sum over fewer, for those to be averaged
_SQUARINGS = 5  # of Gram matrices: of an eigenvalue of 0.9 times the largest 0.03 are left
_PLACES = 3  # of the long prefix, in which a frame may be read
_AS_LIKELY = 0.98  # of the largest eigenvalue; bursts have that at other places, too, whole frames 0.95
_IN_USE = 1e-3  # of the usual power: fainter subcarriers are the filter's skirts


@dataclass(frozen=True)
class Prefix:
    """What the cyclic prefix tells of a frame.

    Attributes
    ----------
    middle : float
        Sample of the middle of a prefix.
    carrier : float
        Carrier's distance from the nearest whole subcarrier, in subcarriers, -0.5..0.5.
    contrast : float
        Peak of the folded correlation over its scatter elsewhere.
    """

    middle: float
    carrier: float
    contrast: float


@lru_cache(maxsize=4)
def _folding(count: int, spacing: float) -> np.ndarray:
    """(count,) int: place of each sample in its symbol, read-only."""
    bins = round(spacing)
    index = (np.arange(count) * (bins / spacing)).astype(np.intp) % bins
    index.setflags(write=False)
    return index


def find_prefix(frame: np.ndarray, numerology: Numerology) -> Prefix:
    """Correlation of a complex64 frame with itself a symbol later, folded over the symbols."""
    useful = numerology.useful
    product = frame[useful:] * frame[:-useful].conj()
    bins = round(numerology.spacing)
    index = _folding(product.size, numerology.spacing)
    folded = np.bincount(index, product.real, bins) + 1j * np.bincount(index, product.imag, bins)
    folded -= folded.mean()  # a tone correlates everywhere
    width = int(numerology.prefix)
    summed = ndimage.uniform_filter1d(folded, width, mode="wrap")
    size = np.abs(summed)
    peak = int(size.argmax())
    beside = int(1.5 * width) + 1
    scatter = np.sqrt(
        np.mean(size.take(np.arange(peak + beside, peak + bins - beside + 1), mode="wrap") ** 2)
    )
    contrast = float(size[peak] / scatter) if scatter > 0 else 0.0
    return Prefix(peak * numerology.spacing / bins, float(np.angle(summed[peak]) / (2 * np.pi)), contrast)


def transforms(frame: np.ndarray, starts: np.ndarray, numerology: Numerology) -> np.ndarray:
    """(L, subcarriers) complex64, lowest frequency first, of the windows at ``starts``; power is kept."""
    spectra = fft.fft(
        frame.take(numerology.places(starts), mode="wrap"), axis=1, norm="ortho", overwrite_x=True
    )
    first = (numerology.useful + 1) // 2
    return np.concatenate([spectra[:, first:], spectra[:, :first]], axis=1)


@dataclass
class Grid:
    """Symbols with a common timing, and a first channel.

    Attributes
    ----------
    starts : (L,) int
        First sample of each symbol's transform.
    first_long : float
        Middle of a long prefix, in samples of the frame.
    symbols : (L, K) complex64
        Received elements, timing and phases of the symbols taken out by ``phase``.
    phase : (L, K) complex64
        The factor that did so, of modulus 1.
    channel : (K,) complex64
        Known up to a quarter turn per subcarrier.
    used : (K,) bool
        Subcarriers worth demodulating.
    angles : (L,) float
        The symbols' phases in ``phase``, in radians; a quarter turn more or less is the same.
    around : function that takes a slice of the symbols and returns (K,) complex64, or None
        The channel at those symbols, where it was acquired; noisier, but right where the channel moves.
    """

    starts: np.ndarray
    first_long: float
    symbols: np.ndarray
    phase: np.ndarray
    channel: np.ndarray
    used: np.ndarray
    angles: np.ndarray
    around: Callable[[slice], np.ndarray] | None = None


def level_in_use(symbols: np.ndarray, clear: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Power per subcarrier where something is sent, and which subcarriers are in use: (K,) float32, (K,) bool."""
    share = box(clear.astype(np.float32), BLOCK)
    blocks = box(power(symbols) * clear, BLOCK)
    blocks *= (share >= 0.4) / np.maximum(share, np.float32(1e-3))
    occupied = blocks > _OCCUPIED * blocks.max(axis=0)
    count = np.maximum(occupied.sum(axis=0, dtype=np.float32), 1)
    level = box((blocks * occupied).sum(axis=0) / count, _SMOOTH)
    top = middle(level[level > 0.1 * level.max()])
    return np.maximum(level, 1e-6 * top), level > _IN_USE * top


@lru_cache(maxsize=8)
def _passed(count: int, per_cycle: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tables for the Gram matrices of ``count`` symbols, one for each place of the long prefix, read-only.

    Returns how many long prefixes came before each symbol, (places, L) int. Then where in the flat array of products
    (prefixes between two symbols, later symbol, earlier symbol) each element is taken from, (places, L, L) int. Last
    the sign of its imaginary part, (L, L) float32.
    """
    index = np.arange(count)
    places = np.arange(min(per_cycle, count))
    passed = np.cumsum((index % per_cycle == places[:, None]) & (index > 0), axis=1)
    between = np.abs(passed[:, :, None] - passed[:, None, :])
    pairs = (between * count + np.maximum.outer(index, index)) * count + np.minimum.outer(index, index)
    lower = np.sign(np.subtract.outer(index, index)).astype(np.float32)
    for fixed in (passed, pairs, lower):
        fixed.setflags(write=False)
    return passed, pairs, lower


def acquire(
    frame: np.ndarray,
    prefix: Prefix,
    numerology: Numerology,
    clear_of: Callable[[np.ndarray], np.ndarray],
) -> Grid:
    """The first of `acquired`."""
    return next(acquired(frame, prefix, numerology, clear_of))


def acquired(
    frame: np.ndarray,
    prefix: Prefix,
    numerology: Numerology,
    clear_of: Callable[[np.ndarray], np.ndarray],
) -> Iterator[Grid]:
    """Symbols, long prefix and phases of a frame whose carrier offset is removed; the likeliest place of that prefix
    first, then up to two others that are nearly as likely.

    ``clear_of(starts)`` tells which elements (L, K) no return can be in. The fourth power removes the data from QPSK
    and QAM. What is left is alike in all symbols only if they are taken at the right times. All places of the long
    prefix are tried. The symbols agree best at the right one, by the largest eigenvalue of their Gram matrix; its
    eigenvector holds the symbols' phases. The symbols of a burst may be too few to tell.
    """
    middles = prefix.middle % numerology.spacing + numerology.spacing * np.arange(
        -1, frame.size // numerology.useful + 1
    )
    _, starts = numerology.windows(middles, frame.size)
    symbols = transforms(frame, starts, numerology)
    clear = clear_of(starts)
    level, used = level_in_use(symbols, clear)
    fourth = symbols * (1 / np.sqrt(level))
    size = power(fourth)
    fourth *= fourth
    fourth *= fourth
    fourth *= (clear & used & (size > 0.1)) / (size + np.float32(0.05))
    count = len(starts)
    index = np.arange(count)
    late = ((starts - starts[0]) - index * (numerology.useful + numerology.prefix)).astype(np.float32)[
        :, None
    ]
    fourth *= unit(-4 * late * numerology.turn)
    passed, pairs, lower = _passed(count, numerology.per_cycle)
    # after 0, 1, 2 ... long prefixes
    longer = numerology.longer * np.arange(-(-count // numerology.per_cycle) + 1, dtype=np.float32)[:, None]
    # Gram matrices: symbols n long prefixes apart are turned by n
    rows = fourth * unit(4 * longer * numerology.turn)[:, None]
    # real and imaginary parts as real products, which cost a quarter
    both = np.concatenate([fourth, 1j * fourth]).view(np.float32)
    parts = rows.view(np.float32).reshape(-1, both.shape[1]) @ both.T
    apart = (parts[:, :count] + 1j * parts[:, count:]).ravel()
    gram = apart.take(pairs)
    gram.imag *= lower  # the upper half is the lower one's conjugate
    for place, vector in _strongest(gram):
        before = passed[place]
        turned = course(vector, before)
        phase = unit((longer[before] - late) * numerology.turn - (turned / 4).astype(np.float32)[:, None])
        upright = np.exp(-1j * turned)[:, None].astype(np.complex64) * rows[before, index]
        first_long = starts[0] + place * (numerology.useful + numerology.prefix)
        yield Grid(
            starts,
            float(first_long + (numerology.longer if place else 0.0)),
            symbols * phase,
            phase,
            _channel(upright.sum(axis=0), level, numerology),
            used,
            turned / 4,
            lambda part, upright=upright: _channel(upright[part].sum(axis=0), level, numerology),
        )


def _strongest(gram: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Which of Hermitian matrices (n, L, L) of one trace have the largest eigenvalues, and their eigenvectors (L,).

    The largest first, then at most two that are hardly smaller. High powers of a matrix have that eigenvalue alone: a
    solver's steps take four times as long.
    """
    # no power is too large for a number, nor too small
    powers = gram * (4 / max(gram[0].trace().real, FAINT))
    for _ in range(_SQUARINGS):
        powers = powers @ powers
    diagonals = np.einsum("nii->ni", powers).real
    high = diagonals.sum(axis=1)
    order = np.argsort(-high, kind="stable")[:_PLACES]
    least = _AS_LIKELY ** (2**_SQUARINGS) * high[order[0]]
    likely = [place for place in order if place == order[0] or high[place] >= least]
    return [(int(place), powers[place, :, diagonals[place].argmax()]) for place in likely]


def retuned(grid: Grid, spectra: np.ndarray, step: float, numerology: Numerology) -> Grid:
    """The grid of a frame of whose carrier ``step`` subcarriers more are removed than when it was acquired.

    ``spectra`` (L, K) are its symbols' `transforms`.
    """
    back = 2 * np.pi * step / numerology.useful * (grid.starts + numerology.useful / 2)
    phase = grid.phase * np.exp(1j * back).astype(np.complex64)[:, None]
    return replace(grid, symbols=spectra * phase, phase=phase, angles=grid.angles - back)


def _channel(mean: np.ndarray, level: np.ndarray, numerology: Numerology) -> np.ndarray:
    """(K,) complex64 channel, up to a quarter turn, of elements' mean fourth powers (K,) and mean powers (K,)."""
    slope = np.angle(np.vdot(mean[:-1], mean[1:]))
    straight = mean * unit(np.float32(-slope) * numerology.subcarriers)
    # a short channel is averaged further: where synchronisation signals cancel the data, noise makes turns of its own
    smooth, far = (ndimage.uniform_filter1d(straight, width) for width in (_SMOOTH, _FAR))
    if np.abs(far).sum() > _AS_LARGE * np.abs(smooth).sum():
        smooth = far
    angle = np.angle(smooth)
    angle[1:] -= 2 * np.pi * np.cumsum(np.rint(np.diff(angle) / (2 * np.pi)))
    # points of QPSK and QAM stand on the diagonals: their fourth power is negative
    angle = (angle + slope * numerology.subcarriers - np.pi) / 4
    return np.sqrt(level) * unit(angle.astype(np.float32, copy=False))
