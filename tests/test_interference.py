"""Interference: exact window SIR and overlap, and spectra that are those of the textbook."""

import numpy as np
import pytest
from scipy import signal

from radalt.core.interference import Interferer, QpskEmitter, ToneEmitter, interference_frames
from radalt.core.interference.effects import impaired
from radalt.core.interference.emitters.fmcw import FmcwEmitter
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.emitters.pulsed_radar import PulsedRadarEmitter
from radalt.core.interference.emitters.qpsk import rrc_taps
from radalt.core.interference.emitters.qpsk_received import QpskReceivedEmitter
from radalt.core.interference.stream import JammerStream
from radalt.core.interference.transmission import Transmission, begin
from radalt.core.programme import Programme
from radalt.core.waveform import Waveform

RATE_HZ = 7.5e6
N = 7500


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def db(ratio: float) -> float:
    return 10 * np.log10(ratio)


def test_burst_starts_anywhere_it_fits_or_where_it_is_told():
    burst = Interferer(QpskEmitter(), 0.0, 0.4)
    first = [np.flatnonzero(interference_frames([burst], 1, N, RATE_HZ, rng(s)))[0] for s in range(400)]
    assert 0 <= min(first) < 100 and 4400 < max(first) <= 4500
    assert np.mean(first) == pytest.approx(2250, abs=4 * 4500 / np.sqrt(12 * 400))
    for start, expected in ((0.0, 0), (0.25, 1875), (1.0, 4500)):
        burst = Interferer(QpskEmitter(), 0.0, 0.4, start=start)
        assert np.flatnonzero(interference_frames([burst], 1, N, RATE_HZ, rng()))[0] == expected


def test_sum_of_interferers_has_the_sum_of_their_powers_or_the_total_that_is_asked_for():
    parts = [
        Interferer(QpskEmitter(pulse="rrc", carrier_hz=-2e6, bandwidth_hz=1e6), -10.0),
        Interferer(ToneEmitter(frequencies_hz=(2e6,)), -13.0),
    ]
    power = np.mean(np.abs(interference_frames(parts, 20, N, RATE_HZ, rng())) ** 2)
    # disjoint bands: orthogonal but for their skirts
    assert power == pytest.approx(10**1.0 + 10**1.3, rel=0.01)
    total = interference_frames(parts, 5, N, RATE_HZ, rng(), total_sir_db=-20.0)
    np.testing.assert_allclose(db(np.mean(np.abs(total) ** 2, axis=1)), 20.0, atol=0.01)
    assert not interference_frames([], 2, N, RATE_HZ, rng(), total_sir_db=-20.0).any()


def spectrum(samples: np.ndarray, cells: int = 1024) -> tuple[np.ndarray, np.ndarray]:
    frequency, density = signal.welch(samples, RATE_HZ, "hann", cells, return_onesided=False, detrend=False)
    order = np.argsort(frequency)
    return frequency[order], density[order]


@pytest.mark.parametrize("rolloff", [0.05, 0.1, 0.25, 1.0])
def test_shaped_qpsk_has_the_raised_cosine_power_spectrum(rolloff):
    """PSD of white symbols through a root-raised-cosine is the raised cosine itself (Nyquist's first criterion)."""
    emitter = QpskEmitter(bandwidth_hz=3e6, pulse="rrc", rolloff=rolloff, carrier_hz=0.5e6)
    frequency, density = spectrum(emitter.samples(1_500_000, RATE_HZ, rng()))
    symbol_rate = 3e6 / (1 + rolloff)
    offset = np.abs(frequency - 0.5e6)
    edge = np.clip((offset - (1 - rolloff) * symbol_rate / 2) / (rolloff * symbol_rate), 0, 1)
    expected = 0.5 * (1 + np.cos(np.pi * edge)) / symbol_rate
    # 2900 averages: 2 %; and the pulse is cut
    assert np.max(np.abs(density - expected)) < 0.12 * expected.max()
    passband = expected > 0.5 * expected.max()
    assert np.mean(density[passband] / expected[passband]) == pytest.approx(1.0, abs=0.02)
    outside = offset > 0.6 * 3e6
    assert db(density[outside].max() / expected.max()) < -30


@pytest.mark.parametrize("rolloff", [0.2, 0.25, 0.5, 1.0])
def test_pulse_and_matched_filter_leave_no_intersymbol_interference(rolloff):
    """Includes roll-offs where a tap falls on the closed form's removable singularity t = 1/(4 rolloff)."""
    up = 10
    taps = rrc_taps(rolloff, up, span_symbols=48)
    response = np.convolve(taps, taps)[taps.size - 1 :: up]
    assert response[0] == pytest.approx(1.0)
    assert np.abs(response[1:25]).max() < 3e-3


