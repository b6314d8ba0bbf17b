"""The simulated channel: each impairment alone against its definition, and nothing at all while it is off."""

from dataclasses import replace

import numpy as np
import pytest
from frames import N, W
from test_effects import band_limited as frames_of_band

from radalt import Waveform
from radalt.core.channel.delay_line import MOST_BLOCKS, DelayLine
from radalt.core.channel.settings import ChannelSettings, DropSettings
from radalt.core.channel.simulated import SimulatedChannel
from radalt.core.interference.multipath import FadingChannel
from radalt.core.programme import Programme
from radalt.core.returns.point import point_return

PLAIN = ChannelSettings(snr_db=None, start_offset_samples=100)
FRAMES = 8


def band_limited(count: int, seed: int = 1) -> np.ndarray:
    """Noise in the middle 80 % of the band: what a fractional delay can be checked with."""
    return frames_of_band(1, count, np.random.default_rng(seed))[0]


def play(settings: ChannelSettings, radar=None, jammer=None, *, seed=1, frames=FRAMES, **keys) -> np.ndarray:
    """The received stream, gaps cut out."""
    channel = SimulatedChannel(W, settings, seed=seed, frames=frames, **keys)
    out = []
    for i in range(frames):
        tx = np.zeros(N, np.complex64) if radar is None else radar[i * N : (i + 1) * N].astype(np.complex64)
        jam = None if jammer is None else jammer[i * N : (i + 1) * N].astype(np.complex64)
        out += [samples for _, samples in channel.process(tx, jam)]
    return np.concatenate(out)


def power_db(samples: np.ndarray) -> float:
    return 10 * np.log10(np.mean(np.abs(samples) ** 2))


def delayed(samples: np.ndarray, delay: float) -> np.ndarray:
    """Reference: exact fractional delay by the phase ramp of a whole-signal transform (circular)."""
    f = np.fft.fftfreq(samples.size)
    return np.fft.ifft(np.fft.fft(samples) * np.exp(-2j * np.pi * f * delay))


@pytest.mark.parametrize("offset", [0.0, 7.0, 100.0, 7498.0])
def test_whole_latency_is_an_exact_shift_and_what_is_off_is_not_there(offset):
    x = band_limited(FRAMES * N).astype(np.complex64)
    out = play(replace(PLAIN, start_offset_samples=offset, full_scale=0.1), x)
    np.testing.assert_array_equal(out[int(offset) :], x[: x.size - int(offset)])
    assert not out[: int(offset)].any()


@pytest.mark.parametrize("offset", [80.25, 777.5, 5000.123, 9000.9])
def test_fractional_latency_is_the_ideal_delay(offset):
    """-60 dB of interpolation error up to 80 % of the band; the fraction is kept to 1/4096 sample."""
    x = band_limited(FRAMES * N)
    out = play(replace(PLAIN, start_offset_samples=offset), x)
    middle = slice(3 * N, 7 * N)
    assert power_db(out[middle] - delayed(x, offset)[middle]) < -55


def test_unset_latency_is_drawn_from_the_seed_with_a_fraction():
    latencies = [SimulatedChannel(W, ChannelSettings(), seed=s).latency_samples for s in range(200)]
    assert latencies[3] == SimulatedChannel(W, ChannelSettings(), seed=3).latency_samples
    assert len(set(latencies)) == 200 and all(v != int(v) for v in latencies)
    assert 80 <= min(latencies) < 300 and 7200 < max(latencies) < N


@pytest.mark.parametrize("snr_db", [-5.0, 10.0, 20.0])
def test_snr_is_return_power_over_noise_power_in_the_whole_band(snr_db):
    noise = play(replace(PLAIN, snr_db=snr_db), frames=20)
    assert power_db(noise) == pytest.approx(-snr_db, abs=0.05)  # 150,000 samples: 0.01 dB
    density = np.mean(np.abs(np.fft.fft(noise.reshape(-1, 300), axis=1)) ** 2, axis=0)
    assert 10 * np.log10(density.max() / density.min()) < 2.5  # white: 500 averages
    assert abs(np.mean(noise**2)) < 0.02 * np.mean(np.abs(noise) ** 2)  # circular


