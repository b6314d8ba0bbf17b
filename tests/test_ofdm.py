"""Cancellation of OFDM: what is sent is read blindly, subtracted, and the return is left."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import signal

from radalt.core.interference import Interferer, QpskEmitter, ToneEmitter, interference_frames
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.multipath import FadedEmitter, FadingChannel
from radalt.core.interference.stream import JammerStream
from radalt.core.mitigation import MitigationError, create, ofdm_cancel
from radalt.core.mitigation.ofdm import demodulator
from radalt.core.mitigation.ofdm.acquisition import find_prefix
from radalt.core.mitigation.ofdm.burst import whole
from radalt.core.mitigation.ofdm.carrier import carrier_step, course, whole_subcarriers
from radalt.core.mitigation.ofdm.front_end import front_end
from radalt.core.mitigation.ofdm.lattice import CELL, decide, misread, nearest
from radalt.core.mitigation.ofdm.numerology import Numerology
from radalt.core.mitigation.ofdm.ridge import Ridge, expected_return
from radalt.core.mitigation.ofdm.tones import without_tones
from radalt.core.mitigation.ofdm.under_noise import mean_points
from radalt.core.mitigation.ofdm.upright import true_up, turned
from radalt.core.receiver.altimeter import Altimeter, AltimeterSettings
from radalt.core.returns.point import point_return
from radalt.core.waveform import Waveform
from radalt.studies.cancellation.cases import CASES, Case, received

W = Waveform()
ALTIMETER = Altimeter(W, AltimeterSettings())
NR10 = {"channel_bandwidth_hz": 10e6, "cell_id": 77, "frame_count": 2, "seed": 5}


def noise(count, rng):
    """(count, N) complex noise of unit power."""
    return rng.standard_normal((count, W.samples_per_frame, 2)).view(np.complex128)[..., 0] / np.sqrt(2)


def returns(count, seed, snr_db=10.0):
    """Altitudes, and frames of point targets with noise."""
    rng = np.random.default_rng([seed, 1])
    altitude_m = rng.uniform(3, 1500, count)
    frames = point_return(W, altitude_m, vertical_speed_m_per_s=rng.uniform(-10, 10, count))
    return altitude_m, frames + 10 ** (-snr_db / 20) * noise(count, rng)


def heard(emitter, count, sir_db, seed, overlap=1.0):
    """(count, N) interference of an emitter that starts anew with every frame."""
    rng = np.random.default_rng([seed, 2])
    return interference_frames(
        [Interferer(emitter, sir_db, overlap)], count, W.samples_per_frame, W.rate_hz, rng
    )


def right(frames, altitude_m):
    """Share of frames whose declared altitude is within 5 m."""
    result = ALTIMETER.detect(ALTIMETER.spectra(np.asarray(frames, dtype=np.complex64)))
    return np.mean(result["valid"] & (np.abs(result["altitude_m"] - altitude_m) < 5))


def single(frames):
    """Each frame behind a method that has heard nothing before."""
    return np.concatenate([create("ofdm_cancel", W).process(f[None].astype(np.complex64)) for f in frames])


@pytest.mark.parametrize(
    ("sir_db", "overlap", "options"),
    [
        (-30, 1.0, {}),
        (-55, 1.0, {}),
        (-45, 0.6, {}),
        (-18, 1.0, {"modulation": "qpsk"}),
        (-21, 1.0, {"modulation": "16qam"}),
        (-28, 1.0, {"modulation": "256qam"}),  # where a nearest point is any point
        (-50, 1.0, {"modulation": "256qam"}),
        (-45, 1.0, {"load": 0.3}),
        (-45, 1.0, {"carrier_hz": 1.234_567e6}),
        (-50, 1.0, {"channel_bandwidth_hz": 5e6, "cell_id": 3}),
        (-28, 1.0, {"modulation": "mixed"}),
        (-50, 1.0, {"modulation": "mixed"}),
        (-40, 1.0, {"slot_load": 0.5}),
    ],
)
def test_altitudes_are_right_under_a_carrier_that_fills_the_band(sir_db, overlap, options):
    altitude_m, frames = returns(12, 3)
    frames = frames + heard(NrEmitter(**{**NR10, **options}), 12, sir_db, 4, overlap)
    assert right(single(frames), altitude_m) >= 11 / 12
    if sir_db < -29:
        assert right(frames, altitude_m) < 0.5  # the case is hard without


@pytest.mark.parametrize(
    ("case", "seed"),
    [("nr10_mixed", 10), ("nr10_offset", 11), ("nr5", 3), ("nr10_part", 5), ("nr5_part", 2)],
)
def test_errors_are_a_few_times_those_without_interference(case, seed):
    """A point that was misread is no return, and beside the band there is nothing to be misread.

    A carrier that is whole subcarriers off turns its symbols at each long prefix. A symbol that a burst cuts tells
    nothing of the channel: to it, a carrier that begins looks like one that grows.
    """
    frames, altitude_m = received(CASES[case], -40.0, 24, np.random.default_rng([77, seed]))
    result = ALTIMETER.detect(ALTIMETER.spectra(single(frames)))
    assert result["valid"].all()
    assert np.sqrt(np.mean((result["altitude_m"] - altitude_m) ** 2)) < 4 * 0.032


@pytest.mark.parametrize("case", ["nr10_qpsk", "nr5", "nr10_load30"])
def test_a_return_that_is_seen_without_help_is_measured_better_with_it(case):
    """Neither in an element with QPSK nor in one with noise alone is a return of -15 dB taken for data."""
    frames, altitude_m = received(CASES[case], -15.0, 24, np.random.default_rng([78, 1]))
    before, after = (ALTIMETER.process(some)["altitude_m"] - altitude_m for some in (frames, single(frames)))
    assert np.sqrt(np.mean(after**2)) < 0.7 * np.sqrt(np.mean(before**2))


def read_on(frames, monkeypatch, most):
    """Frames behind a method that reads ``most`` frames on what one told of them; and how many it read so."""
    monkeypatch.setattr(ofdm_cancel, "_READ_ON", most)
    read, count = ofdm_cancel.read_on, []
    with monkeypatch.context() as patch:
        patch.setattr(ofdm_cancel, "read_on", lambda *a, **k: (count.append(read(*a, **k)), count[-1])[1])
        cleaned = create("ofdm_cancel", W).process(frames.astype(np.complex64))
    return cleaned, sum(one is not None for one in count)


@pytest.mark.parametrize(
    ("case", "sir_db"),
    [
        ("nr10_stream", -40.0),
        ("nr10_mixed_stream", -40.0),
        ("nr10_offset_stream", -40.0),
        ("nr10_stream", -27.5),  # where the return is wider than a cell
        ("nr10_stream_256qam", -30.0),
    ],
)
def test_what_a_frame_tells_of_the_next_ones_costs_no_accuracy(case, sir_db, monkeypatch):
    """The synchronisation signals of a half frame among them."""
    frames, altitude_m = received(CASES[case], sir_db, 24, np.random.default_rng(78))
    error_m = []
    for most, fewest in ((0, 0), (7, 15)):
        cleaned, count = read_on(frames, monkeypatch, most)
        assert fewest <= count <= 24 * most
        result = ALTIMETER.detect(ALTIMETER.spectra(cleaned))
        assert result["valid"].all()
        error_m.append(np.sqrt(np.mean((result["altitude_m"] - altitude_m) ** 2)))
    assert error_m[1] < 1.15 * error_m[0]


@pytest.mark.parametrize("modulation", ["64qam", "256qam"])
def test_beside_a_synchronisation_block_a_narrow_carrier_is_followed(modulation, monkeypatch):
    """The block takes 240 of the 300 subcarriers of 5 MHz: all others are silent around it, for half of a frame.

    Most symbols fit what was predicted, so nothing is found anew, and the channel stands still.
    """
    altitude_m, frames = returns(24, 9)
    emitter = NrEmitter(channel_bandwidth_hz=5e6, modulation=modulation)
    jammer = JammerStream(W, [Interferer(emitter, -45.0)], seed=1, free_running=True)
    frames = frames + np.stack([jammer.next_frame() for _ in range(24)])
    still = []
    fresh = ofdm_cancel.still
    monkeypatch.setattr(
        ofdm_cancel, "still", lambda *a: (still.append(a[0].received.channel.ndim), fresh(*a))[1]
    )
    method = create("ofdm_cancel", W)
    cleaned = method.process(frames.astype(np.complex64))
    assert method.found <= 2 and len(still) <= 6 and set(still) == {1}
    assert right(cleaned[1:], altitude_m[1:]) == 1.0


@pytest.mark.parametrize(("before_db", "after_db"), [(-28, -20), (-20, -28), (-18, -28), (-24, -44)])
def test_a_return_that_changes_by_much_is_measured_at_once(before_db, after_db):
    """Where it is wider than a cell it is told by its power, and that of the frame before would tell another one."""
    altitude_m, frames = returns(32, 9)
    jammer = JammerStream(W, [Interferer(NrEmitter(**NR10), 0.0)], seed=3, free_running=True)
    frames *= 10 ** (np.repeat([before_db, after_db], 16) / 20)[:, None]
    frames += np.stack([jammer.next_frame() for _ in range(32)])
    cleaned = create("ofdm_cancel", W).process(frames.astype(np.complex64))
    assert right(cleaned[1:], altitude_m[1:]) == 1.0


def test_a_return_wider_than_a_cell_is_told_beside_points_on_the_axes():
    """The synchronisation signals: of the lattice's points those beside theirs leave the return upside down."""
    rng = np.random.default_rng(7)
    points = rng.choice(np.arange(-7, 8, 2), (2, 13, 500)) * 42**-0.5
    points = (points[0] + 1j * points[1]).astype(np.complex64)
    points[2, 186:313] = rng.choice([1, -1, 1j, -1j], 127)
    ridge = np.zeros(points.shape, dtype=bool)
    for symbol in range(13):
        ridge[symbol, 20 + 72 * (symbol % 6) : 104 + 72 * (symbol % 6)] = True
    alone = 0.14 * np.exp(2j * np.pi * rng.random(points.shape)) * ridge
    received = SimpleNamespace(
        symbols=(points + alone + 0.007 * noise(13, rng)[:, :500]).astype(np.complex64),
        channel=np.ones(500, dtype=np.complex64),
        points=points * ~ridge,
        kinds=np.ones(points.shape, dtype=np.int8),
        few=np.broadcast_to(np.arange(13)[:, None] == 2, points.shape),
        capped=np.where(ridge, 0.6, 0.0).astype(np.float32),
        amplitudes=None,
        noise=5e-5,
    )
    kept, sir_db = expected_return(received, ridge, (~ridge).astype(np.float32))
    assert sir_db == pytest.approx(20 * np.log10(0.14) - 8.5, abs=1.0)
    told = np.zeros(points.shape, dtype=np.complex64)
    told[ridge] = kept
    there = ridge[2, 192:307].nonzero()[0] + 192
    error = np.mean(np.abs(told - alone)[2, there] ** 2)
    assert there.size > 50 and error < 0.01 * np.mean(np.abs(alone[2, there]) ** 2)


