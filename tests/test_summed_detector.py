"""Detectors per block of sweeps, and the diffuse ground that they meet."""

from dataclasses import replace

import numpy as np
import pytest

from radalt.core.deramp.ground import DiffuseGround, facet_frame
from radalt.core.deramp.if_waveform import IfWaveform, white_noise
from radalt.core.returns.point import point_return
from radalt.core.returns.terrain.antenna import GaussianAntenna
from radalt.core.returns.terrain.ground import reflectivity
from radalt.core.tracker.summed_detector import CounterDetector, SummedDetector
from radalt.core.tracker.tracker_settings import Status

SWEEP = IfWaveform(bandwidth_hz=150e6, sweep_s=7e-3, rate_hz=1.536e6, pass_hz=0.5e6)
FT = 0.3048


def flown(altitude_m, frames, speed=0.0, waveform=SWEEP):
    middle = (np.arange(frames) + 0.5) * waveform.sweep_s
    return point_return(waveform, altitude_m + speed * middle, vertical_speed_m_per_s=np.full(frames, speed))


@pytest.mark.parametrize("strategy", ["strongest", "leading_edge"])
@pytest.mark.parametrize("feet", [50, 1000, 5000])
def test_a_point_is_unbiased(strategy, feet):
    detector = SummedDetector(SWEEP, 8, max_altitude_m=1600.0, strategy=strategy)
    status, altitude = detector(flown(feet * FT + 0.3, 8))
    assert status[0] == Status.NORMAL
    # cells are 1 m
    assert altitude[0] == pytest.approx(feet * FT + 0.3, abs=0.02 if strategy == "strongest" else 0.12)


@pytest.mark.parametrize("speed", [-15.0, 15.0])
def test_doppler_cancels_in_a_triangle(speed):
    _, altitude = SummedDetector(SWEEP, 8, max_altitude_m=600.0)(flown(300.0, 8, speed))
    assert altitude[0] == pytest.approx(300.0 + speed * 4 * SWEEP.sweep_s, abs=0.25)


def test_noise_alone_exceeds_the_threshold_as_stated():
    detector = SummedDetector(replace(SWEEP, sweep_s=1.75e-3), 8, max_altitude_m=300.0, pfa=0.05)
    noise = white_noise(detector.waveform, 8 * 600, 1.0, np.random.default_rng(1))
    rate = np.mean(detector(noise)[0] == Status.NORMAL)
    assert 0.02 < rate < 0.075  # cells are correlated: below the bound; 600 outputs, 3 sigma above


def test_a_counter_reads_the_beat_and_is_captured_by_what_is_stronger():
    counter = CounterDetector(SWEEP, 8, max_altitude_m=1600.0)
    frames = flown(300.0, 16)
    assert counter(frames)[1] == pytest.approx([300.0, 300.0], abs=0.05)
    extra = flown(900.0, 16)
    assert counter(frames + 3 * extra)[1] == pytest.approx([900.0, 900.0], abs=10.0)


def test_facets_are_the_sum_of_point_returns():
    rng = np.random.default_rng(3)
    ranges, rates = rng.uniform(200.0, 260.0, 12), rng.uniform(-10.0, 10.0, 12)
    amplitude = rng.standard_normal(12) + 1j * rng.standard_normal(12)
    for shape in ("triangle", "sawtooth_down"):
        w = replace(SWEEP, shape=shape)
        exact = amplitude @ point_return(w, ranges, vertical_speed_m_per_s=rates, dtype=np.complex128)
        direct = facet_frame(w, ranges, rates, amplitude)
        error = np.vdot(direct - exact, direct - exact).real / np.vdot(exact, exact).real
        # beats rounded to an eighth of a cell: phase up to 1/16 cycle at the ends
        assert 10 * np.log10(error) < -14.0


@pytest.mark.parametrize("feet", [200, 1000, 5000])
@pytest.mark.parametrize("forward", [0.0, 70.0])
def test_the_summed_leading_edge_keeps_diffuse_ground(feet, forward):
    """Within 3 ft or 3 % from 200 ft up; the nearest ground is the altitude."""
    detector = SummedDetector(SWEEP, 8, max_altitude_m=1600.0, strategy="leading_edge")
    rng = np.random.default_rng(9)
    ground = DiffuseGround(GaussianAntenna(45.0), reflectivity(), forward_m_per_s=forward)
    frames = np.array([ground.frame(SWEEP, feet * FT, 1.0, rng) for _ in range(8 * 12)])
    frames += white_noise(SWEEP, len(frames), 1e-8, rng)
    status, altitude = detector(frames)
    good = (status == Status.NORMAL) & (np.abs(altitude - feet * FT) < max(3 * FT, 0.03 * feet * FT))
    assert good.mean() >= 0.9
