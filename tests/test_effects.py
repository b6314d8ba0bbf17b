"""Emitters as they are: error vectors, amplifier, fading that goes on, oscillators, streams, against closed forms."""

import numpy as np
import pytest
from gnuradio import radalt
from scipy.special import eval_genlaguerre, j0
from test_nr import demodulate

from radalt.core.interference import Interferer, QpskEmitter, ToneEmitter
from radalt.core.interference.amplifier import Amplifier
from radalt.core.interference.effects import ImpairedEmitter, Impairments, Oscillator, Path, PhaseNoise
from radalt.core.interference.emitters.fmcw import FmcwEmitter
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.emitters.qpsk import rrc_taps
from radalt.core.interference.emitters.qpsk_received import QpskReceivedEmitter
from radalt.core.interference.multipath import PROFILES, FadingChannel
from radalt.core.interference.nr_grid import resource_grid
from radalt.core.interference.stream import JammerStream
from radalt.core.interference.transmission import Transmission
from radalt.core.scene import parse_scene
from radalt.core.waveform import Waveform

RATE_HZ = 7.5e6
N = 7500
EVERYTHING = Impairments(
    amplifier=Amplifier(backoff_db=6.0),
    fading=FadingChannel(profile="EVA", doppler_hz=120.0),
    oscillator=Oscillator(carrier_offset_hz=700.0, clock_ppm=5.0),
    phase_noise=PhaseNoise(rms_deg=2.0),
)


class Wave:
    """Emitter that sends one wave of known frequency, phase 0 at the start of each call's part."""

    def __init__(self, hz=0.0):
        self.hz = hz

    def samples(self, count, rate_hz, rng):
        return np.exp(2j * np.pi * self.hz / rate_hz * np.arange(count))


def impaired(emitter, **effects):
    return ImpairedEmitter(emitter=emitter, effects=Impairments(**effects))


def test_a_radar_that_is_drawn_into_the_window_is_heard_in_it():
    emitter = ImpairedEmitter(emitter=FmcwEmitter(), effects=Impairments(fading=FadingChannel(doppler_hz=50)))
    rng = np.random.default_rng(3)
    power = [np.mean(np.abs(emitter.samples(500, RATE_HZ, rng)) ** 2) for _ in range(100)]
    assert min(power) > 1e-3 * np.median(power)


QUIET = Impairments(oscillator=EVERYTHING.oscillator, phase_noise=EVERYTHING.phase_noise)
STILL = Impairments(fading=FadingChannel(profile="PA"))


@pytest.mark.parametrize(
    ("emitter", "effects", "within_db"),
    [
        (NrEmitter(frame_count=2), QUIET, 0.02),
        (QpskEmitter(pulse="rrc"), QUIET, 0.02),
        (NrEmitter(), STILL, 0.5),
    ],
    ids=["nr", "qpsk", "nr through a channel that does not move"],
)
def test_stream_keeps_its_sir_in_the_mean_and_starts_nothing_anew(emitter, effects, within_db):
    one = Interferer(ImpairedEmitter(emitter=emitter, effects=effects), -17.0)
    for seed in range(1 if effects is QUIET else 4):
        stream = JammerStream(Waveform(), [one], seed=seed, free_running=True)
        stream.next_frame()
        power = np.mean([np.mean(np.abs(stream.next_frame().astype(complex)) ** 2) for _ in range(40)])
        assert 10 * np.log10(power) == pytest.approx(17.0, abs=within_db)


@pytest.mark.parametrize("evm", [0.05, 0.2, "typical"])
@pytest.mark.parametrize("pulse", ["rectangular", "rrc"])
def test_qpsk_demodulated_has_the_evm_asked_for(pulse, evm):
    """By a textbook receiver with symbol timing, of shaped pulses behind the matched filter; 4 samples a symbol."""
    wide = 1.5 if pulse == "rrc" else 1.0
    emitter = QpskEmitter(bandwidth_hz=wide * RATE_HZ / 4, pulse=pulse, rolloff=0.5, evm=evm)
    samples = emitter.samples(80_000, RATE_HZ, np.random.default_rng(2))
    if pulse == "rrc":
        matched = np.convolve(samples, rrc_taps(0.5, 4, 48), mode="valid")
        best = min(measured_evm(matched[timing::4]) for timing in range(4))
    else:
        best = measured_evm(samples[np.flatnonzero(np.diff(samples)) + 1])
    assert best == pytest.approx(0.175 / 2 if evm == "typical" else evm, rel=0.02)


