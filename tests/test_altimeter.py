"""The altimeter against a whole-signal reference, the Cramer-Rao bound, and frames that hold no altitude."""

import numpy as np
import pytest
from frames import W

from radalt.core.altimeter.altimeter import RESULT_DTYPE, Altimeter, AltimeterSettings, Reason
from radalt.core.altimeter.cfar import Cfar
from radalt.core.altimeter.cramer_rao import altitude_crb_m, beat_crb_hz
from radalt.core.altimeter.sweep_pairing import PairSearch
from radalt.core.returns.point import point_return
from radalt.core.waveform import Waveform

FAST = Altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=150.0))
C = 299_792_458.0


def noise(shape: tuple[int, ...], snr_db: float, rng: np.random.Generator) -> np.ndarray:
    """Complex white noise at an SNR against unit power, over the whole band, before dechirping."""
    sigma = 10 ** (-snr_db / 20) / np.sqrt(2)
    return sigma * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))


def frames_of(kind: str, altitudes: np.ndarray) -> np.ndarray:
    if kind == "true_delay":
        return point_return(W, altitudes)
    return np.stack([W.beat_shifted(a) for a in altitudes])


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize(
    ("kind", "snr_db", "low_m", "high_m", "speed", "most"),
    [
        *(
            (kind, snr_db, 3, 1500, 20.0, 1.3)
            for kind in ("synthetic", "true_delay")
            for snr_db in (10.0, 15.0, 20.0)
        ),
        *(("true_delay", 10.0, 40, 1400, speed, 1.1) for speed in (0.0, 20.0, 150.0)),
    ],
)
def test_error_is_near_the_cramer_rao_bound(kind, snr_db, low_m, high_m, speed, most):
    """White noise, any speeds allowed: within 1.1 of it, at the span's ends, where a true delay's tail is on the other
    slope, 1.3; without bias."""
    rng = np.random.default_rng(int(snr_db))
    altitudes = rng.uniform(low_m, high_m, 600)
    altimeter = Altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=speed))
    result = altimeter.process(frames_of(kind, altitudes) + noise((600, 7500), snr_db, rng))
    error = result["altitude_m"] - altitudes
    # v = c (f_up + f_down) / 4 f_c of two independent beats
    bound, speed_bound = altitude_crb_m(W, snr_db), C / (4 * 4.3e9) * np.sqrt(2) * beat_crb_hz(W, snr_db)
    assert result["valid"].all()
    np.testing.assert_array_equal(result["altitude_m"], result["forced_altitude_m"])
    assert 0.9 < rms(error) / bound < most
    assert abs(error.mean()) < 0.15 * bound + 1e-3
    assert speed == 0.0 or 0.9 < rms(result["vertical_speed_m_per_s"]) / speed_bound < 1.3


def reference_altitude(frame: np.ndarray) -> float:
    """Whole-signal reference: full-rate dechirp, maximum of |DTFT| of each half by refining grids."""
    mixed = np.conj(frame.astype(complex)) * W.reference
    t = np.arange(3750) / 7.5e6
    beats = []
    for half, sign in ((mixed[:3750], 1), (mixed[3750:], -1)):
        padded = np.abs(np.fft.fft(half, 1 << 15))
        centre = np.fft.fftfreq(1 << 15, 1 / 7.5e6)[np.argmax(padded)]
        width = 300.0
        for _ in range(4):
            grid = centre + np.linspace(-width, width, 61)
            centre = grid[np.argmax(np.abs(np.exp(-2j * np.pi * np.outer(grid, t)) @ half))]
            width /= 25
        beats.append(sign * centre)
    return C * (beats[0] + beats[1]) / (4 * 15e9)


def test_two_rates_and_interpolation_give_the_full_rate_maximum_likelihood_altitude():
    rng = np.random.default_rng(7)
    altitudes = rng.uniform(3, 1500, 12)
    frames = (frames_of("synthetic", altitudes) + noise((12, 7500), 10.0, rng)).astype(np.complex64)
    result = Altimeter(W).process(frames)
    reference = np.array([reference_altitude(f) for f in frames])
    assert rms(result["altitude_m"] - reference) < 0.8 * altitude_crb_m(W, 10.0)
    assert rms(reference - altitudes) < 2 * altitude_crb_m(W, 10.0)


