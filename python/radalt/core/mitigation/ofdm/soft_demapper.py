"""Soft demapper: posterior of the points, with the constellation of each block and control elements judged from data.

PDSCH has one QAM order per user, which holds for a block of subcarriers over a half slot. Control channels, pilots,
synchronisation signals and silence hold for about a resource block of one symbol. Both are mixture models:
``p(z) = P_c p_control(z) + (1 - P_c) sum_q P_q p_q(z) + outlier``, with ``P_q`` pooled over a half slot's block and
``P_c`` over twelve subcarriers of a symbol (D. Guo, S. Verdu,
"Randomly spread CDMA", IEEE Trans. Inf. Theory 51(6), 2005: the posterior mean minimises the squared error).
"""

from dataclasses import dataclass

import numpy as np

from .arrays import block_sums, moving_sum, segment_spread, segment_sums, spread
from .constellation import BOOSTED, EMPTY, QAM, QPSK, rail_index, rail_tables
from .numerology import Numerology
from .settings import OfdmSettings

_NEIGHBOUR = np.float32(0.5)  # weight of the two blocks next to one, when its QAM order is judged


@dataclass(frozen=True)
class SoftSymbols:
    """Posterior of a frame's symbols."""

    mean: np.ndarray  # (L, K) complex64 ``E[s | z]``
    second: np.ndarray  # (L, K) float32 ``E[|s|^2 | z]``
    log_density: np.ndarray  # (L, K) float32, of the received elements, in nats
    order: np.ndarray  # (3, half slots, blocks) float32 probabilities of 16, 64 and 256QAM
    control: np.ndarray  # (L, K) float32 probabilities of control symbols, pilots or silence


@dataclass(frozen=True)
class _Mixture:
    """Densities (L, K) by class, and the posteriors that go with them."""

    places: np.ndarray
    silent: (
        np.ndarray
    )  # (2, L, K) rail densities of silence and of QPSK 3 dB up: points on the axes have one of each
    boosted: np.ndarray
    qpsk: np.ndarray  # weighted by their priors, as are the next two
    strong: np.ndarray
    axes: np.ndarray
    control: np.ndarray
    qam: list[np.ndarray]
    data: np.ndarray
    order: np.ndarray
    probability: np.ndarray


def _orders(pooled: list[np.ndarray]) -> np.ndarray:
    """(3, half slots, blocks) probabilities of the QAM orders from their log likelihoods, (half slots, blocks) each."""
    nats = np.stack(pooled)
    nats += _NEIGHBOUR * (moving_sum(nats, 3) - nats)
    nats -= nats.max(axis=0)
    order = np.exp(nats)
    order /= order.sum(axis=0)
    return order


