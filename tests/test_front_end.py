"""Amplifier and converter against closed forms, and a blocker against brute force at radio frequency."""

import numpy as np
import pytest

from radalt.core.deramp.front_end import Amplifier, Bursts, Converter, rectified, rectified_mw_per_hz

AMPLIFIER = Amplifier(p1db_dbm=-20.0, iip3_dbm=-8.0)


def amplitude(dbm):
    return np.sqrt(10 ** (np.asarray(dbm) / 10))


def gaussian(n, rate, width):
    """A band of Gaussian noise of power 1."""
    spectrum = np.fft.fft(np.random.default_rng(1).standard_normal((n, 2)) @ (1, 1j))
    spectrum[np.abs(np.fft.fftfreq(n, 1 / rate)) > 0.5 * width] = 0
    envelope = np.fft.ifft(spectrum)
    return envelope / np.sqrt(np.mean(np.abs(envelope) ** 2))


def applied(x):
    return x * AMPLIFIER.gain(np.abs(x))


def test_one_decibel_at_p1db_and_saturation_beyond():
    loss_db = 20 * np.log10(AMPLIFIER.gain(amplitude([-60.0, -20.0])))
    assert list(loss_db) == [pytest.approx(0.0, abs=0.001), pytest.approx(-1.0, abs=1e-9)]
    out = AMPLIFIER.envelope(amplitude(np.arange(-60.0, 41.0)))
    assert (np.diff(out) > 0).all() and out[-1] < 1.01 * out[-21]  # a limit, not a fold


@pytest.mark.parametrize("power_dbm", [-60.0, -45.0, -35.0])
def test_third_order_is_that_of_iip3(power_dbm):
    """Two tones of power P: 3 P - 2 IIP3 in dBm next to them."""
    n = np.arange(4000)
    x = amplitude(power_dbm) * (np.exp(2j * np.pi * 100 * n / 4000) + np.exp(2j * np.pi * 110 * n / 4000))
    lines = np.abs(np.fft.fft(applied(x)) / 4000)
    assert 20 * np.log10(lines[120]) == pytest.approx(3 * power_dbm + 16.0, abs=0.07)


def test_weak_gain_is_the_derivative():
    a, d = amplitude([-40.0, -20.0, -10.0, 5.0]), 1e-7
    slope = (AMPLIFIER.envelope(a + d) - AMPLIFIER.envelope(a - d)) / (2 * d)
    by_differences = 0.5 * (slope + AMPLIFIER.envelope(a) / a)
    assert np.allclose(AMPLIFIER.weak_gain(a), by_differences, rtol=1e-4)


@pytest.mark.parametrize("power_dbm", [-30.0, -22.0, -15.0])
def test_a_blocker_outside_the_band_needs_its_envelope_alone(power_dbm):
    """Brute force: a weak carrier 460 MHz from a Gaussian blocker of 98 MHz, both through the amplifier at 2.4 GS/s."""
    rate, n = 2.4e9, 1 << 19
    at = round(300e6 * n / rate)
    wanted = 1e-5 * np.exp(2j * np.pi * (np.arange(n) * at % n) / n)
    moved = np.exp(2j * np.pi * np.mod(np.arange(n) * round(-160e6 * n / rate) / n, 1))
    blocker = amplitude(power_dbm) * gaussian(n, rate, 98e6) * moved
    out = np.fft.fft(applied(wanted + blocker) - applied(blocker))[at] / n / 1e-5
    brute_db = 20 * np.log10(abs(out))
    weak = AMPLIFIER.weak_gain(np.abs(blocker))
    assert 20 * np.log10(np.mean(weak)) == pytest.approx(brute_db, abs=0.01)
    under = AMPLIFIER.with_strong(power_dbm, constant_envelope=False)
    assert 20 * np.log10(under.weak) == pytest.approx(brute_db, abs=0.05)  # this realisation's envelope
    assert under.modulation == pytest.approx(np.var(weak) / np.mean(weak) ** 2, rel=0.05)


def test_a_known_modulation_gives_its_lines_on_a_weak_signal():
    """A carrier of power P with AM of depth m: a weak signal's gain, 1 - 2 a^2 / A3^2, has lines of 2 m P / A3^2."""
    n, depth, power_dbm = np.arange(4000), 0.3, -40.0
    strong = amplitude(power_dbm) * (1 + depth * np.cos(2 * np.pi * 37 * n / 4000))
    line = np.fft.fft(AMPLIFIER.weak_gain(strong))[37] / 4000
    assert line.real == pytest.approx(-2 * depth * 10 ** ((power_dbm + 8.0) / 10), rel=0.01)


