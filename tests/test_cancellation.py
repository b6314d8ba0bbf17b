"""The study of cancellation: its interference is what it says, its rows follow from the seed, its page is written."""

import csv

import numpy as np
import pytest
from gnuradio import radalt
from pages import assert_whole

from radalt.core.interference import Interferer, QpskEmitter
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.stream import JammerStream
from radalt.core.scene import parse_scene
from radalt.evaluation.engine.options import Options
from radalt.evaluation.engine.run import run
from radalt.studies.cancellation.cases import CASES, WAVEFORM, received
from radalt.studies.cancellation.command import _describe
from radalt.studies.cancellation.study import CancellationStudy


@pytest.mark.parametrize(
    "name", ["evm_3", "stream", "part", "eva", "tones", "stream_radios", "stream_ra4_30", "qpsk", "layer_20"]
)
def test_interference_has_the_power_that_the_sir_says(name):
    case = CASES[name]
    frames, altitude_m = received(case, -30.0, 6, np.random.default_rng(1))
    assert frames.shape == (6, WAVEFORM.samples_per_frame) and altitude_m.shape == (6,)
    # return 1, noise 0.1, interference 1000; a stream holds its SIR in the long run, not in every frame
    within = 0.9 if name.startswith("stream_ra4") else 0.2 if case.stream else 0.02
    assert np.mean(np.abs(frames) ** 2) == pytest.approx(1001.1, rel=within)
    clean, same_m = received(case, None, 6, np.random.default_rng(1))
    np.testing.assert_array_equal(same_m, altitude_m)
    assert np.mean(np.abs(clean) ** 2) == pytest.approx(1.6 if case.radio else 1.1, rel=0.25)


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


def test_a_carrier_goes_on_where_a_base_station_repeats_itself():
    """12,345.67 cycles in 10 ms: without that its phase would leap by two thirds of a turn."""
    emitter = NrEmitter(frame_count=1, carrier_hz=1_234_567.0)
    stream = JammerStream(WAVEFORM, [Interferer(emitter, -10.0)], seed=3, free_running=True)
    frames = np.stack([stream.next_frame() for _ in range(32)])
    for first in (1, 11):
        turned = frames[first : first + 10] * np.exp(2j * np.pi * 0.67)
        np.testing.assert_allclose(frames[first + 10 : first + 20], turned, atol=2e-3)


def test_a_scene_s_base_station_goes_on_too_whatever_its_sir_is_set_to():
    """A whole scene's source has a total SIR: no frame is scaled by itself, and a new SIR is a new gain alone."""
    scene = parse_scene({"interference": {"nr": {"sir_db": -20.0, "free_running": True, "frame_count": 2}}})
    source = radalt.mixture_jammer_source(scene, sir_db=-10.0)
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


def test_study_end_to_end(tmp_path, measured_here, browser):
    study = CancellationStudy(cases=("evm_3", "stream", "qpsk"), frames=3, seed=5, sirs_db=(-20.0, -45.0))
    assert [point.frames for point in study.points()] == [3, 3, 3]
    page = run(study, Options(tmp_path / "a", jobs=1))
    assert_whole(page, browser)
    text = page.read_text(encoding="utf-8")
    assert "64QAM, EVM 3 %" in text and "## Where it stops" in text and "## What it costs" in text
    for name in ("pd.png", "rows.csv"):
        assert (tmp_path / "a" / name).stat().st_size > 500
    rows = list(csv.DictReader((tmp_path / "a" / "rows.csv").open(encoding="utf-8")))
    assert [row["method"] for row in rows if row["case"] == "qpsk"] == ["none", "qpsk_cancel"] * 2
    low = {row["case"]: row for row in rows if float(row["sir_db"]) == -45.0 and row["method"] != "none"}
    assert all(float(row["pd"]) == 1.0 for row in low.values())
    assert low["evm_3"]["tracked"] == "0" and low["stream"]["tracked"] == "2"
    assert 0 < float(low["stream"]["ffts_median"]) < float(low["evm_3"]["ffts_median"])
    # a worker's rows are those of the seed alone
    again = study.measure(study.points()[0])[-1]
    assert float(low["evm_3"]["rmse_detected_m"]) == pytest.approx(again["rmse_detected_m"])
    assert _describe([again]) == "evm_3, ofdm_cancel: Pd 1.00"


def test_qpsk_is_demodulated_by_its_own_method():
    """An error vector of 8.75 % is 21 dB below the symbol and stays; -25 dB is borne without mitigation."""
    study = CancellationStudy(cases=("qpsk",), frames=4, seed=6, sirs_db=(-30.0, -42.0))
    (point,) = study.points()
    rows = study.measure(point)
    assert {row["method"] for row in rows} == {"none", "qpsk_cancel"}
    assert sum(row["correct"] for row in rows if row["method"] == "qpsk_cancel") >= 7
