"""The ground return against closed forms: range, power, Doppler, speckle; shortcut against direct sum."""

import numpy as np
import pytest
from hostile import refused
from make_landing_data import write_dted
from scipy.integrate import quad
from test_waveform import dechirped_beats

from radalt.core.returns import terrain
from radalt.core.returns.link import RadarLink
from radalt.core.returns.point import point_return
from radalt.core.returns.terrain import AircraftState, ConstantGamma, GaussianAntenna, GroundGrid
from radalt.core.waveform import Waveform

LIGHT = 299792458.0
WAVE = Waveform()
LAMBDA = LIGHT / WAVE.carrier_hz


def _state(height_m, velocity=(0.0, 0.0, 0.0), **attitude):
    return AircraftState(0.0, 41.97, -87.95, 200.0 + height_m, velocity, **attitude)


def over_flat(*parts, waveform=WAVE, **more):
    """The return of level ground at 200 m."""
    return terrain.TerrainReturn(terrain.FlatTerrain(200.0), waveform, *parts, **more)


def _db(x):
    return 10.0 * np.log10(x)


def sum_of_sweeps(waveform, amplitude, ranges_m, rates_m_per_s, index=0):
    """Every sweep at every sample: exact and slow."""
    return sum(
        a * point_return(waveform, r, vertical_speed_m_per_s=v, frame_index=index, dtype=np.complex128)
        for a, r, v in zip(amplitude, ranges_m, rates_m_per_s, strict=True)
    )


@pytest.mark.parametrize("height_m", [3.0, 30.0, 151.3, 900.0])
def test_point_under_a_flat_earth_measures_its_analytic_range(height_m):
    scene = over_flat(GaussianAntenna(0.5, 30.0))
    result = scene(_state(height_m, (0.0, 0.0, -3.7)))
    up, down = dechirped_beats(WAVE, result.frame)
    slope = WAVE.slope_hz_per_s
    assert LIGHT * (up - down) / (4 * slope) == pytest.approx(height_m, abs=0.1)
    # the echo closes at the vertical speed: f_D = 2 v f_c / c
    assert 0.5 * (up + down) * LAMBDA / 2 == pytest.approx(-3.7, abs=0.03)
    assert (result.height_m, result.climb_m_per_s) == (pytest.approx(height_m, abs=1e-9), -3.7)


@pytest.mark.parametrize("height_m", [10.0, 31.0, 100.0, 320.0, 1000.0])
def test_power_of_a_pulse_limited_surface(height_m):
    """First range cell under a wide beam: a disc of area 2 pi h dR, so
    P = P_t G0^2 lambda^2 sigma0 / ((4 pi)^3 L) 2 pi dR / h^3."""
    antenna, ground = GaussianAntenna(120.0, 5.0), ConstantGamma(0.0)
    scene = over_flat(antenna, ground, grid=GroundGrid(cells_per_radius=64))
    cell = 0.02 * height_m  # 20 m, the resolution, at 1000 m
    sigma0 = ground.sigma0(0.0, WAVE.carrier_hz)
    closed = 0.4 * 10 * LAMBDA**2 * sigma0 / ((4 * np.pi) ** 3 * 10**0.6) * 2 * np.pi * cell / height_m**3
    facets, power = scene.facets(_state(height_m))
    first = power[facets.range_m < height_m + cell].sum()
    assert _db(first / closed) == pytest.approx(0.0, abs=0.5)


@pytest.mark.parametrize("height_m", [10.0, 45.0, 200.0, 1000.0])
def test_frames_carry_the_integral_of_the_radar_equation(height_m):
    """Mean frame power over speckle, default beam, against 2 pi C / h^2 int G^2 sigma0 sin cos."""
    antenna, ground, link = GaussianAntenna(), ConstantGamma(), RadarLink()
    waveform = Waveform(rate_hz=1.5e6, bandwidth_hz=1.5e6)
    lam = LIGHT / waveform.carrier_hz

    def density(theta):
        return antenna.gain(theta, 0.0) ** 2 * ground.sigma0(theta, 4.3e9) * np.sin(theta) * np.cos(theta)

    constant = link.transmit_w * lam**2 / ((4 * np.pi) ** 3 * 10 ** (link.losses_db / 10))
    expected = constant * 2 * np.pi / height_m**2 * quad(density, 0, np.pi / 2)[0]
    power, stated = [], []
    for seed in range(300):
        scene = over_flat(antenna, ground, link, GroundGrid(seed, 8), waveform=waveform)
        result = scene(_state(height_m, (70.0, 0.0, 0.0)))
        power.append(np.mean(np.abs(result.frame) ** 2))
        stated.append(result.power_w)
    assert _db(np.mean(stated) / expected) == pytest.approx(0.0, abs=0.05)
    assert np.std(_db(stated)) < 0.2  # only the facets' places in their coarse cells
    # 300 draws of one or two degrees of freedom: 0.25 dB
    assert _db(np.mean(power) / expected) == pytest.approx(0.0, abs=0.75 if height_m < 20 else 0.5)


