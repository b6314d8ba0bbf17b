"""QPSK as received, and its cancellation: clock, symbols and pulse found blindly, all else untouched."""

import numpy as np
import pytest
from frames import ALTIMETER, W, returns, white

from radalt.core.interference import Interferer, QpskEmitter, ToneEmitter, interference_frames
from radalt.core.interference.effects import ImpairedEmitter, Impairments
from radalt.core.interference.emitters.fmcw import FmcwEmitter
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.emitters.qpsk_received import QpskReceivedEmitter
from radalt.core.interference.multipath import FadingChannel
from radalt.core.mitigation import create
from radalt.core.mitigation.qpsk.settings import DEFAULTS
from radalt.core.mitigation.qpsk.symbol_timing import find_symbol_timing

N, RATE_HZ = W.samples_per_frame, W.rate_hz


PATHS = Impairments(fading=FadingChannel(profile="EVA"))
ECHOES = ImpairedEmitter(emitter=QpskReceivedEmitter(), effects=PATHS)


def received(emitter, sir_db, count=4, seed=1, overlap=1.0, snr_db=10.0):
    """Frames with interference, the same without, and their altitudes."""
    rng = np.random.default_rng(seed)
    altitude_m, clean = returns(rng, count, snr_db)
    jam = interference_frames([Interferer(emitter, sir_db, overlap)], count, N, RATE_HZ, rng)
    return (clean + jam).astype(np.complex64), clean, altitude_m


def left(cleaned, clean):
    """(n,) power of what is left of the interference, where a frame was not blanked."""
    return np.array([np.mean(np.abs(c - r)[c != 0] ** 2) for c, r in zip(cleaned, clean, strict=True)])


@pytest.mark.parametrize("pulse", ["rectangular", "rrc"])
@pytest.mark.parametrize("clock_ppm", [0.0, 300.0])
def test_symbols_come_at_the_rate_of_a_clock_of_their_own(pulse, clock_ppm):
    emitter = QpskReceivedEmitter(pulse=pulse, clock_ppm=clock_ppm)
    frame = emitter.samples(N, RATE_HZ, np.random.default_rng(2)).astype(np.complex64)
    timing = find_symbol_timing(frame, DEFAULTS)
    # in symbols over the frame; 300 ppm are half a symbol
    rate = emitter.symbol_rate_hz / RATE_HZ * (1 + 1e-6 * clock_ppm)
    assert timing.rate * N == pytest.approx(rate * N, abs=0.03)


def test_a_line_next_to_half_the_sample_rate_lies_between_two_bins():
    k = np.arange(7498)  # the last bin ends a floor
    frame = (1.0 + 0.5 * np.cos(0.99985 * np.pi * k)) * np.exp(0.3j * k)
    assert 0.499 < find_symbol_timing(frame.astype(np.complex64), DEFAULTS).rate < 0.5


def test_edges_lie_between_samples_and_the_filter_takes_the_corners():
    rng = np.random.default_rng(3)
    paper = np.abs(QpskEmitter().samples(N, RATE_HZ, rng))
    kept = np.abs(QpskReceivedEmitter().samples(N, RATE_HZ, rng))
    assert np.ptp(paper) < 1e-9
    assert kept.min() < 0.2 and kept.max() > 1.1


@pytest.mark.parametrize(("pulse", "power"), [("rectangular", 0.94), ("rrc", 1.0)])
def test_power_is_one_before_the_filter(pulse, power):
    window = QpskReceivedEmitter(pulse=pulse).samples(100_000, RATE_HZ, np.random.default_rng(4))
    assert np.mean(np.abs(window) ** 2) == pytest.approx(power, abs=0.02)