def test_gain_scales_return_interference_and_noise_alike():
    x, j = band_limited(FRAMES * N), band_limited(FRAMES * N, 2)
    settings = replace(PLAIN, snr_db=10.0)
    out, louder = play(settings, x, j), play(replace(settings, gain_db=6.0), x, j)
    np.testing.assert_allclose(louder, out * 10**0.3, atol=1e-5)


def test_jammer_delay_is_added_to_the_latency():
    j = band_limited(FRAMES * N).astype(np.complex64)
    out = play(replace(PLAIN, jammer_delay_samples=23.0), None, j)
    np.testing.assert_array_equal(out[123:], j[:-123])


def test_jammer_lo_offset_shifts_its_spectrum_without_a_seam():
    line = np.ones(FRAMES * N)
    out = play(replace(PLAIN, jammer_lo_offset_hz=12_345.0), None, line)[2 * N :]
    increments = np.angle(out[1:] * np.conj(out[:-1]))
    np.testing.assert_allclose(increments, 2 * np.pi * 12_345.0 / 7.5e6, atol=2e-6)


@pytest.mark.parametrize("ppm", [-20.0, 20.0])
def test_jammer_clock_drifts_by_its_parts_per_million(ppm):
    """A tone of 0.1 cycles a sample arrives at that of the jammer's clock; after 36 frames 20 ppm are 5.4 samples."""
    tone = np.exp(2j * np.pi * 0.1 * np.arange(40 * N))
    out = play(replace(PLAIN, jammer_clock_ppm=ppm), None, tone, frames=40)[3 * N :]
    ahead = np.unwrap(np.angle(out * tone[3 * N :].conj())) / (2 * np.pi * 0.1)
    assert ahead[-1] - ahead[0] == pytest.approx(ppm * 1e-6 * 36 * N, abs=0.01)
    assert power_db(out) == pytest.approx(0.0, abs=0.1)


def test_jammer_clock_may_drift_past_a_frame():
    """10,000 frames of 100 ppm are one frame of drift either way: the delay line has to hold."""
    w = Waveform(sweep_s=1e-4)
    tone = np.exp(2j * np.pi * 0.1 * np.arange(w.samples_per_frame)).astype(np.complex64)
    silence = np.zeros_like(tone)
    for ppm in (-100.0, 100.0):
        channel = SimulatedChannel(w, replace(PLAIN, jammer_clock_ppm=ppm), frames=10)
        for _ in range(10_200):
            out = channel.process(silence, tone)[0][1]
        np.testing.assert_allclose(np.abs(out), 1.0, atol=1e-3)


def test_dc_offset_is_a_constant_added():
    x = band_limited(FRAMES * N)
    difference = play(replace(PLAIN, dc_offset=0.3), x) - play(PLAIN, x)
    np.testing.assert_allclose(difference, 0.3, atol=1e-6)


@pytest.mark.parametrize(("gain_db", "phase_deg"), [(1.0, 0.0), (0.0, 3.0), (0.5, -2.0)])
def test_iq_imbalance_makes_an_image_of_the_textbook_ratio(gain_db, phase_deg):
    """Image over signal |(1 - g e^{-j phi}) / (1 + g e^{j phi})| of a tone at +1 MHz, seen at -1 MHz."""
    tone = np.exp(2j * np.pi * 1e6 / 7.5e6 * np.arange(FRAMES * N))
    out = play(replace(PLAIN, iq_gain_db=gain_db, iq_phase_deg=phase_deg), tone)[2 * N : 3 * N]
    spectrum = np.abs(np.fft.fft(out))
    g, phi = 10 ** (gain_db / 20), np.deg2rad(phase_deg)
    expected = abs((1 - g * np.exp(-1j * phi)) / (1 + g * np.exp(1j * phi)))
    assert spectrum[-1000] / spectrum[1000] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("bits", [6, 8, 12])
def test_converter_noise_is_a_twelfth_of_the_step_squared(bits):
    """Two rails of step^2 / 12 each; against a unit signal at full scale 4: 6.02 dB a bit."""
    x = band_limited(FRAMES * N) * 0.7
    error = play(replace(PLAIN, adc_bits=bits, full_scale=4.0), x) - play(PLAIN, x)
    step = 4.0 / 2 ** (bits - 1)
    assert power_db(error[N:]) == pytest.approx(10 * np.log10(2 * step**2 / 12), abs=0.15)
    rails = play(replace(PLAIN, adc_bits=bits, full_scale=4.0), x).view(np.float32) / step
    np.testing.assert_allclose(rails, np.rint(rails), atol=1e-5)


