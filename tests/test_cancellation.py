"""The study of cancellation: its interference is what it says, its rows follow from the seed, its page is written."""

import csv

import cancellation
import numpy as np
import pytest
from gnuradio import radalt

from radalt.core.interference import Interferer, QpskEmitter
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.stream import JammerStream
from radalt.core.mitigation.ofdm.lattice import nearest
from radalt.core.scene import parse_scene
from radalt.evaluation.engine import estimate as estimates
from radalt.evaluation.engine.options import Options
from radalt.evaluation.engine.run import run
from radalt.evaluation.results.score import SCORE_COLUMNS
from radalt.studies.cancellation.cases import CASES, WAVEFORM, Antennas, received
from radalt.studies.cancellation.command import _describe as describe
from radalt.studies.cancellation.flights import FlightsStudy
from radalt.studies.cancellation.known_symbols import (
    BLANKED_BURST,
    KNOWN,
    misread_share,
    placed,
    weak_return_gain_db,
    with_known_symbols,
)
from radalt.studies.cancellation.mixtures import MIXTURES, measure_mixture
from radalt.studies.cancellation.report import _within
from radalt.studies.cancellation.study import SIRS_DB, CancellationStudy
from radalt.studies.cancellation.tracked import FLIGHTS


@pytest.mark.parametrize(
    "name",
    [
        "nr10_64qam",
        "nr10_stream",
        "nr10_part",
        "nr10_eva",
        "nr10_tones",
        "nr10_radios",
        "nr10_idle",
        "qpsk",
        "qpsk_radios",
    ],
)
def test_interference_has_the_power_that_the_sir_says(name):
    case = CASES[name]
    frames, altitude_m = received(case, -30.0, 6, np.random.default_rng(1))
    assert frames.shape == (6, WAVEFORM.samples_per_frame) and altitude_m.shape == (6,)
    # return 1, noise 0.1, interference 1000; a stream holds its SIR over its period, not in every frame
    assert np.mean(np.abs(frames) ** 2) == pytest.approx(1001.1, rel=0.2 if case.stream else 0.02)
    clean, same_m = received(case, None, 6, np.random.default_rng(1))
    np.testing.assert_array_equal(same_m, altitude_m)
    assert np.mean(np.abs(clean) ** 2) == pytest.approx(1.6 if CASES[name].radio else 1.1, rel=0.25)


def test_qpsk_is_read_by_its_own_method(monkeypatch):
    monkeypatch.setattr("radalt.studies.cancellation.study.SIRS_DB", SIRS_DB[1::3])
    cases = ("qpsk_ideal", "qpsk", "qpsk_radios")
    study = CancellationStudy(("qpsk_cancel",), cases, frames=1, flights=0, seed=6)
    for name, point in zip(cases, study.points(), strict=True):
        held = study.measure(point)
        assert [row["sir_db"] for row in held] == list(SIRS_DB[1::3])
        # an error vector of 8.75 % is 21 dB below the symbol and stays; -25 dB is borne without mitigation
        limit_db = -60.0 if name == "qpsk_ideal" else -25.0 + 20.0 * np.log10(0.0875)
        held = [row for row in held if row["sir_db"] >= limit_db]
        assert len(held) >= 4 and sum(row["correct"] for row in held) >= 0.9 * sum(
            row["trials"] for row in held
        )


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


def test_bursts_and_locked_jammers_start_anew():
    for interferer, free in (
        (Interferer(QpskEmitter(), -10.0, 0.5), True),
        (Interferer(QpskEmitter(), -10.0), False),
    ):
        stream = JammerStream(WAVEFORM, [interferer], seed=4, free_running=free)
        power = [np.mean(np.abs(stream.next_frame()) ** 2) for _ in range(4)]
        if not free:
            assert power == pytest.approx([10.0] * 4, rel=1e-4)
        assert stream.interferers[0] is interferer


