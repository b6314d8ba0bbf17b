"""Other radars and out-of-band masks as interferers: phase, power, and what of them passes our receiver."""

import numpy as np
import pytest
from test_effects import EVERYTHING

from radalt.core.interference import Interferer, QpskEmitter, ToneEmitter, interference_frames
from radalt.core.interference.effects import ImpairedEmitter
from radalt.core.interference.emitters import NamedEmitter, emitter_class, emitter_names, register
from radalt.core.interference.emitters.faa_91_220 import ButterworthFilter, FaaMask, pfd_dbw_per_m2_mhz
from radalt.core.interference.emitters.fmcw import FmcwEmitter
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.emitters.pulsed_radar import PulsedRadarEmitter
from radalt.core.interference.receiver_filter import resample_periodic
from radalt.core.returns.link_budget import diffuse_loop_loss_db
from radalt.core.returns.terrain import AircraftState, FlatTerrain, GaussianAntenna, GroundGrid, TerrainReturn
from radalt.core.returns.terrain.ground import ConstantGamma
from radalt.core.waveform import C_M_PER_S, Waveform

RATE_HZ = 7.5e6


@pytest.mark.parametrize("up_fraction", [0.5, 0.3, 1.0, 0.0])
def test_fmcw_phase_is_the_integral_of_its_frequency(up_fraction):
    """B T and f T are no whole numbers of cycles here: pasted formulae would jump at the seams."""
    sweep = {"carrier_hz": 1.2345e6, "sweep_bandwidth_hz": 10.1e6, "sweep_period_s": 0.7777e-3}
    emitter = FmcwEmitter(**sweep, up_fraction=up_fraction)
    step_s = 1e-9
    for centre_s in (0.0, 0.7777e-3 * up_fraction, 0.7777e-3, -0.7777e-3, 3.1e-3):
        t = centre_s + (np.arange(-500, 500) + 0.3) * step_s
        increments = np.diff(emitter.phase_cycles(t))
        increments -= np.rint(increments)
        middle = np.mod((t[1:] + t[:-1]) / 2, 0.7777e-3)
        up_s = up_fraction * 0.7777e-3
        if up_fraction in (0.0, 1.0):
            position = middle / 0.7777e-3
            rise = position if up_fraction else 1.0 - position
        else:
            rise = np.where(middle < up_s, middle / up_s, (0.7777e-3 - middle) / (0.7777e-3 - up_s))
        frequency = 1.2345e6 + 10.1e6 * (rise - 0.5)
        error_cycles = np.abs(increments - frequency * step_s)
        # A sawtooth changes frequency within one step; nowhere does the phase itself jump.
        assert error_cycles.max() < 10.1e6 * step_s * 1.01
        assert np.median(error_cycles) < 1e-8


def test_fmcw_is_heard_only_while_it_crosses_the_band():
    emitter = FmcwEmitter(sweep_bandwidth_hz=150e6, sweep_period_s=2e-3)
    window = emitter.samples(30_000, RATE_HZ, np.random.default_rng(2))  # 4 ms: four crossings
    power = np.abs(window) ** 2
    loud = power > power.max() / 4
    # -6 dB points of the filter at +-3.5625 MHz, swept at 150 MHz a millisecond
    crossing_s = 7.125e6 / 150e9
    edges = np.flatnonzero(np.diff(loud.astype(int)))
    passages = np.diff(edges)[np.diff(edges) < 1000]
    assert 3 <= passages.size <= 5
    np.testing.assert_allclose(passages, crossing_s * RATE_HZ, rtol=0.05)
    assert np.median(power) < 1e-6 * power.max()


def test_fmcw_in_the_band_is_the_unfiltered_chirp():
    """A sweep inside the flat band passes unchanged: dechirping it leaves a constant."""
    emitter = FmcwEmitter(sweep_bandwidth_hz=5e6, sweep_period_s=1e-3, carrier_hz=0.5e6)
    count, rng = 20_000, np.random.default_rng(3)
    window = emitter.samples(count, RATE_HZ, np.random.default_rng(3))
    # Timing from the seed: the draws of `_start_s`, then the phase.
    t = emitter._start_s(count, RATE_HZ, rng) + np.arange(count) / RATE_HZ
    reference = np.exp(2j * np.pi * (emitter.phase_cycles(t) + rng.random()))
    assert np.abs(window - reference).max() < 5e-3  # the turning points have a little spectrum outside
    assert np.sqrt(np.mean(np.abs(window - reference) ** 2)) < 1e-3