def test_converter_clips_at_full_scale():
    x = 10 * band_limited(FRAMES * N)
    rails = play(replace(PLAIN, adc_bits=12, full_scale=4.0), x).view(np.float32)
    assert (rails.min(), rails.max()) == (-4.0, pytest.approx(4.0 * (2047 / 2048)))
    one_bit = np.unique(play(replace(PLAIN, adc_bits=1, full_scale=4.0), x)[2 * N :].view(np.float32))
    np.testing.assert_allclose(one_bit, [-2.0, 2.0])


@pytest.mark.parametrize(("altitude", "speed"), [(3.0, 0.0), (700.0, 0.0), (1500.0, -80.0)])
def test_true_delay_is_the_return_of_the_whole_signal_formula(altitude, speed):
    """Against s(t - tau) exp(-j 2 pi f_c tau) evaluated without a filter; range walk inside a frame is left out."""
    programme = Programme((altitude,), 10, vertical_speed_m_per_s=speed)
    x = np.tile(W.reference, 20)
    out = play(PLAIN, x, frames=20, true_delay=programme)
    received = out[12 * N + 100 : 13 * N + 100]
    expected = point_return(W, altitude, vertical_speed_m_per_s=speed)
    coherence = abs(np.vdot(expected, received)) / np.linalg.norm(expected) / np.linalg.norm(received)
    assert coherence**2 > 0.998
    # the corner of the triangle at the band edge has spectrum outside the interpolator's 97 %
    if not speed:
        assert power_db(received - expected) < -25
    assert power_db(received) == pytest.approx(0.0, abs=0.02)


def test_leakage_is_the_transmitted_sweep_at_zero_delay_and_alone_before_the_trials():
    programme = Programme((900.0,), 10)
    x = np.tile(W.reference, 14)
    with_it = play(replace(PLAIN, leakage_db=-6.0), x, frames=14, true_delay=programme)
    first = programme.preamble_frames * N + 100  # of the trials
    leakage = 10 ** (-6 / 20) * np.roll(x, 100)
    np.testing.assert_allclose(with_it[N:first], leakage[N:first], atol=2e-6)
    difference = with_it - play(PLAIN, x, frames=14, true_delay=programme)
    np.testing.assert_allclose(difference[first:], leakage[first:], atol=2e-6)


def test_leakage_and_landing_gear_stand_at_their_distances():
    settings = replace(PLAIN, leakage_db=20.0, leakage_m=1.0, gear_db=6.0, gear_m=4.5)
    out = play(settings, np.tile(W.reference, 14), frames=14, true_delay=Programme((900.0,), 10))
    received = out[4 * N + 100 : 5 * N + 100]
    expected = 10.0 * point_return(W, 1.0) + 10 ** (6 / 20) * point_return(W, 4.5)
    assert power_db(received - expected) < power_db(expected) - 25.0  # as of a true delay, above


def test_paths_of_the_return_come_behind_the_first():
    x, time = np.zeros(FRAMES * N, np.complex64), np.arange(FRAMES * N)
    x[4 * N] = 1.0
    plain, spread = (
        np.abs(play(replace(PLAIN, start_offset_samples=500.0, return_multipath=m), x)) ** 2
        for m in (None, FadingChannel(profile="ETU"))
    )
    first = np.average(time[: plain.size], weights=plain)
    assert first + 1.0 < np.average(time[: spread.size], weights=spread) < first + 5e-6 * W.rate_hz


def test_gaps_are_all_there_and_what_is_left_is_untouched():
    frames, settings = 300, replace(PLAIN, drops=DropSettings(25, 100, 20_000))
    x = band_limited(frames * N).astype(np.complex64)
    whole = play(PLAIN, x, frames=frames)
    channel, kept = SimulatedChannel(W, settings, seed=3, frames=frames), np.ones(frames * N, bool)
    assert len(channel.gaps) == 25
    for first, length in channel.gaps:
        assert 100 <= length <= 20_000 and first >= 20 * N
        kept[first : first + length] = False
    expected, got = 0, np.zeros(frames * N, bool)
    for i in range(frames):
        for counter, samples in channel.process(x[i * N : (i + 1) * N]):
            assert counter >= expected
            got[counter : counter + samples.size] = True
            np.testing.assert_array_equal(samples, whole[counter : counter + samples.size])
            expected = counter + samples.size
    np.testing.assert_array_equal(got, kept)


