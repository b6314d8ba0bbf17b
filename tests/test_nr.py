"""The NR downlink against the recursions and tables of TS 38.211, redone here bit by bit and sum by sum."""

import numpy as np
import pytest

from radalt.core.interference import nr_sequences
from radalt.core.interference.emitters import nr
from radalt.core.interference.nr_grid import Element, ssb_block

RATE_HZ = 7.5e6


def lfsr_gold(c_init: int, length: int) -> list[int]:
    """Clause 5.2.1 with two shift registers, one bit at a time."""
    x1 = [1] + [0] * 30
    x2 = [(c_init >> i) & 1 for i in range(31)]
    out = []
    for n in range(1600 + length):
        if n >= 1600:
            out.append(x1[0] ^ x2[0])
        x1 = x1[1:] + [x1[3] ^ x1[0]]
        x2 = x2[1:] + [x2[3] ^ x2[2] ^ x2[1] ^ x2[0]]
    return out


def lfsr_qpsk(c_init: int, length: int) -> np.ndarray:
    c = lfsr_gold(c_init, 2 * length)
    return np.array([complex(1 - 2 * c[2 * m], 1 - 2 * c[2 * m + 1]) for m in range(length)]) / 2**0.5


def lfsr7(initial: str, tap: int) -> list[int]:
    """`initial` is written [x(6) .. x(0)] as in the standard."""
    register = [int(bit) for bit in reversed(initial)]
    out = []
    for _ in range(127):
        out.append(register[0])
        register = register[1:] + [register[tap] ^ register[0]]
    return out


def test_gold_sequence_is_the_two_registers_of_many_seeds_and_no_bits():
    for c_init in (0, 1, 0x12345678, 2**31 - 1):
        assert nr_sequences.gold_sequence(c_init, 400).tolist() == lfsr_gold(c_init, 400)
    seeds = np.array([[3, 5], [7, 11]])
    bits = nr_sequences.gold_sequence(seeds, 77)
    assert bits.shape == (2, 2, 77) and bits[1, 0].tolist() == lfsr_gold(7, 77)
    assert nr_sequences.gold_sequence(9, 0).shape == (0,)
    for bad in (2**31, -1):
        with pytest.raises(ValueError, match="reduce it modulo"):
            nr_sequences.gold_sequence(bad, 8)