def test_fmcw_outside_the_band_does_not_fold_in():
    """Sampled without a filter this sweep would fold over and fill the band all the time."""
    emitter = FmcwEmitter(carrier_hz=8e6, sweep_bandwidth_hz=10e6, sweep_period_s=4e-3, up_fraction=1.0)
    assert emitter.in_band_fraction(RATE_HZ) == pytest.approx((3.5625 - 3.0) / 10)
    power = np.abs(emitter.samples(30_000, RATE_HZ, np.random.default_rng(1))) ** 2
    assert np.mean(power < 1e-5 * power.max()) > 0.85


def test_fmcw_long_run_power_is_one_and_no_window_is_silent():
    rng = np.random.default_rng(11)
    anywhere = FmcwEmitter(sweep_bandwidth_hz=60e6, sweep_period_s=1.1e-3, always_in_window=False)
    power = [np.mean(np.abs(anywhere.samples(5000, RATE_HZ, rng)) ** 2) for _ in range(60)]
    assert np.mean(power) == pytest.approx(1.0, abs=0.1)
    slow = FmcwEmitter(sweep_period_s=20e-3, sweep_bandwidth_hz=60e6)
    assert min(np.mean(np.abs(slow.samples(750, RATE_HZ, rng)) ** 2) for _ in range(60)) > 1e-3
    silent = FmcwEmitter(sweep_period_s=20e-3, sweep_bandwidth_hz=60e6, always_in_window=False)
    assert min(np.mean(np.abs(silent.samples(750, RATE_HZ, rng)) ** 2) for _ in range(30)) < 1e-6


def test_pulses_come_at_the_repetition_interval_with_their_width():
    emitter = PulsedRadarEmitter(prf_hz=5e3, pulse_width_s=4e-6, carrier_hz=1e6)
    window = emitter.samples(15_000, RATE_HZ, np.random.default_rng(5))  # 2 ms
    envelope = np.abs(window)
    rising = np.flatnonzero(np.diff((envelope > envelope.max() / 2).astype(int)) == 1)
    assert 9 <= rising.size <= 11
    np.testing.assert_allclose(np.diff(rising), 1500, atol=1)
    inside = envelope > envelope.max() / 2
    assert inside.sum() / rising.size / RATE_HZ == pytest.approx(4e-6, rel=0.05)
    # Long-run power 1: amplitude is the inverse root of the duty cycle (less the edges).
    assert np.median(envelope[inside]) == pytest.approx(np.sqrt(1 / (5e3 * 4e-6)), rel=0.05)


def test_linear_fm_within_the_pulse():
    emitter = PulsedRadarEmitter(prf_hz=1e3, pulse_width_s=100e-6, chirp_bandwidth_hz=4e6)
    window = emitter.samples(7500, RATE_HZ, np.random.default_rng(6))
    loud = np.flatnonzero(np.abs(window) > np.abs(window).max() * 0.7)
    middle = window[loud[0] + 50 : loud[0] + 650]
    frequency = np.angle(middle[1:] * middle[:-1].conj()) * RATE_HZ / 2 / np.pi
    slope = np.polyfit(np.arange(frequency.size) / RATE_HZ, frequency, 1)[0]
    assert slope == pytest.approx(4e6 / 100e-6, rel=0.01)


@pytest.mark.parametrize("carrier_hz", [0.0, 3.0e6, 9.0e6])
@pytest.mark.parametrize("pulse_width_s", [0.2e-6, 2e-6])
def test_pulsed_long_run_power_is_one_wherever_the_carrier(carrier_hz, pulse_width_s):
    pulses = {"prf_hz": 10e3, "pulse_width_s": pulse_width_s, "carrier_hz": carrier_hz}
    emitter = PulsedRadarEmitter(**pulses, always_in_window=False)
    window = emitter.samples(30_000, RATE_HZ, np.random.default_rng(7))  # 40 whole intervals
    assert np.mean(np.abs(window) ** 2) == pytest.approx(1.0, rel=0.03)


