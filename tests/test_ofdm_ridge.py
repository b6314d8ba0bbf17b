"""What is told of a return in elements that also hold data: its density, its mean, its level."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import trapezoid

from radalt.core.mitigation.ofdm.lattice import DENSE, nearest
from radalt.core.mitigation.ofdm.received import Received
from radalt.core.mitigation.ofdm.ridge import Density, NearPoints, few_beside, modulus_of

SHAPE = (13, 500)
NOISE = 1e-4


def complex_normal(rng, *shape):
    return (rng.standard_normal((*shape, 2)) @ [1, 1j]) * np.sqrt(0.5)


def heard(rng, sent, return_db, few):
    """Symbols of unit channel with a return of modulus `modulus_of` and noise, and the return."""
    modulus = modulus_of(1.0, return_db)
    returned = modulus * np.exp(2j * np.pi * rng.random(SHAPE))
    symbols = (sent + returned + np.sqrt(NOISE) * complex_normal(rng, *SHAPE)).astype(np.complex64)
    blank = np.zeros(SHAPE, dtype=np.float32)
    none = np.zeros(SHAPE[0])
    kinds = np.full(SHAPE, 1, dtype=np.int8)
    received = Received(
        symbols, np.ones(SHAPE, dtype=np.complex64), np.ones(SHAPE[1], dtype=np.complex64), nearest(symbols, 64), kinds,
        blank, blank, none, NOISE, none, none, 0.0, None, few,
    )  # fmt: skip
    return received, returned


@pytest.mark.parametrize("sir_db", [-34.0, -22.0])
def test_density_of_a_return_over_the_plane_is_one(sir_db):
    density = Density(1.0, np.array([sir_db, sir_db - 6]), NOISE)
    distance = np.linspace(0.0, 6 * modulus_of(1.0, sir_db), 20_000, dtype=np.float32)
    for one in density(distance):
        assert trapezoid(2 * np.pi * distance * one, distance) == pytest.approx(1.0, abs=0.06)
    assert np.array_equal(density.first(distance), density(distance)[0])
    assert density.first(np.float32([100.0])) == 0  # what is far from all points tells nothing


def test_shares_of_few_points_are_those_beside():
    few, clear = np.zeros(SHAPE, dtype=bool), np.ones(SHAPE, dtype=np.float32)
    few[3] = True  # a synchronisation signal or control
    few[:, 120:144] = True  # a user of QPSK
    share = few_beside(few, clear, varying=True)
    # of a symbol of 121 elements and a block of 156
    assert share[3].min() > 0.4 and share[7, 132] > 0.5 and share[7, 300] < 0.05
    share = few_beside(few & (np.arange(13) == 3)[:, None], clear, varying=False)
    assert (share[3] == 1).all() and (np.delete(share, 3, axis=0) == 0).all()


def test_mean_of_a_return_that_folds_is_nearer_to_it_than_what_the_nearest_point_leaves():
    rng = np.random.default_rng(21)
    sent = nearest(complex_normal(rng, *SHAPE).astype(np.complex64), 64)
    received, returned = heard(rng, sent, -24.0, np.zeros(SHAPE, dtype=bool))
    at = np.arange(2000)
    near = NearPoints(received, at, np.zeros(at.size, dtype=np.float32), modulus_of(1.0, -16.0))
    tried = np.arange(-34.0, -15.0, 2.0)
    assert tried[near.evidence(Density(1.0, tried, NOISE), 1.0).argmax()] == pytest.approx(-24.0, abs=2.0)
    assert tried[near.some(8).evidence(Density(1.0, tried, NOISE), 1.0).argmax()] == pytest.approx(
        -24.0, abs=2.0
    )
    true, rest = returned.ravel()[at], (received.symbols - received.points).ravel()[at]
    found = near.expected(Density(1.0, np.array([-24.0]), NOISE))
    assert np.mean(np.abs(found - true) ** 2) < 0.6 * np.mean(np.abs(rest - true) ** 2)


def test_a_lattice_of_one_alphabet_is_that_of_each_element():
    rng = np.random.default_rng(22)
    sent = nearest(complex_normal(rng, *SHAPE).astype(np.complex64), 64)
    received, _ = heard(rng, sent, -24.0, np.zeros(SHAPE, dtype=bool))
    at, share = np.arange(600), np.zeros(600, dtype=np.float32)
    density = Density(1.0, np.array([-24.0]), NOISE)
    alone = NearPoints(received, at, share, 0.3).expected(density)
    kinds = received.kinds.copy()
    kinds[-1, -1] = DENSE.index(256)
    at = np.append(at, kinds.size - 1)
    beside = NearPoints(replace(received, kinds=kinds), at, np.append(share, share[:1]), 0.3).expected(
        density
    )
    assert np.abs(alone - beside[:-1]).max() < 1e-5