@pytest.mark.parametrize("change", ["turns", "fades", "echoes", "ends"])
def test_what_changes_is_read_anew(change, monkeypatch):
    """A path that appears between two frames, with nothing but what the frames before had told."""
    altitude_m, frames = returns(24, 9)
    emitters = [Interferer(NrEmitter(**NR10), -45.0, 1.0)]
    jammer = JammerStream(W, emitters, seed=3, free_running=True, total_sir_db=None)
    jam = np.stack([jammer.next_frame() for _ in range(24)])
    late = jam[12:]
    if change == "turns":
        late *= np.exp(0.4j)
    elif change == "fades":
        late *= 0.8
    elif change == "echoes":
        late += 0.5j * np.roll(late.ravel(), 9).reshape(late.shape)
    else:
        late[:] = 0
    cleaned, count = read_on(frames + jam, monkeypatch, 7)
    assert count > 8
    assert right(cleaned[1:], altitude_m[1:]) >= 21 / 23


def test_a_followed_clock_of_its_own_costs_no_accuracy(monkeypatch):
    """Two radios: the clock slips by a sample in 70 frames, and the receiver adds an image and a constant.

    What the clock loses in a frame is known after some, so that the next frames fit the prediction.
    """
    frames, altitude_m = received(CASES["nr10_radios"], -40.0, 40, np.random.default_rng([77, 12]))
    cleaned, count = read_on(frames, monkeypatch, 15)
    assert count > 30
    result = ALTIMETER.detect(ALTIMETER.spectra(cleaned))
    assert np.sqrt(np.mean((result["altitude_m"] - altitude_m) ** 2)) < 3 * 0.032


