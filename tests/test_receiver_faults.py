"""A receiver's faults that leave frames valid and wrong: each has its right status, and none gives a wrong altitude."""

from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest
from frames import N, W, measured, noise

from radalt import Altimeter, AltimeterSettings, AltitudeTracker
from radalt.core.altimeter.beat_spectra import Spectra
from radalt.core.returns.point import point_return
from radalt.core.timing.repeated_frames import RepeatedFrames, RepeatedNoise
from radalt.core.timing.segmenter import FrameSegmenter
from radalt.core.tracker.tracker import Status

ALTIMETER = Altimeter(W, AltimeterSettings(max_altitude_m=1000.0, max_vertical_speed_m_per_s=20.0))
PREAMBLE, TRIALS, BROKEN = 8, 150, 40  # frames; the fault begins with trial frame 40
SPEED = -5.0


@lru_cache(maxsize=3)
def descent(frames: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Altitudes in mid-frame at 5 m/s down, and frames at an SNR of 10 dB."""
    rng = np.random.default_rng(seed)
    path = 300.0 + SPEED * (np.arange(frames) + 0.5) * W.sweep_s
    return path, point_return(W, path, vertical_speed_m_per_s=SPEED) + noise(rng, frames, 10.0)


def late_rail(samples: np.ndarray) -> np.ndarray:
    return samples.real + 1j * np.r_[0.0, samples.imag[:-1]]


def one_bit(samples: np.ndarray) -> np.ndarray:
    return np.sign(samples.real) + 1j * np.sign(samples.imag)


def stuck_bit(samples: np.ndarray) -> np.ndarray:
    """Bit 3 of twelve is always one."""
    rails = np.round(samples.astype(np.complex64).view(np.float32) * 400.0).astype(np.int32) | 8
    return (rails.astype(np.float32) / 400.0).view(np.complex64)


def received(fault, first: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Path, and the stream whose samples are faulty from a trial frame on (-8: from the start)."""
    path, frames = descent(TRIALS, seed)
    preamble = descent(PREAMBLE, seed + 1)[1]
    preamble = preamble - point_return(W, descent(PREAMBLE)[0], vertical_speed_m_per_s=SPEED)
    stream = np.concatenate([preamble + point_return(W, np.zeros(PREAMBLE)), frames]).ravel()
    at = (PREAMBLE + first) * N
    return path, np.concatenate([stream[:at], fault(stream[at:])]).astype(np.complex64)


def segmented(stream: np.ndarray, path: np.ndarray, *, noise: bool = True):
    """The segmenter after the stream, and the frames that it released."""
    segmenter = FrameSegmenter(W, None, true_delay=True, noise=noise)

    def sent(index: int) -> tuple[float, float]:
        at = index - PREAMBLE
        return (0.0, 0.0) if at < 0 else (float(path[min(at, TRIALS - 1)]), SPEED)

    segmenter.follow(sent)
    return segmenter, segmenter.push(stream)


def frozen(samples: np.ndarray, frames: int) -> np.ndarray:
    """The first frames again and again."""
    return np.resize(samples[: frames * N], samples.size)


@pytest.mark.parametrize("frames", [1, 40])
def test_a_frozen_receiver_gives_no_frame_and_no_lock(frames):
    path, stream = received(lambda x: frozen(x, frames), BROKEN)
    segmenter, out = segmented(stream, path)
    assert out[-1].index - PREAMBLE < BROKEN + frames  # the first of each is as good as any
    assert segmenter.fault == "frozen" and segmenter.status()["locked"] is False
    assert segmenter.counters["faulty_frames"] == TRIALS - BROKEN - frames
    exempt, out = segmented(stream, path, noise=False)
    assert exempt.fault == "" and exempt.counters["faulty_frames"] == 0


@pytest.mark.parametrize("fault", [late_rail, np.real])
def test_a_rail_that_is_late_or_dead_in_flight_is_a_fault_within_64_frames(fault):
    """Late by a sample it would move every altitude by 10 m, and each frame would still be valid."""
    path, stream = received(fault, BROKEN)
    segmenter, out = segmented(stream, path)
    assert segmenter.fault == "quadrature" or segmenter.state == "lost"
    assert max(f.index for f in out) < PREAMBLE + BROKEN + 64


@pytest.mark.parametrize("fault", [late_rail, np.real, np.imag])
def test_no_lock_is_taken_on_a_sweep_with_its_conjugate(fault):
    path, stream = received(fault, -PREAMBLE)
    segmenter, out = segmented(stream, path)
    assert segmenter.state == "acquiring" and segmenter.fault == "quadrature" and not out


@pytest.mark.parametrize("fault", [one_bit, stuck_bit, lambda x: 1.1 * x.real + 0.95j * x.imag])
def test_a_receiver_that_still_measures_right_keeps_its_frames(fault):
    """Hard clipping to one bit, a bit that sticks, an imbalance of 1.3 dB."""
    path, stream = received(fault, BROKEN)
    segmenter, out = segmented(stream, path)
    assert segmenter.fault == "" and out[-1].index - PREAMBLE >= TRIALS - 4
    late = [f for f in out if f.index >= PREAMBLE + BROKEN]
    found = measured(late, ALTIMETER)
    right = np.abs(found["altitude_m"] - path[[f.index - PREAMBLE for f in late]]) < 5.0
    assert right.mean() > 0.95


@pytest.mark.parametrize("frames", [1, 40])
def test_a_tracker_says_failure_of_frozen_frames(frames):
    """From 0.4 s on, at 5 m/s: 98 of 100 outputs were NORMAL, 61 of them wrong by more than 5 m."""
    _, samples = descent(400 + frames)
    spectra = ALTIMETER.spectra(samples)
    at = np.r_[np.arange(400), 400 + np.arange(2000) % frames]
    path = 300.0 + SPEED * (np.arange(2400) + 1.0) * W.sweep_s
    played = Spectra(spectra.power[at], spectra.support[at], spectra.beat_hz, spectra.scale[at])
    outputs = AltitudeTracker(ALTIMETER).process(played)
    normal = outputs["status"] == Status.NORMAL
    assert normal[2:10].all() and not normal[11:].any()
    assert np.all(outputs["status"][11:] == Status.FAILURE)
    assert np.abs(outputs["altitude_m"] - path[outputs["frame_index"]])[normal].max() < 1.0
    exempt = AltitudeTracker(ALTIMETER, noise=False).process(played)
    assert np.all(exempt["status"] != Status.FAILURE)


def statuses(frames) -> np.ndarray:
    """What a tracker says of 40 frames at a time."""
    tracker = AltitudeTracker(ALTIMETER)
    outputs = [tracker.process(ALTIMETER.spectra(batch.astype(np.complex64))) for batch in frames]
    return np.concatenate(outputs)["status"]


def test_a_ring_of_more_than_a_second_is_a_failure_within_120_ms():
    samples = descent(1200)[1]
    said = statuses(samples[np.arange(first, first + 40) % 1200] for first in range(0, 1600, 40))
    assert np.all(said[2:30] == Status.NORMAL) and np.all(said[33:] == Status.FAILURE)


def test_rings_of_a_second_are_found_by_equal_frames_and_of_a_minute_by_their_noise():
    """960 frames of 1 ms, and 2,900 of 20 ms, as a driver returns old buffers again and again."""
    assert RepeatedFrames(1e-3).check(np.arange(2000) % 960)[960:].all()
    sweep = SimpleNamespace(sweep_s=0.02, half_sweep_s=1.0, half_slopes=(1.0, -1.0))
    tables = SimpleNamespace(waveform=sweep, beat_hz=np.arange(64.0), search_hz=(20.0, 40.0), cell_hz=1.0)
    cells = np.random.default_rng(2).standard_normal((2900, 2, 128)).view(complex)[np.arange(3300) % 2900]
    played = SimpleNamespace(cells=cells, power=np.abs(cells) ** 2)
    again = RepeatedNoise(tables, 40).check(played, played, np.ones(3300, dtype=bool))
    assert not again[:2900].any() and again[3020:].all()


@pytest.mark.parametrize(
    "change",
    [
        lambda old, k: old * np.float32(1.03**k),
        lambda old, k: old * np.exp(0.7j * k),
        lambda old, k: old + 0.05 * (k % 3),
        lambda old, k: old + 0.02 * np.random.default_rng(k).standard_normal(old.shape),
    ],
    ids=["gain", "phase", "dc", "dither"],
)
def test_a_buffer_that_comes_again_with_another_gain_phase_dc_or_dither_is_a_failure(change):
    samples = descent(440)[1]
    played = [samples[first : first + 40] for first in range(0, 440, 40)]
    said = statuses([*played, *(change(played[-1], k) for k in range(1, 20))])
    assert np.all(said[2:11] == Status.NORMAL) and np.all(said[14:] == Status.FAILURE)


@pytest.mark.parametrize(("speed", "strength"), [(0.0, 0.0), (-5.0, 1.0), (-5.0, 100.0)])
def test_a_hover_and_interference_that_repeats_itself_are_no_frozen_receiver(speed, strength):
    """A return that keeps its phase, in new noise; ten frames of interference again and again, 3 and 43 dB stronger."""
    rng = np.random.default_rng(3)
    again = np.float32(strength) * noise(rng, 10, -3.0)
    path = 300.0 + speed * (np.arange(1200) + 0.5) * W.sweep_s

    def batch(first: int) -> np.ndarray:
        sent = point_return(W, path[first : first + 40], vertical_speed_m_per_s=speed)
        return sent + noise(rng, 40, 10.0) + again[np.arange(first, first + 40) % 10]

    said = statuses(batch(first) for first in range(0, 1200, 40))
    assert Status.FAILURE not in said
    assert strength > 1.0 or np.mean(said[2:] == Status.NORMAL) > 0.9


@pytest.mark.parametrize(("value", "status"), [(0.0, "FAILURE"), (0.3 - 0.2j, "FAILURE")])
def test_a_receiver_that_gives_nothing_or_a_constant_is_a_failure(value, status):
    _, samples = descent(320)
    samples = samples.astype(np.complex64)
    samples[200:] = value
    outputs = AltitudeTracker(ALTIMETER).process(ALTIMETER.spectra(samples))
    assert outputs["status"][4] == Status.NORMAL
    assert np.all(outputs["status"][6:] == getattr(Status, status))


@pytest.mark.parametrize(("speed", "snr_db"), [(-5.0, 10.0), (8.0, -10.0)])
def test_i_and_q_exchanged_from_the_start_give_no_altitude_once_the_track_has_moved(speed, snr_db):
    """A centred sweep's conjugate is the sweep half a frame later: the altitude is right, the Doppler's sign wrong."""
    rng = np.random.default_rng(4)
    path = 300.0 + speed * (np.arange(800) + 0.5) * W.sweep_s
    stream = (point_return(W, path, vertical_speed_m_per_s=speed) + noise(rng, 800, snr_db)).ravel()
    for samples, given in ((stream, True), (1j * stream.conj()[N // 2 : -N // 2], False)):
        spectra = ALTIMETER.spectra(samples.reshape(-1, N).astype(np.complex64))
        outputs = AltitudeTracker(ALTIMETER).process(spectra)
        normal = outputs["status"] == Status.NORMAL
        assert normal[2:].all() if given else not normal[9:].any()
        assert np.abs(outputs["altitude_m"] - path[outputs["frame_index"]])[normal].max() < 1.0