def test_rectangular_pulses_have_the_spectrum_of_the_sinc_and_do_not_fold():
    emitter = QpskReceivedEmitter(bandwidth_hz=2e6, carrier_hz=0.0)
    window = emitter.samples(750 * 200, RATE_HZ, np.random.default_rng(5)).reshape(200, 750)
    density = np.mean(np.abs(np.fft.fft(window * np.hanning(750), axis=1)) ** 2, axis=0)
    frequency = np.fft.fftfreq(750, 1 / RATE_HZ)
    flat = (np.abs(frequency) < 0.44 * RATE_HZ) & (np.abs(np.abs(frequency) - 2e6) > 0.2e6)
    ratio = density[flat] / np.sinc(frequency[flat] / 2e6) ** 2
    np.testing.assert_allclose(10 * np.log10(ratio / np.median(ratio)), 0.0, atol=1.5)


@pytest.mark.parametrize("sir_db", [-15.0, -45.0])
@pytest.mark.parametrize(
    "emitter",
    [
        QpskReceivedEmitter(),
        QpskReceivedEmitter(pulse="rrc"),
        QpskReceivedEmitter(pulse="rrc", bandwidth_hz=1e6, carrier_hz=-1.3e6),
        QpskReceivedEmitter(bandwidth_hz=3.7e6, clock_ppm=-20.0),
        QpskReceivedEmitter(bandwidth_hz=0.4e6),
    ],
    ids=["rectangular", "rrc", "narrow, off centre", "fast", "slow"],
)
def test_what_is_left_is_less_than_the_return(emitter, sir_db):
    frames, clean, _ = received(emitter, sir_db)
    method = create("qpsk_cancel", W)
    cleaned = method.process(frames)
    assert method.cancelled == 4
    assert np.median(left(cleaned, clean)) < 0.3
    assert np.mean(cleaned == 0) < 0.06
    assert method.outcome.suppression_db == pytest.approx(-sir_db, abs=3.0)
    assert method.active_share > 0.98


def test_tones_on_top_are_taken_away_first():
    tones = interference_frames([Interferer(ToneEmitter(3), -30.0)], 4, N, RATE_HZ, np.random.default_rng(17))
    frames, clean, _ = received(QpskReceivedEmitter(), -30.0)
    cleaned = create("qpsk_cancel", W).process((frames + tones).astype(np.complex64))
    # three parameters of each tone take QPSK along, which has 3.75 times its mean power per bin in its band
    assert left(cleaned, clean).max() < 0.5 + 3 * 3 * 1000 * 3.75 / N  # of 2,000


def test_echoes_belong_to_the_pulse():
    frames, clean, _ = received(ECHOES, -30.0, count=12, seed=7)
    assert np.mean(left(create("qpsk_cancel", W).process(frames), clean) < 0.3) >= 0.9


def test_a_burst_is_cancelled_and_the_rest_of_the_frame_stays():
    frames, clean, _ = received(QpskReceivedEmitter(), -30.0, count=4, seed=8, overlap=0.5)
    method = create("qpsk_cancel", W)
    cleaned = method.process(frames)
    assert method.cancelled == 4 and method.active_share == pytest.approx(0.5, abs=0.05)
    assert left(cleaned, clean).max() < 1.0
    quiet = np.abs(frames) < 5
    assert np.mean(cleaned[quiet] == 0) < 0.06


@pytest.mark.parametrize(
    ("emitter", "sir_db"),
    [
        (NrEmitter(channel_bandwidth_hz=10e6), -30.0),
        (NrEmitter(), -30.0),
        (ToneEmitter(3), -30.0),
        (FmcwEmitter(), -30.0),
        (QpskReceivedEmitter(evm=0.35), -30.0),
        (QpskReceivedEmitter(), 5.0),
        (QpskReceivedEmitter(), 200.0),
    ],
    ids=["nr10", "nr5", "tones", "fmcw", "EVM 35 %", "weak", "none"],
)
def test_frames_without_readable_qpsk_pass_bit_for_bit(emitter, sir_db):
    frames, _, _ = received(emitter, sir_db, count=6, seed=9)
    assert create("qpsk_cancel", W).process(frames).tobytes() == frames.tobytes()