def test_a_return_about_as_large_as_a_cell_needs_no_frame_read_anew(monkeypatch):
    """In some frames it is larger than the cells of most users, in others not, as their alphabets have it."""
    frames, altitude_m = received(CASES["nr10_mixed_stream"], -32.0, 60, np.random.default_rng([77, 16]))
    cleaned, count = read_on(frames, monkeypatch, 31)
    assert count > 52
    result = ALTIMETER.detect(ALTIMETER.spectra(cleaned))
    assert np.sqrt(np.mean((result["altitude_m"] - altitude_m) ** 2)) < 3 * 0.032


def test_a_frame_with_one_symbol_of_a_half_slot_is_not_read_anew(monkeypatch):
    """Its elements are too few to tell the users' alphabets, and judged anew they are read no better."""
    frames, altitude_m = received(CASES["nr10_mixed_stream"], -28.0, 84, np.random.default_rng([6840032, 8]))
    cleaned, count = read_on(frames, monkeypatch, 63)
    assert count > 75
    assert right(cleaned, altitude_m) == 1


@pytest.mark.parametrize("case", ["nr10_burst", "nr10_idle"])
def test_a_short_burst_that_cannot_be_read_is_blanked(case):
    frames, altitude_m = received(CASES[case], -40.0, 24, np.random.default_rng([77, 13]))
    assert right(frames, altitude_m) < 0.2
    assert right(single(frames), altitude_m) > 0.95


def test_a_burst_is_blanked_where_it_leaves_enough_of_the_sweep():
    """A third of the sweep lost doubles the error; what is left of a burst's three symbols costs more."""
    frames, altitude_m = received(CASES["nr10_burst"], -20.0, 24, np.random.default_rng([880220, 3]))
    cleaned = single(frames)
    lost = cleaned == 0
    assert np.mean(lost, axis=1) == pytest.approx(0.3, abs=0.01)
    assert all(
        np.ptp(np.flatnonzero(row)) == np.count_nonzero(row) - 1 for row in lost
    )  # all of it, quiet samples too
    np.testing.assert_allclose(cleaned[~lost], frames[~lost], rtol=1e-5)
    result = ALTIMETER.detect(ALTIMETER.spectra(cleaned))
    assert np.sqrt(np.mean((result["altitude_m"] - altitude_m) ** 2)) < 3 * 0.03


def test_angle_and_slope_are_exact_where_one_side_alone_is_asked():
    numerology = Numerology(W.rate_hz, 15e3)
    late = np.array([0.015, -0.03])
    turned = np.exp(1j * (0.2 + late[:, None] * numerology.turn)).astype(np.complex64)
    turned[:, :100] = 0
    _, angles, slopes = true_up(turned, numerology)
    assert angles == pytest.approx(0.2, abs=1e-4)
    assert slopes == pytest.approx(late, rel=2e-3)


