"""The deramping receiver: its IF computed directly is that of the full-rate simulation of the same realisation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import fft

from radalt import Altimeter, AltimeterSettings, Waveform
from radalt.core.deramp.emitters import Carrier, OtherAltimeter, Tone, interference_if
from radalt.core.deramp.if_waveform import IfWaveform, white_noise
from radalt.core.fir import kaiser_lowpass
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.emitters.qpsk import QpskEmitter
from radalt.core.returns.point import point_return

C = 299_792_458.0
# slope 20 GHz/s; full rate 38.4 MS/s, so that every beat with the sweep stays below its Nyquist frequency
SWEEP = IfWaveform(bandwidth_hz=20e6, sweep_s=2e-3, rate_hz=768e3, pass_hz=250e3)
FULL = 10  # full rate over simulation rate
OTHER = Waveform(bandwidth_hz=15e6, sweep_s=1.3e-3, rate_hz=20e6)


def carried(emitter, bandwidth_hz, offset_hz):
    return Carrier.begun(emitter, SWEEP, bandwidth_hz, offset_hz, np.random.default_rng(1))


EMITTERS = {
    "tone": Tone(3.1e6, 0.2),
    "tone at the sweep's edge": Tone(-9.9e6),
    "NR 10 MHz": carried(NrEmitter(channel_bandwidth_hz=10e6), 18e6, 1e6),  # at 19.2 MS/s
    "NR 5 MHz at the sweep's edge": carried(NrEmitter(channel_bandwidth_hz=5e6), 4.5e6, -8e6),
    "QPSK": carried(QpskEmitter(1.125e6, pulse="rrc"), 1.125e6, 2.3e6),
    "altimeter of another slope": OtherAltimeter(OTHER, 0.123e-3, 1e6),
    "altimeter of the same sweep, 1 us late": OtherAltimeter(SWEEP, 1e-6),
}


def full_rate(emitter, t):
    """An emitter's samples on the air at times t on the full rate's grid; a carrier's by one ideal interpolation."""
    if isinstance(emitter, Carrier):
        up = round(FULL * SWEEP.simulation_hz / emitter.rate_hz)
        first = round(t[0] * emitter.rate_hz - 0.5)
        count = -(-t.size // up) + 2 * 512
        sent = emitter.signal(first - 512 + round(SWEEP.sweep_s * emitter.rate_hz), count)
        spectrum = np.fft.fftshift(np.fft.fft(sent))
        side = (up - 1) * count
        fine = np.fft.ifft(np.fft.ifftshift(np.pad(spectrum, (side // 2, side - side // 2)))) * up
        start = round((t[0] - (first - 512) / emitter.rate_hz) * FULL * SWEEP.simulation_hz)
        return fine[start : start + t.size] * np.exp(2j * np.pi * emitter.offset_hz * t)
    return np.exp(2j * np.pi * emitter.cycles(t))


def full_rate_if(sweep, wave, frame=0):
    """Mixed with the sweep at the full rate, decimated, filtered."""
    taps = kaiser_lowpass(sweep.stop_hz, sweep.simulation_hz - sweep.stop_hz, FULL * sweep.simulation_hz)
    side = taps.size // 2
    count = (sweep.simulation_times_s.size - 1) * FULL + 1
    t = sweep.simulation_times_s[0] + np.arange(-side, count + side) / (FULL * sweep.simulation_hz)
    mixed = wave(t + frame * sweep.sweep_s) * np.exp(-2j * np.pi * sweep.phase_cycles(t))
    return sweep.filtered(np.convolve(mixed, taps, mode="valid")[::FULL])


def agreement(direct, full):
    """Power ratio and error vector in decibels."""
    power = [float(np.vdot(x, x).real) for x in (direct, full, direct - full)]
    return 10 * np.log10(power[0] / power[1]), 10 * np.log10(power[2] / power[1])


@pytest.mark.parametrize("shape", ["triangle", "sawtooth_up"])
@pytest.mark.parametrize("name", EMITTERS)
def test_interference_is_that_of_the_full_rate(name, shape):
    sweep, emitter, frame = replace(SWEEP, shape=shape), EMITTERS[name], 3
    direct = interference_if(sweep, emitter, 1, frame)[0]
    ratio_db, error_db = agreement(direct, full_rate_if(sweep, lambda t: full_rate(emitter, t), frame))
    assert abs(ratio_db) < 0.05
    assert error_db < -25.0  # QPSK's tails, which the carrier leaves out


def test_if_filter_passes_its_band_and_rejects_what_folds():
    t = SWEEP.simulation_times_s
    gain = [np.abs(SWEEP.filtered(np.exp(2j * np.pi * f * t))[50:-50]) for f in (0.0, 249e3, 385e3, 1.9e6)]
    assert np.allclose(gain[:2], 1.0, atol=2e-4) and np.max(gain[2:]) < 2e-4


@pytest.mark.parametrize("shape", ["triangle", "sawtooth_up", "sawtooth_down"])
def test_return_is_that_of_the_full_rate(shape):
    sweep, altitude_m, speed = replace(SWEEP, shape=shape), 300.0, -30.0

    def received(t):
        delay = 2 * (altitude_m + speed * (t - sweep.half_sweep_s)) / C
        return np.exp(2j * np.pi * (sweep.phase_cycles(t - delay) - np.mod(sweep.carrier_hz * delay, 1.0)))

    direct = point_return(sweep, altitude_m, vertical_speed_m_per_s=speed)
    ratio_db, error_db = agreement(direct, full_rate_if(sweep, received))
    assert abs(ratio_db) < 0.05
    assert error_db < -20.0  # the instants in which the return is on the ramp before


@pytest.mark.parametrize("altitude_m", [30.0, 123.4, 700.0])
def test_the_same_altimeter_reads_the_same_altitude(altitude_m):
    fast = Waveform(bandwidth_hz=20e6, sweep_s=2e-3, rate_hz=38.4e6)
    settings = AltimeterSettings(max_altitude_m=1000.0)
    full = Altimeter(fast, settings).process(point_return(fast, np.array([altitude_m])))
    direct = Altimeter(SWEEP, settings).process(point_return(SWEEP, np.array([altitude_m])))
    assert direct["altitude_m"][0] == pytest.approx(full["altitude_m"][0], abs=2e-3)


def test_white_noise_has_its_density_in_every_beat_cell():
    density = 1.380649e-23 * 290 * 1e3 * 10**0.8  # k T0 F in mW/Hz, noise figure 8 dB
    noise = white_noise(SWEEP, 400, density, np.random.default_rng(1)).reshape(800, -1)
    cells = np.mean(np.abs(fft.fft(noise, axis=1) / noise.shape[1]) ** 2)
    assert abs(10 * np.log10(cells * SWEEP.half_sweep_s / density)) < 0.05  # k T0 F / T_h per cell
    # and the full rate, mixed with the sweep, says the same
    rng, rate = np.random.default_rng(2), FULL * SWEEP.simulation_hz

    def on_air(t):
        return np.sqrt(density * rate / 2) * (rng.standard_normal(t.size) + 1j * rng.standard_normal(t.size))

    full = np.array([full_rate_if(SWEEP, on_air) for _ in range(12)]).reshape(24, -1)
    inside = np.abs(np.fft.fftfreq(full.shape[1], 1 / SWEEP.rate_hz)) < SWEEP.pass_hz
    there = np.mean(np.abs(fft.fft(full, axis=1)[:, inside] / full.shape[1]) ** 2)
    assert abs(10 * np.log10(there / cells)) < 0.15  # 24 half sweeps of 500 cells