@pytest.mark.parametrize("iip2_dbm", [-10.0, 20.0])
def test_two_carriers_give_the_product_that_iip2_says(iip2_dbm):
    """Brute force ``x + a x^2`` on a rail: carriers of power P give a line of P^2 / IIP2 at their difference."""
    n, each_dbm = np.arange(4096), -30.0
    tones = amplitude(each_dbm) * np.sqrt(2) * np.cos(2 * np.pi * np.outer([500, 510], n) / 4096)
    squared = tones.sum(axis=0) ** 2 * 10 ** (-iip2_dbm / 20) / np.sqrt(2)
    brute = 2 * np.abs(np.fft.fft(squared)[10] / 4096) ** 2
    assert 10 * np.log10(brute) == pytest.approx(2 * each_dbm - iip2_dbm, abs=0.01)
    both = np.exp(2j * np.pi * np.outer([500, 510], n) / 4096).sum(axis=0)
    envelope_mw = np.abs(amplitude(each_dbm) * both) ** 2
    line = np.abs(np.fft.fft(rectified(envelope_mw, iip2_dbm))[10] / 4096) ** 2
    assert line == pytest.approx(brute / 2, rel=1e-6)  # the rest at the image: a wanted line is on one side


def test_a_rectified_carrier_of_noise_has_the_density_of_the_closed_form():
    rate, n, width, power_dbm, iip2_dbm = 400e6, 1 << 20, 98e6, -20.0, 10.0
    envelope = amplitude(power_dbm) * gaussian(n, rate, width)
    at_if = np.fft.fft(rectified(np.abs(envelope) ** 2, iip2_dbm))[1:2600]  # 1 MHz of beats
    density = np.mean(np.abs(at_if) ** 2) / n / rate
    assert density == pytest.approx(rectified_mw_per_hz(10 ** (power_dbm / 10), iip2_dbm, width), rel=0.08)


def test_bursts_modulate_a_return_with_the_lines_of_their_pattern():
    """On for a share d, line k is (1 - weak) sin(pi k d) / (pi k) of the return; a slow recovery lowers the mean."""
    bursts, t, k = Bursts(5e-3, 0.74), np.arange(50000) * 1e-7, np.arange(1, 6)
    lines = np.abs(np.fft.fft(bursts.gain(t, 0.25, 0.0)) / t.size)
    assert lines[k] == pytest.approx(0.75 * np.abs(np.sin(np.pi * k * 0.74)) / (np.pi * k), abs=2e-5)
    assert lines[0] == pytest.approx(1 - 0.75 * np.mean(bursts.on(t)))
    slow = bursts.gain(t, 0.25, 1e-3)
    assert np.mean(slow) == pytest.approx(1 - 0.75 * (0.74 + 0.2 * (1 - np.exp(-1.3))), rel=1e-3)


def test_small_blockers_act_as_the_cubic_says():
    """``x (1 - |x|^2 / A3^2)``: gain 1 - 2 P / A3^2 next to a Gaussian of power P, modulation (2 P / A3^2)^2, of it a
    share of 2 (P / A3^2)^2 that is no multiple of the input; next to a carrier the same mean."""
    share = 10 ** ((-35.0 + 8.0) / 10)
    gaussian = AMPLIFIER.with_strong(-35.0, constant_envelope=False)
    weaker = AMPLIFIER.with_strong(-40.0, constant_envelope=False)
    assert weaker.distortion == pytest.approx(2 * 10 ** (2 * (-40.0 + 8.0) / 10), rel=0.05)
    assert gaussian.weak == pytest.approx(1 - 2 * share, abs=3e-4)
    assert gaussian.modulation == pytest.approx((2 * share) ** 2, rel=0.1)
    carrier = AMPLIFIER.with_strong(-35.0, constant_envelope=True)
    assert (carrier.weak, carrier.modulation) == (pytest.approx(1 - 2 * share, abs=3e-4), 0.0)
    assert carrier.own == pytest.approx(1 - share, abs=3e-4)


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