def test_doppler_cancels_in_the_altitude_and_is_the_vertical_speed():
    rng = np.random.default_rng(4)
    altitudes, speeds = rng.uniform(20, 1500, 150), rng.uniform(-150, 150, 150)
    frames = point_return(W, altitudes, vertical_speed_m_per_s=speeds) + noise((150, 7500), 20.0, rng)
    result = FAST.process(frames)
    assert result["valid"].all() and rms(result["altitude_m"] - altitudes) < 0.2
    assert np.abs(result["vertical_speed_m_per_s"] - speeds).max() < 1.0  # a hertz of Doppler is 3.5 cm/s
    doppler = (result["beat_up_hz"] + result["beat_down_hz"]) / 2
    np.testing.assert_allclose(doppler, 2 * speeds * 4.3e9 / C, atol=30.0)


@pytest.mark.parametrize(
    "w",
    [
        Waveform(bandwidth_hz=7.100123e6),
        Waveform(bandwidth_hz=6.7001666e6, sweep_s=3e-3, centered=False),
        Waveform(bandwidth_hz=20e6, rate_hz=25e6, sweep_s=2e-3),
    ],
    ids=["part_cycles", "slow_uncentred", "wide"],
)
def test_other_sweeps_work_as_well(w):
    altitudes = np.array([5.0, 77.7, 600.0, 1450.0])
    result = Altimeter(w).process(np.stack([w.beat_shifted(a) for a in altitudes]))
    np.testing.assert_allclose(result["altitude_m"], altitudes, atol=0.02)
    delayed = Altimeter(w).process(point_return(w, altitudes))
    np.testing.assert_allclose(delayed["altitude_m"], altitudes, atol=0.5)


@pytest.mark.parametrize("window", ["boxcar", "hann", "hamming", "blackman"])
@pytest.mark.parametrize("strategy", ["strongest", "leading_edge", "centroid"])
def test_every_window_and_strategy_finds_a_point_target(window, strategy):
    """Interpolation and leading edge are exact for one tone; the centroid keeps to a twentieth of the 20 m cell."""
    altitudes = np.linspace(60, 1400, 97)
    settings = AltimeterSettings(window=window, strategy=strategy)
    result = Altimeter(W, settings).process(frames_of("synthetic", altitudes))
    error = result["altitude_m"] - altitudes
    assert np.abs(error).max() < {"strongest": 0.01, "leading_edge": 0.02, "centroid": 1.0}[strategy]


def test_leading_edge_reads_the_nearest_point_of_an_extended_return():
    """Incoherent ground behind its nearest point, decaying over 40 m: the edge is nearest to the truth."""
    rng = np.random.default_rng(9)
    depth = np.linspace(0, 120, 40)
    amplitude = np.exp(-depth / 80)
    strategies = "leading_edge", "centroid", "strongest"
    errors = {Altimeter(W, AltimeterSettings(strategy=s)): [] for s in strategies}
    echoes = frames_of("synthetic", 300 + depth)
    for _ in range(60):
        gains = amplitude * (rng.standard_normal(40) + 1j * rng.standard_normal(40))
        frame = gains @ echoes
        for altimeter, values in errors.items():
            values.append(altimeter.process(frame[None])["forced_altitude_m"][0] - 300)
    edge, centroid, strongest = map(np.mean, errors.values())
    assert edge < min(centroid, strongest) - 5


def test_a_cell_is_blind_for_its_own_delay_and_no_longer():
    """What comes before the echo of 1400 m could is left out of its cells, and stays in those of 30 m."""
    rng = np.random.default_rng(11)
    early = np.zeros((60, 2, 3750), dtype=np.complex64)
    early[..., :50] = noise((60, 100), 0.0, rng).reshape(60, 2, 50)  # 6.7 us: 1000 m
    altimeter = Altimeter(W)
    spectra = altimeter.spectra(early.reshape(60, 7500))
    power = (spectra.power * spectra.scale[:, None, None] ** 2).mean(axis=(0, 1))
    altitude = W.beats_to_altitude_m(spectra.beat_hz, -spectra.beat_hz)
    near, far = (power[np.abs(altitude - a) < 60.0].mean() for a in (30.0, 1400.0))
    assert far < 0.002 * near


