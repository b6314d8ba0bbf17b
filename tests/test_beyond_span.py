"""Ground beyond the span of altitudes: no method makes a low altitude of it, whatever its height, speed and SNR."""

import runpy

import numpy as np
import pytest
from frames import ALTIMETER, W, noise, white

from radalt import Altimeter, AltimeterSettings, AltitudeTracker, Waveform
from radalt.core.altimeter.altimeter import Reason
from radalt.core.altimeter.beyond_span import BeyondSpan
from radalt.core.interference import Interferer, QpskEmitter, interference_frames
from radalt.core.mitigation import create
from radalt.core.returns.point import point_return
from radalt.core.scene import parse_scene
from radalt.core.tracker.tracker import Status
from radalt.evaluation.flowgraph.generate import prepare
from radalt.evaluation.flowgraph.run import run_point
from radalt.evaluation.simulation import run_chain

FAST = Altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=150.0))


def flown(rng: np.random.Generator, count: int, low_m: float, high_m: float, snr_db: float | None):
    """Altitudes (n,) in metres, frames (n, N) of noise and, with an SNR, a return at up to 150 m/s either way."""
    altitudes = rng.uniform(low_m, high_m, count)
    frames = noise(rng, count, 0.0)
    if snr_db is not None:
        speeds = rng.uniform(-150, 150, count)
        returns = point_return(W, altitudes, vertical_speed_m_per_s=speeds, phase_cycles=rng.random(count))
        frames += np.float32(10 ** (snr_db / 20)) * returns
    return altitudes, frames


# a network's filterbank at its worst: one sample in thirty of the dechirped frame, held
FOLDS = """import numpy as np
def mitigate(frames, waveform):
    beats = (frames * waveform.reference.conj())[:, ::30]
    return np.repeat(beats, 30, axis=1) * waveform.reference
"""


@pytest.fixture
def folds(tmp_path):
    (tmp_path / "folds.py").write_text(FOLDS)
    return str(tmp_path / "folds.py")


@pytest.mark.parametrize("snr_db", [30.0, 10.0, 0.0, -10.0])
def test_it_is_seen_at_any_height_and_speed_and_ground_within_the_span_is_not_taken_for_it(snr_db):
    rng = np.random.default_rng([1, int(snr_db + 100)])
    beyond = BeyondSpan(W, 1500.0)
    top_m = W.max_unambiguous_altitude_m
    for low_m, high_m in ((1545.0, 4000.0), (4000.0, top_m)):
        assert beyond(flown(rng, 60, low_m, high_m, snr_db)[1]).all()
    assert not beyond(flown(rng, 100, 0.0, 1500.0, snr_db)[1]).any()


def test_a_beat_as_wide_as_the_sweep_is_no_return():
    """Above the bandwidth's rate such a beat has a cell; its return would leave nothing of the half sweep."""
    w = Waveform(bandwidth_hz=1e6, sweep_s=10e-3, rate_hz=2e6)
    at = np.exp(-2j * np.pi * w.bandwidth_hz * np.arange(w.samples_per_half) / w.rate_hz)
    frame = w.reference * np.concatenate([at, at.conj()])
    received = frame + 1.4 * white(np.random.default_rng(3), 1, frame.size)
    assert not BeyondSpan(w, 1500.0)(received.astype(np.complex64)).any()


@pytest.mark.parametrize("name", ["tcae", "whitening", "blanking", "custom"])
def test_no_method_makes_an_altitude_of_it(name, folds):
    """At 2,600 to 3,100 m the shipped network shows 103 to 603 m; declared at most as often as noise alone is."""
    method = create(name, W, **{"file": folds} if name == "custom" else {})
    if name == "custom":
        mitigate = runpy.run_path(folds)["mitigate"]
        alone = FAST.process(mitigate(flown(np.random.default_rng(2), 40, 2600, 3100, 30.0)[1], W))
        assert alone["valid"].mean() > 0.5
    rng, declared = np.random.default_rng(3), []
    for snr_db in (30.0, 10.0, 0.0, -10.0):
        for low_m, high_m in ((1500.0 + 12.0, 3200.0), (3200.0, W.max_unambiguous_altitude_m)):
            _, frames = flown(rng, 30, low_m, high_m, snr_db)
            declared.extend(FAST.process(method.process(frames))["valid"])
    assert sum(declared) <= len(declared) * FAST.false_alarms_per_frame + 2


def test_the_users_own_method_and_a_process_of_its_own_have_the_test_too(folds):
    _, frames = flown(np.random.default_rng(4), 12, 2600.0, 3100.0, 10.0)
    for options in ({}, {"own_process": True}):
        method = create("custom", W, file=folds, **options)
        np.testing.assert_array_equal(method.process(frames), frames)
        out = np.empty_like(frames)
        method.process_into(frames, out)
        np.testing.assert_array_equal(out, frames)
        assert method.status()["beyond_frames"] == 24 == method.status()["frames"]


def test_the_span_is_the_altimeters_and_frames_between_keep_their_order():
    _, frames = flown(np.random.default_rng(5), 6, 2000.0, 2100.0, 10.0)
    near = flown(np.random.default_rng(6), 6, 100.0, 1400.0, 10.0)[1]
    mixed = np.stack([frames, near], axis=1).reshape(12, -1)
    cleaned = create("whitening", W).process(mixed)
    np.testing.assert_array_equal(cleaned[::2], frames)
    np.testing.assert_array_equal(cleaned[1::2], create("whitening", W).process(near))
    wide = create("whitening", W, max_altitude_m=2500.0)
    assert wide.status()["beyond_frames"] == 0 and (wide.process(frames) != frames).any(axis=1).all()