def test_without_a_return_it_invents_none():
    frames, clean, _ = received(QpskReceivedEmitter(), -40.0, count=30, seed=11)
    alone = (frames - clean + np.sqrt(0.1) * white(np.random.default_rng(12), 30)).astype(np.complex64)
    assert ALTIMETER.process(create("qpsk_cancel", W).process(alone))["valid"].sum() <= 3


def test_level_changes_nothing_and_batches_change_nothing():
    frames, _, _ = received(QpskReceivedEmitter(pulse="rrc"), -30.0, count=5, seed=13)
    whole = create("qpsk_cancel", W).process(frames)
    method = create("qpsk_cancel", W)
    parts = np.concatenate([method.process(frames[:2]), method.process(frames[2:])])
    np.testing.assert_array_equal(parts, whole)
    for scale in (2.0**-30, 2.0**30):
        scaled = create("qpsk_cancel", W).process(frames * np.float32(scale)) / np.float32(scale)
        np.testing.assert_allclose(scaled, whole, atol=1e-3 * np.abs(whole).max())


def going_on(*windows, sir_db=-40.0, seed=21):
    """Frames of what goes on from frame to frame, ``windows`` of (emitter or None, samples), and the same without."""
    rng = np.random.default_rng(seed)
    parts = [emitter.samples(size, RATE_HZ, rng) if emitter else np.zeros(size) for emitter, size in windows]
    jam = np.concatenate(parts).reshape(-1, N)
    clean = returns(rng, len(jam))[1]
    return (clean + 10 ** (-sir_db / 20) * jam).astype(np.complex64), clean


@pytest.mark.parametrize("sir_db", [-15.0, -55.0])
@pytest.mark.parametrize(
    "emitter",
    [
        QpskReceivedEmitter(clock_ppm=20.0, carrier_hz=40e3),
        QpskReceivedEmitter(pulse="rrc", bandwidth_hz=1e6, carrier_hz=-1.3e6),
        QpskReceivedEmitter(pulse="rrc", bandwidth_hz=3.3e6, clock_ppm=-300.0),
        QpskReceivedEmitter(bandwidth_hz=RATE_HZ * 14 / 169),  # 14 symbols last 169 samples
        ECHOES,
    ],
    ids=["rectangular", "narrow, off centre", "fast, clock far off", "slow", "echoes"],
)
def test_an_emitter_that_goes_on_is_followed_and_no_more_is_left_than_of_one_frame(emitter, sir_db):
    frames, clean = going_on((emitter, 8 * N), sir_db=sir_db)
    method = create("qpsk_cancel", W)
    followed = left(method.process(frames), clean)
    assert method.cancelled == 8 and method.tracked == 7
    alone = []
    for frame in frames:
        method.reset()
        alone.append(method.process(frame))
    assert np.median(followed[1:]) < 1.1 * np.median(left(alone, clean)) + 0.01


PLAIN = QpskReceivedEmitter()