def test_power_and_noise_budget_by_hand():
    scene = over_flat()
    result = scene(_state(100.0))
    # -174 dBm/Hz + 8 dB + 10 log10(7.5 MHz) = -97.2 dBm
    assert _db(result.noise_w) + 30 == pytest.approx(-97.2, abs=0.1)
    assert result.snr_db == pytest.approx(_db(result.power_w / result.noise_w))
    stronger = over_flat(link=RadarLink(0.8, 0.0, 8.0))(_state(100.0))
    assert _db(stronger.power_w / result.power_w) == pytest.approx(3.01 + 6.0, abs=0.01)


@pytest.mark.parametrize("height_m", [5.0, 60.0, 300.0, 1000.0])
@pytest.mark.parametrize("centered", [True, False])
def test_shortcut_equals_the_direct_sum(height_m, centered):
    waveform = Waveform(centered=centered)
    scene = over_flat(waveform=waveform, grid=GroundGrid(7, 6))
    state = _state(height_m, (72.0, 10.0, -3.8), heading_deg=95.0, pitch_deg=2.0, roll_deg=4.0)
    facets, power = scene.facets(state)
    seen = power > 1e-7 * power.max()
    amplitude = (np.sqrt(power) * facets.reflectivity)[seen]
    exact = sum_of_sweeps(waveform, amplitude, facets.range_m[seen], facets.range_rate_m_per_s[seen])
    fast = scene(state).frame
    error = _db(np.sum(np.abs(fast - exact) ** 2) / np.sum(np.abs(exact) ** 2))
    assert error < -45.0


def test_shortcut_is_phase_continuous_where_b_th_is_not_whole():
    waveform = Waveform(bandwidth_hz=7.3331e6, centered=False)
    rng = np.random.default_rng(2)
    amplitude = rng.normal(size=40) + 1j * rng.normal(size=40)
    ranges, rates = rng.uniform(200, 300, 40), rng.uniform(-20, 20, 40)
    for index in (0, 3):
        fast = terrain.synthesise(waveform, amplitude, ranges, rates, frame_index=index)
        exact = sum_of_sweeps(waveform, amplitude, ranges, rates, index)
        assert _db(np.sum(np.abs(fast - exact) ** 2) / np.sum(np.abs(exact) ** 2)) < -45.0


def test_doppler_width_matches_theory():
    """Level flight at v over a narrow beam: sigma_f = (2 v / lambda) sqrt(E[sin^2 theta] / 2), so frames a
    time dt apart correlate as exp(-2 (pi sigma_f dt)^2)."""
    height, speed = 200.0, 6.0
    antenna, ground = GaussianAntenna(20.0, 15.0), ConstantGamma()

    def weight(theta):
        return antenna.gain(theta, 0.0) ** 2 * np.cos(theta) ** 2 * np.sin(theta)

    mean = quad(lambda t: weight(t) * np.sin(t) ** 2, 0, 1.2)[0] / quad(weight, 0, 1.2)[0]
    sigma_hz = 2 * speed / LAMBDA * np.sqrt(mean / 2)
    scene = over_flat(antenna, ground)
    facets, power = scene.facets(_state(height, (speed, 0.0, 0.0)))
    doppler = -2 * facets.range_rate_m_per_s / LAMBDA
    centre = np.average(doppler, weights=power)
    assert np.sqrt(np.average((doppler - centre) ** 2, weights=power)) == pytest.approx(sigma_hz, rel=0.03)
    # the same width, measured on the signal
    step_s, products, energy = 4e-3, 0.0, 0.0
    metres_per_deg = 6378137.0 * np.pi / 180 * np.cos(np.radians(41.97)) * 1.0015
    for seed in range(60):
        path = over_flat(antenna, ground, grid=GroundGrid(seed))
        lons = (-87.95 + speed * dt / metres_per_deg for dt in (0.0, step_s))
        frames = [path(AircraftState(0.0, 41.97, lon, 400.0, (speed, 0.0, 0.0))).frame for lon in lons]
        products += np.vdot(frames[0], frames[1])
        energy += 0.5 * sum(np.vdot(f, f).real for f in frames)
    measured = np.sqrt(-np.log(np.abs(products) / energy) / 2) / (np.pi * step_s)
    assert measured == pytest.approx(sigma_hz, rel=0.1)


