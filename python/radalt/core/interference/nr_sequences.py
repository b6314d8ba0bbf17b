"""Sequences of the NR downlink, 3GPP TS 38.211: Gold, PSS, SSS, DM-RS and QAM constellations.

Everything here is exact and deterministic; nothing draws random numbers.
"""

import numpy as np

GOLD_ADVANCE = 1600  # N_C of clause 5.2.1
GOLD_DEGREE = 31  # length of the shift registers, clause 5.2.1
BITS_PER_SYMBOL = {"qpsk": 2, "16qam": 4, "64qam": 6, "256qam": 8}  # clauses 5.1.3 to 5.1.6


def _extend_lfsr(state: np.ndarray, taps: tuple[int, ...], length: int) -> np.ndarray:
    """Run x(n+31) = sum x(n+tap) mod 2 from `state` (rows, 31) to (rows, length), in O(log length) steps.

    Squaring a polynomial over GF(2) doubles its exponents (Frobenius), so the sequence also obeys x(n + 31 q) = sum
    x(n + tap q) for q = 1, 2, 4 and so on. The longer the known part, the longer the next block.
    """
    known = state
    longest_reach = GOLD_DEGREE - max(taps)
    while known.shape[1] < length:
        q = 1 << ((known.shape[1] // GOLD_DEGREE).bit_length() - 1)
        start = known.shape[1] - GOLD_DEGREE * q
        span = longest_reach * q
        block = np.zeros((known.shape[0], span), dtype=np.uint8)
        for tap in taps:
            block ^= known[:, start + tap * q : start + tap * q + span]
        known = np.concatenate([known, block], axis=1)
    return known[:, :length]


def gold_sequence(c_init: int | np.ndarray, length: int) -> np.ndarray:
    """Length-31 Gold sequence c(n), TS 38.211 clause 5.2.1: uint8 (..., length) of 0 and 1.

    ``c_init``, an integer or an array of them (...), is the initial value of the second m-sequence, below 2**31.
    """
    init = np.asarray(c_init, dtype=np.int64)
    if init.size and (init.min() < 0 or init.max() >= 1 << GOLD_DEGREE):
        raise ValueError(f"c_init {c_init} is outside 0..2^31-1; reduce it modulo 2^31")
    rows = init.reshape(-1, 1)
    first = np.zeros((1, GOLD_DEGREE), dtype=np.uint8)
    first[0, 0] = 1
    second = ((rows >> np.arange(GOLD_DEGREE)) & 1).astype(np.uint8)
    total = length + GOLD_ADVANCE
    x1 = _extend_lfsr(first, (0, 3), total)[:, GOLD_ADVANCE:]
    x2 = _extend_lfsr(second, (0, 1, 2, 3), total)[:, GOLD_ADVANCE:]
    return (x1 ^ x2).reshape(init.shape + (length,))


def gold_qpsk(c_init: int | np.ndarray, length: int) -> np.ndarray:
    """DM-RS symbols r(m) = ((1 - 2c(2m)) + j (1 - 2c(2m+1))) / sqrt 2, unit power; (..., length) complex128.

    The same form serves PBCH (7.4.1.4.1), PDCCH (7.4.1.3.1) and PDSCH (7.4.1.1.1); see `gold_sequence`.
    """
    antipodal = 1.0 - 2.0 * gold_sequence(c_init, 2 * length)
    return (antipodal[..., 0::2] + 1j * antipodal[..., 1::2]) / np.sqrt(2.0)


def _m_sequence(seed: tuple[int, ...], tap: int) -> np.ndarray:
    """x(i+7) = x(i+tap) + x(i) mod 2, 127 values; `seed` is x(0)..x(6)."""
    bits = list(seed)
    for i in range(127 - 7):
        bits.append(bits[i + tap] ^ bits[i])
    return np.array(bits, dtype=np.int64)


_PSS_M = _m_sequence((0, 1, 1, 0, 1, 1, 1), 4)
_SSS_M0 = _m_sequence((1, 0, 0, 0, 0, 0, 0), 4)
_SSS_M1 = _m_sequence((1, 0, 0, 0, 0, 0, 0), 1)


def check_cell_id(cell_id: int) -> None:
    """Raise ValueError unless `cell_id` is an integer 0..1007 (clause 7.4.2.1)."""
    if isinstance(cell_id, bool) or not isinstance(cell_id, (int, np.integer)) or not 0 <= cell_id <= 1007:
        raise ValueError(f"cell_id {cell_id!r} is outside 0..1007; choose an integer physical cell identity")


def pss(cell_id: int) -> np.ndarray:
    """Primary synchronisation signal, clause 7.4.2.2: (127,) float64 of +-1 for cell 0..1007."""
    return 1.0 - 2.0 * _PSS_M[(np.arange(127) + 43 * (cell_id % 3)) % 127]


def sss(cell_id: int) -> np.ndarray:
    """Secondary synchronisation signal, clause 7.4.2.3: (127,) float64 of +-1 for cell 0..1007."""
    n_id1, n_id2 = divmod(int(cell_id), 3)
    n = np.arange(127)
    m0 = 15 * (n_id1 // 112) + 5 * n_id2
    m1 = n_id1 % 112
    return (1.0 - 2.0 * _SSS_M0[(n + m0) % 127]) * (1.0 - 2.0 * _SSS_M1[(n + m1) % 127])


def pbch_dmrs(cell_id: int, i_ssb: int) -> np.ndarray:
    """PBCH DM-RS, clause 7.4.1.4.1: (144,) complex128.

    `i_ssb` is the i-bar of the clause, 0..7: for L_max = 4 the two low bits of the block index plus 4 times the
    half-frame number, else the three low bits of the index.
    """
    c_init = (i_ssb + 1) * (cell_id // 4 + 1) * 2**11 + 2**6 * (i_ssb + 1) + cell_id % 4
    return gold_qpsk(c_init, 144)


def _symbol_c_init(slot: np.ndarray, symbol: np.ndarray, n_id: int) -> np.ndarray:
    slot, symbol = np.asarray(slot, dtype=np.int64), np.asarray(symbol, dtype=np.int64)
    return (2**17 * (14 * slot + symbol + 1) * (2 * n_id + 1) + 2 * n_id) % 2**31


def dmrs(cell_id: int, slot: np.ndarray, symbol: np.ndarray, length: int) -> np.ndarray:
    """DM-RS of PDCCH, r_l(m) of clause 7.4.1.3.1, and PDSCH, r(n) of 7.4.1.1.1 with n_SCID = 0: (..., length).

    N_ID is the cell identity; `slot` (in the frame) and `symbol` (in the slot) broadcast together to (...,).
    """
    return gold_qpsk(_symbol_c_init(slot, symbol, cell_id), length)


def csi_rs(cell_id: int, slot: int, symbol: int, length: int) -> np.ndarray:
    """CSI-RS r(m), clause 7.4.1.5.2, n_ID = cell identity: (length,) complex128."""
    c_init = (2**10 * (14 * slot + symbol + 1) * (2 * cell_id + 1) + cell_id) % 2**31
    return gold_qpsk(c_init, length)


def constellation(modulation: str) -> np.ndarray:
    """QAM constellation of clause 5.1, unit mean power: (2**Q,) complex128, index = bits with b(0) as the MSB.

    Raises ValueError for anything but 'qpsk', '16qam', '64qam', '256qam'.
    """
    if modulation not in BITS_PER_SYMBOL:
        raise ValueError(
            f"modulation {modulation!r} is no NR modulation; choose one of {', '.join(BITS_PER_SYMBOL)}"
        )
    bits = BITS_PER_SYMBOL[modulation]
    index = np.arange(1 << bits)
    sign = 1 - 2 * ((index[:, None] >> np.arange(bits - 1, -1, -1)) & 1)
    real = sign[:, bits - 2].astype(float)
    imag = sign[:, bits - 1].astype(float)
    # Nested Gray form of clauses 5.1.3 to 5.1.6, from the innermost bracket outwards.
    for level, bit in enumerate(range(bits - 4, -1, -2), start=1):
        real = sign[:, bit] * (2**level - real)
        imag = sign[:, bit + 1] * (2**level - imag)
    return (real + 1j * imag) / np.sqrt(2.0 * ((1 << bits) - 1) / 3.0)