@pytest.mark.parametrize(
    ("later", "place"),
    [
        (PLAIN, 0),
        (PLAIN, N // 3),
        (QpskReceivedEmitter(bandwidth_hz=1.7e6), N // 2),
        (QpskReceivedEmitter(carrier_hz=90e3), N // 2),
        (QpskReceivedEmitter(pulse="rrc"), N // 2),
    ],
    ids=["jumps between frames", "jumps", "rate", "carrier", "pulse"],
)
def test_an_emitter_that_changes_is_read_again_in_the_next_frame(later, place):
    frames, clean = going_on((PLAIN, 4 * N + place), (later, 6 * N - place))
    method = create("qpsk_cancel", W)
    rest = left(method.process(frames), clean)
    changed = 4 + (place > 0)
    assert rest[:4].max() < 0.3 and rest[changed:].max() < 0.3
    assert method.tracked >= 3 + len(frames) - changed - 1


@pytest.mark.parametrize("sir_db", [-30.0, -50.0])
def test_bursts_that_frames_cut_are_cancelled_at_both_ends_of_a_frame(sir_db):
    windows = ((PLAIN, 1500), *((None, 4500), (PLAIN, 3000)) * 3, (None, 4500), (PLAIN, 1500))
    frames, clean = going_on(*windows, sir_db=sir_db)
    method = create("qpsk_cancel", W)
    assert left(method.process(frames), clean).max() < 0.6
    assert method.cancelled == 4


def test_a_frame_of_which_most_would_be_blanked_is_read_anew():
    # at -10 dB the points are hardly safe, so that runs of them are short
    frames, _, _ = received(QpskReceivedEmitter(pulse="rrc"), -10.0, count=40, seed=24)
    assert np.mean(create("qpsk_cancel", W).process(frames) == 0, axis=1).max() < 0.2


def test_an_emitter_that_ends_leaves_frames_as_they_were_and_is_found_when_it_begins_again():
    frames, clean = going_on((PLAIN, 3 * N + 2500), (None, 3 * N), (PLAIN, 4 * N - 2500))
    method = create("qpsk_cancel", W)
    cleaned = method.process(frames)
    rest = left(cleaned, clean)
    assert rest[:3].max() < 0.3 and rest[7:].max() < 0.3
    # its last 2,500 samples are a burst; so are its first 5,000
    assert rest[[3, 6]].max() < 1.0
    np.testing.assert_array_equal(cleaned[4:6], frames[4:6])


@pytest.mark.parametrize("sir_db", [-30.0, -40.0])
def test_tones_that_begin_later_are_taken_away_too(sir_db):
    frames, clean = going_on((PLAIN, 10 * N))
    tones = interference_frames([Interferer(ToneEmitter(2), sir_db)], 6, N, 7.5e6, np.random.default_rng(22))
    frames[4:] += tones.astype(np.complex64)
    method = create("qpsk_cancel", W)
    rest = left(method.process(frames), clean)
    assert method.cancelled == 10
    assert rest[:4].max() < 0.3 and np.median(rest[4:]) < 0.02 * 10 ** (-sir_db / 10)


def test_a_tone_in_the_place_of_the_emitter_is_no_data():
    time = np.arange(4 * N)
    frames, clean = going_on((PLAIN, 8 * N))
    frames[4:] = clean[4:] + 100 * np.exp(2j * np.pi * 1_200.0 / RATE_HZ * time).reshape(4, N)
    cleaned = create("qpsk_cancel", W).process(frames)
    assert left(cleaned[:4], clean[:4]).max() < 0.3
    np.testing.assert_array_equal(cleaned[4:], frames[4:])


def test_a_gap_in_the_stream_of_frames_costs_nothing():
    frames, clean = going_on((PLAIN, 12 * N))
    kept = [0, 1, 2, 6, 7, 11]  # what is between was dropped
    method = create("qpsk_cancel", W)
    assert left(method.process(frames[kept]), clean[kept]).max() < 0.3
    assert method.cancelled == 6 and method.tracked == 5


@pytest.mark.parametrize("factor", [0.5, 30.0, 1e-12, 1e12])
def test_a_level_of_its_own_may_come_next(factor):
    frames, _ = going_on((PLAIN, 4 * N))
    method = create("qpsk_cancel", W)
    before, later = method.process(frames[:2]), method.process(frames[2:] * np.float32(factor))
    assert method.cancelled == 4
    assert np.linalg.norm(later) / factor == pytest.approx(np.linalg.norm(before), rel=0.1)


@pytest.mark.parametrize("factor", [0.0, 1e-36, 1e30, 1e36])
def test_a_level_whose_squares_no_float32_holds_passes(factor):
    frames, _ = going_on((PLAIN, 4 * N))
    method = create("qpsk_cancel", W)
    method.process(frames[:2])
    loud = frames[2:] * np.float32(factor)
    np.testing.assert_array_equal(method.process(loud), loud)
