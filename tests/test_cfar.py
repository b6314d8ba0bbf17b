"""CFAR: the law of false alarms holds per pair and per frame, in white noise, bursts and coloured noise."""

import numpy as np
import pytest
from frames import W, noise

from radalt.core.altimeter.altimeter import Altimeter, AltimeterSettings, Reason
from radalt.core.altimeter.cfar import Cfar, support_of
from radalt.core.altimeter.pair_threshold import pair_threshold, upcrossings
from radalt.core.waveform import Waveform

LAW = {"strategy": "centroid"}  # without the test of likelihood, which leaves fewer altitudes of noise
# (2, 3750) that bins of both half sweeps stand for
BEAT_HZ = np.outer([-1.0, 1.0], np.fft.fftfreq(3750, 1 / 7.5e6))


def burst_of(frames: np.ndarray, share: float) -> np.ndarray:
    """White noise in the middle of each half sweep, 40 dB above the rest."""
    place = np.abs(np.mod(np.arange(W.samples_per_frame), 3750) - 1875) < 0.5 * share * 3750
    return frames * np.where(place, np.float32(100.0), np.float32(1.0))


def passed(frames: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Frames of which a filter passes an amplitude of ``gain`` (2, 3750) at the beats of `BEAT_HZ`."""
    mixed = (frames * W.reference.conj()).reshape(-1, 2, 3750)
    return (np.fft.ifft(np.fft.fft(mixed) * gain).reshape(-1, 7500) * W.reference).astype(np.complex64)


@pytest.mark.parametrize(
    "speed, more", [(0.0, {}), (20.0, {"window": "hann"}), (150.0, {}), (150.0, {"max_altitude_m": 600.0})]
)
def test_altitudes_on_noise_alone_are_as_rare_as_the_design_says_and_no_rarer(speed, more):
    """At any speed, span and window: a threshold that is higher than the bound asks costs altitudes."""
    settings = {"pfa_per_frame": 0.15, "max_vertical_speed_m_per_s": speed} | LAW | more
    altimeter = Altimeter(W, AltimeterSettings(**settings))
    rng = np.random.default_rng(5)
    valid = np.concatenate([altimeter.process(noise(rng, 100, 0.0))["valid"] for _ in range(15)])
    assert 0.8 * 0.15 < valid.mean() < 1.05 * 0.15


WIDE = Waveform(bandwidth_hz=150e6, sweep_s=0.1e-3, rate_hz=150e6)  # cells of 1 m


@pytest.mark.parametrize(
    ("waveform", "top_m", "count"), [(W, 1500.0, 2000), (WIDE, 2500.0, 1500)], ids=["7.5 MHz", "150 MHz"]
)
def test_a_frame_of_noise_has_an_altitude_as_rarely_whatever_the_sweep(waveform, top_m, count):
    """The default's 0.0155 per frame, over 75 cells of 20 m and over 2,500 of 1 m."""
    rng = np.random.default_rng(13)
    altimeter = Altimeter(waveform, AltimeterSettings(max_altitude_m=top_m))
    assert altimeter.false_alarms_per_frame == 0.0155
    reasons = []
    for _ in range(count // 100):
        frames = rng.standard_normal((100, 2 * waveform.samples_per_frame), dtype=np.float32)
        reasons.extend(altimeter.process(frames.view(np.complex64))["reason"])
    found = np.isin(reasons, (Reason.OK, Reason.AMBIGUOUS)).mean()
    deviation = np.sqrt(0.0155 / count)
    assert 0.8 * 0.0155 - 2 * deviation < found < 1.05 * 0.0155 + 2 * deviation
    assert np.mean(np.array(reasons) == Reason.OK) < found


@pytest.mark.parametrize(("share", "speed"), [(0.1, 150.0), (0.27, 20.0), (0.27, 150.0), (0.6, 150.0)])
def test_bursts_cause_no_more_false_alarms_than_white_noise_and_not_many_fewer(share, speed):
    """Noise in part of the half sweep correlates cells: with the threshold of white noise a twentieth is declared."""
    altimeter = Altimeter(W, AltimeterSettings(pfa_per_frame=0.15, max_vertical_speed_m_per_s=speed, **LAW))
    rng = np.random.default_rng(6)
    valid = [altimeter.process(burst_of(noise(rng, 100, 0.0), share))["valid"] for _ in range(6)]
    assert 0.1 < np.mean(valid) / altimeter.false_alarms_per_frame < 1.05


@pytest.mark.parametrize("width_hz", [80e3, 120e3])
def test_noise_passed_by_a_filter_causes_no_more_false_alarms(width_hz):
    """A network passes part of the band, in cells of 83 kHz: against the band's mean half would be declared."""
    altimeter = Altimeter(W, AltimeterSettings(pfa_per_frame=0.15, **LAW))
    rng = np.random.default_rng(7)
    gain = 0.1 + 0.9 * np.exp(-((np.abs(BEAT_HZ) - 70e3) ** 2) / (2 * (width_hz / 2.35) ** 2))
    valid = [altimeter.process(passed(noise(rng, 100, 0.0), gain))["valid"].mean() for _ in range(6)]
    assert np.mean(valid) < 1.5 * altimeter.false_alarms_per_frame


def test_noise_in_pieces_within_the_span_causes_no_more_false_alarms_and_not_many_fewer():
    """A network leaves little beyond the span: neglecting that, twice as many as in white noise are declared."""
    altimeter = Altimeter(W, AltimeterSettings(pfa_per_frame=0.15, **LAW))
    rng = np.random.default_rng(10)
    pieces = np.isin(np.arange(W.samples_per_frame) % 3750 // 150, (2, 6, 11, 15, 21))
    gain = np.where((BEAT_HZ > 0.0) & (BEAT_HZ < 120e3), 1.0, 0.5)
    valid = [altimeter.process(passed(noise(rng, 100, 0.0) * pieces, gain))["valid"] for _ in range(6)]
    assert 0.4 < np.mean(valid) / altimeter.false_alarms_per_frame < 1.0


def test_a_narrower_interval_of_speeds_keeps_the_rate():
    altimeter = Altimeter(W, AltimeterSettings(pfa_per_frame=0.15, max_vertical_speed_m_per_s=150.0, **LAW))
    rng = np.random.default_rng(8)
    spectra = [altimeter.spectra(noise(rng, 100, 0.0)) for _ in range(10)]
    for low, high in ((-2.0, 2.0), (40.0, 60.0), (-150.0, -130.0)):
        valid = np.mean([altimeter.detect(s, vertical_speed_m_per_s=(low, high))["valid"] for s in spectra])
        assert 0.3 * altimeter.false_alarms_per_frame < valid < 1.2 * altimeter.false_alarms_per_frame


def test_the_law_holds_on_processes_made_without_the_altimeter():
    """Spectra of white noise by a padded FFT, known noise: pairs within reach above T, by brute force."""
    rng = np.random.default_rng(9)
    samples, over, span, reach, floor = 64, 8, 40, 3 * 8, 2.0
    crossing = upcrossings(np.ones(samples))
    assert crossing == pytest.approx(np.sqrt(np.pi / 3), rel=0.01)
    draws = rng.standard_normal((2000, 2, 2 * samples)).view(complex) / np.sqrt(2 * samples)
    power = np.abs(np.fft.fft(draws, over * samples)[..., : span * over + 1]) ** 2
    for rate in (0.02, 0.1):
        for apart, partners in ((0, 0.0), (reach, 2 * reach / over)):
            level = pair_threshold(rate, span, partners, crossing, floor)
            best = np.zeros(len(power))
            for d in range(-apart, apart + 1):
                up = power[:, 0, max(0, d) : power.shape[-1] + min(0, d)]
                down = power[:, 1, max(0, -d) : power.shape[-1] + min(0, -d)]
                sums = np.where(np.minimum(up, down) >= floor, up + down, 0.0)
                best = np.maximum(best, sums.max(axis=1))
            assert 0.45 * rate < np.mean(best > level) < 1.35 * rate


@pytest.mark.parametrize("share", [1.0, 0.5, 0.2])
def test_support_is_the_share_of_the_samples_that_noise_lasts_for(share):
    rng = np.random.default_rng(1)
    samples = rng.standard_normal((2000, 500), dtype=np.float32).view(np.complex64)
    samples[:, round(share * 250) :] = 0
    assert support_of(samples, 250).mean() == pytest.approx(share, rel=0.05)


@pytest.mark.parametrize("group", [1, 4])
def test_white_noise_level_is_the_mean_of_the_band_but_for_the_energy_of_the_cell(group):
    """Reference: one cell at a time, by hand; a tone that peaks in a cell has the energy of ``group`` such cells."""
    power = np.random.default_rng(1).uniform(0.8, 1.2, (2, 2, 120)).astype(np.float32)  # even: no colour
    cfar = Cfar(train=5, guard=1, group=group, per_resolution=group, energy=group)
    cells = cfar.significance(power, np.ones((2, 2)))
    margin, looks = 6 * group, 120 / group - 1
    assert cells.noise.shape == (2, 2, 120 - 2 * margin)
    for frame, half, at in np.ndindex(2, 2, 120 - 2 * margin):
        row, here = power[frame, half], power[frame, half, margin + at]
        level = (row.sum() - group * here) / (120 - group)
        assert cells.noise[frame, half, at] == pytest.approx(level, rel=1e-5)
        assert cells.value[frame, half, at] == pytest.approx(looks * np.log1p(here / level / looks), rel=1e-4)


def test_noise_level_next_to_a_step_of_30_db_is_that_of_the_cells_around():
    rng = np.random.default_rng(2)
    power = rng.exponential(size=(200, 2, 160)).astype(np.float32)
    power[..., 80:] *= 1000
    cfar = Cfar(train=12, guard=2, group=1, per_resolution=1.0, energy=1.0)
    cells = cfar.significance(power, np.ones((200, 2)))
    assert cells.noise[..., :30].mean() == pytest.approx(1.0, rel=0.05)
    assert cells.noise[..., -30:].mean() == pytest.approx(1000.0, rel=0.05)
    np.testing.assert_allclose(cells.looks, 0.6 * 24)


def test_a_strong_return_is_not_taken_for_colour():
    rng = np.random.default_rng(3)
    power = rng.exponential(size=(200, 2, 160)).astype(np.float32)
    power[..., 80] += 300.0
    cfar = Cfar(train=12, guard=2, group=1, per_resolution=1.0, energy=1.0)
    assert np.median(cfar.significance(power, np.ones((200, 2))).looks) > 150
    # nor are its surroundings: what is left of white noise is as white as all of it
    assert cfar.colour_beyond(power, np.ones((200, 2)), np.full((200, 2), 80)).mean() < 0.06
