"""Amplifier and converter against closed forms, and a blocker against brute force at radio frequency."""

import numpy as np
import pytest

from radalt.core.deramp.front_end import Amplifier, Converter

AMPLIFIER = Amplifier(p1db_dbm=-20.0, iip3_dbm=-8.0)


def amplitude(dbm):
    return np.sqrt(10 ** (np.asarray(dbm) / 10))


def applied(x):
    return x * AMPLIFIER.gain(np.abs(x))


def test_one_decibel_at_p1db_and_saturation_beyond():
    loss = 20 * np.log10(AMPLIFIER.gain(amplitude([-60.0, -20.0, 20.0])))
    assert loss[0] == pytest.approx(0.0, abs=0.001)
    assert loss[1] == pytest.approx(-1.0, abs=1e-9)
    out = AMPLIFIER.envelope(amplitude(np.arange(-60.0, 41.0)))
    assert (np.diff(out) > 0).all()
    assert out[-1] < 1.01 * out[-21]  # a limit, not a fold


@pytest.mark.parametrize("power_dbm", [-60.0, -45.0, -35.0])
def test_third_order_is_that_of_iip3(power_dbm):
    """Two tones of power P: 3 P - 2 IIP3 in dBm beside them."""
    n = np.arange(4000)
    x = amplitude(power_dbm) * (np.exp(2j * np.pi * 100 * n / 4000) + np.exp(2j * np.pi * 110 * n / 4000))
    lines = np.abs(np.fft.fft(applied(x)) / 4000)
    assert 20 * np.log10(lines[120]) == pytest.approx(3 * power_dbm + 16.0, abs=0.07)


def test_weak_gain_is_the_derivative():
    a, d = amplitude([-40.0, -20.0, -10.0, 5.0]), 1e-7
    by_differences = 0.5 * (
        (AMPLIFIER.envelope(a + d) - AMPLIFIER.envelope(a - d)) / (2 * d) + AMPLIFIER.envelope(a) / a
    )
    assert np.allclose(AMPLIFIER.weak_gain(a), by_differences, rtol=1e-4)


@pytest.mark.parametrize("power_dbm", [-30.0, -22.0, -15.0])
def test_a_blocker_beside_the_band_needs_its_envelope_alone(power_dbm):
    """Brute force: a weak carrier 460 MHz from a Gaussian blocker of 98 MHz, both through the amplifier at 2.4 GS/s."""
    rate, n = 2.4e9, 1 << 19
    rng = np.random.default_rng(1)
    spectrum = np.fft.fft(rng.standard_normal(n) + 1j * rng.standard_normal(n))
    spectrum[np.abs(np.fft.fftfreq(n, 1 / rate)) > 49e6] = 0
    envelope = np.fft.ifft(spectrum)
    envelope /= np.sqrt(np.mean(np.abs(envelope) ** 2))
    at = round(300e6 * n / rate)
    wanted = 1e-5 * np.exp(2j * np.pi * (np.arange(n) * at % n) / n)
    moved = np.exp(2j * np.pi * np.mod(np.arange(n) * round(-160e6 * n / rate) / n, 1))
    blocker = amplitude(power_dbm) * envelope * moved
    out = np.fft.fft(applied(wanted + blocker) - applied(blocker))[at] / n / 1e-5
    brute_db = 20 * np.log10(abs(out))
    of_envelope = 20 * np.log10(np.mean(AMPLIFIER.weak_gain(np.abs(blocker))))
    assert of_envelope == pytest.approx(brute_db, abs=0.01)
    beside = AMPLIFIER.beside(power_dbm, constant_envelope=False)
    assert 20 * np.log10(beside.weak) == pytest.approx(brute_db, abs=0.05)  # this realisation's envelope
    assert beside.modulation == pytest.approx(
        np.var(AMPLIFIER.weak_gain(np.abs(blocker))) / np.mean(AMPLIFIER.weak_gain(np.abs(blocker))) ** 2,
        rel=0.05,
    )


def test_small_blockers_act_as_the_cubic_says():
    """Gain 1 - 2 P / A3^2 beside a Gaussian of power P, modulation (2 P / A3^2)^2; beside a carrier the same mean."""
    share = 10 ** ((-35.0 + 8.0) / 10)
    gaussian = AMPLIFIER.beside(-35.0, constant_envelope=False)
    assert gaussian.weak == pytest.approx(1 - 2 * share, abs=3e-4)
    assert gaussian.modulation == pytest.approx((2 * share) ** 2, rel=0.1)
    carrier = AMPLIFIER.beside(-35.0, constant_envelope=True)
    assert (carrier.weak, carrier.modulation) == (pytest.approx(1 - 2 * share, abs=3e-4), 0.0)
    assert carrier.own == pytest.approx(1 - share, abs=3e-4)


def test_intercept_too_low_says_so():
    with pytest.raises(ValueError, match="more than 7.8 dB above"):
        Amplifier(-20.0, -12.5)


@pytest.mark.parametrize("over_db", [-6.0, 0.0, 6.0, 12.0])
def test_clipped_carrier_is_the_closed_form(over_db):
    """A carrier's rails clipped at 1/a of their peak keep ``2/pi (asin(1/a) + sqrt(1 - 1/a^2)/a)``."""
    x = np.exp(2j * np.pi * np.mod(np.arange(1 << 16) * 0.01234567, 1)).astype(np.complex64)
    rms = np.sqrt(0.5)
    # full scale = rms * headroom = peak / a
    out = Converter(14, 20 * np.log10(np.sqrt(2)) - over_db)(x[None], rms)[0]
    a = max(10 ** (over_db / 20), 1.0)
    closed = 2 / np.pi * (np.arcsin(1 / a) + np.sqrt(1 - 1 / a**2) / a)
    assert np.vdot(x, out).real / x.size == pytest.approx(closed, abs=1e-3)


def test_quantisation_noise_is_a_twelfth_of_a_step_squared():
    rng = np.random.default_rng(1)
    x = (rng.standard_normal((4, 20000)) + 1j * rng.standard_normal((4, 20000))).astype(np.complex64)
    error = Converter(8, 14.0)(x, 1.0) - x
    step = 10 ** (14.0 / 20) / 128
    assert np.mean(np.abs(error) ** 2) == pytest.approx(2 * step**2 / 12, rel=0.03)