def test_a_receivers_image_and_constant_are_told_from_chance():
    rng = np.random.default_rng(31)
    sent, rest = (100 * noise(1, rng)[0]).astype(np.complex64), noise(1, rng)[0].astype(np.complex64)
    assert front_end(sent, rest) is None
    found = front_end(sent, rest + 0.004j * sent.conj() + 0.3)
    assert found.image == pytest.approx(0.004j, abs=5e-4)
    assert found.constant == pytest.approx(0.3, abs=0.05)
    assert np.abs(found.without(sent + 0.004j * sent.conj() + 0.3) - sent).mean() < 0.06


def under_noise(modulation, own_snr_db, sir_db, count, seed):
    """Frames and altitudes under a carrier with noise of its own."""
    case = Case("", {**NR10, "modulation": modulation}, own_snr_db=own_snr_db)
    return received(case, sir_db, count, np.random.default_rng(seed))


@pytest.mark.parametrize(("own_snr_db", "sir_db"), [(8.0, -29.0), (14.0, -30.0)])
def test_qpsk_is_taken_away_although_noise_hides_it(own_snr_db, sir_db):
    frames, altitude_m = under_noise("qpsk", own_snr_db, sir_db, 16, 44)
    assert right(frames, altitude_m) < 0.5
    assert right(single(frames), altitude_m) >= 14 / 16


@pytest.mark.parametrize(("modulation", "own_snr_db"), [("16qam", 8.0), ("64qam", 8.0), ("64qam", 12.0)])
def test_qam_that_noise_hides_is_not_taken_for_qpsk(modulation, own_snr_db):
    frames, _ = under_noise(modulation, own_snr_db, -28.0, 12, 45)
    np.testing.assert_array_equal(single(frames), frames)


@pytest.mark.parametrize("own_snr_db", [5.0, 12.0])
def test_mean_of_qpsk_is_that_of_its_points(own_snr_db):
    """By Bayes' rule, point by point."""
    rng = np.random.default_rng(46)
    spread = np.full(50, 10 ** (-own_snr_db / 10), dtype=np.float32)
    values = (noise(1, rng)[0, :50] + np.exp(0.25j * np.pi)).astype(np.complex64)[None]
    qpsk = np.exp(0.25j * np.pi * (1 + 2 * np.arange(4)))
    points = np.concatenate([[0], qpsk, np.sqrt(2) * qpsk])
    shares = np.array([0.2, 0.5, 0.3])
    prior = np.repeat(shares / [1, 4, 4], [1, 4, 4])
    weight = prior[:, None] * np.exp(-(np.abs(values - points[:, None]) ** 2) / spread)
    weight /= weight.sum(axis=0)
    mean, scatter, found = mean_points(values, spread, shares[:, None, None])
    np.testing.assert_allclose(mean[0], points @ weight, atol=1e-5)
    np.testing.assert_allclose(scatter[0], np.abs(points) ** 2 @ weight - np.abs(mean[0]) ** 2, atol=1e-5)
    np.testing.assert_allclose(found[0, 0], weight[0], atol=1e-5)


def test_symbols_turn_at_each_long_prefix():
    """A carrier 82 subcarriers off: evenly from symbol to symbol, and by the longer prefix once in seven."""
    index, passed = np.arange(13), (np.arange(13) + 3) // 7
    angles = 4 * 2 * np.pi * 82 / 500 * (index * (500 + 36 - 2 / 7) + passed * 3.90625)
    found = course(np.exp(1j * angles), passed)
    assert np.abs(np.angle(np.exp(1j * (found - angles)))).max() < 1e-3


@pytest.mark.parametrize("shift", [0.0, -14.0, 5 / 3])
@pytest.mark.parametrize("first_long", [-40.0, 1100.5])
def test_how_symbols_turn_tells_whole_subcarriers(shift, first_long):
    """What is left is the carrier's rest; one symbol has its points on the axes, and one says nothing."""
    numerology = Numerology(W.rate_hz, 15e3)
    _, starts = numerology.windows(numerology.times(first_long, 7500), 7500)
    times = numerology.times_at(starts, first_long)
    turns = 2 * np.pi / 500 * times
    angles = 0.2 + (shift + 0.004) * turns + 0.01 * np.random.default_rng(1).standard_normal(len(times))
    angles[4] += np.pi / 4
    weight = np.ones(len(times))
    weight[2] = 0
    found, left = whole_subcarriers(angles + np.pi / 2 * np.arange(len(times)), weight, times, numerology)
    assert found == pytest.approx(shift)
    if shift:
        weight[4] = 0
        assert carrier_step(left, weight, numerology) == pytest.approx(0.004, abs=5e-4)


def test_turns_without_order_tell_nothing():
    numerology = Numerology(W.rate_hz, 15e3)
    times = numerology.times(0.0, 7500)
    angles = np.random.default_rng(2).uniform(0, np.pi / 2, len(times))
    found, left = whole_subcarriers(angles, np.ones(len(times)), times, numerology)
    assert found == 0 and left is angles