def test_qpsk_as_received_has_its_errors_before_the_filter():
    """Same symbols, timing and phase; what differs is the held errors, of that power."""
    ideal = QpskReceivedEmitter().samples(60_000, RATE_HZ, np.random.default_rng(3))
    sent = QpskReceivedEmitter(evm=0.1).samples(60_000, RATE_HZ, np.random.default_rng(3))
    error = np.mean(np.abs(sent - ideal) ** 2) / np.mean(np.abs(ideal) ** 2)
    assert np.sqrt(error) == pytest.approx(0.1, rel=0.02)


def measured_evm(symbols):
    """RMS distance to the nearest of four points, over their radius, phase and gain by least squares."""
    turn = np.exp(1j * (np.angle(-np.mean(symbols**4)) / 4))
    quarter = np.round((np.angle(symbols / turn) - np.pi / 4) / (np.pi / 2))
    ideal = np.exp(1j * (np.pi / 4 + quarter * np.pi / 2))
    gain = np.vdot(ideal, symbols) / ideal.size
    return np.sqrt(np.mean(np.abs(symbols / gain - ideal) ** 2))


def orders(amplifier, count=12):
    """b_n^2, powers of a Gaussian signal's orders 1, 3, 5 ... behind the amplifier: y = sum_n b_n x L_n^(1)(|x|^2) /
    sqrt(n + 1), b_n = E[y x* L_n^(1)(|x|^2)] / sqrt(n + 1), autocorrelation sum_n b_n^2 rho |rho|^(2n)."""
    a = np.linspace(0.0, 6.0, 60_001)
    saturation = 10 ** (amplifier.backoff_db / 20)
    p = amplifier.smoothness
    out = a / (1 + (a / saturation) ** (2 * p)) ** (0.5 / p)
    density, n = 2 * a * np.exp(-(a**2)), np.arange(count)
    parts = density * out * a * eval_genlaguerre(n[:, None], 1, a**2)
    return (parts.sum(axis=1) * (a[1] - a[0])) ** 2 / (n + 1)


def order_spectra(width, count, size=1 << 14):
    """(count, size) spectra of rho |rho|^(2n) for a flat band of ``width`` cycles per sample; each sums to 1."""
    lag = np.fft.fftfreq(size, 1 / size)
    rho = np.sinc(width * lag)
    return np.stack([np.fft.fft(rho ** (2 * n + 1)).real / size for n in range(count)])


@pytest.mark.parametrize(("backoff_db", "smoothness"), [(3.0, 2.0), (8.0, 2.0), (6.0, 10.0)])
def test_amplifier_distorts_a_gaussian_band_as_the_series_of_its_orders_says(backoff_db, smoothness):
    amplifier = Amplifier(backoff_db=backoff_db, smoothness=smoothness)
    size, width = 1 << 18, 0.125
    rng = np.random.default_rng(6)
    band = np.abs(np.fft.fftfreq(size)) < width / 2
    sent = np.fft.ifft(np.where(band, rng.standard_normal((size, 2)).view(complex)[:, 0], 0.0))
    sent *= 3.7 / np.sqrt(np.mean(np.abs(sent) ** 2))
    got = amplifier.amplify(sent, 3.7**2) / 3.7
    power = orders(amplifier)
    gain = np.vdot(sent, got) / np.vdot(sent, sent) * 3.7
    assert abs(gain) ** 2 == pytest.approx(power[0], rel=0.01)
    error = got - gain * sent / 3.7
    assert np.mean(np.abs(error) ** 2) == pytest.approx(power[1:].sum(), rel=0.03)
    # where in frequency: in the band (EVM), and in the channel next to it (regrowth)
    spectrum = np.abs(np.fft.fft(error)) ** 2 / size**2
    expected = np.tensordot(power[1:], order_spectra(width, 12)[1:], 1)
    places = [np.abs(np.fft.fftfreq(part.size)) for part in (spectrum, expected)]
    for low, high in ((0.0, width / 2), (width / 2, 1.5 * width)):
        inside = [(at > low) & (at < high) for at in places]
        assert spectrum[inside[0]].sum() == pytest.approx(expected[inside[1]].sum(), rel=0.05)