def test_rectangular_qpsk_has_the_sinc_squared_spectrum_whose_side_lobes_fill_the_band():
    emitter = QpskEmitter()
    frequency, density = spectrum(emitter.samples(1_500_000, RATE_HZ, rng()))
    assert emitter.symbol_rate_hz == pytest.approx(0.267 * 7.5e6)
    # aliases of the unfiltered pulse fold in: sum the sinc over the zones
    zones = frequency[:, None] + RATE_HZ * np.arange(-200, 201)
    expected = np.sum(np.sinc(zones / emitter.symbol_rate_hz) ** 2, axis=1) / emitter.symbol_rate_hz
    inside = np.abs(frequency) < 3.7e6
    assert np.max(np.abs(density - expected)[inside]) < 0.12 * expected.max()
    side = np.abs(np.abs(frequency) - 1.5 * emitter.symbol_rate_hz) < 0.1e6
    assert db(density[side].mean() / density.max()) == pytest.approx(-13.3, abs=1.0)


@pytest.mark.parametrize("pulse", ["rectangular", "rrc"])
def test_qpsk_has_unit_mean_power_and_four_equal_phases(pulse):
    emitter = QpskEmitter(pulse=pulse, bandwidth_hz=1.875e6)  # rectangular: four samples a symbol
    samples = emitter.samples(200_000, RATE_HZ, rng())
    assert np.mean(np.abs(samples) ** 2) == pytest.approx(1.0, rel=0.02)
    if pulse == "rectangular":
        turned = samples**4 / np.mean(samples**4)
        np.testing.assert_allclose(turned, 1.0, atol=1e-9)  # the fourth power strips the modulation
        quadrant = np.round(np.angle(samples / samples[0]) / (np.pi / 2)) % 4
        np.testing.assert_allclose(np.bincount(quadrant.astype(int)) / samples.size, 0.25, atol=0.01)


def test_tones_are_lines_of_equal_power_at_their_frequencies():
    wanted = (-3.0e6, 0.0, 1.234e6)
    samples = ToneEmitter(frequencies_hz=wanted).samples(N, RATE_HZ, rng())
    lines = np.abs(np.fft.fft(samples)) ** 2 / N**2
    bins = np.round(np.array(wanted) / 1000).astype(int) % N
    np.testing.assert_allclose(lines[bins], 1 / 3, rtol=1e-9)
    lines[bins] = 0
    assert lines.max() < 1e-20


def test_random_tones_stay_in_their_span():
    samples = ToneEmitter(40, span_hz=1e6).samples(N, RATE_HZ, rng())
    frequency, density = spectrum(samples, 2048)
    assert density[np.abs(frequency) < 0.52e6].sum() / density.sum() > 0.999
    assert density[np.abs(frequency) > 0.4e6].max() > 0  # and reach its edges
    assert np.unique(ToneEmitter(2).samples(10, RATE_HZ, rng(1))).size == 10


class Silent:
    """An emitter that sends nothing."""

    def samples(self, count, rate_hz, rng):
        return np.zeros(count, dtype=complex)


@pytest.mark.parametrize("free_running", [False, True])
@pytest.mark.parametrize("overlap", [0.0, 0.4, 1.0])
def test_nothing_of_what_lay_in_the_output_stays_there(overlap, free_running):
    for emitter, present in ((Silent(), False), (QpskEmitter(), True), (QpskEmitter(pulse="rrc"), True)):
        stream = JammerStream(Waveform(), [Interferer(emitter, overlap=overlap)], free_running=free_running)
        used = np.full((5, N), np.nan, np.complex64)
        for frame in used:
            stream.next_frame(frame)
        active = np.count_nonzero(used[1:]) / used[1:].size
        assert active == pytest.approx(overlap if present else 0.0, abs=0.2 if free_running else 1e-3)
        assert np.isfinite(used).all()


@pytest.mark.parametrize(("overlap", "free_running"), [(0.5, False), (1.0, True)])
def test_a_stream_is_silent_where_its_programme_is_and_nowhere_else(overlap, free_running):
    """Free running also in the frame before a trial and behind it, in which its own windows lie."""
    programme = Programme((100.0,), 20, preamble_frames=8, sync_every_frames=10, sync_frames=8)
    one = Interferer(QpskEmitter(), -10.0, overlap)
    stream = JammerStream(Waveform(), [one], programme=programme, seed=3, free_running=free_running)
    power = [np.mean(np.abs(stream.next_frame()) ** 2) for _ in range(programme.total_frames)]
    expected = np.where(programme.is_trial(np.arange(programme.total_frames)), 10.0, 0.0)
    np.testing.assert_allclose(power, expected, rtol=2e-3)