@pytest.mark.parametrize(("strategy", "within_m"), [("strongest", 0.05), ("leading_edge", 0.3)])
def test_cells_too_many_for_a_blind_part_each_have_one_in_common(strategy, within_m):
    """2,500 cells of 1 m."""
    w, altitudes = Waveform(bandwidth_hz=150e6, sweep_s=0.1e-3, rate_hz=150e6), np.linspace(60, 2490, 49)
    altimeter = Altimeter(w, AltimeterSettings(max_altitude_m=2500.0, strategy=strategy))
    found = altimeter.process(point_return(w, altitudes))["altitude_m"]
    np.testing.assert_allclose(found, altitudes, rtol=0, atol=within_m)


def test_snr_is_the_peak_over_the_noise_of_the_beat_spectrum():
    """Coherent gain of a half sweep of 3750 samples: 35.7 dB over the SNR before dechirping."""
    rng = np.random.default_rng(6)
    on_cell = W.beats_to_altitude_m(40e3, -40e3)
    frames = W.beat_shifted(float(on_cell)) + noise((200, 7500), -10.0, rng)
    snr = Altimeter(W, AltimeterSettings(window="hann")).process(frames)["snr_db"]
    # Hann loses 1.76 dB to its noise bandwidth; half a cell of straddling costs up to 0.4 dB
    assert snr.mean() == pytest.approx(-10 + 10 * np.log10(3750) - 1.76, abs=0.6)


def test_known_timing_offset_is_subtracted_as_delay():
    frames = point_return(W, np.array([200.0, 200.0]) + C / 2 * np.array([0.3, -0.5]) / 7.5e6)
    offsets = np.array([0.3, -0.5]) / 7.5e6
    result = Altimeter(W).process(frames, timing_offset_s=offsets, frame_index=np.array([7, 9]))
    np.testing.assert_allclose(result["altitude_m"], 200.0, atol=0.1)
    np.testing.assert_array_equal(result["frame_index"], [7, 9])


@pytest.mark.parametrize("altitude", [8e3, 10e3, 15e3, 20e3, 30e3])
def test_a_fraction_of_a_sample_of_latency_is_no_bias_at_any_altitude(altitude):
    """Of a beat shift the part past the edge of the band is turned by a fraction, up to half of a half sweep."""
    turn = np.exp(-2j * np.pi * np.fft.fftfreq(W.samples_per_frame) * 0.37)
    frame = np.fft.ifft(np.fft.fft(W.beat_shifted(altitude)) * turn)[None]
    altimeter = Altimeter(W, AltimeterSettings(max_altitude_m=altitude))
    result = altimeter.process(frame, timing_offset_s=0.37 / W.rate_hz)
    assert abs(result["altitude_m"][0] - altitude) < 0.1


def test_batch_gives_what_single_frames_give_bit_for_bit():
    rng = np.random.default_rng(1)
    frames = frames_of("synthetic", rng.uniform(3, 1500, 9)) + noise((9, 7500), 0.0, rng)
    frames[4] = noise((7500,), 0.0, rng)
    altimeter = Altimeter(W)
    whole = altimeter.process(frames)
    for size in (1, 2, 4, 5):
        cuts = np.split(np.arange(9), range(size, 9, size))
        parts = [altimeter.process(frames[at], frame_index=at) for at in cuts]
        assert np.concatenate(parts).tobytes() == whole.tobytes()
    assert whole.dtype == RESULT_DTYPE