def test_study_end_to_end(tmp_path, monkeypatch):
    module = "radalt.studies.cancellation.study"
    # all kinds, and a second of each, take a minute
    monkeypatch.setattr(f"{module}.FLIGHTS", dict(list(FLIGHTS.items())[:1]))
    monkeypatch.setattr(f"{module}.FRAMES", 120)
    for name, count in {
        "_ROUNDS": 1,
        "_FRAMES": 2,
        "_LONG_LEAD": 2,
        "_LONG": 2,
    }.items():  # times are no matter of this test
        monkeypatch.setattr(f"radalt.studies.cancellation.costs.{name}", count)
    monkeypatch.setattr(estimates, "_scale", lambda sample: 1.0)  # test_engine's business, and 5 s
    study = CancellationStudy(
        ("none", "ofdm_cancel"), ("nr10_ideal", "nr10_64qam"), frames=1, flights=1, seed=5
    )
    assert [point.frames for point in study.points()] == [1, 3, 120]  # a limit was asked for 64QAM
    page = run(study, Options(tmp_path / "a", jobs=1))
    text = page.read_text(encoding="utf-8")
    assert (
        "10 MHz, 64QAM, ideal emitter" in text
        and "## Behind the tracker" in text
        and "## Where it stops" in text
    )
    for name in ("pd.png", "frame.png", "rows.csv"):
        assert (tmp_path / "a" / name).stat().st_size > 1000
    assert (
        len((tmp_path / "a" / "tracked.csv").read_text().splitlines()) == 1 + 15
    )  # five methods, three speeds
    rows = list(csv.DictReader((tmp_path / "a" / "rows.csv").open(encoding="utf-8")))
    held = [r for r in rows if r["case"] == "nr10_ideal" and r["method"] == "ofdm_cancel"]
    assert [float(row["sir_db"]) for row in held] == list(SIRS_DB)
    assert sum(int(row["correct"]) for row in held) >= 0.95 * sum(int(row["trials"]) for row in held)
    assert all(row["frames_cleaned"] == row["trials"] for row in held[-8:])  # SIR -30 dB and below
    assert {row["frames_cleaned"] for row in rows if row["method"] == "none"} == {"0"}
    # a worker's rows are those of the seed alone
    monkeypatch.setattr(f"{module}.SIRS_DB", SIRS_DB[-2:])
    again = [row for row in study.measure(study.points()[0]) if row["method"] == "ofdm_cancel"]
    assert [float(row["rmse_correct_m"]) for row in held[-2:]] == pytest.approx(
        [row["rmse_correct_m"] for row in again]
    )


def test_flights_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("radalt.studies.cancellation.flights.FRAMES", 120)
    monkeypatch.setattr(estimates, "_scale", lambda sample: 1.0)
    page = run(FlightsStudy(("none",), flights=2, length_s=1, seed=5), Options(tmp_path / "a", jobs=1))
    assert "2 flights of 1 s" in page.read_text(encoding="utf-8")
    rows = list(csv.DictReader((tmp_path / "a" / "rows.csv").open(encoding="utf-8")))
    assert len(rows) == 3 * 2 * 3 and {r["outputs"] for r in rows} == {"3"}  # kinds, flights, allowed speeds
    for stray, said in (("--flight-s=3", "needs --flights-only"), ("--flights=0", "at least one flight")):
        options = [stray] if "flight-s" in stray else ["--flights-only", stray]
        with pytest.raises(SystemExit) as left:
            cancellation.main(options)
        error = capsys.readouterr().err
        assert left.value.code == 2 and said in error and error.count("\n") == 1


def test_a_genie_that_takes_the_qpsk_away_leaves_what_can_be_demodulated():
    """QPSK and NR in one band are not demodulated jointly: the mixture breaks at about -30 dB."""
    without, whole = (measure_mixture(name, -45.0, 6, [5]) for name in ("paper_qpsk", "paper"))
    assert whole["pd"] < 0.6 < 0.8 < without["pd"]
    assert set(CancellationStudy().tables["mixtures"].names) == set(whole)
    assert describe([without]).startswith("mixture paper_qpsk, hybrid: Pd ")
    whole = [point.case for point in CancellationStudy().points() if point.table == "mixtures"]
    assert whole == list(MIXTURES)
    assert not CancellationStudy(cases=("qpsk",)).points()[-1].table == "mixtures"


def test_a_stations_own_noise_and_antennas_add_power_of_their_own():
    clean, altitude_m = received(CASES["nr10_64qam"], -30.0, 4, np.random.default_rng(2))
    noisy, same_m = received(CASES["nr10_noise5"], -30.0, 4, np.random.default_rng(2))
    np.testing.assert_array_equal(altitude_m, same_m)
    # a symbol's prefix is its end: coherence is the share of power that is signal
    for frames, low, high in ((clean, 0.97, 1.0), (noisy, 0.72, 0.86)):
        folded = [np.abs(_prefixes(frame)) for frame in frames]
        assert low < np.mean(folded) <= high
    emitter = Antennas(carrier=NrEmitter(channel_bandwidth_hz=10e6), antennas=2)
    sent = emitter.samples(75_000, 7.5e6, np.random.default_rng(3))
    assert np.mean(np.abs(sent) ** 2) == pytest.approx(1.0, rel=0.3)  # both send the same SSB
    assert np.abs(_prefixes(sent[:7500])) > 0.97  # one timing


def _prefixes(frame):
    """Greatest coherence of 20 samples with those a symbol later, by the timing of the symbols of half a slot."""
    product = frame[500:] * frame[:-500].conj()
    power = 0.5 * (np.abs(frame[500:]) ** 2 + np.abs(frame[:-500]) ** 2)
    starts = (
        np.arange(0, 3300)[:, None, None]
        + np.rint(np.arange(6) * 535.16).astype(int)[:, None]
        + np.arange(20)
    )
    return np.max(np.abs(product[starts].sum(axis=(1, 2))) / power[starts].sum(axis=(1, 2)))


