"""Resource grid of an NR downlink carrier: SS/PBCH blocks, CORESET, PDSCH (TS 38.211, 38.213).

Exact: PSS, SSS, all DM-RS, all resource-element positions. Random: the payload bits under PBCH, PDCCH and
PDSCH. Channel coding followed by Gold scrambling makes transmitted bits equiprobable and uncorrelated, so
uniform random bits leave the waveform's statistics unchanged; they cannot be decoded. Precoding, a second layer
and error vectors are drawn. Not modelled: CSI-RS other than the tracking reference signal, beam sweeping,
transmit windowing.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from . import nr_sequences as seq
from .evm import TYPICAL, TYPICAL_EVM, evm_fraction
from .nr_config import DOWNLINK_SYMBOLS, MIXED, SSB_START_SYMBOLS, SSB_SUBCARRIERS, SYMBOLS_PER_SLOT, NrConfig

CORESET_SYMBOLS = 2  # duration of the CORESET, 1..3 in TS 38.211 clause 7.3.2.2: assumed
# PDSCH DM-RS symbols by kind of slot: type A position 2 and one additional, TS 38.211 Table 7.4.1.1.2-3
DMRS_SYMBOLS = {"D": (2, 11), "S": (2, 9)}
PRECODED_BLOCKS = 4  # precoding resource block group, TS 38.214 clause 5.1.2.3
PRECODING_DB = 6.0  # spread of amplitudes over precoding groups, dB: assumed
TRS_SYMBOLS = (6, 10)  # TS 38.214 clause 5.1.6.1.1; the pair, out of three, that never collides with DM-RS
TRS_STEP = 4  # subcarriers: density 3, TS 38.211 Table 7.4.1.5.3-1, row 1
# EPRE ratio of TS 38.214 Table 4.1-1: -3 dB for two CDM groups without data.
DMRS_AMPLITUDE = 10.0 ** (3.0 / 20.0)


class Element(IntEnum):
    """What a resource element carries."""

    EMPTY = 0
    PSS = 1
    SSS = 2
    PBCH = 3
    PBCH_DMRS = 4
    PDCCH = 5
    PDCCH_DMRS = 6
    PDSCH = 7
    PDSCH_DMRS = 8
    CSI_RS = 9


@dataclass(frozen=True)
class ResourceGrid:
    """`values` (subcarriers, symbols) complex128; `elements` (subcarriers, symbols) uint8 of `Element`.

    `evm` (subcarriers, symbols) is the error vectors' RMS fraction, None for an ideal carrier.
    """

    values: np.ndarray
    elements: np.ndarray
    evm: np.ndarray | None = None

    def where(self, *kinds: Element) -> np.ndarray:
        """Boolean mask (subcarriers, symbols) of the resource elements that carry any of `kinds`."""
        return np.isin(self.elements, kinds)


def _random_symbols(modulation: str, count: int, rng: np.random.Generator) -> np.ndarray:
    points = seq.constellation(modulation)
    return points[rng.integers(0, points.size, count)]


def ssb_block(cell_id: int, i_ssb: int, rng: np.random.Generator) -> ResourceGrid:
    """One SS/PBCH block (240, 4), TS 38.211 Table 7.4.3.1-1; DM-RS comb at v = cell_id mod 4.

    The 864 PBCH bits are random (their coding and scrambling whiten them anyway).
    """
    values = np.zeros((SSB_SUBCARRIERS, 4), dtype=np.complex128)
    elements = np.zeros(values.shape, dtype=np.uint8)
    values[56:183, 0], elements[56:183, 0] = seq.pss(cell_id), Element.PSS
    values[56:183, 2], elements[56:183, 2] = seq.sss(cell_id), Element.SSS
    elements[:, (1, 3)] = Element.PBCH
    elements[:48, 2] = elements[192:, 2] = Element.PBCH
    comb = np.arange(SSB_SUBCARRIERS) % 4 == cell_id % 4
    elements[comb[:, None] & (elements == Element.PBCH)] = Element.PBCH_DMRS
    # r(m) and d(m) run over subcarriers first, then symbols: the transposed views below are in that order.
    values.T[elements.T == Element.PBCH_DMRS] = seq.pbch_dmrs(cell_id, i_ssb)
    values.T[elements.T == Element.PBCH] = _random_symbols("qpsk", 432, rng)
    return ResourceGrid(values, elements)


def _place_ssb(config: NrConfig, grid: ResourceGrid, rng: np.random.Generator) -> None:
    rows = slice(config.ssb_first_subcarrier, config.ssb_first_subcarrier + SSB_SUBCARRIERS)
    for index in config.ssb_indices:
        block = ssb_block(config.cell_id, index, rng)
        first = SYMBOLS_PER_SLOT * (index // 2) + SSB_START_SYMBOLS[index % 2]
        grid.values[rows, first : first + 4] = block.values
        grid.elements[rows, first : first + 4] = block.elements


def _ssb_reserved(config: NrConfig) -> np.ndarray:
    """(resource blocks, symbols of a frame) bool: touched by an SS/PBCH block, TS 38.214 clause 5.1.4."""
    reserved = np.zeros((config.resource_blocks, config.slots_per_frame * SYMBOLS_PER_SLOT), dtype=bool)
    low = config.ssb_first_subcarrier // 12
    high = -(-(config.ssb_first_subcarrier + SSB_SUBCARRIERS) // 12)
    for index in config.ssb_indices:
        first = SYMBOLS_PER_SLOT * (index // 2) + SSB_START_SYMBOLS[index % 2]
        reserved[low:high, first : first + 4] = True
    return reserved


def _place_pdcch(
    config: NrConfig, grid: ResourceGrid, reserved: np.ndarray, rng: np.random.Generator
) -> None:
    """CORESET over the largest multiple of six resource blocks from block 0, not interleaved (7.3.2.2).

    A CCE is six REGs numbered time first, that is 6/duration resource blocks over all CORESET symbols. DM-RS on
    subcarriers 1, 5, 9 of each REG in use (7.4.1.3.2, precoder granularity of a REG bundle).
    """
    duration = CORESET_SYMBOLS
    width = 6 // duration
    cce_count = (config.resource_blocks // 6) * duration
    slots, symbols = np.meshgrid(np.arange(config.slots_per_frame), np.arange(duration), indexing="ij")
    pilots = seq.dmrs(config.cell_id, slots, symbols, 3 * config.resource_blocks)
    kinds = np.full(12, Element.PDCCH, dtype=np.uint8)
    kinds[[1, 5, 9]] = Element.PDCCH_DMRS
    for slot in range(config.slots_per_frame):
        if config.slot_kinds[slot] == "U":
            continue
        columns = slice(SYMBOLS_PER_SLOT * slot, SYMBOLS_PER_SLOT * slot + duration)
        blocked = reserved[: cce_count * width, columns].reshape(cce_count, -1).any(axis=1)
        free = rng.permutation(np.flatnonzero(~blocked))
        used = np.zeros(cce_count, dtype=bool)
        used[free[: round(config.pdcch_load * cce_count)]] = True
        block_used = np.zeros(config.resource_blocks, dtype=bool)
        block_used[: cce_count * width] = np.repeat(used, width)
        kind = np.where(block_used[:, None], kinds, 0).reshape(-1, 1).repeat(duration, axis=1)
        values = np.zeros(kind.shape, dtype=np.complex128)
        data = kind == Element.PDCCH
        values[data] = _random_symbols("qpsk", int(data.sum()), rng)
        comb = np.arange(config.subcarriers) % 4 == 1
        values[comb] = np.where(kind[comb] == Element.PDCCH_DMRS, pilots[slot].T, 0.0)
        grid.values[:, columns] += values
        grid.elements[:, columns] |= kind


def _place_pdsch(
    config: NrConfig, grid: ResourceGrid, reserved: np.ndarray, rng: np.random.Generator
) -> None:
    """PDSCH mapping type A from the end of the CORESET to symbol 13, DM-RS configuration type 1, port 1000.

    A resource block that an SS/PBCH block touches is not scheduled in that slot: its DM-RS would fall on the block,
    which TS 38.214 clause 5.1.4 forbids.
    """
    count = round(config.load * config.resource_blocks)
    for slot, kind in enumerate(config.slot_kinds):
        if kind == "U":
            continue
        columns = slice(SYMBOLS_PER_SLOT * slot, SYMBOLS_PER_SLOT * (slot + 1))
        start = rng.integers(0, config.resource_blocks - count + 1)
        block = np.zeros((config.resource_blocks, 1), dtype=bool)
        block[start : start + count] = True
        elements = grid.elements[:, columns]
        dmrs = DMRS_SYMBOLS[kind]
        block[reserved[:, columns].any(axis=1)] = False
        data = np.repeat(block, 12, axis=0).repeat(SYMBOLS_PER_SLOT, axis=1)
        data[:, :CORESET_SYMBOLS] = False
        data[:, DOWNLINK_SYMBOLS[kind] :] = False
        data[elements == Element.CSI_RS] = False
        comb = np.zeros(data.shape, dtype=bool)  # elements of the DM-RS
        comb[::2, dmrs] = np.repeat(block, 12, axis=0)[::2]
        data[:, dmrs] = False  # both CDM groups are without data
        sent = _layers(config, slot, dmrs, data, comb, grid, rng)
        if config.power_spread_db:
            own = _of_groups(config, rng.uniform(-config.power_spread_db, 0.0, _groups(config)))
            sent *= 10.0 ** (own[:, None] / 20.0)
        grid.values[:, columns][data | comb] = sent[data | comb]
        elements[data], elements[comb] = Element.PDSCH, Element.PDSCH_DMRS


def _layers(
    config: NrConfig,
    slot: int,
    dmrs: tuple[int, ...],
    data: np.ndarray,
    comb: np.ndarray,
    grid: ResourceGrid,
    rng: np.random.Generator,
) -> np.ndarray:
    """(subcarriers, 14) PDSCH and DM-RS of a slot as received by one antenna: one or two precoded layers."""
    pilots = seq.dmrs(config.cell_id, slot, np.array(dmrs), 6 * config.resource_blocks)
    pilots = pilots.T * DMRS_AMPLITUDE
    total = np.zeros(data.shape, dtype=np.complex128)
    user = None
    if config.modulation == MIXED:
        user = _of_groups(config, rng.integers(0, len(seq.BITS_PER_SYMBOL), _groups(config)))
    layers = 1 if config.second_layer_db is None else 2
    for layer in range(layers):
        one = np.zeros(data.shape, dtype=np.complex128)
        one[::2, dmrs] = pilots
        if layer:  # port 1001: the second orthogonal cover code of the comb, TS 38.211 Table 7.4.1.1.2-1
            one[2::4, dmrs] *= -1.0
        one[~comb] = 0.0
        one[data] = _payload(config, data, user, rng)
        if config.precoding or layer:
            one *= _precoder(config, rng)[:, None]
        total += one if not layer else 10.0 ** (config.second_layer_db / 20.0) * one
    if grid.evm is not None and user is not None and config.evm == TYPICAL:
        own = np.array([TYPICAL_EVM[name] for name in seq.BITS_PER_SYMBOL])[user][:, None]
        here = grid.evm[:, SYMBOLS_PER_SLOT * slot : SYMBOLS_PER_SLOT * (slot + 1)]
        here[:] = np.where(data | comb, own, here)
    return total


def _precoder(config: NrConfig, rng: np.random.Generator) -> np.ndarray:
    """(subcarriers,) a phase, and with ``precoding`` an amplitude within 6 dB, per group of four resource blocks."""
    groups = -(-config.resource_blocks // PRECODED_BLOCKS)
    weights = np.exp(2j * np.pi * rng.random(groups))
    if config.precoding:
        weights *= 10.0 ** (rng.uniform(-0.5, 0.5, groups) * PRECODING_DB / 20.0)
    return np.repeat(weights, 12 * PRECODED_BLOCKS)[: config.subcarriers]


def _place_trs(config: NrConfig, grid: ResourceGrid) -> None:
    """Tracking reference signal, a CSI-RS of one port and density 3 over the carrier, TS 38.211 clause 7.4.1.5."""
    for slot in config.trs_slots:
        for symbol in TRS_SYMBOLS:
            column = SYMBOLS_PER_SLOT * slot + symbol
            values = seq.csi_rs(config.cell_id, slot, symbol, 3 * config.resource_blocks)
            grid.values[::TRS_STEP, column] = values
            grid.elements[::TRS_STEP, column] = Element.CSI_RS


def _groups(config: NrConfig) -> int:
    """Resource block groups of the carrier, the last one perhaps smaller."""
    return -(-config.resource_blocks // config.group_blocks)


def _of_groups(config: NrConfig, values: np.ndarray) -> np.ndarray:
    """(subcarriers,) each group's value."""
    return np.repeat(values, 12 * config.group_blocks)[: config.subcarriers]