@pytest.mark.parametrize("scale", [1e-30, 1e-12, 1e12, 1e30])
def test_result_does_not_depend_on_the_level(scale):
    frame = (W.beat_shifted(321.0) + noise((1, 7500), 10.0, np.random.default_rng(1))).astype(np.complex64)
    altimeter = Altimeter(W)
    expected, scaled = (altimeter.process(f)[0] for f in (frame, frame * np.float32(scale)))
    assert bool(scaled["valid"])
    for name in ("altitude_m", "vertical_speed_m_per_s", "snr_db"):
        assert scaled[name] == pytest.approx(expected[name], rel=1e-4, abs=1e-3)


def test_unusable_frames_are_invalid_with_their_reason_and_leave_their_neighbours_alone():
    rng = np.random.default_rng(5)
    clean = W.beat_shifted(250.0)
    frames = np.stack([clean] * 6)
    frames[1, 100] = np.nan
    frames[2, 7000] = np.inf
    frames[3] = 0
    frames[4] = noise((7500,), 0.0, rng)
    result = Altimeter(W, AltimeterSettings(pfa_per_frame=1e-7)).process(frames)
    names = [Reason.NAMES[r] for r in result["reason"]]
    assert names == ["ok", "not_finite", "not_finite", "no_signal", "no_detection", "ok"]
    assert list(result["valid"]) == [True, False, False, False, False, True]
    assert np.isnan(result["altitude_m"][1:5]).all()
    np.testing.assert_allclose(result["altitude_m"][[0, 5]], 250.0, atol=0.01)
    # a forced decision exists for noise, not for what is no frame at all
    assert np.isfinite(result["forced_altitude_m"][[0, 4, 5]]).all()
    assert np.isnan(result["forced_altitude_m"][1:4]).all()


def test_sweeps_that_disagree_beyond_doppler_are_no_target():
    """One altitude going up, another going down: each sweep detects, together they are impossible."""
    up, down = W.beat_shifted(200.0), W.beat_shifted(900.0)
    frame = np.concatenate([up[:3750], down[3750:]]) + noise((7500,), 20.0, np.random.default_rng(1))
    result = Altimeter(W).process(frame[None])[0]
    assert (Reason.NAMES[result["reason"]], bool(result["valid"])) == ("sweeps_disagree", False)


@pytest.mark.parametrize("altitude", [165.0, 170.0, 175.0, 425.0, 430.0, 435.0])
def test_a_return_just_outside_either_end_of_the_span_is_named_as_that(altitude):
    """Its flank lies within: a peak that does not exist would be the doubt of a spectrum, this is one of the span."""
    settings = AltimeterSettings(min_altitude_m=200.0, max_altitude_m=400.0, max_vertical_speed_m_per_s=0.0)
    frames = point_return(W, np.full(4, altitude)) + noise((4, 7500), 10.0, np.random.default_rng(1))
    assert list(Altimeter(W, settings).process(frames)["reason"]) == 4 * [Reason.OUT_OF_RANGE]


@pytest.mark.parametrize("altitude", [200.0, 1600.0])
def test_a_weak_return_within_the_span_is_not_declared_with_a_strong_one_beyond_either_end(altitude):
    frames = point_return(W, np.full(4, altitude)) + 0.25 * point_return(W, np.full(4, 800.0))
    frames += noise((4, 7500), 20.0, np.random.default_rng(1))
    result = Altimeter(W, AltimeterSettings(min_altitude_m=300.0)).process(frames)
    np.testing.assert_allclose(result["forced_altitude_m"], 800.0, atol=5.0)
    assert list(result["reason"]) == 4 * [Reason.OUT_OF_RANGE]


PLACE = np.mod(np.arange(7500), 3750)