def test_with_all_symbols_known_the_emitters_own_noise_is_what_stays():
    held = {kind: with_known_symbols(kind, -29.0, 12, [1]) for kind in ("64qam", "64qam_8")}
    assert list(held["64qam"][0]) == list(CancellationStudy().tables["known"].names)
    pd = {kind: {row["method"]: row["pd"] for row in rows} for kind, rows in held.items()}
    assert pd["64qam"]["known symbols"] == pd["64qam_8"]["known symbols"] == 1.0
    assert pd["64qam_8"]["none"] < 0.7
    errors = [rows[-1]["rmse_correct_m"] for rows in held.values()]
    # error vectors of 4 %, 28 dB below the signal, are as strong as the return; noise 8 dB below is stronger
    assert errors[0] < 0.3 < errors[1]
    study = CancellationStudy()
    assert [point.case for point in study.points() if point.table == "known"] == list(KNOWN)


@pytest.mark.parametrize(("kind", "limit_m"), [("burst", 0.4), ("ra4_moving", 0.9)])
def test_known_symbols_of_bursts_and_moving_echoes_are_taken_away(kind, limit_m):
    rows = {row["method"]: row for row in with_known_symbols(kind, -40.0, 8, [880219])}
    assert rows["none"]["pd"] < 0.3 and rows["known symbols"]["pd"] == 1.0
    assert rows["known symbols"]["rmse_correct_m"] < limit_m
    assert (BLANKED_BURST in rows) == (KNOWN[kind].overlap < 1)
    if BLANKED_BURST in rows:  # nothing but the rest of the sweep
        assert rows[BLANKED_BURST]["pd"] == 1.0 and rows[BLANKED_BURST]["rmse_correct_m"] < limit_m


@pytest.mark.parametrize("first", [-30, 0, 700])
def test_the_place_of_what_was_sent_is_found(first):
    rng = np.random.default_rng(6)
    sent = rng.standard_normal((600, 2)).view(np.complex128)[:, 0]
    frame = 0.1 * rng.standard_normal((1000, 2)).view(np.complex128)[:, 0]
    at = np.arange(max(0, first), min(1000, first + 600))
    frame[at] += 2j * sent[at - first]
    found, *ends = placed(frame, sent)
    assert ends == [at[0], at[-1] + 1]
    np.testing.assert_allclose(found[at], sent[at - first], rtol=1e-6)
    assert not np.delete(found, at).any()


@pytest.mark.parametrize(
    ("every", "cleaned", "mark"),
    [
        (0.09, 0.09, "yes"),
        (13.0, 0.05, "0.050 in the 96 of 99 cleaned"),
        (13.0, 0.2, "no"),
        (None, None, "no"),
    ],
)
def test_a_line_says_whether_its_errors_are_near_those_without_interference(every, cleaned, mark):
    counts = {"trials": 99, "frames_cleaned": 96}
    assert _within({"rmse_detected_m": every, "rmse_cleaned_m": cleaned} | counts, 0.09) == mark
    assert _within(None, 0.09) == ""


def test_batches_of_a_case_are_pooled_with_their_errors():
    batches = [
        [{**dict.fromkeys(SCORE_COLUMNS, 0), "trials": 4, "detections": 3, "correct": count, "rmse_correct_m": error_m}
         | {"frames_cleaned": count, "rmse_cleaned_m": error_m}]
        for count, error_m in ((1, 0.5), (3, 0.1), (0, float("nan")))
    ]  # fmt: skip
    (row,) = CancellationStudy().pooled(batches)
    assert row["correct"] == row["frames_cleaned"] == 4
    assert row["rmse_correct_m"] == row["rmse_cleaned_m"] == pytest.approx(np.sqrt(0.28 / 4))
    assert CancellationStudy().pooled(batches[:1])[0]["rmse_cleaned_m"] == 0.5


@pytest.mark.parametrize(("points", "snr_db"), [(4, 20.0), (64, 35.0)])
def test_points_that_can_be_read_are_as_good_as_known(points, snr_db):
    known_db = 10 * np.log10(1 + 10 ** (snr_db / 10))
    assert weak_return_gain_db(points, snr_db) == pytest.approx(known_db, abs=0.02)
    assert weak_return_gain_db(points, 0.0) < 1.5  # and points that cannot be are noise


@pytest.mark.parametrize("points", [4, 16, 64, 256])
def test_share_of_wrong_points_is_that_of_decided_ones(points):
    rng = np.random.default_rng(points)
    half = np.sqrt(1.5 / (points - 1))
    sent = half * (2 * rng.integers(0, round(np.sqrt(points)), (2, 40_000)) - np.sqrt(points) + 1)
    heard = sent + np.sqrt(0.05) * rng.standard_normal(sent.shape)  # 10 dB
    wrong = np.abs(
        nearest((heard[0] + 1j * heard[1]).astype(np.complex64), points) - (sent[0] + 1j * sent[1])
    )
    assert np.mean(wrong > half) == pytest.approx(misread_share(points, 10.0), abs=0.008)