@pytest.mark.parametrize("sir_db", [-15.0, -45.0])
def test_tones_on_top_are_taken_away_first(sir_db):
    """Their power is in a few of 7,500 bins, so they stand out of a carrier of the same power by 30 dB."""
    altitude_m, frames = returns(12, 21)
    tones = heard(ToneEmitter(3), 12, sir_db, 22)
    frames = frames + tones + heard(NrEmitter(**NR10), 12, sir_db, 23)
    assert right(single(frames), altitude_m) >= 11 / 12


def test_of_tones_three_parameters_each_stay():
    """Least squares takes as much noise along as it has parameters: amplitude, phase and frequency of each tone."""
    wide = noise(1, np.random.default_rng(24))[0]
    at = np.array([-3001.3, -3000.0, 12.5, 2222.22])[:, None] * np.arange(W.samples_per_frame)
    tones = np.exp(2j * np.pi * at / W.samples_per_frame).sum(axis=0)
    left = without_tones((tones + wide).astype(np.complex64)) - wide
    assert np.vdot(left, left).real < 2 * 1.5 * len(at)  # of 7,500 of noise
    assert without_tones(wide.astype(np.complex64)) is None
    assert without_tones(heard(NrEmitter(**NR10, load=0.3), 1, -30, 25)[0].astype(np.complex64)) is None


@pytest.mark.parametrize(
    "emitter",
    [
        None,
        QpskEmitter(),
        QpskEmitter(pulse="rrc"),
        QpskEmitter(bandwidth_hz=6e6, pulse="rrc"),
        ToneEmitter(1),
    ],
)
def test_frames_without_ofdm_pass_bit_for_bit(emitter):
    _, frames = returns(20, 5)
    if emitter is not None:
        frames = frames + heard(emitter, 20, -30, 6, 0.5)
    frames = frames.astype(np.complex64)
    np.testing.assert_array_equal(single(frames), frames)
    alone = noise(20, np.random.default_rng(7)).astype(np.complex64)
    np.testing.assert_array_equal(single(alone), alone)


@pytest.mark.parametrize("beyond_m", [0.0, 1500.0])
@pytest.mark.parametrize("snr_db", [0.0, 10.0, 20.0, 40.0])
def test_a_sweep_is_not_taken_for_ofdm(snr_db, beyond_m):
    """A linear sweep meets itself one symbol later as a tone, and stands over the scatter where there is no noise."""
    altitude_m = beyond_m + np.linspace(20, 1480, 8)
    rng = np.random.default_rng(12)
    frames = point_return(W, altitude_m) + 10 ** (-snr_db / 20) * noise(8, rng)
    ground = point_return(W, 300 + rng.exponential(40, 60), phase_cycles=rng.random(60)) * rng.rayleigh(
        1, (60, 1)
    )
    frames = np.vstack([frames, ground.sum(axis=0) / 8 + 10 ** (-snr_db / 20) * noise(1, rng)]).astype(
        np.complex64
    )
    assert create("ofdm_cancel", W).process(frames).tobytes() == frames.tobytes()


@pytest.mark.parametrize("inr_db", [20, 40, 60])
def test_nothing_is_invented_where_there_is_no_return(inr_db):
    rng = np.random.default_rng([8, inr_db])
    frames = noise(30, rng) + heard(NrEmitter(**NR10), 30, -inr_db, 9)
    result = ALTIMETER.detect(ALTIMETER.spectra(single(frames)))
    # design bound 1.55 % of frames: 4 of 30 or more have a chance of 1 in 800
    assert np.count_nonzero(result["valid"]) <= 3


def continuing(count, sir_db, stream_seed, **options):
    """(count, N) of a base station that does not start anew every millisecond."""
    stream = JammerStream(
        W, [Interferer(NrEmitter(**{**NR10, **options}), sir_db)], seed=stream_seed, free_running=True
    )
    return np.stack([stream.next_frame() for _ in range(count)])


def test_a_transmission_that_goes_on_is_found_once_and_followed():
    altitude_m, frames = returns(30, 10)
    frames = (frames + continuing(30, -45.0, 11, carrier_hz=7003.0)).astype(np.complex64)
    frames = frames[1:]  # the stream begins within the first
    method = create("ofdm_cancel", W)
    cleaned = method.process(frames)
    assert right(cleaned, altitude_m[1:]) == 1.0
    # a slot that is mostly synchronisation block may be looked for anew
    assert method.found <= 2 and method.found + method.followed == 29
    assert method.status()["followed"] == method.followed


def test_a_clock_of_its_own_is_followed():
    # two radios: 2 ppm, 3.1 kHz, DC, IQ imbalance, 12 bits
    frames, altitude_m = received(CASES["nr10_radios"], -45.0, 30, np.random.default_rng(30))
    method = create("ofdm_cancel", W)
    assert right(method.process(frames), altitude_m) >= 0.95
    assert method.found <= 3 and method.found + method.followed == 30


@pytest.mark.parametrize(
    ("case", "fewest", "most"), [("nr10_stream", 0, 1), ("nr10_eva", 0, 1), ("nr10_eva_moving", 16, 16)]
)
def test_a_channel_is_found_to_stand_still(case, fewest, most, monkeypatch):
    """In frames each looked at alone: decisions a quarter turn off, or delays, look like one that moves."""
    frames, _ = received(CASES[case], -45.0, 48, np.random.default_rng([6760003, 8]))
    moving = []
    fresh = ofdm_cancel.still
    monkeypatch.setattr(
        ofdm_cancel, "still", lambda *a: (moving.append(a[0].received.channel.ndim > 1), fresh(*a))[1]
    )
    single(frames[:16])
    assert len(moving) == 16 and fewest <= sum(moving) <= most


