"""A sawtooth has one slope: range and Doppler are one, and a track's own speed takes them apart."""

from dataclasses import replace

import numpy as np
import pytest

from radalt import Altimeter, AltimeterSettings, AltitudeTracker, TrackerSettings, Waveform
from radalt.core.deramp.if_waveform import IfWaveform, white_noise
from radalt.core.returns.point import point_return
from radalt.core.tracker.tracker import Status

# 150 MHz in 7 ms, the whole period of a sawtooth: frames of two of them
SAW = IfWaveform(bandwidth_hz=150e6, sweep_s=14e-3, rate_hz=768e3, pass_hz=250e3, shape="sawtooth_up")
SETTINGS = AltimeterSettings(max_altitude_m=600.0, max_vertical_speed_m_per_s=40.0)
BIAS = 0.2007  # metres per metre per second: f_c / k


@pytest.mark.parametrize("shape", ["sawtooth_up", "sawtooth_down"])
def test_phase_is_the_integral_of_the_frequency(shape):
    w = Waveform(shape=shape, bandwidth_hz=7.1e6)
    t = (np.arange(8 * w.samples_per_frame) + 0.5) / (8 * w.rate_hz)
    phase = np.concatenate([[0.0], np.cumsum(w.frequency_hz(t)) / (8 * w.rate_hz)])[:-1:8]
    assert np.abs(w.reference - np.exp(2j * np.pi * phase)).max() < 2e-5
    slope = np.diff(w.frequency_hz(w.sample_times_s[:10])) * w.rate_hz
    assert np.allclose(slope, w.half_slopes[0] * w.slope_hz_per_s)


@pytest.mark.parametrize("shape", ["sawtooth_up", "sawtooth_down"])
@pytest.mark.parametrize("speed", [-20.0, 0.0, 20.0])
def test_a_frame_is_biased_by_its_doppler_and_has_no_speed(shape, speed):
    w = replace(SAW, shape=shape)
    found = Altimeter(w, SETTINGS).process(point_return(w, [300.0], vertical_speed_m_per_s=speed))[0]
    sign = 1 if shape == "sawtooth_up" else -1
    assert abs(found["altitude_m"] - (300.0 + sign * BIAS * speed)) < 0.02
    assert np.isnan(found["vertical_speed_m_per_s"])
    assert abs(sign * BIAS - w.doppler_lead_s) < 1e-4


def test_at_full_rate_as_in_the_deramped_domain():
    fast = Waveform(bandwidth_hz=7.5e6, sweep_s=2e-3, shape="sawtooth_up")
    found = Altimeter(fast).process(point_return(fast, np.array([300.0]), vertical_speed_m_per_s=20.0))[0]
    assert abs(found["altitude_m"] - (300.0 + 20.0 * fast.carrier_hz / fast.slope_hz_per_s)) < 0.1


@pytest.mark.parametrize("shape", ["sawtooth_up", "sawtooth_down", "triangle"])
@pytest.mark.parametrize("speed", [-20.0, 20.0])
def test_the_tracker_corrects_with_its_own_speed(shape, speed):
    w = replace(SAW, shape=shape)
    altimeter = Altimeter(w, SETTINGS)
    settings = TrackerSettings(output_s=8 * w.sweep_s, max_vertical_speed_m_per_s=30.0)
    tracker = AltitudeTracker(altimeter, settings)
    frames = 8 * 16
    middle = (np.arange(frames) + 0.5) * w.sweep_s
    received = point_return(w, 300.0 + speed * middle, vertical_speed_m_per_s=np.full(frames, speed))
    received += white_noise(w, frames, 1e-3 / w.rate_hz, np.random.default_rng(1))
    out = tracker.process(altimeter.spectra(received))[8:]
    truth = 300.0 + speed * (out["frame_index"] + 1) * w.sweep_s
    assert (out["status"] == Status.NORMAL).all()
    assert np.abs(out["altitude_m"] - truth).max() < 0.6  # uncorrected: 4 m
    assert np.abs(out["vertical_speed_m_per_s"] - speed).max() < 2.0


def test_short_and_long_sweeps_work_in_the_deramped_domain():
    for sweep_s, bandwidth in ((0.2e-3, 1e6), (20e-3, 200e6)):
        w = IfWaveform(bandwidth_hz=bandwidth, sweep_s=sweep_s, rate_hz=1.92e6)
        altitude = 100.0
        found = Altimeter(w, AltimeterSettings(max_altitude_m=600.0)).process(point_return(w, [altitude]))
        assert abs(found["altitude_m"][0] - altitude) < 0.05 * w.range_resolution_m