def test_right_frames_under_interference_are_not_refused():
    """Interference shows lines nowhere; one frame in a hundred may show one by chance."""
    rng = np.random.default_rng(7)
    beyond, taken = BeyondSpan(W, 1500.0), 0
    for overlap in (0.1, 0.6, 1.0):
        for sir_db in (-10.0, -30.0):
            _, frames = flown(rng, 60, 3.0, 1400.0, 10.0)
            parts = [Interferer(QpskEmitter(), sir_db, overlap)]
            frames += interference_frames(parts, 60, W.samples_per_frame, W.rate_hz, rng)
            taken += int(beyond(frames).sum())
    assert taken <= 4


def stream(rng: np.random.Generator, high_m: float, low_m: float | None, weaker_db: float, count: int = 400):
    """Frames of two sinking returns in noise 10 dB below the higher one, 40 at a time."""
    for first in range(0, count, 40):
        sunk = 5e-3 * np.arange(first, first + 40)
        frames = point_return(W, high_m - sunk, vertical_speed_m_per_s=-5.0)
        if low_m is not None:
            low = point_return(W, low_m - sunk, vertical_speed_m_per_s=-5.0, phase_cycles=rng.random())
            frames = frames + np.float32(10.0 ** (-weaker_db / 20.0)) * low
        yield frames + noise(rng, 40, 10.0)


@pytest.mark.parametrize("altitude_m", [2600.0, 2800.0])
def test_the_tracker_gives_no_altitude_of_it(altitude_m):
    method, tracker = create("tcae", W), AltitudeTracker(ALTIMETER)
    statuses = []
    for frames in stream(np.random.default_rng(8), altitude_m, None, 0.0):
        spectra = (ALTIMETER.spectra(x) for x in (method.process(frames), frames))
        statuses.extend(tracker.process(next(spectra), received=next(spectra))["status"].tolist())
    assert len(statuses) == 10 and Status.NORMAL not in statuses


@pytest.mark.parametrize("high_m", [1560.0, 2600.0, 20_000.0])
@pytest.mark.parametrize("weaker_db", [1.0, 8.0, 20.0])
def test_what_lies_within_the_span_is_not_the_ground_while_ground_beyond_it_is_stronger(high_m, weaker_db):
    """A weak echo at 300 m, from the start: a bird, a radar, a second bounce. The altimeter's reason says so."""
    tracker, rng = AltitudeTracker(ALTIMETER), np.random.default_rng([9, int(high_m), int(weaker_db)])
    for frames in stream(rng, high_m, 300.0, weaker_db, 200):
        spectra = ALTIMETER.spectra(frames)
        found = ALTIMETER.detect(spectra)
        assert not found["valid"].any()
        assert set(found["reason"]) <= {Reason.OUT_OF_RANGE, Reason.NO_DETECTION, Reason.AMBIGUOUS}
        assert Status.NORMAL not in tracker.process(spectra)["status"]


def test_a_line_beyond_the_span_ten_decibels_below_the_ground_takes_no_altitude():
    tracker, rng = AltitudeTracker(ALTIMETER), np.random.default_rng(10)
    outputs = [tracker.process(ALTIMETER.spectra(frames)) for frames in stream(rng, 2600.0, 300.0, -10.0)]
    outputs = np.concatenate(outputs)[2:]
    assert np.all(outputs["status"] == Status.NORMAL) and np.all(np.abs(outputs["altitude_m"] - 300.0) < 3.0)


@pytest.mark.parametrize("least", [1.0, 0.1])
def test_a_line_beyond_the_span_has_the_energy_by_which_a_cleaned_frame_is_searched_for_it(least):
    rng = np.random.default_rng([11, int(10 * least)])
    for snr_db in (60.0, 20.0, 10.0, 0.0):
        frames = flown(rng, 100, 1545.0, W.max_unambiguous_altitude_m, snr_db)[1]
        low = point_return(W, rng.uniform(0.0, 1500.0, 100), phase_cycles=rng.random(100))
        power = 10.0 ** ((snr_db + rng.uniform(-1.0, 2.0, (100, 1))) / 10.0) / least
        frames += np.sqrt(power).astype(np.float32) * low
        there = BeyondSpan(W, 1500.0).ratio(frames) >= least
        given = ALTIMETER.beyond(ALTIMETER.spectra(frames), np.arange(100), least)
        assert 10 < there.sum() < 90 and (given[there] >= least).all()


def test_a_received_frame_is_examined_once_however_many_methods_there_are(monkeypatch, tmp_path):
    """Directly, and in a flowgraph; altimeters do not examine it again."""
    scene = parse_scene({"altitude": {"programme_m": [300.0], "frames": 20}, "channel": {"snr_db": 20.0}})
    examined, real, methods = [], BeyondSpan.ratio, ("none", "whitening", "blanking", "lms")
    monkeypatch.setattr(BeyondSpan, "ratio", lambda self, f: examined.append(len(f)) or real(self, f))
    for run in (run_chain, lambda scene, methods: run_point(prepare(scene, methods, tmp_path), scene)):
        examined.clear()
        results = run(scene, methods).results
        assert {len(results[name]) for name in methods} == {sum(examined)} and sum(examined) >= 20