def test_free_running_stream_ignores_the_sweep():
    """Its bursts, tied to the start of its own windows, lie anywhere against ours, and keep their rate and power."""
    interferer = Interferer(QpskEmitter(), -10.0, 0.2, start=0.0)
    tied = JammerStream(Waveform(), [interferer], seed=1)
    assert all(np.flatnonzero(tied.next_frame())[0] == 0 for _ in range(3))
    starts = set()
    for seed in range(6):
        stream = JammerStream(Waveform(), [interferer], seed=seed, free_running=True)
        samples = np.concatenate([stream.next_frame() for _ in range(4)])
        edges = np.flatnonzero(np.diff(np.abs(samples) > 0, prepend=False) == 1)[::2]
        assert set(np.diff(edges)) == {N}
        starts.add(edges[0] % N)
        assert np.mean(np.abs(samples[edges[0] : edges[0] + 2 * N]) ** 2) == pytest.approx(10.0, rel=1e-3)
    assert len(starts) == 6


class Anew:
    """An emitter known by windows only."""

    def samples(self, count, rate_hz, rng):
        return rng.standard_normal(count) + 0j


AMPLIFIED = impaired(QpskEmitter(pulse="rrc"), {"amplifier": {}}, "qpsk")
IMPAIRED = {"fading": {"doppler_hz": 300.0}, "oscillator": {"clock_ppm": -20.0}, "phase_noise": {}}
TRANSMITTERS = {
    "nr": NrEmitter(carrier_hz=1_234_567.0),
    "tones": ToneEmitter(5),
    "rectangular": QpskEmitter(evm="typical"),
    "rrc": QpskEmitter(pulse="rrc", carrier_hz=1e6),
    "received": QpskReceivedEmitter(evm="typical"),
    "received rrc": QpskReceivedEmitter(pulse="rrc"),
    "fmcw": FmcwEmitter(sweep_bandwidth_hz=20e6, sweep_period_s=1.1e-3),
    "pulsed": PulsedRadarEmitter(),
    "windows": Anew(),
    "amplified": AMPLIFIED,
    "impaired": impaired(QpskEmitter(pulse="rrc"), IMPAIRED, "qpsk"),
}


@pytest.mark.parametrize("name", list(TRANSMITTERS))
def test_a_transmission_is_a_function_of_time(name):
    """Ragged chunks in any order are those of one chunk, bit for bit; its blocks meet without a seam."""
    emitter, (first, last) = TRANSMITTERS[name], (-20_000, 40_000)
    whole = Transmission(emitter, N).at(first, last - first, RATE_HZ, rng(3))
    ends = [first, -16_384, -1, 0, 1, 7_500, 8_123, 16_383, 16_384, 32_800, last]
    chunks = list(zip(ends[:-1], ends[1:], strict=True))
    again, parts = Transmission(emitter, N), {}
    for start, end in chunks[::-1]:
        parts[start] = again.at(start, end - start, RATE_HZ, rng(3))
    np.testing.assert_array_equal(np.concatenate([parts[start] for start, _ in chunks]), whole)
    direct = begin(emitter, RATE_HZ, rng(3))(first, last - first)
    # a receiver's filter is 80 dB down, and two blocks of a moving filter differ by its interpolation: -60 dB
    np.testing.assert_allclose(whole, direct, atol=5e-3 if name == "impaired" else 1e-4)


@pytest.mark.parametrize("pulse", ["rectangular", "rrc"])
def test_the_symbol_clock_runs_on_through_the_gaps_of_bursts(pulse):
    """Bursts of a free-running stream are pieces of one transmission, each at its SIR."""
    emitter = QpskEmitter(pulse=pulse)
    stream = JammerStream(Waveform(), [Interferer(emitter, -10.0, 0.3)], seed=5, free_running=True)
    sent = np.concatenate([stream.next_frame() for _ in range(8)])[stream._shift :][: 7 * N].reshape(7, N)
    (transmission,) = stream._running.values()
    for frame, steady in zip(sent, transmission.at(0, 7 * N, RATE_HZ, rng()).reshape(7, N), strict=True):
        assert np.mean(np.abs(frame) ** 2) == pytest.approx(10.0, rel=1e-4)
        on = frame != 0
        assert np.count_nonzero(on) == round(0.3 * N)
        gain = np.vdot(steady[on], frame[on]) / np.vdot(steady[on], steady[on])
        np.testing.assert_allclose(frame[on], gain * steady[on], atol=1e-4)