@pytest.mark.parametrize(
    ("kept", "snr_db", "speed", "given", "within_m"),
    [
        (np.abs(PLACE - 1875) > 0.3 * 3750, 10.0, 20.0, "altitude_m", 10.0),
        (np.isin(PLACE // 150, (2, 6, 11, 15, 21)), -10.0, 20.0, "altitude_m", 10.0),
        (np.abs(PLACE - 1875) > 0.37 * 3750, 0.0, 0.0, "forced_altitude_m", 5.0),
    ],
    ids=["edges", "pieces", "edges 0.74 apart"],
)
def test_return_of_which_a_method_left_pieces_is_read_at_its_peak(kept, snr_db, speed, given, within_m):
    """Two slits make side lobes nearly as high as the peak 20 m away; those of five pieces are no coloured noise. Of
    edges 0.74 of a sweep apart the lobe is 0.3 dB lower: on the spectrum's own cells 0.85 would be right."""
    rng = np.random.default_rng(8)
    altitudes = rng.uniform(30, 1470, 200)
    frames = frames_of("true_delay", altitudes) + noise((200, 7500), snr_db, rng)
    altimeter = Altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=speed))
    error = altimeter.process(frames * kept)[given] - altitudes
    assert np.mean(np.abs(error) < within_m) > 0.97


def test_a_half_sweep_that_shows_no_peak_leaves_the_altitude_to_the_other():
    """Speed 0, the up sweep all noise: where it has no peak at the return, the down sweep says where the return is."""
    rng = np.random.default_rng(9)
    altitudes = rng.uniform(50, 1400, 40)
    frames = frames_of("synthetic", altitudes) + noise((40, 7500), 20.0, rng)
    frames[:, :3750] = noise((40, 3750), 0.0, rng)
    result = Altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=0.0)).process(frames)
    assert np.median(np.abs(result["forced_altitude_m"] - altitudes)) < 0.3


@pytest.mark.parametrize(("amplitude", "said"), [(0.25, "out_of_range"), (0.9, "out_of_range"), (1.1, "ok")])
def test_a_stronger_return_beyond_the_span_is_the_return(amplitude, said):
    """At 1200 m the span of 1000 m has ended; what is at 300 m is then a second echo, unless it is stronger."""
    frame = W.beat_shifted(1200.0) + amplitude * W.beat_shifted(300.0)
    frame = (frame + noise((7500,), 20.0, np.random.default_rng(1)))[None]
    for strategy, reason in (("strongest", said), ("leading_edge", "ok")):
        settings = AltimeterSettings(max_altitude_m=1000.0, max_vertical_speed_m_per_s=0.0, strategy=strategy)
        result = Altimeter(W, settings).process(frame)[0]
        assert Reason.NAMES[result["reason"]] == reason
        assert result["forced_altitude_m"] == pytest.approx(300.0, abs=5.0)


def test_the_pair_is_the_best_of_all_that_the_speeds_allow():
    """Brute force over all pairs of points, two per cell, and over the rivals beyond a main lobe."""
    rng = np.random.default_rng(32)
    for apart in ((0, 0), (-3, 3), (-9, 9), (2, 5), (-7, -4), (-60, 60)):
        value = rng.exponential(size=(20, 2, 40)).astype(np.float32) ** 2
        search = PairSearch(Cfar(), 0, 40, apart, 4, 1.0, 1.0, 1.0, 1.0, np.zeros(60), False)
        pair, best, rival = search._best_pair(value)
        for k in range(20):
            pairs = [
                (value[k, 0, i] + value[k, 1, j], i, j)
                for i in range(40)
                for j in range(max(0, i - 2 * apart[1]), min(39, i - 2 * apart[0]) + 1)
            ]
            top = max(pairs)
            rivals = [p[0] for p in pairs if abs(p[1] - top[1]) > 8 or abs(p[2] - top[2]) > 8]
            assert tuple(pair[k]) == top[1:] and best[k] == pytest.approx(top[0])
            assert rival[k] == pytest.approx(max(rivals))


def test_a_speed_from_the_track_decides_between_grating_lobes():
    """Two edges of a sweep 0.7 apart leave lobes 28 m next to the peak, which pass for a speed if speeds are free."""
    rng = np.random.default_rng(33)
    altitudes = rng.uniform(100, 1400, 300)
    edges = np.abs(PLACE - 1875) > 0.35 * 3750
    frames = (point_return(W, altitudes) + noise((300, 7500), -13.0, rng)) * edges
    free = FAST.process(frames)
    known = FAST.process(frames, vertical_speed_m_per_s=(-2.0, 2.0))
    right = [np.abs(r["forced_altitude_m"] - altitudes) < 5.0 for r in (free, known)]
    assert right[1].mean() > right[0].mean() + 0.08
    assert (known["valid"] & right[1]).mean() > 0.7 > 0.1 > free["valid"].mean()
    # what is not declared could be either of several altitudes
    assert (free["reason"] == Reason.AMBIGUOUS).mean() > 0.8
    # and a frame says how ambiguous it is: between a right and a wrong one, it is right in two cases of three
    good, bad = free["ambiguity_db"][right[0]], free["ambiguity_db"][~right[0]]
    assert np.mean(good[:, None] > bad) > 0.6


