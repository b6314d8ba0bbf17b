"""Emitters that go on from frame to frame, and the power of their sum."""

import numpy as np
import pytest
from gnuradio import radalt

from radalt.core.interference import Interferer, QpskEmitter
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.stream import JammerStream
from radalt.core.scene import parse_scene
from radalt.core.waveform import Waveform

WAVEFORM = Waveform()


def test_a_free_running_base_station_goes_on_from_frame_to_frame():
    emitter = NrEmitter(frame_count=2)  # 20 ms
    stream = JammerStream(WAVEFORM, [Interferer(emitter, -10.0)], seed=3, free_running=True)
    frames = np.stack([stream.next_frame() for _ in range(45)])
    np.testing.assert_allclose(frames[1:21], frames[21:41], atol=1e-5)
    assert np.mean(np.abs(frames[1:21]) ** 2) == pytest.approx(10.0, rel=1e-3)
    # each sample is where the emitter's period has it: frames meet without a step
    period, _ = emitter.period(WAVEFORM.rate_hz)
    sent = frames[1:21].ravel()
    lined_up = np.abs(np.fft.ifft(np.fft.fft(sent) * np.fft.fft(period).conj()))
    assert lined_up.max() == pytest.approx(np.linalg.norm(sent) * np.linalg.norm(period), rel=1e-3)
    power = np.mean(np.abs(frames[1:21]) ** 2, axis=1)
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
    stream = JammerStream(WAVEFORM, parts, seed=6, free_running=True, total_sir_db=-10.0)
    power = [np.mean(np.abs(stream.next_frame()) ** 2) for _ in range(81)][1:]
    assert np.mean(power) == pytest.approx(10.0, rel=0.03)
    assert np.std(power) > 0.3
