"""What makes one set of weights serve any sweep: sizes and tables of the network `compact`, from a waveform.

Every operation of `compact` is local in time, in frequency or in the beat domain. So its weights mean the same at
another sweep once the sizes are counted in that sweep's own units:

- a column of the filterbank lasts as many *beat cells* as the trained one: 250 columns pass the 150 kHz in 1 ms that an
  altitude of 1500 m has at 7.5 MHz, and a sweep of twice the bandwidth gets 500;
- a learned filter is stretched to three columns, a learned position to the same fraction of the sweep;
- a spectral gain covers about 15 cells of the frame's own spectrum.

`tables_of` makes the constants that follow from a sweep. The training code builds its fixed networks from the same
tables; the exported network takes them as inputs, bound once when it is loaded.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import fft

from ..waveform import Waveform
from .base import MitigationError

# Layout with which `compact` was trained: Waveform(), 1500 m.
HOP, COLUMNS, GROUP = 30, 250, 15  # samples per column, columns per frame, cells per spectral gain
FILTER_HOPS = 3  # length of a filter, hops
_SPAN_M, _SPEED_M_PER_S = 1500.0, 100.0
# Sweeps over which break-points were measured (docs/tcae.md).
SERVED = {"bandwidth_hz": (1e6, 56e6), "sweep_s": (0.2e-3, 10e-3), "rate_hz": (2e6, 56e6)}
_COLUMNS_WITHIN = (0.8, 1.25)  # number of columns over the number that the span requires
_GROUPS = range(11, 21)
_MOST_LONGER = 1.15  # longest resampled frame over the frame, to find a length with small factors


@dataclass(frozen=True)
class Layout:
    """Sizes of the network for one sweep.

    ``hop``, ``columns``: samples per column (even) and columns (even); a frame is resampled to ``hop * columns``;
    ``group``: cells of the frame's spectrum that share a gain; ``factors`` (int, int, int): of the number of samples,
    the first a multiple of ``group``: the lengths of the spectrum's three partial DFTs.
    """

    hop: int
    columns: int
    group: int
    factors: tuple[int, int, int]

    @property
    def samples(self) -> int:
        """Samples of a frame inside the network."""
        return self.hop * self.columns


def layout_of(waveform: Waveform, span_m: float | None = None) -> Layout:
    """Sizes for a sweep and the highest altitude that has to pass; None, and less than 1500 m, take 1500 m.

    Raises `MitigationError` if the sweep lies outside `SERVED`; names value, limit and remedy.
    """
    for key, (low, high) in SERVED.items():
        value = getattr(waveform, key)
        if not low * (1 - 1e-9) <= value <= high * (1 + 1e-9):
            raise MitigationError(
                f"tcae: waveform.{key} is {value:g}; the network serves {low:g} to {high:g}: choose such a sweep, or "
                "another method, such as whitening"
            )
    span_m = max(span_m or 0.0, _SPAN_M)
    layout = _layout(
        waveform.samples_per_frame, COLUMNS * _cells(waveform, span_m) / _cells(Waveform(), _SPAN_M)
    )
    if layout is None:
        raise MitigationError(
            f"tcae: an altitude of {span_m:g} m is {_cells(waveform, span_m) / 2:.3g} beat cells per half sweep of "
            f"{waveform.samples_per_half} samples, too {'many' if span_m > _SPAN_M else 'few'} for the network; "
            "change altimeter.max_altitude_m or the sweep"
        )
    return layout


def _cells(waveform: Waveform, span_m: float) -> float:
    """Beat cells (of 1 / sweep_s) up to an altitude, with a Doppler on top."""
    beat_hz = waveform.altitude_to_beat_hz(span_m) + waveform.vertical_speed_to_doppler_hz(_SPEED_M_PER_S)
    return float(beat_hz) * waveform.sweep_s


@lru_cache(maxsize=64)
def _layout(samples: int, wanted: float) -> Layout | None:
    """The layout nearest to the wanted number of columns, the frame's own length and `GROUP`; None without any."""
    best, least = None, np.inf
    low, high = (max(4, round(0.5 * share * wanted)) for share in _COLUMNS_WITHIN)
    for columns in range(2 * low, 2 * high + 2, 2):
        hop = 2 * max(1, -(-samples // (2 * columns)))
        length = hop * columns
        if length > _MOST_LONGER * samples:
            continue
        for group in _GROUPS:
            factors = factors_of(length, group) if length % group == 0 else None
            if factors is None:
                continue
            # a longer frame costs most, since it is resampled
            cost = abs(np.log(columns / wanted)) + 4.0 * (length / samples - 1)
            cost += 0.3 * abs(np.log(group / GROUP)) + 0.1 * sum(factors) / (3.0 * length ** (1 / 3))
            if cost < least:
                best, least = Layout(hop, columns, group, factors), cost
    return best


@lru_cache(maxsize=4096)
def factors_of(samples: int, group: int) -> tuple[int, int, int] | None:
    """Three whole factors with the smallest sum, the first a multiple of ``group``: (15, 20, 25) for 7500 and 15."""
    divisors = [d for d in range(1, int(samples**0.5) + 1) if samples % d == 0]
    divisors += [samples // d for d in divisors]
    triples = [
        (a, b, samples // (a * b))
        for a in divisors
        if a % group == 0
        for b in divisors
        if samples % (a * b) == 0 and a * b * b <= samples
    ]
    return min(triples, key=sum, default=None)


def resampled(frames: np.ndarray, samples: int) -> np.ndarray:
    """(..., N) complex frames at another number of samples per frame, by their DFT; the same array where it is N."""
    n = frames.shape[-1]
    if n == samples:
        return frames
    spectrum, kept = fft.fft(frames), min(n, samples)
    out = np.zeros((*frames.shape[:-1], samples), dtype=spectrum.dtype)
    out[..., : (kept + 1) // 2] = spectrum[..., : (kept + 1) // 2]
    out[..., -(kept // 2) :] = spectrum[..., -(kept // 2) :]
    return fft.ifft(out, overwrite_x=True) * (samples / n)


def tables_of(waveform: Waveform, layout: Layout) -> dict[str, np.ndarray]:
    """The constants of the network for a sweep, float32, by the names of the exported network's inputs.

    ``hop`` samples h, ``L`` columns, ``a, b, c`` factors, ``K = 3 h`` taps:

    - ``cosine``, ``sine`` (1, N): the reference sweep; ``norm`` (1, N): inverse of the filterbank's squared windows;
    - ``stretch`` (90, K): learned filters to K taps; ``place`` (125, L / 2): learned positions to half the columns;
    - ``ramp`` (h, 1, 3), ``local`` (h, 2, 3), ``halves`` (2, h): interpolation and means within columns;
    - ``group`` (group,): only its length counts;
    - ``first`` ... ``back_third``: the DFT of a b c points, see `dft_tables`.
    """
    reference = resampled(waveform.reference.astype(np.complex128), layout.samples)
    kernel = FILTER_HOPS * layout.hop
    tables = {
        "cosine": reference.real[None],
        "sine": reference.imag[None],
        # the scales of both filters to a kernel of other length: one in `stretch`, its square root over here
        "norm": filterbank_norm(layout.columns, layout.hop, FILTER_HOPS)
        * np.sqrt(kernel / (FILTER_HOPS * HOP)),
        "stretch": _stretch(FILTER_HOPS * HOP, kernel) * np.sqrt(FILTER_HOPS * HOP / kernel),
        "place": _stretch(COLUMNS // 2, layout.columns // 2),
        "ramp": _ramp(layout.hop),
        "local": _local_mean(layout.hop),
        "halves": _halves(layout.hop),
        "group": np.ones(layout.group),
    } | dft_tables(layout)
    return {name: np.ascontiguousarray(values, dtype=np.float32) for name, values in tables.items()}


def filterbank_norm(columns: int, hop: int, spans: int) -> np.ndarray:
    """(1, N) one over the sum of a filterbank's squared Hann windows of ``spans`` columns, over ``sqrt(kernel)``."""
    kernel = spans * hop
    squares = (0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(kernel) + 0.5) / kernel)) ** 2
    total = np.zeros((columns + spans - 1) * hop)
    for column in range(columns):
        total[column * hop : column * hop + kernel] += squares
    total = total[(spans - 1) // 2 * hop :][: columns * hop]
    return (1.0 / (np.sqrt(kernel) * total))[None]


def _stretch(old: int, new: int) -> np.ndarray:
    """(old, new) weights that bring ``old`` values on an interval to ``new``: means over shares where those are fewer,
    else linear interpolation."""
    if new == old:
        return np.eye(old)
    weights = np.zeros((old, new))
    if new < old:
        edges = np.linspace(0, old, new + 1)
        start = np.arange(old)[:, None]
        share = np.minimum(edges[1:], start + 1) - np.maximum(edges[:-1], start)
        return np.clip(share, 0, None) * new / old
    position = (np.arange(new) + 0.5) / new * old - 0.5
    before = np.clip(np.floor(position).astype(int), 0, old - 2)
    after = np.clip(position - before, 0, 1)
    weights[before, np.arange(new)] = 1 - after
    weights[before + 1, np.arange(new)] = after
    return weights


def _ramp(hop: int) -> np.ndarray:
    """(hop, 1, 3) weights of linear interpolation from column values to samples, as a convolution."""
    position = (np.arange(hop) + 0.5) / hop - 0.5
    before, after = np.clip(-position, 0, None), np.clip(position, 0, None)
    return np.stack([before, 1 - before - after, after], 1)[:, None]


def _local_mean(hop: int) -> np.ndarray:
    """(hop, 2, 3) weights that turn means over half columns (of this and its neighbours) into the running mean
    over three of them, interpolated linearly to the samples of a column."""
    half = hop // 2
    ramp = _ramp(half)[:, 0]  # (half, 3): from half column j - 1, j, j + 1
    weights = np.zeros((hop, 6))  # half columns 2t - 2 ... 2t + 3
    for which in (0, 1):
        for tap in range(3):
            for neighbour in (-1, 0, 1):
                weights[which * half : (which + 1) * half, 1 + which + tap + neighbour] += ramp[:, tap] / 3
    return weights.reshape(hop, 3, 2).transpose(0, 2, 1)


def _halves(hop: int) -> np.ndarray:
    """(2, hop) weights of the means over a column's halves."""
    halves = np.zeros((2, hop))
    halves[0, : hop // 2] = halves[1, hop // 2 :] = 2.0 / hop
    return halves


def dft_tables(layout: Layout) -> dict[str, np.ndarray]:
    """Matrices of the DFT of ``a b c`` points in three products and one twiddle each way.

    J. W. Cooley and J. W. Tukey, 1965: with ``n = b c n1 + c n2 + n3`` and ``k = k1 + a k2 + a b k3`` the first twiddle
    depends on ``k1`` and ``n2`` alone and lies in the second product's matrices, one for each ``k1``. ``first`` has
    shape (2a, 2a), ``second`` (a, 2b, 2b), ``third`` (2c, 2c), ``turn_re`` and ``turn_im`` (a, b, c); ``back_...`` is
    the inverse. ``both`` (c, 2c) doubles c values for real and imaginary parts, and its transpose sums theirs.
    """
    a, b, c = layout.factors
    roots = [np.exp(-2j * np.pi * np.outer(np.arange(m), np.arange(m)) / m) for m in layout.factors]
    k1, n2 = np.arange(a)[:, None, None], np.arange(b)
    second = roots[1] * np.exp(-2j * np.pi * k1 * n2 / (a * b))  # (k1, k2, n2)
    place = np.arange(a)[:, None, None] + a * np.arange(b)[:, None]  # k1 + a k2
    twiddle = np.exp(-2j * np.pi * place * np.arange(c) / layout.samples)  # (k1, k2, n3)
    third = _real_coded(roots[2])  # symmetric but for signs: rows times its transpose
    paired = np.stack([_paired(_real_coded(m)) for m in second])
    return {
        # rows in pairs (real, imaginary) where the next step reads pairs
        "first": _paired(_real_coded(roots[0])),
        "second": paired,
        "third": third.T,
        "turn_re": twiddle.real,
        "turn_im": twiddle.imag,
        "both": np.tile(np.eye(c), 2),
        # each step's conjugate transpose, in the opposite order
        "back_first": _paired(_real_coded(roots[0])).T / layout.samples,
        "back_second": paired.transpose(0, 2, 1),
        "back_third": third,
    }


def _paired(matrix: np.ndarray) -> np.ndarray:
    """Rows (all real parts, all imaginary parts) as (real, imaginary) of the first, of the second ..."""
    return matrix.reshape(2, -1, matrix.shape[1]).transpose(1, 0, 2).reshape(matrix.shape)


def _real_coded(matrix: np.ndarray) -> np.ndarray:
    """Complex (m, m) as real (2m, 2m) acting on stacked real and imaginary parts."""
    return np.block([[matrix.real, -matrix.imag], [matrix.imag, matrix.real]])