@pytest.mark.parametrize(("window", "closed_form_db"), [("boxcar", 13.3), ("hann", 31.5), ("blackman", 58.1)])
def test_peak_to_sidelobe_ratio_of_a_point_target_is_that_of_the_window(window, closed_form_db):
    result = Altimeter(W, AltimeterSettings(window=window)).process(W.beat_shifted(305.0)[None])
    assert result["peak_to_sidelobe_db"][0] == pytest.approx(closed_form_db, abs=0.5)


def test_peak_to_sidelobe_ratio_of_two_returns_is_that_of_their_powers():
    two = W.beat_shifted(500.0) + 10 ** (-6 / 20) * W.beat_shifted(500.0 + 20 * W.range_resolution_m)
    assert Altimeter(W).process(two[None])["peak_to_sidelobe_db"][0] == pytest.approx(6.0, abs=0.3)
    assert np.isnan(Altimeter(W).process(0 * two[None])["peak_to_sidelobe_db"][0])


@pytest.mark.parametrize("speed", [-10.0, 0.0, 10.0])
def test_one_half_sweep_in_ruins_is_no_speed(speed):
    """Of one half sweep a tenth is left: its peak may be anywhere within the speeds allowed: 26 m at 150 m/s."""
    rng = np.random.default_rng(34)
    altitudes = rng.uniform(100, 1400, 200)
    left = np.arange(7500) < 3750 + 375
    frames = (point_return(W, altitudes, vertical_speed_m_per_s=speed) + noise((200, 7500), -5.0, rng)) * left
    for altimeter in (FAST, Altimeter(W)):
        result = altimeter.process(frames)
        wrong = result["valid"] & (np.abs(result["altitude_m"] - altitudes) >= 5.0)
        assert wrong.mean() <= 0.01
    assert result["valid"].mean() > 0.8


def test_ambiguity_of_a_clear_return_is_large_and_of_two_equal_ones_is_none():
    clear = Altimeter(W).process(W.beat_shifted(500.0) + noise((1, 7500), 10.0, np.random.default_rng(1)))
    assert 100 < clear["ambiguity_db"][0] <= 999.0
    two = W.beat_shifted(500.0) + W.beat_shifted(900.0) + noise((40, 7500), 0.0, np.random.default_rng(2))
    found = Altimeter(W).process(two)
    assert np.median(found["ambiguity_db"]) < 40 < clear["ambiguity_db"][0]
    assert (np.minimum(*np.abs(found["forced_altitude_m"] - np.array([[500.0], [900.0]]))) < 2).all()
    # which of the two it is, is declared only where noise decides clearly
    assert set(found["reason"]) == {Reason.OK, Reason.AMBIGUOUS}
    assert found["ambiguity_db"][~found["valid"]].max() < found["ambiguity_db"][found["valid"]].max()


@pytest.mark.parametrize("interval", [(5.0, -5.0), (-151.0, 0.0), (0.0, np.nan)])
def test_impossible_intervals_of_speed_are_refused(interval):
    with pytest.raises(ValueError, match=r"vertical_speed_m_per_s is .* \+/-150 m/s"):
        Altimeter(W).process(W.beat_shifted(500.0)[None], vertical_speed_m_per_s=interval)


def test_no_guard_cells_is_a_setting():
    result = Altimeter(W, AltimeterSettings(guard_cells=0.0)).process(W.beat_shifted(300.0)[None])
    assert abs(result["forced_altitude_m"][0] - 300.0) < 1.0