PROGRAMME = Programme((500.0, 100.0), frames_per_step=3)


def test_a_delay_line_that_expects_repeats_gives_what_any_other_gives():
    n, rng = 500, np.random.default_rng(7)
    expecting, other = DelayLine(n, 899.75, repeats=True), DelayLine(n, 899.75)
    sweeps = rng.standard_normal((3, 2 * n)).astype(np.float32).view(np.complex64)
    # long runs of one sweep, in which nothing is moved any more, and changes within and between the pushes
    stream = [0] * 40 + [1] * 3 + [0] * 30 + [2] * 25 + [0, 1, 2] * 4 + [1] * 40
    while stream:
        count = int(rng.integers(1, MOST_BLOCKS + 1))
        blocks = sweeps[stream[:count]].ravel()
        del stream[:count]
        for line in (expecting, other):
            line.push(blocks)
        for delay in (250.3, 899.75, 310.0):
            got = expecting.read(delay, blocks.size // n)
            expected = other.read(delay, blocks.size // n)
            np.testing.assert_array_equal(np.broadcast_to(got, expected.shape), expected)


def test_a_delay_does_not_depend_on_the_length_of_the_blocks():
    samples = np.random.default_rng(8).standard_normal(24_000).astype(np.float32).view(np.complex64)
    delayed = []
    for n in (500, 2000):
        line, out = DelayLine(n, 300.0), []
        for block in samples.reshape(-1, n):
            line.push(block)
            out.append(line.read(200.3).ravel().copy())
        delayed.append(np.concatenate(out))
    np.testing.assert_allclose(*delayed, atol=1e-4)


@pytest.mark.parametrize("sweep_s", [1e-3, 520e-6], ids=["1 ms", "0.52 ms"])
@pytest.mark.parametrize(
    ("settings", "more"),
    [
        (ChannelSettings(), {}),
        (ChannelSettings(start_offset_samples=90.0, gain_db=3.0), {}),
        (ChannelSettings(drops=DropSettings(3, 100, 9_000)), {}),
        (ChannelSettings(jammer_clock_ppm=20.0, jammer_lo_offset_hz=1e3), {}),
        (ChannelSettings(leakage_db=-6.0), {"true_delay": PROGRAMME}),
        (ChannelSettings(return_multipath=FadingChannel(profile="ETU")), {}),
    ],
    ids=["latency with a fraction", "whole latency", "gaps", "another clock", "true delay", "multipath"],
)
@pytest.mark.parametrize("noisy", [True, False], ids=["jammer", "no jammer"])
def test_a_sample_is_the_same_to_the_bit_however_many_frames_come_with_a_call(settings, more, noisy, sweep_s):
    w = Waveform(sweep_s=sweep_s)
    n, frames = w.samples_per_frame, 80
    # sweeps that repeat, change within a call, and change with every frame
    altitudes = [0.0] * 10 + [300.0] * 7 + [120.0] * 31 + [float(a) for a in range(100, 132)]
    sent = np.concatenate([w.beat_shifted(a) for a in altitudes])
    rng = np.random.default_rng(5)
    jammer = rng.standard_normal(2 * sent.size).astype(np.float32).view(np.complex64) if noisy else None

    def received(frames_per_call: list[int], in_place: bool) -> list[np.ndarray]:
        channel = SimulatedChannel(w, settings, seed=4, frames=frames, **more)
        got, at = [], 0
        for count in frames_per_call:
            span = slice(at, at + count * n)
            out = np.full(count * n, np.nan, np.complex64) if in_place else None
            pieces = channel.process(sent[span], None if jammer is None else jammer[span], out)
            for counter, samples in pieces:
                got += counter + np.arange(samples.size), samples.copy()
                if in_place:
                    assert samples.tobytes() == out[counter - at :][: samples.size].tobytes()
            at += count * n
        return [np.concatenate(got[::2]), np.concatenate(got[1::2])]

    counters, samples = received([1] * frames, False)
    for frames_per_call in ([16, 16, 16, 16, 16], [3, 5, 1, 2, 7, 13, 29, 20]):
        again = received(frames_per_call, True)
        np.testing.assert_array_equal(again[0], counters)
        assert again[1].tobytes() == samples.tobytes()