@pytest.mark.parametrize("sir_db", [-7.0, -7.5, -8.0])
def test_noise_beside_the_band_of_a_burst_is_not_what_it_sends(sir_db):
    """Where the emitter is silent there, noise over a channel that is noise as well is near some point."""
    altitude_m, frames = returns(40, 40)
    jam = heard(NrEmitter(channel_bandwidth_hz=5e6, cell_id=321, frame_count=2, seed=99), 40, sir_db, 41, 0.3)
    cleaned = single(frames + jam)
    assert right(frames + jam, altitude_m) == 1
    assert right(cleaned, altitude_m) == 1


def test_a_silent_symbol_of_another_signal_is_not_read_as_silence():
    _, frames = returns(4, 32)
    jam = continuing(4, -40.0, 33)
    jam[2:] = heard(ToneEmitter(3), 2, -30, 24, 0.5)
    frames = (frames + jam).astype(np.complex64)
    cleaned = create("ofdm_cancel", W).process(frames)
    np.testing.assert_array_equal(cleaned[2:], frames[2:])


@pytest.mark.parametrize("profile", ["PA", "RA4"])
def test_four_paths_at_30_km_per_hour(profile):
    altitude_m, frames = returns(16, 34)
    channel = FadingChannel(profile=profile, doppler_hz=120.0)
    frames = frames + heard(FadedEmitter(emitter=NrEmitter(**NR10), channel=channel), 16, -45, 35)
    assert right(frames, altitude_m) < 0.3
    assert right(single(frames), altitude_m) >= 14 / 16


def test_a_stream_cut_anywhere_gives_the_same_frames():
    _, frames = returns(9, 12)
    frames = (frames + continuing(9, -35.0, 13)).astype(np.complex64)
    whole = create("ofdm_cancel", W).process(frames)
    method = create("ofdm_cancel", W)
    parts = np.concatenate([method.process(part) for part in (frames[:1], frames[1:4], frames[4:])])
    np.testing.assert_array_equal(parts, whole)


def test_what_cannot_be_read_is_looked_for_less_often_and_found_when_it_can():
    hidden, _ = received(CASES["nr10_noise5"], -40.0, 20, np.random.default_rng(7))
    seen, _ = received(CASES["nr10_stream"], -40.0, 8, np.random.default_rng(8))
    method, looks = create("ofdm_cancel", W), []
    find = method._find
    method._find = lambda frame: looks.append(1) or find(frame)
    np.testing.assert_array_equal(method.process(hidden), hidden)
    assert 8 <= len(looks) <= 10
    assert (method.process(seen) != seen).any(axis=1)[-1] and method.found == 1


def test_what_noise_hides_is_given_up_in_the_first_turn(monkeypatch):
    hidden, _ = received(CASES["nr10_noise10"], -40.0, 4, np.random.default_rng(991203))
    monkeypatch.delattr(demodulator, "true_up")  # which ends a turn, and would fail
    np.testing.assert_array_equal(create("ofdm_cancel", W).process(hidden), hidden)


def test_a_carrier_is_found_so_well_that_no_symbols_are_read_again(monkeypatch):
    frames, _ = received(CASES["nr10_stream"], -45.0, 10, np.random.default_rng(991204))
    again, readings = ofdm_cancel.once_more, []
    monkeypatch.setattr(ofdm_cancel, "once_more", lambda *a, **k: readings.append(1) or again(*a, **k))
    for frame in frames:
        create("ofdm_cancel", W).process(frame)
    assert not readings


@pytest.mark.parametrize(("seed", "count", "first"), [(6790002, 52, 20), (6790023, 120, 60)])
def test_a_channel_that_stands_still_is_not_taken_for_one_that_moves(seed, count, first, monkeypatch):
    """Of 20 frames, all the data that the stream has, one seemed to, and was read ten times."""
    frames, _ = received(CASES["nr10_stream"], -45.0, count, np.random.default_rng([seed, 8]))
    rested, moving = ofdm_cancel.at_rest, []

    def at_rest(frame):
        frame = rested(frame)
        moving.append(frame.received.channel.ndim > 1)
        return frame

    monkeypatch.setattr(ofdm_cancel, "at_rest", at_rest)
    for frame in frames[first : first + 20]:
        create("ofdm_cancel", W).process(frame)
    assert len(moving) == 20 and not any(moving)


@pytest.mark.parametrize("tail", [12, 25])
def test_a_quarter_turn_of_the_channel_is_bridged_as_far_as_it_goes(tail):
    rng = np.random.default_rng(991205)
    sent = nearest((rng.standard_normal((13, 500, 2)) @ [0.7, 0.7j]).astype(np.complex64), 64)
    turn = np.interp(np.arange(500), [250, 258, 258 + tail], [0, 0.75, 1])  # fast at first
    channel = np.exp(0.5j * np.pi * turn).astype(np.complex64)
    every = np.ones(sent.shape, dtype=bool)
    found = decide(sent / channel, every, np.repeat([0, 1], [7, 6]))
    mended = demodulator.bridged(channel, found.capped, every)
    # the points of QAM leave quarter turns open
    assert np.abs(mended**4 - 1).max() < 0.1


