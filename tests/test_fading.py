"""Multipath: powers, delays, Rice factors and Doppler against the definitions."""

import numpy as np
import pytest
from scipy.special import j0

from radalt.core.interference.effects import ImpairedEmitter, Impairments
from radalt.core.interference.multipath import PROFILES, FadingChannel

RATE_HZ = 7.5e6


class Sent:
    """Emitter of given samples, and silence around them, whose first is number 0 of the stream."""

    unit_power = True

    def __init__(self, samples):
        self.sent = samples

    def begin(self, rate_hz, rng):
        def signal(first, count):
            number = np.arange(first, first + count)
            inside = (number >= 0) & (number < self.sent.size)
            return np.where(inside, self.sent[np.clip(number, 0, self.sent.size - 1)], 0)

        return signal


def received(sent, channel, rng):
    """(N,) of what arrives of the emitter's first N samples."""
    emitter = ImpairedEmitter(emitter=Sent(sent), effects=Impairments(fading=channel))
    return emitter.begin(RATE_HZ, rng)(0, sent.size)


def rms_delay_s(channel):
    power = np.append(channel.powers, channel.los_power)
    delay = np.append(channel.delays_s, 0.0)
    mean = np.sum(power * delay) / power.sum()
    return np.sqrt(np.sum(power * (delay - mean) ** 2) / power.sum())


LTE = {"EPA": 43e-9, "EVA": 357e-9, "ETU": 991e-9, "PA": 46e-9}


@pytest.mark.parametrize("name", list(PROFILES))
def test_powers_sum_to_one_and_delays_have_the_published_spread(name):
    """TR 38.901 normalises its tables to a unit RMS delay spread: any wrong entry shows here."""
    channel = FadingChannel(profile=name, delay_spread_s=300e-9)
    assert channel.powers.sum() + channel.los_power == pytest.approx(1.0)
    if name != "RA4":  # whose spread nobody states
        assert rms_delay_s(channel) == pytest.approx(LTE.get(name, 300e-9), rel=0.01)


@pytest.mark.parametrize(("name", "k_db"), [("TDL-D", 13.3), ("TDL-E", 22.0)])
def test_rice_factor_of_the_first_tap(name, k_db):
    channel = FadingChannel(profile=name)
    assert 10 * np.log10(channel.los_power / channel.powers[0]) == pytest.approx(k_db, abs=0.01)
    rng = np.random.default_rng(1)
    gains = np.array([channel.draw(rng).gains(np.zeros(1))[0, 0] for _ in range(4000)])
    assert np.mean(np.abs(gains) ** 2) == pytest.approx(channel.los_power + channel.powers[0], rel=0.02)


def band_limited(frames, count, rng, width=0.4):
    """Random periodic frames with lines in the inner `width` of the band."""
    spectrum = rng.standard_normal((frames, count)) + 1j * rng.standard_normal((frames, count))
    spectrum[:, np.abs(np.fft.fftfreq(count)) > width] = 0
    signal = np.fft.ifft(spectrum, axis=-1)
    return signal / np.sqrt(np.mean(np.abs(signal) ** 2))


def test_a_burst_has_echoes_after_it_and_silence_before():
    frame = np.zeros(4000, complex)
    frame[1000:1500] = band_limited(1, 500, np.random.default_rng(0), 0.3)[0] * np.hanning(500)
    faded = received(frame, FadingChannel(profile="ETU"), np.random.default_rng(3))
    power = np.abs(faded) ** 2
    assert power[:990].sum() < 1e-6 * power.sum()
    assert power[1500:1540].sum() > 1e-6 * power.sum()
    assert power[1600:].sum() < 1e-6 * power.sum()


@pytest.mark.parametrize("doppler_hz", [0.0, 2000.0])
@pytest.mark.parametrize("name", ["EVA", "TDL-D"])
def test_tones_arrive_with_exact_fractional_delays(name, doppler_hz):
    """y(t) = sum_i g_i(t) sum_f exp(j 2 pi f (t - tau_i)), away from the ends of what is sent."""
    count = 6000
    channel = FadingChannel(profile=name, delay_spread_s=777e-9, doppler_hz=doppler_hz)
    t = np.arange(count) / RATE_HZ
    tones = np.array([-401, 3, 250]) * RATE_HZ / 1500
    found = received(np.exp(2j * np.pi * tones[:, None] * t).sum(axis=0), channel, np.random.default_rng(12))
    gains = channel.draw(np.random.default_rng(12)).gains(t)
    expected = np.zeros(count, complex)
    for delay_s, gain in zip(channel.delays_s, gains.T, strict=True):
        expected += gain * np.exp(2j * np.pi * tones[:, None] * (t - delay_s)).sum(axis=0)
    np.testing.assert_allclose(found[1500:-1500], expected[1500:-1500], atol=5e-3)


def test_doppler_gives_clarkes_autocorrelation():
    doppler_hz = 1000.0
    channel = FadingChannel(profile="EPA", doppler_hz=doppler_hz)
    lag_s = np.arange(16) * 1e-4
    rng = np.random.default_rng(7)
    gains = np.array([channel.draw(rng).gains(lag_s).T for _ in range(6000)])
    correlation = np.mean(gains * np.conj(gains[..., :1]), axis=0).sum(axis=0)
    np.testing.assert_allclose(correlation, j0(2 * np.pi * doppler_hz * lag_s), atol=0.03)
    # Rayleigh: the kurtosis of a complex Gaussian tap is 2.
    tap = np.abs(gains[:, 0, 5]) ** 2
    assert np.mean(tap**2) / np.mean(tap) ** 2 == pytest.approx(2.0, abs=0.2)