def test_amplified_5g_demodulates_with_the_evm_of_the_series():
    amplifier = Amplifier(backoff_db=5.0)
    emitter = NrEmitter(channel_bandwidth_hz=10e6, modulation="64qam", ssb_indices=(), pdcch_load=1.0)
    sent = resource_grid(emitter, np.random.default_rng(emitter.seed)).values
    received, _ = emitter.period(RATE_HZ, amplifier)
    offset = (np.arange(624) - 312) * 15e3
    passed = np.abs(offset) < 3.0e6
    got = demodulate(received, RATE_HZ, 624, 140, 0.0, passed)[:, 2:]
    ideal = sent[passed][:, 2:]
    gain = np.vdot(ideal, got) / np.vdot(ideal, ideal)
    evm2 = np.mean(np.abs(got / gain - ideal) ** 2) / np.mean(np.abs(ideal) ** 2)
    width = 0.125
    spectra = order_spectra(width, 12)
    inner = np.abs(np.fft.fftfreq(spectra.shape[1])) < width / 9.36 * 3.0
    power = orders(amplifier)
    expected = power[1:] @ spectra[1:, inner].sum(axis=1) / (power[0] * spectra[0, inner].sum())
    # not quite Gaussian: 624 subcarriers of 64QAM
    assert np.sqrt(evm2) == pytest.approx(np.sqrt(expected), rel=0.06)
    assert emitter.period(RATE_HZ, amplifier)[0] is received  # once, whatever the number of frames


def test_any_emitter_is_amplified_wide_and_then_received():
    """Two tones give third-order products next to them: IM3 of a Rapp amplifier, by its Fourier series."""
    tones = ToneEmitter(frequencies_hz=(0.9e6, 1.1e6))
    samples = impaired(tones, amplifier=Amplifier(backoff_db=4)).samples(N, RATE_HZ, np.random.default_rng(1))
    lines = np.abs(np.fft.fft(samples)) ** 2
    envelope = np.sqrt(2.0) * np.cos(np.pi * (np.arange(4096) + 0.5) / 2048)  # of two tones, over one beat
    bent = envelope / (1 + (envelope**2 / 10**0.4) ** 2) ** 0.25
    series = np.abs(np.fft.fft(bent)) ** 2
    assert lines[1300] / lines[1100] == pytest.approx(series[3] / series[1], rel=0.02)
    assert lines[500] / lines[900] == pytest.approx(series[5] / series[1], rel=0.1)


@pytest.mark.parametrize(("clock_ppm", "offset_hz"), [(50.0, 0.0), (-20.0, 777.0), (0.0, -1234.5)])
def test_oscillator_shifts_and_stretches_a_wave_exactly(clock_ppm, offset_hz):
    hz = 1.7e6
    emitter = impaired(Wave(hz), oscillator=Oscillator(carrier_offset_hz=offset_hz, clock_ppm=clock_ppm))
    for count in (N, 40_001):
        got = emitter.samples(count, RATE_HZ, np.random.default_rng(1))
        moved_hz = hz * (1 + 1e-6 * clock_ppm) + offset_hz
        expected = np.exp(2j * np.pi * moved_hz / RATE_HZ * np.arange(count))
        gain = np.vdot(expected, got) / count
        assert abs(gain) == pytest.approx(1.0, abs=1e-4)
        assert np.abs(got / gain - expected).max() < 1e-4


@pytest.mark.parametrize(("rms_deg", "bandwidth_hz"), [(2.0, 5e3), (10.0, 100e3)])
def test_phase_noise_has_its_rms_and_its_autocorrelation(rms_deg, bandwidth_hz):
    running = Path(impaired(Wave(), phase_noise=PhaseNoise(rms_deg=rms_deg, bandwidth_hz=bandwidth_hz)), N)
    rng = np.random.default_rng(9)
    phase = np.rad2deg(np.angle(np.concatenate([running.samples(N, RATE_HZ, rng) for _ in range(400)])))
    assert np.std(phase) == pytest.approx(rms_deg, rel=0.03)
    for lag in (round(RATE_HZ / (4 * np.pi * bandwidth_hz)), round(RATE_HZ / (2 * np.pi * bandwidth_hz))):
        found = np.mean(phase[lag:] * phase[:-lag]) / np.var(phase)
        assert found == pytest.approx(np.exp(-2 * np.pi * bandwidth_hz * lag / RATE_HZ), abs=0.03)
    assert np.abs(np.diff(phase)).max() < 3.0 * rms_deg  # no frame begins with a phase of its own


def test_fading_does_not_step_where_frames_meet():
    """Before placement scales each to its SIR."""
    running = Path(impaired(Wave(), fading=FadingChannel(profile="EVA", doppler_hz=120.0)), N)
    rng = np.random.default_rng(8)
    step = np.abs(np.diff(np.concatenate([running.samples(N, RATE_HZ, rng) for _ in range(6)])))
    # 2 pi 120 Hz / 7.5 MHz = 1e-4 a sample at unit gain; seams of the interpolation may reach -60 dB
    assert step.max() < 3e-3


