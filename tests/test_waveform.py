"""The sweep and the beat/range algebra: phase is integrated frequency, beat is slope times delay, Doppler cancels."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from radalt.core.altimeter.cramer_rao import altitude_crb_m, beat_crb_hz
from radalt.core.returns.point import point_return
from radalt.core.waveform import Waveform, exp_cycles

C = 299_792_458.0
# B T_h is 3750 cycles, 3550.0615 cycles and 10050.25 cycles: only the first may be pasted sweep by sweep
SWEEPS = [
    Waveform(),
    Waveform(bandwidth_hz=7.100123e6),
    Waveform(bandwidth_hz=6.7001666e6, sweep_s=3e-3),
    Waveform(centered=False),
    Waveform(bandwidth_hz=7.100123e6, centered=False),
    Waveform(bandwidth_hz=6.7001666e6, sweep_s=3e-3, centered=False),
]
IDS = [f"{w.bandwidth_hz:g}-{w.sweep_s:g}-{'centered' if w.centered else 'from_zero'}" for w in SWEEPS]


def integrated_phase(w: Waveform, frames: int, per_sample: int = 8) -> np.ndarray:
    """Whole-signal reference: the triangle of instantaneous frequency, integrated by the midpoint rule,
    which is exact on straight pieces; every corner of the triangle lies on the grid."""
    count = frames * w.samples_per_frame * per_sample
    step_s = 1.0 / (w.rate_hz * per_sample)
    position = np.mod((np.arange(count) + 0.5) / (w.samples_per_frame * per_sample), 1.0)
    frequency = w.bandwidth_hz * (1.0 - np.abs(2.0 * position - 1.0))
    if w.centered:
        frequency -= w.bandwidth_hz / 2
    phase = np.concatenate([[0.0], np.cumsum(frequency * step_s)])
    return phase[:-1:per_sample]


@pytest.mark.parametrize("w", SWEEPS, ids=IDS)
def test_sweeps_are_the_integral_of_their_frequency_without_a_step_at_the_seams(w):
    frames = 3
    played = np.concatenate([w.reference * w.frame_rotation(i) for i in range(frames)])
    expected = np.exp(2j * np.pi * integrated_phase(w, frames))
    assert np.abs(played - expected).max() < 2e-5  # float32 table, 1e4 cycles summed by the reference


@pytest.mark.parametrize("w", SWEEPS, ids=IDS)
def test_phase_is_exact_after_hours(w):
    """Reduced modulo one cycle in float64; a float32 accumulator would be noise after seconds."""
    frame = 10_000_019  # about three hours of millisecond sweeps
    u = w.samples_per_frame // 3  # a sample on the way up
    time = Fraction(u) / Fraction(w.rate_hz)
    half = Fraction(w.sweep_s) / 2
    slope = Fraction(w.bandwidth_hz) / half
    start = -Fraction(w.bandwidth_hz) / 2 if w.centered else Fraction(0)
    whole = frame * (Fraction(w.bandwidth_hz) * half + 2 * start * half)
    exact = float((whole + start * time + slope * time**2 / 2) % 1)
    error = w.phase_cycles(np.array(float(time)), frame) - exact
    assert abs(error - np.rint(error)) < 2e-5  # B T_h is rounded to float64: 1e7 sweeps of 1e-12 each


def test_exponential_of_cycles_reduces_before_it_rounds():
    phase = np.array([1e9 + 0.25, -1e9 - 0.5, 0.125])
    np.testing.assert_allclose(exp_cycles(phase), [1j, -1, np.sqrt(0.5) * (1 + 1j)], atol=1e-6)


def dechirped_beats(w: Waveform, frame: np.ndarray, skip_s: float = 2e-5) -> tuple[float, float]:
    """Reference: slope of the unwrapped phase of conj(rx) ref in each half, away from the seams."""
    phase = np.unwrap(np.angle(np.conj(frame.astype(complex)) * w.reference))
    half, skip = w.samples_per_half, round(skip_s * w.rate_hz)
    t = w.sample_times_s
    spans = [slice(skip, half - skip), slice(half + skip, 2 * half - skip)]
    return tuple(np.polyfit(t[s], phase[s], 1)[0] / (2 * np.pi) for s in spans)


@pytest.mark.parametrize("altitude_m", [3.0, 77.7, 1500.0])
@pytest.mark.parametrize("w", [SWEEPS[0], SWEEPS[1], SWEEPS[5]], ids=[IDS[0], IDS[1], IDS[5]])
def test_beat_is_slope_times_delay_for_both_kinds_of_altitude(w, altitude_m):
    beat_hz = w.bandwidth_hz / (w.sweep_s / 2) * 2 * altitude_m / C
    for frame in (point_return(w, altitude_m), w.beat_shifted(altitude_m)):
        up, down = dechirped_beats(w, frame)
        assert up == pytest.approx(beat_hz, rel=2e-6, abs=0.01)
        assert down == pytest.approx(-beat_hz, rel=2e-6, abs=0.01)
        assert w.beats_to_altitude_m(up, down) == pytest.approx(altitude_m, rel=2e-6, abs=1e-3)
    assert w.altitude_to_beat_hz(altitude_m) == pytest.approx(beat_hz, rel=1e-12)


def test_one_hertz_of_beat_is_one_centimetre_and_one_bin_is_twenty_metres():
    w = Waveform()
    assert w.beats_to_altitude_m(1.0, -1.0) == pytest.approx(C / 30e9)
    assert w.beats_to_altitude_m(2000.0, -2000.0) == pytest.approx(w.range_resolution_m)
    assert w.range_resolution_m == pytest.approx(19.986, abs=1e-3)


@pytest.mark.parametrize("speed", [-120.0, -3.0, 60.0])
def test_doppler_cancels_in_the_up_down_mean_and_is_the_vertical_speed(speed):
    w = Waveform()
    up, down = dechirped_beats(w, point_return(w, 400.0, vertical_speed_m_per_s=speed))
    doppler_hz = 2 * speed * 4.3e9 / C
    assert (up + down) / 2 == pytest.approx(doppler_hz, rel=1e-3)
    assert w.beats_to_vertical_speed_m_per_s(up, down) == pytest.approx(speed, rel=1e-3)
    # range walk over half the time between the two halves' middles: v T_h / 2 up, the same down; they cancel as well
    assert w.beats_to_altitude_m(up, down) == pytest.approx(400.0, abs=2e-3 * abs(speed) / 60 + 1e-3)
    assert w.vertical_speed_to_doppler_hz(speed) == pytest.approx(doppler_hz)


def test_return_is_the_delayed_sweep_with_its_carrier_phase_and_the_previous_tail():
    """Reference: integrate the frequency over two sweeps, read it tau earlier, turn by -2 pi f_c tau."""
    w = Waveform(bandwidth_hz=7.100123e6, centered=False)
    per_sample = 8
    delay_samples = 60 + 3 / per_sample  # on the reference's grid
    altitude = delay_samples / w.rate_hz * C / 2
    fine = integrated_phase(replace(w, rate_hz=w.rate_hz * per_sample), 2)
    at = np.arange(7500, 15000) * per_sample - int(delay_samples * per_sample)
    expected = np.exp(2j * np.pi * (fine[at] - np.mod(4.3e9 * 2 * altitude / C, 1.0)))
    got = point_return(w, altitude, frame_index=1)
    assert np.abs(got - expected).max() < 1e-5


def test_batches_of_returns_are_the_single_returns():
    w = Waveform()
    batch = point_return(w, [10.0, 900.0], vertical_speed_m_per_s=[0.0, -30.0], phase_cycles=[0.1, 0.7])
    one = point_return(w, 900.0, vertical_speed_m_per_s=-30.0, phase_cycles=0.7)
    assert batch.shape == (2, 7500)
    np.testing.assert_allclose(batch[1], one, atol=1e-6)


@pytest.mark.parametrize("w", SWEEPS, ids=IDS)
def test_synthetic_altitude_changes_on_a_sweep_boundary_without_a_phase_step(w):
    """The shift's phase is back at zero at the seam: the next sample comes a sample's phase later.
    The carrier phase -2 pi f_c tau of the altitude, a constant per sweep, is set aside."""
    altitudes = (1500.0, 20.0, 333.0)
    phases = []
    for index, altitude in enumerate(altitudes):
        sweep = w.beat_shifted(altitude) * w.frame_rotation(index)
        carrier = np.exp(2j * np.pi * np.mod(w.carrier_hz * 2 * altitude / C, 1.0))
        phases.append(np.angle(sweep * carrier))
    increments = np.diff(np.concatenate(phases)) / (2 * np.pi)
    frequency = np.diff(integrated_phase(w, 3))
    beat = np.repeat([w.altitude_to_beat_hz(a) for a in altitudes], w.samples_per_frame) / w.rate_hz
    up = np.tile(np.repeat([-1.0, 1.0], w.samples_per_half), 3)
    error = increments - (frequency + up[:-1] * beat[:-1])
    assert np.abs(error - np.rint(error)).max() < 2e-5


def test_bounds_are_the_inverse_of_the_numerical_fisher_information():
    """Cramer-Rao of a complex tone of unknown amplitude, phase and frequency, by numerical derivatives."""
    w, snr_db = Waveform(), 7.0
    t = np.arange(w.samples_per_half) / w.rate_hz
    tone = np.exp(2j * np.pi * 1234.5 * t + 0.4j)
    gradients = np.stack([tone, 1j * tone, 2j * np.pi * t * tone])
    fisher = 2 * 10 ** (snr_db / 10) * (gradients @ gradients.conj().T).real
    sigma_hz = np.sqrt(np.linalg.inv(fisher)[2, 2])
    assert beat_crb_hz(w, snr_db) == pytest.approx(sigma_hz, rel=1e-6)
    # R = c (f_up - f_down) / 4k of two independent beats
    assert altitude_crb_m(w, snr_db) == pytest.approx(C / (4 * 15e9) * np.sqrt(2) * sigma_hz, rel=1e-6)