def test_another_emitter_is_found_when_the_first_has_gone():
    altitude_m, frames = returns(12, 14)
    jam = np.concatenate([continuing(6, -40.0, 15), continuing(6, -40.0, 16, cell_id=300, seed=9)])
    method = create("ofdm_cancel", W)
    cleaned = method.process((frames + jam).astype(np.complex64))
    good = np.delete(np.arange(12), [0, 6])  # streams begin within a frame
    assert right(cleaned[good], altitude_m[good]) == 1.0
    assert method.found >= 2 and method.found + method.followed >= 10


def test_a_clean_frame_ends_the_following():
    _, frames = returns(6, 17)
    jam = continuing(6, -40.0, 18)
    jam[3:] = 0
    frames = (frames + jam).astype(np.complex64)
    cleaned = create("ofdm_cancel", W).process(frames)
    np.testing.assert_array_equal(cleaned[3:], frames[3:])


def wide_spacing(rng, symbols=64):
    """OFDM of 30 kHz at 7.5 MS/s, one payload: prefixes of TS 38.211 clause 5.3.1 at 30.72 MS/s, resampled."""
    parts = []
    for number in range(symbols):
        spectrum = np.zeros(1024, dtype=complex)
        points = rng.integers(0, 4, 300)
        spectrum[np.r_[1:151, 874:1024]] = np.exp(0.25j * np.pi * (1 + 2 * points))
        useful = np.fft.ifft(spectrum) * 32
        prefix = 88 if number % 14 == 0 else 72
        parts.append(np.concatenate([useful[-prefix:], useful]))
    return signal.resample_poly(np.concatenate(parts), 125, 512)


def test_the_spacing_is_found_by_itself():
    rng = np.random.default_rng(19)
    altitude_m, frames = returns(6, 20)
    stream = wide_spacing(rng, 28 * 3)
    for number in range(6):
        first = 400 + 1711 * number
        part = stream[first : first + W.samples_per_frame]
        frames[number] += part / np.sqrt(np.mean(np.abs(part) ** 2)) * 10**2
    assert right(frames, altitude_m) < 0.5
    assert right(single(frames), altitude_m) >= 5 / 6


def test_symbols_fill_their_cycles():
    for spacing_hz in (15e3, 30e3):
        numerology = Numerology(7.5e6, spacing_hz)
        length = numerology.per_cycle * (numerology.useful + numerology.prefix) + numerology.longer
        assert length == pytest.approx(7.5e6 * 0.5e-3)
        times = numerology.times(100.0, 7500)
        held, starts = numerology.windows(times, 7500)
        assert len(starts) in (2 * numerology.per_cycle - 1, 2 * numerology.per_cycle)
        assert np.abs(starts - times[held]).max() <= numerology.prefix / 3 + 1


@pytest.mark.parametrize("points", [16, 64, 256])
def test_nearest_point_and_mean_error_of_a_cell(points):
    rng = np.random.default_rng(points)
    side = np.arange(-np.sqrt(points) + 1, np.sqrt(points), 2) * np.sqrt(1.5 / (points - 1))
    lattice = (side[:, None] + 1j * side).ravel()
    assert np.mean(np.abs(lattice) ** 2) == pytest.approx(1)
    values = (rng.uniform(-1.5, 1.5, 500) + 1j * rng.uniform(-1.5, 1.5, 500)).astype(np.complex64)
    brute = lattice[np.abs(values[:, None] - lattice).argmin(axis=1)]
    np.testing.assert_allclose(nearest(values, points), brute, atol=1e-5)
    # whole cells, up to the outermost points' own
    reach = side[-2] + (side[-1] - side[-2]) / 2
    inner = rng.uniform(-reach, reach, 20_000) + 1j * rng.uniform(-reach, reach, 20_000)
    inner = inner.astype(np.complex64)
    assert np.mean(np.abs(inner - nearest(inner, points)) ** 2) == pytest.approx(CELL[points], rel=0.05)


def test_the_prefix_tells_time_and_carrier():
    emitter = NrEmitter(**NR10, carrier_hz=2_000.0)
    numerology = Numerology(W.rate_hz, 15e3)
    frame = heard(emitter, 1, -30, 21)[0].astype(np.complex64)
    found = find_prefix(frame, numerology)
    assert found.contrast > 8
    assert found.carrier == pytest.approx(2_000 / 15e3, abs=5e-3)
    later = find_prefix(np.roll(frame, 100), numerology)
    assert (later.middle - found.middle - 100 + 30) % numerology.spacing == pytest.approx(30, abs=3)


@pytest.mark.parametrize(("first", "last", "cut"), [(0, 7500, []), (1000, 4900, [1, 8]), (1303, 7500, [])])
def test_symbols_that_a_burst_cuts_are_known(first, last, cut):
    numerology = Numerology(W.rate_hz, 15e3)
    starts = 232 + (535.7 * np.arange(13)).astype(int)
    rng = np.random.default_rng(4)
    frame = (0.01 * noise(1, rng)[0]).astype(np.complex64)
    frame[first:last] += noise(1, rng)[0, first:last]
    own = np.mean(np.abs(frame[starts[:, None] + np.arange(500)]) ** 2, axis=1)
    assert np.flatnonzero(~whole(frame, own, starts, numerology)).tolist() == cut