# -- emitters that go on from frame to frame, and the power of their sum
@pytest.mark.parametrize(
    "effects",
    [{}, {"fading": FadingChannel(), "oscillator": Oscillator(carrier_offset_hz=500.0)}],
    ids=["as it is", "still channel, offset of whole cycles"],
)
def test_a_free_running_base_station_comes_again_after_its_period(effects):
    emitter = impaired(NrEmitter(frame_count=2), **effects)  # 20 ms
    stream = JammerStream(Waveform(), [Interferer(emitter, -10.0)], seed=3, free_running=True)
    frames = np.stack([stream.next_frame() for _ in range(45)])
    np.testing.assert_allclose(frames[1:21], frames[21:41], atol=3e-4)
    power = np.mean(np.abs(frames[1:21]) ** 2, axis=1)
    assert power.mean() == pytest.approx(10.0, rel=0.1 if effects else 1e-3)
    assert power.std() > 0.05 * power.mean()  # one gain: power goes with what is sent


def test_a_scene_s_base_station_goes_on_too_whatever_its_sir_is_set_to():
    """A whole scene's source has a total SIR: no frame is scaled by itself, and a new SIR is a new gain alone."""
    scene = parse_scene({"interference": {"nr": {"sir_db": -20.0, "free_running": True, "frame_count": 2}}})
    source = radalt.jammer_source(scene, sir_db=-10.0)
    source.stream.programme = None
    frames = np.stack([source.stream.next_frame() for _ in range(45)])
    np.testing.assert_allclose(frames[1:21], frames[21:41], atol=1e-5)
    assert np.mean(np.abs(frames[1:21]) ** 2) == pytest.approx(10.0, rel=1e-3)
    source.set_sir_db(-30.0)
    later = np.stack([source.stream.next_frame() for _ in range(11)])
    np.testing.assert_allclose(later[1:], 10.0 * frames[6:16], atol=1e-4)  # 20 frames are its period


def test_the_sum_of_what_goes_on_meets_the_total_sir_in_the_mean():
    parts = [Interferer(NrEmitter(frame_count=2), -20.0), Interferer(QpskEmitter(), -26.0)]
    stream = JammerStream(Waveform(), parts, seed=6, free_running=True, total_sir_db=-10.0)
    power = [np.mean(np.abs(stream.next_frame()) ** 2) for _ in range(81)][1:]
    assert np.mean(power) == pytest.approx(10.0, rel=0.03)
    assert np.std(power) > 0.3


# -- multipath: powers, delays, Rice factors and Doppler against the definitions
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


def faded(sent, channel, rng):
    """(N,) of what arrives of the emitter's first N samples."""
    return impaired(Sent(sent), fading=channel).begin(RATE_HZ, rng)(0, sent.size)


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
    echoes = faded(frame, FadingChannel(profile="ETU"), np.random.default_rng(3))
    power = np.abs(echoes) ** 2
    before, echo, after = (part.sum() / power.sum() for part in (power[:990], power[1500:1540], power[1600:]))
    assert max(before, after) < 1e-6 < echo


@pytest.mark.parametrize("doppler_hz", [0.0, 2000.0])
@pytest.mark.parametrize("name", ["EVA", "TDL-D"])
def test_tones_arrive_with_exact_fractional_delays(name, doppler_hz):
    """y(t) = sum_i g_i(t) sum_f exp(j 2 pi f (t - tau_i)), away from the ends of what is sent."""
    count = 6000
    channel = FadingChannel(profile=name, delay_spread_s=777e-9, doppler_hz=doppler_hz)
    t = np.arange(count) / RATE_HZ
    tones = np.array([-401, 3, 250]) * RATE_HZ / 1500
    found = faded(np.exp(2j * np.pi * tones[:, None] * t).sum(axis=0), channel, np.random.default_rng(12))
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


def test_clock_and_carrier_go_on_over_frames():
    """Over 20 frames of a stream a wave stays one wave, at its own clock and carrier."""

    class Endless:
        """A wave as a function of time."""

        def begin(self, rate_hz, rng):
            return lambda first, count: np.exp(2j * np.pi * 300e3 / rate_hz * (first + np.arange(count)))

    emitter = impaired(Endless(), oscillator=Oscillator(carrier_offset_hz=333.3, clock_ppm=40.0))
    running = Transmission(emitter, N)
    got = np.concatenate([running.samples(N, RATE_HZ, np.random.default_rng(0)) for _ in range(20)])
    moved_hz = 300e3 * (1 + 40e-6) + 333.3
    wave = np.exp(2j * np.pi * moved_hz / RATE_HZ * np.arange(got.size))
    gain = np.vdot(wave, got) / got.size
    assert np.abs(got / gain - wave).max() < 1e-3