def test_a_pulse_far_from_the_band_is_heard_through_its_edges_only():
    """Twelve megahertz off, what passes the filter are the two edges of a long pulse."""
    emitter = PulsedRadarEmitter(carrier_hz=12e6, pulse_width_s=20e-6, prf_hz=1e3)
    power = np.abs(emitter.samples(7500, RATE_HZ, np.random.default_rng(4))) ** 2
    peak = np.flatnonzero(power > power.max() / 4)
    assert (peak[-1] - peak[0]) / RATE_HZ == pytest.approx(20e-6, rel=0.05)
    assert power[(peak[0] + peak[-1]) // 2] < 0.01 * power.max()


@pytest.mark.parametrize("rate_hz", [7.5e6, 10e6, 30.72e6])
def test_resampling_keeps_tones_in_place_without_delay_or_seam(rate_hz):
    count = 76_800  # 10 ms at 7.68 MHz
    tones_hz = np.array([-3.1e6, -1.7e6, 0.4e6, 2.9e6])
    amplitude = np.array([1.0, 0.5j, -0.7, 0.3])
    sent = amplitude @ np.exp(2j * np.pi * tones_hz[:, None] * np.arange(count) / 7.68e6)
    got = resample_periodic(sent, 7.68e6, rate_hz)
    t = np.arange(round(10e-3 * rate_hz)) / rate_hz
    expected = (amplitude[:, None] * np.exp(2j * np.pi * tones_hz[:, None] * t)).sum(axis=0)
    np.testing.assert_allclose(got, expected, atol=1e-3)


EVERY_TYPE = {
    "tones": ToneEmitter(count=3),
    "qpsk": QpskEmitter(),
    "nr5": NrEmitter(carrier_hz=-0.8e6, load=0.4),
    "nr10": NrEmitter(channel_bandwidth_hz=10e6, carrier_hz=2.2e6),
    "nr with every effect": ImpairedEmitter(emitter=NrEmitter(), effects=EVERYTHING),
    "qpsk with every effect": ImpairedEmitter(emitter=QpskEmitter(), effects=EVERYTHING),
    "tones with every effect": ImpairedEmitter(emitter=ToneEmitter(3), effects=EVERYTHING),
    "fmcw": FmcwEmitter(sweep_bandwidth_hz=40e6, sweep_period_s=2e-3),
    "pulsed": PulsedRadarEmitter(),
    "faa": FaaMask(),
}


@pytest.mark.parametrize("name", list(EVERY_TYPE))
def test_sir_and_overlap_are_exact_for_every_type_and_windows_follow_the_seed(name):
    windows = (EVERY_TYPE[name].samples(512, RATE_HZ, np.random.default_rng(seed)) for seed in (1, 1, 2))
    one, two, other = windows
    assert one.dtype == np.complex128 and np.array_equal(one, two) and not np.allclose(one, other)
    rng = np.random.default_rng(21)
    for _ in range(6):
        sir_db, overlap = rng.uniform(-40, 0), rng.uniform(0.05, 1.0)
        interferer = Interferer(EVERY_TYPE[name], sir_db=sir_db, overlap=overlap)
        frame = interference_frames([interferer], 1, 7500, RATE_HZ, rng)[0]
        assert -10 * np.log10(np.mean(np.abs(frame) ** 2)) == pytest.approx(sir_db, abs=1e-9)
        active = np.flatnonzero(frame)
        assert active[-1] - active[0] < round(overlap * 7500)
        if name != "pulsed":  # which is truly silent between its pulses
            assert active.size == round(overlap * 7500)


def test_every_emitter_file_holds_the_emitter_of_its_name():
    for name in emitter_names():
        emitter = emitter_class(name)(**({"file": "air.sigmf-meta"} if name == "recording" else {}))
        assert emitter.scene_name == name
        assert emitter.label.startswith(name) and " " not in emitter.label
        assert emitter.title(7.5e6)
    assert "amplifier 6 dB backed off" in EVERY_TYPE["nr with every effect"].title(7.5e6)


@pytest.mark.parametrize("name", ["qpsk", "nr", "", "two words"])
def test_a_name_that_is_taken_or_none_is_refused(name):
    with pytest.raises(ValueError, match="scene_name"):
        register(type("Mine", (NamedEmitter,), {"scene_name": name}))


# -- 14 CFR 91.220(b) Table 1 as received interference, against a link budget done by hand
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
    path = {"antenna": GaussianAntenna(beam_deg, 20.0), "ground": ConstantGamma(), "carrier_hz": 4.3e9}
    loss_db = diffuse_loop_loss_db(height_m, **path, losses_db=6.0)
    assert loss_db == pytest.approx(6.0 - 10 * np.log10(share), abs=0.02)


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