def test_speckle_belongs_to_the_ground():
    """The same place gives the same frame, whoever comes by; another seed or place gives another."""
    scene = over_flat()
    here = scene(_state(900.0)).frame
    assert np.array_equal(here, scene(_state(900.0)).frame)
    moved = AircraftState(0.0, 41.97, -87.95 + 1e-9, 1100.0)  # 0.08 mm east
    far = AircraftState(0.0, 41.97, -87.93, 1100.0)
    other = over_flat(grid=GroundGrid(2))

    def coherence(frame):
        return np.abs(np.vdot(here, frame)) / np.sqrt(np.vdot(here, here).real * np.vdot(frame, frame).real)

    assert coherence(scene(moved).frame) == pytest.approx(1.0, abs=1e-3)
    assert max(coherence(frame) for frame in (scene(far).frame, other(_state(900.0)).frame)) < 0.9


def test_speckle_amplitudes_are_complex_gaussian():
    facets, _ = over_flat(grid=GroundGrid(11, 64)).facets(_state(500.0))
    z = facets.reflectivity
    assert z.size > 10000
    assert np.mean(np.abs(z) ** 2) == pytest.approx(1.0, abs=0.03)
    assert np.mean(np.abs(z) ** 4) == pytest.approx(2.0, abs=0.15)
    assert abs(np.mean(z)) < 0.03 and abs(np.mean(z**2)) < 0.03


def test_bank_moves_the_beam_but_not_the_truth():
    scene = over_flat()
    level, banked = scene(_state(150.0)), scene(_state(150.0, roll_deg=25.0))
    assert banked.height_m == level.height_m and banked.power_w < level.power_w
    facets, power = scene.facets(_state(150.0, roll_deg=25.0))
    # heading north, right wing down: the belly looks left, to the west
    assert np.average(facets.direction[:, 0], weights=power) < -0.1


def _hill_files(tmp_path, elevation):
    return terrain.Terrain.load([write_dted(tmp_path / "t.dt1", elevation, 41, -88, 1)])


def test_cliff_gives_the_near_edge_as_nearest(tmp_path):
    elevation = np.full((1201, 1201), 200, np.int16)
    elevation[600:, :] = 260  # a 60 m step, one post (69 m) wide, at 87.5 W
    ground = _hill_files(tmp_path, elevation)
    scene = terrain.TerrainReturn(ground, WAVE)
    before = scene(AircraftState(0.0, 41.5, -87.502, 400.0, (70.0, 0.0, 0.0)))  # 166 m before the edge
    assert (before.height_m, before.climb_m_per_s) == (pytest.approx(200.0), 0.0)
    after = scene(AircraftState(0.0, 41.5, -87.4995, 400.0))
    assert after.height_m == pytest.approx(140.0) and after.nearest_m == pytest.approx(140.0, abs=0.5)
    corner = np.hypot(166.0 - 69.0, 140.0)  # the upper edge of the step is nearer than the ground below
    assert before.nearest_m == pytest.approx(min(200.0, np.hypot(166.0, 140.0), corner + 60), rel=0.25)
    on_the_face = scene(AircraftState(0.0, 41.5, -87.5004, 400.0, (70.0, 0.0, 0.0)))
    assert on_the_face.climb_m_per_s == pytest.approx(-70.0 * 60.0 / 69.4, rel=0.02)
    assert np.isfinite(on_the_face.frame).all()


def test_slope_puts_the_nearest_point_uphill(tmp_path):
    slope = 0.1
    elevation = np.round(np.arange(1201)[:, None] * 69.3 * slope - 3000 + np.zeros(1201)).astype(np.int16)
    scene = terrain.TerrainReturn(_hill_files(tmp_path, elevation), WAVE, GaussianAntenna(60.0))
    ground = float(scene.terrain.height_m(41.5, -87.4))
    result = scene(AircraftState(0.0, 41.5, -87.4, ground + 400.0))
    assert result.height_m == pytest.approx(400.0)
    assert result.nearest_m == pytest.approx(400.0 * np.cos(np.arctan(slope)), abs=0.7)


def test_below_ground_and_off_the_map_are_named(tmp_path):
    scene = terrain.TerrainReturn(_hill_files(tmp_path, np.full((1201, 1201), 300, np.int16)), WAVE)
    with pytest.raises(terrain.TerrainError, match=r"t = 4 s is -20.00 m above ground.*datum"):
        scene(AircraftState(4.0, 41.5, -87.5, 280.0))
    with refused(terrain.TerrainError, r"does not cover 42\.5.*t\.dt1: 41\.\.42 N.*add the DTED cell"):
        scene(AircraftState(0.0, 42.5, -87.5, 900.0))
    # the aircraft is still over the cell, its footprint is not
    with pytest.raises(terrain.TerrainError, match="does not cover"):
        scene(AircraftState(0.0, 41.5, -87.0005, 900.0))
    assert issubclass(terrain.TerrainError, ValueError) and issubclass(terrain.TrajectoryError, ValueError)
