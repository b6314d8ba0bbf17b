"""A moving channel as echoes: what is read in one part of a frame tells the channel of the others."""

from dataclasses import replace

import numpy as np
import pytest

from radalt.core.mitigation.ofdm.acquisition import Grid
from radalt.core.mitigation.ofdm.demodulator import AGAIN, demodulate
from radalt.core.mitigation.ofdm.echoes import grown
from radalt.core.mitigation.ofdm.lattice import SCALE, nearest
from radalt.core.mitigation.ofdm.numerology import Numerology

NUMEROLOGY = Numerology(7.5e6, 15e3)
STARTS = np.array([20 + 535 * n + n // 7 for n in range(13)])
TURN = NUMEROLOGY.turn


def frame(doppler_hz, rng):
    """Points of 64QAM, two echoes of equal power, one of them moving, and what is heard 50 dB above its noise."""
    anywhere = rng.uniform(-1.2, 1.2, (13, 500)) + 1j * rng.uniform(-1.2, 1.2, (13, 500))
    points = nearest(anywhere.astype(np.complex64), 64)
    moving = np.exp(2j * np.pi * doppler_hz * STARTS / 7.5e6)[:, None]
    channel = (1 + 0.9 * moving * np.exp(-4j * TURN)) / np.sqrt(2)
    noise = rng.standard_normal((13, 500, 2)).view(np.complex128)[..., 0] * 10 ** (-50 / 20)
    symbols = (channel * points + noise).astype(np.complex64)
    ones = np.ones((13, 500), dtype=np.complex64)
    grid = Grid(
        STARTS, 20.0, symbols, ones, channel[6].astype(np.complex64), np.ones(500, bool), np.zeros(13)
    )
    return points, channel, grid


def wrong(received, points):
    """Share of points that are not the right ones; all of a subcarrier may be a quarter turn off, as its channel is."""
    turned = [np.abs(received.points * turn - points) > SCALE[64] for turn in (1, 1j, -1, -1j)]
    return np.min([one.mean(axis=0) for one in turned], axis=0).mean()


@pytest.mark.parametrize("doppler_hz", [60.0, 120.0])
def test_what_is_read_beside_a_moving_null_is_carried_across_it(doppler_hz):
    points, channel, grid = frame(doppler_hz, np.random.default_rng(1))
    clear = np.ones(points.shape, dtype=bool)
    # an eighth of the band was not read, and what is above it a quarter turn off
    known = channel.copy()
    known[:, 250:312] *= np.exp(0.8j)
    known[:, 312:] *= 1j
    start = demodulate(replace(grid, channel=known.astype(np.complex64)), clear, NUMEROLOGY, AGAIN)
    assert wrong(start, points) > 0.1
    assert wrong(grown(grid, clear, start, NUMEROLOGY), points) < 0.02


def test_nothing_read_stays_as_it_was():
    _, channel, grid = frame(60.0, np.random.default_rng(2))
    clear = np.ones(channel.shape, dtype=bool)
    rng = np.random.default_rng(3)
    nothing = rng.standard_normal((13, 500, 2)).view(np.complex128)[..., 0].astype(np.complex64)
    start = demodulate(replace(grid, symbols=nothing), clear, NUMEROLOGY, AGAIN)
    assert grown(replace(grid, symbols=nothing), clear, start, NUMEROLOGY) is start