def _payload(
    config: NrConfig, data: np.ndarray, user: np.ndarray | None, rng: np.random.Generator
) -> np.ndarray:
    """Symbols of the elements where ``data`` (subcarriers, 14) is True; ``user`` (subcarriers,): modulation index."""
    if user is None:
        return _random_symbols(config.modulation, int(data.sum()), rng)
    drawn = np.stack([_random_symbols(name, int(data.sum()), rng) for name in seq.BITS_PER_SYMBOL])
    return np.take_along_axis(drawn, user[np.nonzero(data)[0]][None], axis=0)[0]


def resource_grid(config: NrConfig, rng: np.random.Generator) -> ResourceGrid:
    """Resource elements a_{k,l} of one 10 ms frame.

    Returns a `ResourceGrid` of shape (12 N_RB, 140): subcarrier 0 is the lowest, column 14 slot + symbol. PDSCH, PBCH
    and PDCCH elements have unit mean power; `rng` gives payload bits and allocations.
    """
    shape = (config.subcarriers, config.slots_per_frame * SYMBOLS_PER_SLOT)
    evm = None
    if config.evm:  # outside the users' data, the EVM of the carrier's modulation; where users mix, of 256QAM
        rest = evm_fraction(config.evm, "256qam" if config.modulation == MIXED else config.modulation)
        evm = np.full(shape, rest)
    grid = ResourceGrid(np.zeros(shape, dtype=np.complex128), np.zeros(shape, dtype=np.uint8), evm)
    reserved = _ssb_reserved(config)
    _place_ssb(config, grid, rng)
    _place_pdcch(config, grid, reserved, rng)
    if config.csi_rs:
        _place_trs(config, grid)
    _place_pdsch(config, grid, reserved, rng)
    return grid


def transmitted(grid: ResourceGrid, rng: np.random.Generator) -> np.ndarray:
    """(subcarriers, symbols) elements with the transmitter's error vectors; empty symbols have none.

    The error is white within the carrier: in other symbols, empty elements have it, too.
    """
    if grid.evm is None:
        return grid.values
    data = grid.where(Element.PDSCH)
    reference = grid.values[data if data.any() else grid.elements != Element.EMPTY]
    rms = np.sqrt(0.5 * np.mean(np.abs(reference) ** 2)) if reference.size else 0.0
    error = rng.standard_normal((*grid.values.shape, 2)).view(np.complex128)[..., 0] * (rms * grid.evm)
    return grid.values + error * (grid.elements != Element.EMPTY).any(axis=0)
