"""A long prefix taken for a symbol too late or too early: the symbols between come too late, and tell so."""

from dataclasses import replace

import numpy as np
import pytest

from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.mitigation.ofdm.acquisition import acquire, acquired, find_prefix
from radalt.core.mitigation.ofdm.demodulator import FIRST, demodulate
from radalt.core.mitigation.ofdm.first_reading import Opened
from radalt.core.mitigation.ofdm.lattice import unit
from radalt.core.mitigation.ofdm.long_prefix import well_placed
from radalt.core.mitigation.ofdm.numerology import Numerology
from radalt.core.mitigation.ofdm.ridge import Ridge
from radalt.studies.cancellation.cases import CASES, WAVEFORM, received


def every(starts):
    """No return anywhere."""
    return np.ones((len(starts), 500), dtype=bool)


def frame():
    """Grid and elements of a frame of 64QAM, and its numerology."""
    numerology = Numerology(7.5e6, 15e3)
    sent = NrEmitter(channel_bandwidth_hz=10e6, seed=6).samples(7500, 7.5e6, np.random.default_rng(5))
    sent = sent.astype(np.complex64)
    grid = acquire(
        sent,
        find_prefix(sent, numerology),
        numerology,
        every,
    )
    return grid, np.ones(grid.symbols.shape, dtype=bool), numerology


@pytest.mark.parametrize("later", [1, -1])
def test_symbols_on_the_wrong_side_of_the_long_prefix_are_read(later):
    grid, clear, numerology = frame()
    last = np.flatnonzero(np.diff(numerology.halves(grid.starts, grid.first_long)))
    between = last + (later < 0)
    ramp = np.ones_like(grid.symbols)
    # an emitter's long prefix is `later` by a symbol than it was taken for
    ramp[between] = unit(np.float32(later * numerology.longer) * numerology.turn)
    step = numerology.useful + numerology.prefix
    wrong = replace(
        grid, first_long=grid.first_long - later * step, symbols=grid.symbols * ramp, phase=grid.phase * ramp
    )
    received = demodulate(wrong, clear, numerology, FIRST)
    assert received.misread[between].max() > 0.4
    placed, finer = well_placed(wrong, clear, received, numerology)
    assert placed.first_long == pytest.approx(grid.first_long)
    assert finer.misread.max() < 0.1


def test_a_frame_that_is_read_stays_as_it_is():
    grid, clear, numerology = frame()
    received = demodulate(grid, clear, numerology, FIRST)
    same = well_placed(grid, clear, received, numerology)
    assert same[0] is grid and same[1] is received


def test_the_long_prefix_of_a_burst_is_where_its_symbols_can_be_read():
    """Eight symbols agree nearly as well with the long prefix at another place; with their points they do not."""
    frames, _ = received(CASES["nr5_part"], -40.0, 24, np.random.default_rng([77, 2]))
    numerology = Numerology(WAVEFORM.rate_hz, 15e3)
    ridge = Ridge(WAVEFORM, numerology, 1500.0)
    moved = 0
    for frame in frames:
        opened = Opened(frame / np.std(frame), find_prefix(frame, numerology), numerology, ridge)
        first = opened.read()
        if first is None or first.grid.first_long == opened.grid.first_long:
            continue
        moved += 1
        assert first.misread < demodulate(opened.grid, opened.clear, numerology, FIRST).misread.mean()
    assert moved >= 4


def test_a_whole_frame_has_one_place_of_the_long_prefix():
    numerology = Numerology(7.5e6, 15e3)
    sent = NrEmitter(channel_bandwidth_hz=10e6, seed=6).samples(7500, 7.5e6, np.random.default_rng(5))
    sent = sent.astype(np.complex64)
    grids = list(acquired(sent, find_prefix(sent, numerology), numerology, every))
    assert len(grids) == 1
    assert grids[0].first_long == acquire(sent, find_prefix(sent, numerology), numerology, every).first_long