@pytest.mark.parametrize("ahead", [-np.pi / 4, -0.5, 0.3])
def test_a_symbol_is_set_upright_by_its_points_where_the_channel_is_wrong_in_its_middle(ahead):
    """The channel in the middle, known from two symbols alone, has made half the turn; QPSK is read all the same."""
    rng = np.random.default_rng(11)
    numerology = Numerology(W.rate_hz, 15e3)
    sent = nearest((rng.standard_normal((13, 500, 2)) @ [0.7, 0.7j]).astype(np.complex64), 64)
    sent[:, 200:300] = 0
    sent[4:6, 200:300] = nearest((rng.standard_normal((2, 100, 2)) @ [1, 1j]).astype(np.complex64), 4)
    channel = np.ones(500, dtype=np.complex64)
    symbols = sent.copy()
    symbols[4:6] *= np.exp(1j * ahead)
    every, halves = np.ones(sent.shape, dtype=bool), np.repeat([0, 1], [7, 6])
    found = decide(symbols, every, halves)
    off = misread(found.capped, every, channel)
    odd, back = turned(symbols, channel, off, every, halves, found.kinds)
    assert odd.tolist() == [4, 5]
    assert np.abs(back[4:6] * np.exp(1j * ahead) - 1).max() < 0.06
    # nothing of it is taken back by a channel that is not yet right
    agreement = symbols * back * sent.conj()
    agreement[4:6, 200:300] *= np.exp(0.4j)
    assert np.abs(true_up(agreement, numerology, upright=odd)[1][odd]).max() == 0


@pytest.mark.parametrize("drift", [0.0, 6e-4])
def test_delays_of_symbols_are_told_by_all_of_them_where_a_clock_drifts_evenly(drift):
    """Of 13 symbols' own delays two unknowns are left: 2/13 of the noise's power."""
    rng = np.random.default_rng(12)
    numerology = Numerology(W.rate_hz, 15e3)
    late = 0.01 + drift * np.arange(13)
    turn = np.exp(-1j * late[:, None] * numerology.turn)
    wrong = {True: [], False: []}
    for _ in range(40):
        agreement = turn + 0.3 * noise(13, rng)[:, :500]
        for evenly, errors in wrong.items():
            found = true_up(agreement.astype(np.complex64), numerology, evenly=evenly)[2]
            errors.append(np.mean((found + late) ** 2))
    assert np.mean(wrong[True]) == pytest.approx(2 / 13 * np.mean(wrong[False]), rel=0.4)


def test_a_symbol_of_whose_elements_hardly_any_is_trusted_stays_as_it_is():
    numerology = Numerology(W.rate_hz, 15e3)
    agreement = np.ones((13, 500), dtype=np.complex64)
    agreement[0] = 0
    agreement[0, 497:] = np.exp(0.6j)  # which may all be wrong
    factor, angles, slopes = true_up(agreement, numerology)
    assert np.abs(angles).max() < 1e-6 and np.abs(slopes).max() < 1e-6
    assert np.abs(factor - 1).max() < 1e-6


def test_where_one_alphabet_explains_nearly_all_another_is_found_in_the_rest():
    rng = np.random.default_rng(13)
    random = (rng.standard_normal((13, 500, 2)) @ [0.7, 0.7j]).astype(np.complex64)
    sent = nearest(random, 64)
    sent[7:, 240:276] = nearest(random[7:, 240:276], 256)
    every, halves = np.ones(sent.shape, dtype=bool), np.repeat([0, 1], [7, 6])
    found = decide(sent, every, halves, likely=(1, np.ones(500, dtype=bool)))
    assert np.count_nonzero(np.abs(found.points - sent) > 1e-3) < 0.001 * sent.size
    assert (found.kinds[1, 242:274] == 2).all() and (found.kinds[0] == 1).all()


def test_returns_of_all_altitudes_lie_in_the_ridge():
    numerology = Numerology(W.rate_hz, 15e3)
    starts = np.array([17, 2600, 3600, 6900])
    clear = Ridge(W, numerology, 1500.0).clear(starts, 0.0)
    assert 0.75 < clear.mean() < 0.86
    for altitude_m in (0.0, 400.0, 1500.0):
        frame = point_return(W, np.array([altitude_m]))[0]
        for start, outside in zip(starts, clear, strict=True):
            spectrum = np.abs(np.fft.fftshift(np.fft.fft(frame[start : start + numerology.useful]))) ** 2
            assert spectrum[outside].sum() < 0.03 * spectrum.sum()


def test_what_does_not_fit_is_one_line():
    with pytest.raises(MitigationError, match="rate_hz is 5e\\+06; it has to be a multiple of 30000"):
        create("ofdm_cancel", Waveform(bandwidth_hz=4e6, rate_hz=5e6))
    with pytest.raises(MitigationError, match="ofdm_cancel.span_m is -1.0; it has to be a finite number"):
        create("ofdm_cancel", W, span_m=-1.0)
    with pytest.raises(MitigationError, match="a frame shorter than 0.3e-3 holds too few symbols"):
        create("ofdm_cancel", Waveform(sweep_s=0.2e-3))