@pytest.mark.parametrize("cell_id", [0, 1, 2, 335, 500, 1007])
def test_pss_and_sss(cell_id):
    n_id1, n_id2 = cell_id // 3, cell_id % 3
    x = lfsr7("1110110", 4)
    pss = [1 - 2 * x[(n + 43 * n_id2) % 127] for n in range(127)]
    x0, x1 = lfsr7("0000001", 4), lfsr7("0000001", 1)
    m0, m1 = 15 * (n_id1 // 112) + 5 * n_id2, n_id1 % 112
    sss = [(1 - 2 * x0[(n + m0) % 127]) * (1 - 2 * x1[(n + m1) % 127]) for n in range(127)]
    assert [f(cell_id).tolist() for f in (nr_sequences.pss, nr_sequences.sss)] == [pss, sss]


@pytest.mark.parametrize(("cell_id", "index"), [(0, 0), (17, 3), (1006, 5)])
def test_ss_pbch_block_table(cell_id, index):
    """Table 7.4.3.1-1, cell by cell."""
    block = ssb_block(cell_id, index, np.random.default_rng(1))
    v = cell_id % 4
    c_init = 2**11 * (index + 1) * (cell_id // 4 + 1) + 2**6 * (index + 1) + v
    pilots = iter(lfsr_qpsk(c_init, 144))
    for symbol in range(4):
        for k in range(240):
            kind, value = block.elements[k, symbol], block.values[k, symbol]
            if symbol in (1, 3) or (symbol == 2 and (k < 48 or k >= 192)):
                assert kind == (Element.PBCH_DMRS if k % 4 == v else Element.PBCH)
                assert abs(abs(value) - 1) < 1e-12
                if k % 4 == v:
                    assert abs(value - next(pilots)) < 1e-12
            elif 56 <= k <= 182:
                assert kind == (Element.PSS if symbol == 0 else Element.SSS)
            else:
                assert kind == Element.EMPTY and value == 0
    assert next(pilots, None) is None


def test_blocks_sit_at_case_a_symbols():
    config = nr.NrConfig(ssb_indices=(0, 1, 2, 7), load=0.0, pdcch_load=0.0)
    grid = nr.resource_grid(config, np.random.default_rng(0))
    pss_columns = np.flatnonzero(grid.where(Element.PSS).any(axis=0))
    assert pss_columns.tolist() == [2, 8, 16, 14 * 3 + 8]
    rows = np.flatnonzero(grid.where(Element.PSS)[:, 2])
    assert (rows[0], rows[-1]) == (30 + 56, 30 + 182)  # 240 centred in 300 subcarriers


def test_pdsch_dmrs_positions_and_values():
    """Type A position 2, one additional symbol, two CDM groups without data."""
    cell_id = 321
    grid = nr.resource_grid(nr.NrConfig(cell_id=cell_id, ssb_indices=()), np.random.default_rng(3))
    slot = 6
    found = np.flatnonzero(grid.where(Element.PDSCH_DMRS)[:, 14 * slot : 14 * slot + 14].any(axis=0))
    assert found.tolist() == [2, 11]
    for symbol in found:
        c_init = (2**17 * (14 * slot + int(symbol) + 1) * (2 * cell_id + 1) + 2 * cell_id) % 2**31
        r = lfsr_qpsk(c_init, 150)
        column = grid.values[:, 14 * slot + symbol]
        for n in range(75):  # k = 4n + 2k', configuration type 1, port 1000
            for k_prime in (0, 1):
                assert abs(column[4 * n + 2 * k_prime] - 10 ** (3 / 20) * r[2 * n + k_prime]) < 1e-12
        assert set(grid.elements[1::2, 14 * slot + symbol].tolist()) == {Element.EMPTY}


def test_pdcch_dmrs_positions_and_values():
    cell_id = 99
    config = nr.NrConfig(channel_bandwidth_hz=10e6, cell_id=cell_id, pdcch_load=1.0)
    grid = nr.resource_grid(config, np.random.default_rng(3))
    slot = 4
    for symbol in range(2):
        c_init = (2**17 * (14 * slot + symbol + 1) * (2 * cell_id + 1) + 2 * cell_id) % 2**31
        r = lfsr_qpsk(c_init, 3 * 52)
        kinds = grid.elements[:, 14 * slot + symbol]
        for block in range(48):
            for k_prime in range(3):
                k = 12 * block + 4 * k_prime + 1
                assert kinds[k] == Element.PDCCH_DMRS
                assert abs(grid.values[k, 14 * slot + symbol] - r[3 * block + k_prime]) < 1e-12
        assert (kinds == Element.PDCCH).sum() == 48 * 9
        assert not kinds[48 * 12 :].any()


def test_half_the_control_channel_elements_are_used_whole():
    grid = nr.resource_grid(nr.NrConfig(pdcch_load=0.5, load=0.0, ssb_indices=()), np.random.default_rng(8))
    used = grid.where(Element.PDCCH).reshape(25, 12, 10, 14).any(axis=1)
    assert not used[24].any() and not used[..., 2:].any()
    elements = used[:24, :, :2].reshape(8, 3, 10, 2)  # 6 REGs a CCE: 3 blocks over 2 symbols
    assert np.array_equal(elements.any(axis=(1, 3)), elements.all(axis=(1, 3)))
    assert (elements.all(axis=(1, 3)).sum(axis=0) == 4).all()


@pytest.mark.parametrize("load", [0.0, 0.2, 0.52, 1.0])
def test_load_is_the_fraction_of_resource_blocks(load):
    grid = nr.resource_grid(nr.NrConfig(load=load, ssb_indices=()), np.random.default_rng(2))
    blocks = grid.where(Element.PDSCH).reshape(25, 12, 10, 14).any(axis=(1, 3))
    assert (blocks.sum(axis=0) == round(load * 25)).all()


def test_pdsch_never_meets_a_block_or_the_control_region():
    config = nr.NrConfig(channel_bandwidth_hz=10e6, ssb_indices=(0, 3), load=1.0)
    grid = nr.resource_grid(config, np.random.default_rng(2))
    data = grid.where(Element.PDSCH, Element.PDSCH_DMRS).reshape(52, 12, 140).any(axis=1)
    touched = slice(192 // 12, (192 + 240) // 12)
    assert not data[touched, :28].any()  # its DM-RS in symbols 2 and 11 would hit blocks 0 and 3
    assert data[touched, 28 + 12].all() and data[:16, 12].all()
    assert not data.reshape(52, 10, 14)[..., :2].any()


def axis_level(bits: list[int]) -> int:
    """One rail of clauses 5.1.3 to 5.1.6, written as the nested brackets of the text."""
    level = 1 - 2 * bits[-1]
    for depth, bit in enumerate(reversed(bits[:-1]), start=1):
        level = (1 - 2 * bit) * (2**depth - level)
    return level


@pytest.mark.parametrize(
    ("name", "bits", "energy"), [("qpsk", 2, 2), ("16qam", 4, 10), ("64qam", 6, 42), ("256qam", 8, 170)]
)
def test_constellations(name, bits, energy):
    points = nr_sequences.constellation(name)
    assert np.mean(np.abs(points) ** 2) == pytest.approx(1.0, abs=1e-12)
    for index, point in enumerate(points):
        b = [(index >> (bits - 1 - i)) & 1 for i in range(bits)]
        assert abs(point * energy**0.5 - complex(axis_level(b[0::2]), axis_level(b[1::2]))) < 1e-9
    grid = nr.resource_grid(nr.NrConfig(modulation=name), np.random.default_rng(0))
    sent = grid.values[grid.where(Element.PDSCH)]
    assert np.isin(np.round(sent, 9), np.round(points, 9)).all()
    assert np.unique(np.round(sent, 9)).size == points.size


@pytest.mark.parametrize("bandwidth_hz", [5e6, 10e6])
def test_mixed_users_have_an_alphabet_each(bandwidth_hz):
    config = nr.NrConfig(channel_bandwidth_hz=bandwidth_hz, modulation="mixed")
    grid = nr.resource_grid(config, np.random.default_rng(1))
    group, seen = 12 * {5e6: 2, 10e6: 4}[bandwidth_hz], []
    names = ("qpsk", "16qam", "64qam", "256qam")
    known = {name: np.round(nr_sequences.constellation(name), 9) for name in names}
    for first in range(0, config.subcarriers, group):
        for slot in range(10):
            part = slice(first, first + group), slice(14 * slot, 14 * slot + 14)
            sent = np.round(grid.values[part][grid.elements[part] == Element.PDSCH], 9)
            if sent.size < 200:
                continue
            (name,) = (name for name, points in known.items() if np.isin(sent, points).all())
            seen.append(name)
    assert set(seen) == known.keys()


def test_users_powers_differ_by_the_spread():
    config = nr.NrConfig(channel_bandwidth_hz=10e6, modulation="qpsk", power_spread_db=10.0, ssb_indices=())
    grid = nr.resource_grid(config, np.random.default_rng(2))
    users = np.where(grid.elements == Element.PDSCH, np.abs(grid.values) ** 2, np.nan)
    users = 10 * np.log10(np.nanmax(users.reshape(13, 48, 10, 14), axis=(1, 3)))
    assert -10 <= users.min() < -8 and -2 < users.max() <= 1e-9
    pilots = grid.values[grid.elements == Element.PDSCH_DMRS]
    assert np.abs(pilots).min() == pytest.approx(10 ** ((users.min() + 3) / 20), rel=1e-6)


def demodulate(samples, rate_hz, subcarriers, symbols, carrier_hz=0.0, kept=slice(None), spacing_hz=15e3):
    """Correlate with every subcarrier over one symbol length, timing in units of T_c (clauses 4.1, 5.3.1)."""
    kappa_tc = 64 / (480e3 * 4096)
    numerology = {15e3: 0, 30e3: 1}[spacing_hz]
    frequency = ((np.arange(subcarriers) - subcarriers / 2) * spacing_hz + carrier_hz)[kept]
    length = round(rate_hz / spacing_hz)
    kernel = np.exp(-2j * np.pi * frequency[:, None] * np.arange(length) / rate_hz)
    out = np.empty((frequency.size, symbols), complex)
    start = 0  # of the symbol, prefix included, in kappa T_c
    for number in range(symbols):
        prefix = 144 // 2**numerology + (16 if number % (7 * 2**numerology) == 0 else 0)
        useful_s = (start + prefix) * kappa_tc
        first = int(np.ceil((start + prefix / 2) * kappa_tc * rate_hz - 1e-9))  # half the prefix early
        # The carrier offset turns from sample 0 on, the subcarriers from the start of the useful part.
        lag = np.exp(2j * np.pi * ((frequency - carrier_hz) * useful_s - frequency * first / rate_hz))
        out[:, number] = kernel @ samples[first : first + length] / length * lag
        start += 2048 // 2**numerology + prefix
    assert start * kappa_tc == pytest.approx(symbols / 14 * 1e-3 / 2**numerology, rel=1e-12)
    return out


def evm_db(measured, sent):
    gain = np.vdot(sent, measured) / np.vdot(sent, sent)
    error = measured / gain - sent
    return 10 * np.log10(np.mean(np.abs(error) ** 2) / np.mean(np.abs(sent) ** 2))


@pytest.mark.parametrize(
    ("spacing_hz", "bandwidth_hz", "blocks", "rate_hz"),
    [
        (15e3, 5e6, 25, 7.68e6),
        (15e3, 10e6, 52, 15.36e6),
        (15e3, 20e6, 106, 30.72e6),
        (30e3, 10e6, 24, 15.36e6),
        (30e3, 20e6, 51, 30.72e6),
        (30e3, 100e6, 273, 122.88e6),
    ],
)
def test_every_resource_element_comes_back_at_the_native_rate(spacing_hz, bandwidth_hz, blocks, rate_hz):
    """TS 38.101-1 Table 5.3.2-1; 28 symbols, which hold every kind of cyclic prefix."""
    config = nr.NrConfig(channel_bandwidth_hz=bandwidth_hz, subcarrier_spacing_hz=spacing_hz, cell_id=9)
    assert (config.resource_blocks, config.sample_rate_hz) == (blocks, rate_hz)
    sent = nr.resource_grid(config, np.random.default_rng(config.seed)).values
    assert sent.shape == (12 * blocks, {15e3: 140, 30e3: 280}[spacing_hz])
    samples = nr.frame_samples(config)
    assert samples.size == round(rate_hz * 10e-3)
    kept = slice(None, None, 1 + blocks // 40)
    received = demodulate(samples, rate_hz, 12 * blocks, 28, 0.0, kept, spacing_hz)
    assert np.max(np.abs(received - sent[kept, :28])) < 1e-8  # unscaled definition, so even the gain is 1


@pytest.mark.parametrize(
    ("spacing_hz", "bandwidth_hz", "carrier_hz", "most_db"),
    [
        *((15e3, 5e6, carrier_hz, -40) for carrier_hz in (0.0, -0.73e6)),
        *((15e3, 10e6, carrier_hz, -40) for carrier_hz in (0.0, 3.1e6)),
        # the filter's edges lie in half a prefix of 8.8 samples
        *((30e3, 10e6, 0.0, -35), (30e3, 40e6, 19e6, -35), (30e3, 100e6, -30e6, -35), (15e3, 50e6, 3e6, -35)),
    ],
)
def test_what_the_filter_passes_comes_back_at_the_radars_rate(spacing_hz, bandwidth_hz, carrier_hz, most_db):
    """At 7.5 MS/s a symbol of 15 kHz is 500 samples."""
    place = {"subcarrier_spacing_hz": spacing_hz, "carrier_hz": carrier_hz, "ssb_indices": ()}
    emitter = nr.NrEmitter(channel_bandwidth_hz=bandwidth_hz, **place)
    sent = nr.resource_grid(emitter, np.random.default_rng(emitter.seed)).values
    received, residual_hz = emitter.period(RATE_HZ)
    assert residual_hz == 0 and np.mean(np.abs(received) ** 2) == pytest.approx(1.0)
    offset = (np.arange(emitter.subcarriers) - emitter.subcarriers / 2) * spacing_hz + carrier_hz
    passed = np.abs(offset) < 0.45 * RATE_HZ - 40e3
    assert passed.sum() > 90
    got = demodulate(received, RATE_HZ, emitter.subcarriers, 28, carrier_hz, passed, spacing_hz)
    assert evm_db(got, sent[passed, :28]) < most_db


@pytest.mark.parametrize(
    ("modulation", "evm"), [("qpsk", 0.1), ("qpsk", "typical"), ("64qam", "typical"), ("256qam", "typical")]
)
def test_a_textbook_demodulator_measures_the_evm_asked_for(modulation, evm):
    config = nr.NrConfig(modulation=modulation, evm=evm)
    limit = {"qpsk": 0.175, "16qam": 0.125, "64qam": 0.08, "256qam": 0.035}[modulation]  # TS 38.104
    wanted = limit / 2 if evm == "typical" else evm
    grid = nr.resource_grid(config, np.random.default_rng(config.seed))
    ideal = nr.resource_grid(nr.NrConfig(modulation=modulation), np.random.default_rng(0))
    assert np.array_equal(grid.values, ideal.values)
    data = grid.where(Element.PDSCH)
    got = demodulate(nr.frame_samples(config), config.sample_rate_hz, config.subcarriers, 140)
    error = got - grid.values
    reference = np.sqrt(np.mean(np.abs(grid.values[data]) ** 2))
    measured = np.sqrt(np.mean(np.abs(error[data]) ** 2)) / reference
    assert measured == pytest.approx(wanted, rel=0.02)
    # white, circular, and of every element alike, pilots and empty ones too
    assert abs(np.mean(error**2)) < 0.03 * np.mean(np.abs(error) ** 2)
    for axis in (0, 1):
        lagged = np.vdot(np.delete(error, 0, axis), np.delete(error, -1, axis)) / np.vdot(error, error)
        assert abs(lagged) < 0.03
    rest = ~data & (grid.elements.any(axis=0))
    assert np.sqrt(np.mean(np.abs(error[rest]) ** 2)) / reference == pytest.approx(wanted, rel=0.05)


def test_mixed_users_have_the_typical_evm_of_their_own_alphabet_and_frames_differ():
    config = nr.NrConfig(modulation="mixed", evm="typical", ssb_indices=(), frame_count=2)
    rng = np.random.default_rng(config.seed)
    grids = [nr.resource_grid(config, rng) for _ in range(2)]
    samples = nr.frame_samples(config).reshape(2, -1)
    errors = [demodulate(s, 7.68e6, 300, 140) - g.values for s, g in zip(samples, grids, strict=True)]
    assert abs(np.vdot(*errors)) < 0.02 * np.linalg.norm(errors[0]) * np.linalg.norm(errors[1])
    grid, error = grids[0], errors[0]
    seen = {}
    for first in range(0, 288, 24):
        for slot in range(10):
            part = slice(first, first + 24), slice(14 * slot, 14 * slot + 14)
            here = grid.elements[part] == Element.PDSCH
            sent = np.round(grid.values[part][here], 9)
            size = next(s for s in (4, 16, 64, 256) if np.unique(sent).size <= s)
            seen.setdefault(size, []).append(np.mean(np.abs(error[part][here]) ** 2))
    for size, limit in ((4, 0.175), (16, 0.125), (64, 0.08), (256, 0.035)):
        assert np.sqrt(np.mean(seen[size])) == pytest.approx(limit / 2, rel=0.02)


def test_error_vectors_are_in_the_prefix_as_in_the_symbol():
    samples = nr.frame_samples(nr.NrConfig(evm=0.2))
    np.testing.assert_allclose(samples[:40], samples[512:552], atol=1e-9)


def precoded(config):
    """(groups of four blocks, slots) factor of the DM-RS against the sequence, and how much it varies within them."""
    grid = nr.resource_grid(config, np.random.default_rng(config.seed))
    factors, spread = [], []
    for slot in range(config.slots_per_frame):
        pilots = np.array(lfsr_qpsk((2**17 * (14 * slot + 3) * 1) % 2**31, 6 * config.resource_blocks))
        factor = grid.values[::2, 14 * slot + 2] / (10 ** (3 / 20) * pilots)
        factor = factor[: factor.size // 24 * 24].reshape(-1, 24)
        factors.append(factor.mean(axis=1))
        spread.append(np.abs(factor - factors[-1][:, None]).max())
    return grid, np.array(factors).T, max(spread)


def test_precoders_are_constant_over_four_blocks_and_a_slot_and_within_6_db():
    config = nr.NrConfig(channel_bandwidth_hz=20e6, modulation="qpsk", precoding=True, ssb_indices=())
    grid, factors, spread = precoded(config)
    assert spread < 1e-12
    level = 20 * np.log10(np.abs(factors))
    assert -3.0 <= level.min() < -2.7 and 2.7 < level.max() <= 3.0
    assert np.unique(np.round(np.angle(factors), 6)).size == factors.size
    data = grid.values[: 48 * factors.shape[0]].reshape(-1, 48, 10, 14)[:, :, :, 3:11]
    points = data / factors[:, None, :, None]  # data with its DM-RS
    np.testing.assert_allclose(np.abs(points), 1.0, atol=1e-9)
    np.testing.assert_allclose(points**4, -1.0, atol=1e-9)


def test_second_layer_has_its_power_and_the_other_port_of_the_dmrs():
    config = nr.NrConfig(modulation="64qam", second_layer_db=-6.0, ssb_indices=())
    one = nr.resource_grid(nr.NrConfig(modulation="64qam", ssb_indices=()), np.random.default_rng(0))
    both = nr.resource_grid(config, np.random.default_rng(0))
    assert np.array_equal(one.elements, both.elements)
    data = both.where(Element.PDSCH)
    power = np.mean(np.abs(both.values[data]) ** 2)
    assert power == pytest.approx(1 + 10**-0.6, rel=0.03)
    for slot in (0, 7):
        pilots = np.array(lfsr_qpsk((2**17 * (14 * slot + 3)) % 2**31, 150)) * 10 ** (3 / 20)
        # covers + + and + - of 1000 and 1001
        seen = (both.values[::2, 14 * slot + 2] / pilots)[:144].reshape(-1, 12, 2)
        np.testing.assert_allclose(seen.mean(axis=2), 1.0, atol=1e-9)
        other = (seen[..., 0] - seen[..., 1]) / 2
        np.testing.assert_allclose(np.abs(other), 10**-0.3, atol=1e-9)
        assert np.abs(np.diff(other[:, 0])).min() > 1e-3  # a precoder of its own, by the group of 24 pilots
        assert np.abs(other - other[:, :1]).max() < 1e-9


def test_tdd_sends_in_downlink_slots_and_ten_symbols_of_special_ones():
    config = nr.NrConfig(channel_bandwidth_hz=20e6, subcarrier_spacing_hz=30e3, tdd="DDDSU")
    grid = nr.resource_grid(config, np.random.default_rng(1))
    used = grid.elements.any(axis=0).reshape(20, 14)
    for slot, kind in enumerate("DDDSU" * 4):
        assert used[slot].tolist() == {"D": [1] * 14, "S": [1] * 10 + [0] * 4, "U": [0] * 14}[kind]
    pilots = (grid.elements == Element.PDSCH_DMRS).any(axis=0).reshape(20, 14)
    assert np.flatnonzero(pilots[5]).tolist() == [2, 11]
    assert np.flatnonzero(pilots[8]).tolist() == [2, 9]  # Table 7.4.1.1.2-3, ten symbols
    silent = nr.frame_samples(nr.NrConfig(tdd="DDDSU", evm=0.1)).reshape(10, -1)
    assert not silent[4].any() and silent[5].any()  # no error vectors where nothing is sent


def test_tracking_reference_signal():
    """Clause 7.4.1.5.3, row 1: density 3, one port; TS 38.214 clause 5.1.6.1.1: two symbols in two slots in a row."""
    cell_id = 77
    config = nr.NrConfig(cell_id=cell_id, csi_rs=True)
    grid = nr.resource_grid(config, np.random.default_rng(1))
    rows, columns = np.nonzero(grid.elements == Element.CSI_RS)
    assert np.unique(columns).tolist() == [14 + 6, 14 + 10, 28 + 6, 28 + 10]
    for column in np.unique(columns):
        slot, symbol = divmod(int(column), 14)
        c_init = (2**10 * (14 * slot + symbol + 1) * (2 * cell_id + 1) + cell_id) % 2**31
        assert rows[columns == column].tolist() == list(range(0, 300, 4))
        np.testing.assert_allclose(grid.values[::4, column], lfsr_qpsk(c_init, 75), atol=1e-12)
        assert (grid.elements[1::4, column] == Element.PDSCH).all()  # data around it


@pytest.mark.parametrize("bandwidth_hz", [5e6, 10e6])
def test_windows_have_unit_power_and_wrap_cleanly(bandwidth_hz):
    emitter = nr.NrEmitter(channel_bandwidth_hz=bandwidth_hz, carrier_hz=1234567.0, load=0.6)
    frame, residual_hz = emitter.period(RATE_HZ)
    assert frame.size == 75_000 and residual_hz == pytest.approx(-33.0)
    rng = np.random.default_rng(5)
    power = [np.mean(np.abs(emitter.samples(7500, RATE_HZ, rng)) ** 2) for _ in range(400)]
    assert np.mean(power) == pytest.approx(1.0, abs=0.03)
    long = emitter.samples(160_000, RATE_HZ, np.random.default_rng(6))
    turn = np.exp(-2j * np.pi * residual_hz * 10e-3)
    np.testing.assert_allclose(long[75_000:] * turn, long[: 160_000 - 75_000], atol=1e-9)


@pytest.mark.parametrize(("bandwidth_hz", "carrier_hz"), [(5e6, 4.0e6), (10e6, 0.0), (10e6, -5.05e6)])
def test_nothing_outside_the_receiver_folds_in(bandwidth_hz, carrier_hz):
    """The 10 ms signal is periodic: its lines are those of the same signal built at 61.44 MHz, shifted, but
    for side lobes below -33 dB that OFDM built at 7.68 MHz folds. What of a carrier folded in would be above -15 dB."""
    emitter = nr.NrEmitter(channel_bandwidth_hz=bandwidth_hz, carrier_hz=carrier_hz)
    received, _ = emitter.period(RATE_HZ)
    wide = np.fft.fft(nr.frame_samples(emitter, 4096)) / (4096 * 150)
    got = np.fft.fft(received) / received.size
    line = np.arange(-33_000, 33_001)  # +-3.3 MHz in steps of 100 Hz
    assert evm_db(got[line], wide[line - round(carrier_hz / 100)]) < -33


@pytest.mark.parametrize("bandwidth_hz, occupied_hz, margin_hz", [(5e6, 4.46e6, 5e4), (10e6, 9.3e6, 1e5)])
def test_occupied_bandwidth(bandwidth_hz, occupied_hz, margin_hz):
    config = nr.NrConfig(channel_bandwidth_hz=bandwidth_hz)
    samples = nr.frame_samples(config)
    power = np.fft.fftshift(np.abs(np.fft.fft(samples)) ** 2)
    share = np.cumsum(power) / power.sum()
    low, high = np.searchsorted(share, [0.005, 0.995])
    assert (high - low) * 100.0 == pytest.approx(occupied_hz, abs=margin_hz)