class SoftDemapper:
    """Soft decisions for the elements of one numerology."""

    def __init__(self, numerology: Numerology, settings: OfdmSettings) -> None:
        self._s, self._block = settings, numerology.block
        self._prior = {
            EMPTY: np.float32(settings.prior_empty),
            QPSK: np.float32(settings.prior_qpsk),
            BOOSTED: np.float32(settings.prior_boosted),
        }
        self._axes = np.float32(settings.prior_axes / 2)
        # an element that is none of the points may lie anywhere in |z| < 2; points have unit power
        self._floor = np.float32(settings.outlier / (4 * np.pi))
        self._resource_block = numerology.blocks(12)

    def evidence(
        self, z: np.ndarray, noise: np.ndarray, trust: np.ndarray, segments: np.ndarray
    ) -> np.ndarray:
        """(L, K) float32 log density of the elements, in nats; arguments as in `demap`."""
        return self._nats(self._mixture(z, noise, trust, segments))

    def _nats(self, m: _Mixture) -> np.ndarray:
        both = m.probability * (m.control - m.data)
        both += m.data
        both += self._floor
        return np.log(both)

    def _mixture(self, z: np.ndarray, noise: np.ndarray, trust: np.ndarray, segments: np.ndarray) -> _Mixture:
        places = rail_index(z, noise)
        tables = rail_tables()[0]

        def rails(row: int) -> np.ndarray:
            return tables[row].take(places, mode="clip")

        silent, boosted, qpsk = rails(EMPTY), rails(BOOSTED), rails(QPSK)
        axes = silent[0] * boosted[1]
        axes += silent[1] * boosted[0]
        axes *= self._axes
        qpsk = qpsk[0] * qpsk[1]
        qpsk *= self._prior[QPSK]
        strong = boosted[0] * boosted[1]
        strong *= self._prior[BOOSTED]
        control = silent[0] * silent[1]
        control *= self._prior[EMPTY]
        control += axes
        control += qpsk
        control += strong
        floor = self._floor
        qam = []
        low = np.float32(0.05) * control
        low += floor
        pooled = []
        for row in QAM:
            one_order = rails(row)
            one_order = one_order[0] * one_order[1]
            qam.append(one_order)
            nats = np.log(one_order + low)
            nats *= trust
            pooled.append(block_sums(segment_sums(nats, segments), self._block))
        order = _orders(pooled)
        data = None
        for number, density in enumerate(qam):
            density *= spread(segment_spread(order[number], segments, len(z)), self._block)
            data = density if data is None else data + density
        probability = self._control_probability(control, data, trust)
        return _Mixture(places, silent, boosted, qpsk, strong, axes, control, qam, data, order, probability)

    def _control_probability(self, control: np.ndarray, data: np.ndarray, trust: np.ndarray) -> np.ndarray:
        """(L, K) probabilities of control elements: twelve subcarriers of a symbol hold either these or data."""
        floor = self._floor
        limit = np.float32(self._s.log_limit)
        lead = np.log((control + floor) / (data + floor))
        np.maximum(lead, -limit, out=lead)
        np.minimum(lead, limit, out=lead)
        known = block_sums(trust, self._block)
        led_by = block_sums(lead * trust, self._block)
        led = moving_sum(led_by, self._resource_block)
        many = (led > 0) * known
        # its symbol and its resource block say how often control elements occur
        of_symbol, of_block = (
            known.sum(axis=1, keepdims=True),
            moving_sum(known.sum(axis=0), self._resource_block),
        )
        share = (
            many.sum(axis=1, keepdims=True)
            + moving_sum(many.sum(axis=0), self._resource_block)
            + np.float32(0.5)
        )
        share /= of_symbol + of_block + 1
        # elements under the return say half as much
        half = block_sums(lead, self._block)
        half += led_by
        ratio = moving_sum(half, self._resource_block) * np.float32(0.5)
        odds = np.exp(np.clip(-ratio, -30, 30))
        return spread(share / (share + (1 - share) * odds + np.float32(1e-9)), self._block)

    def demap(self, z: np.ndarray, noise: np.ndarray, trust: np.ndarray, segments: np.ndarray) -> SoftSymbols:
        """Posterior of the symbols.

        ``z`` (L, K) complex64: equalised elements; points have unit mean power; ``noise`` (L, K) float32: noise power
        over channel power; ``trust`` (L, K) float32: 1 for return-free elements in use, which judge constellations
        and control; 0 for the others; ``segments`` (half slots,) int: first symbol of each half slot.
        """
        m = self._mixture(z, noise, trust, segments)
        _, means, seconds = rail_tables()
        of_control = m.probability / (m.control + np.float32(1e-30))
        of_data = (1 - m.probability) / (m.data + np.float32(1e-30))
        mean = np.zeros((2, *z.shape), np.float32)
        second = np.zeros(z.shape, np.float32)
        for row, density, factor in (
            (QPSK, m.qpsk, of_control),
            (BOOSTED, m.strong, of_control),
            *((row, density, of_data) for row, density in zip(QAM, m.qam, strict=True)),
        ):
            if row in QAM and m.order[row - QAM[0]].max() < 0.01:
                continue
            weight = density * factor
            rails = means[row].take(m.places, mode="clip")
            rails *= weight
            mean += rails
            if row in QAM:
                squares = seconds[row].take(m.places, mode="clip")
                weight *= squares[0] + squares[1]
            elif row == BOOSTED:
                weight *= 2
            second += weight
        on_axes = m.axes * of_control
        if on_axes.max() > 0.1:
            real = m.boosted[0] * m.silent[1] > m.silent[0] * m.boosted[1]
            mean[0] += on_axes * real
            mean[1] += on_axes * ~real
            second += on_axes
        out = np.empty(z.shape, np.complex64)
        np.copysign(mean[0], z.real, out=out.real)
        np.copysign(mean[1], z.imag, out=out.imag)
        return SoftSymbols(out, second, self._nats(m), m.order, m.probability)
