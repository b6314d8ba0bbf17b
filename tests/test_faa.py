"""14 CFR 91.220(b) Table 1 as received interference, against a link budget done by hand."""

import numpy as np
import pytest

from radalt.core.interference.emitters.faa_91_220 import ButterworthFilter, FaaMask, pfd_dbw_per_m2_mhz
from radalt.core.returns.link_budget import diffuse_loop_loss_db
from radalt.core.returns.terrain import AircraftState, FlatTerrain, GaussianAntenna, GroundGrid, TerrainReturn
from radalt.core.returns.terrain.ground import ConstantGamma
from radalt.core.waveform import Waveform

RATE_HZ = 7.5e6
C_M_PER_S = 299_792_458.0


def test_table():
    """MHz to dBW/m2/MHz, within each band and at its edges, which belong to the level that asks for less power."""
    levels = {
        3000: 9.5, 4149.9: 9.5, 4150: 6.5, 4155: 6.5, 4165: -1, 4175: -7, 4185: -17, 4195: -34, 4200: -82, 4300: -82,
        4400: -82, 4400.1: -33, 4410: -33, 4420: -21, 4435: -8, 4445: -1, 4460: 6.5, 4461: 9.5, 5600: 9.5,
    }  # fmt: skip
    assert {mhz: pfd_dbw_per_m2_mhz(mhz * 1e6) for mhz in levels} == levels


def test_in_band_power_by_hand():
    """-82 dBW/m^2/MHz over 7.5 MHz into 10 dBi and 3 dB of cable: -82 + 8.75 + 10 - 34.13 - 3 = -100.38 dBW."""
    wavelength_m = C_M_PER_S / 4.3e9
    aperture_db = 10 * np.log10(wavelength_m**2 / (4 * np.pi))
    by_hand_dbm = -82 + 10 * np.log10(7.5) + 10 + aperture_db - 3 + 30
    report = FaaMask(receiver_filter=ButterworthFilter(order=20)).report()  # nearly a brick wall
    assert by_hand_dbm == pytest.approx(-70.38, abs=0.01)
    assert report.in_band_dbm == pytest.approx(by_hand_dbm, abs=0.01)
    assert report.out_of_band_dbm < -150
    noise_dbm = 10 * np.log10(1.380649e-23 * 290 * 7.5e6) + 30 + 8
    assert report.noise_dbm == pytest.approx(noise_dbm, abs=0.01)
    assert report.i_over_n_db == pytest.approx(by_hand_dbm - noise_dbm, abs=0.02)


def test_return_is_that_of_the_terrain_model():
    """One link budget: level ground as the terrain return has it, facet by facet (8 dB apart before)."""
    height_m = 200 * 0.3048 + 2.0
    mask = FaaMask(altitude_ft=200.0, antenna_height_m=2.0)
    ground = TerrainReturn(FlatTerrain(0.0), Waveform(), grid=GroundGrid(seed=1))
    _, facets_w = ground.facets(AircraftState(0.0, 42.0, -87.9, height_m, (0.0, 0.0, 0.0), 90.0))
    assert mask.report().return_dbm == pytest.approx(10 * np.log10(facets_w.sum()) + 30, abs=0.3)
    report = mask.report()
    assert report.sir_db == pytest.approx(report.return_dbm - report.total_dbm)
    # diffuse ground within a beam: the return falls with the square of the range
    far = FaaMask(altitude_ft=400.0, antenna_height_m=2.0)
    ratio_db = 20 * np.log10(far.range_m / mask.range_m)
    assert report.return_dbm - far.report().return_dbm == pytest.approx(ratio_db, abs=1e-6)


def test_loop_loss_by_hand():
    """A narrow beam over uniform ground lights a disc of ``pi (h w / 2)^2 / (4 ln 2)`` twice-weighted square metres."""
    height_m, beam_deg = 300.0, 4.0
    area = np.pi * (height_m * np.radians(beam_deg)) ** 2 / (8 * np.log(2))
    sigma0 = 10 ** ((-5.0 + 5 * np.log10(0.43)) / 10)  # constant gamma at 4.3 GHz
    share = 10.0**4 * (C_M_PER_S / 4.3e9) ** 2 * sigma0 * area / ((4 * np.pi) ** 3 * height_m**4)
    loss = diffuse_loop_loss_db(
        height_m,
        antenna=GaussianAntenna(beam_deg, 20.0),
        ground=ConstantGamma(),
        carrier_hz=4.3e9,
        losses_db=6.0,
    )
    assert loss == pytest.approx(6.0 - 10 * np.log10(share), abs=0.02)


def test_selectivity_decides_what_comes_from_outside():
    """A third-order filter of 200 MHz lets the neighbours drown the band; seven orders more bury them."""
    weak = FaaMask(receiver_filter=ButterworthFilter(bandwidth_hz=200e6, order=3)).report()
    sharp = FaaMask(receiver_filter=ButterworthFilter(bandwidth_hz=200e6, order=10)).report()
    assert weak.out_of_band_dbm > weak.in_band_dbm + 20
    assert sharp.out_of_band_dbm < weak.out_of_band_dbm - 15


def test_butterworth_loss_of_a_band_by_hand():
    """4195 +- 5 MHz lies 105 MHz off: the mid-band loss, less 0.12 dB for the curvature of offset^-8."""
    shape = ButterworthFilter(bandwidth_hz=40e6, order=4)
    band_hz = np.linspace(4.19e9, 4.2e9, 1001)[:-1]
    before, after = (
        FaaMask(receiver_filter=kind).power_density_w_per_hz(band_hz).sum()
        for kind in (ButterworthFilter(bandwidth_hz=1e12), shape)
    )
    loss_db = 10 * np.log10(1 + (105 / 20) ** 8) - 10 * np.log10(1 + 36 / 3 * (5 / 105) ** 2)
    assert 10 * np.log10(before / after) == pytest.approx(loss_db, abs=0.02)
    assert shape.power_gain(np.array([4.28e9, 4.32e9])) == pytest.approx([0.5, 0.5])


def test_emitter_is_gaussian_noise_of_unit_power_in_the_receiver_band():
    mask = FaaMask()
    window = mask.samples(400_000, RATE_HZ, np.random.default_rng(1))
    assert np.mean(np.abs(window) ** 2) == pytest.approx(1.0, abs=0.01)
    assert np.mean(np.abs(window) ** 4) == pytest.approx(2.0, abs=0.05)
    power = np.mean(np.abs(np.fft.fft(window.reshape(-1, 500), axis=1)) ** 2, axis=0) / 500
    frequency = np.fft.fftfreq(500, 1 / RATE_HZ)
    flat = power[np.abs(frequency) < 3.3e6]
    assert flat.std() / flat.mean() < 0.1
    assert flat.mean() == pytest.approx(7.5 / 7.125, rel=0.01)  # all the power within +-3.5625 MHz
    assert power[np.abs(frequency) > 3.74e6].max() < 0.01 * flat.mean()
