"""The tracker: what it gains by integration, what it says of its own error, and when it says nothing."""

import os
from functools import cache

import numpy as np
import pmt
import pytest
from frames import N, W, noise
from gnuradio import radalt
from test_blocks import Messages, Ragged, run

from radalt import Altimeter, AltimeterSettings, AltitudeTracker, TrackerSettings
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.placement import Interferer
from radalt.core.interference.stream import JammerStream
from radalt.core.returns.point import point_return
from radalt.core.scene import parse_scene
from radalt.core.tracker.integrator import Integrator
from radalt.core.tracker.summed_block import Block
from radalt.core.tracker.tracker import State, Status
from radalt.core.waveform import exp_cycles
from radalt.evaluation.results.proportion import clopper_pearson

ALTIMETER = Altimeter(W, AltimeterSettings(max_altitude_m=1000.0, max_vertical_speed_m_per_s=20.0))
FAST = Altimeter(W, AltimeterSettings(max_altitude_m=1000.0, max_vertical_speed_m_per_s=150.0))
T = 0.001  # s, a frame


def returns(rng, altitude_m, speed: float = 0.0) -> np.ndarray:
    """A point return at these altitudes, one a frame, of random phase."""
    apart, at = np.unique(np.asarray(altitude_m, dtype=float), return_inverse=True)
    phase = exp_cycles(rng.random(at.size))
    return point_return(W, apart, vertical_speed_m_per_s=speed)[at] * phase[:, None]


def flight(rng, altitude_m, snr_db: float, speed: float = 0.0) -> np.ndarray:
    """The same in noise."""
    return returns(rng, altitude_m, speed) + noise(rng, np.size(altitude_m), snr_db)


@cache
def integrator(altimeter: Altimeter, frames: int, allowed: float) -> Integrator:
    return Integrator(altimeter, frames, doppler=allowed > 0, max_speed_m_per_s=allowed)


def tracked(frames: np.ndarray, altimeter: Altimeter = ALTIMETER, settings=None, index=None, chunk=200):
    """Outputs of one run."""
    tracker = AltitudeTracker(altimeter, settings or TrackerSettings())
    index = np.arange(len(frames)) if index is None else index
    parts = [
        tracker.process(altimeter.spectra(frames[k : k + chunk]), frame_index=index[k : k + chunk])
        for k in range(0, len(frames), chunk)
    ]
    return np.concatenate(parts)


def block_of(rng, frames: int, snr_db: float, *, speed=0.0, allowed: float | None = None, altitude=500.0):
    """One block with a return at its middle, and what it was made by."""
    altimeter = FAST if speed else ALTIMETER
    allowed = altimeter.settings.max_vertical_speed_m_per_s if allowed is None else allowed
    tables = integrator(altimeter, frames, allowed)
    at = np.arange(frames, dtype=float)
    path = altitude + speed * (at - at.mean()) * T
    ratio = tables.normalise(altimeter.spectra(flight(rng, path, snr_db, speed)))
    return Block(tables, ratio, at)


def test_strength_grows_as_the_square_root_of_the_frames():
    """Deflection of a sum of M looks; log(1 + x) costs 0.3 dB of the plain sum's sqrt(2 M) rho."""
    snr_db, rng = -37.0, np.random.default_rng(1)
    rho = 10.0 ** (snr_db / 10.0) * N / 2  # power over noise in one half sweep's cell
    for frames, runs in ((40, 24), (160, 8)):
        # the strongest of noise adds a little
        near = [block_of(rng, frames, snr_db).strongest(None).strength for _ in range(runs)]
        expected = 0.96 * rho * np.sqrt(2 * frames)
        assert 0.75 * expected < np.mean(near) < 1.25 * expected + 1.0


def test_frames_moved_by_their_speed_lose_nothing_of_a_fast_return():
    """150 m/s over 320 ms cross 48 m, more than two resolution cells: summed where they stand they lose 4 dB."""
    rng = np.random.default_rng(2)
    still = np.mean([block_of(rng, 320, -30.0).best().power for _ in range(2)])
    blocks = [block_of(rng, 320, -30.0, speed=150.0) for _ in range(2)]
    assert 10 * np.log10(np.mean([b.best().power for b in blocks]) / still) > -1.2
    unmoved = np.mean([b.tables.moved_sums(b.ratio, np.zeros((1, 320))).max() / 320 - 1 for b in blocks])
    assert 10 * np.log10(unmoved / still) < -3.0


def test_measurement_knows_its_own_error():
    """Squared error over its claimed variance has a mean of one, in altitude and speed: 120 blocks, two strengths."""
    rng, altitude_ratio, speed_ratio = np.random.default_rng(3), [], []
    for snr_db in (-33.0, -20.0):
        for altitude in rng.uniform(100.0, 900.0, 60):
            found = block_of(rng, 40, snr_db, altitude=altitude).best()
            altitude_ratio.append((found.altitude_m - altitude) ** 2 / found.altitude_variance_m2)
            speed_ratio.append(found.speed_m_per_s**2 / found.speed_variance_m2_per_s2)
    assert 0.6 < np.mean(altitude_ratio) < 1.6
    assert 0.6 < np.mean(speed_ratio) < 1.6


def test_a_measured_speed_knows_the_speckle_of_ground_too():
    """Eight facets within 8 m, ahead and astern: squared error over claimed variance was 15, since halves differ."""
    rng, ratio, k = np.random.default_rng(9), [], np.arange(40)
    tables = integrator(ALTIMETER, 40, 20.0)
    for _ in range(40):
        facets = zip(rng.uniform(300.0, 308.0, 8), rng.uniform(-25.0, 25.0, 8), rng.random(8), strict=True)
        turn_hz = float(W.vertical_speed_to_doppler_hz(1.0))
        sent = [
            np.exp(2j * np.pi * (turn + turn_hz * v * k * T))[:, None]
            * point_return(W, a, vertical_speed_m_per_s=v)
            for a, v, turn in facets
        ]
        spectra = ALTIMETER.spectra(sum(sent) / np.sqrt(8.0) + noise(rng, 40, 10.0))
        found = Block(tables, tables.normalise(spectra), k.astype(float)).best()
        ratio.append(found.speed_m_per_s**2 / (found.speed_variance_m2_per_s2 + 1.5**2))
    assert np.mean(ratio) < 4.0


@pytest.mark.parametrize("pieces", [2, 4])
def test_lobes_of_a_sweep_that_a_method_has_cut_into_pieces_are_no_rivals(pieces):
    """Half of each piece is left: lobes 4 dB below the return, as many resolution cells to either side as pieces."""
    left = np.arange(N) % (N // 2) * 2 * pieces // (N // 2) % 2 == 0
    outputs = tracked(flight(np.random.default_rng(1), np.full(200, 500.0), 10.0) * left)[2:]
    assert np.all(outputs["status"] == Status.NORMAL) and np.allclose(outputs["altitude_m"], 500.0, atol=0.5)


def test_one_frame_of_forty_decides_nothing():
    """A frame with a clean false return among frames of noise: what a method may put out."""
    rng = np.random.default_rng(4)
    frames = noise(rng, 400, 0.0)
    frames[::40] = 30.0 * point_return(W, 500.0)
    assert not np.any(tracked(frames)["state"] == State.TRACK)


@pytest.mark.parametrize("rival_m", [700.0, 320.0])
def test_a_return_that_a_method_has_taken_away_is_a_rival_if_the_received_frames_show_it(rival_m):
    rng = np.random.default_rng(20)
    cleaned = flight(rng, np.full(400, 400.0), 0.0)
    received = cleaned + returns(rng, np.full(400, rival_m))
    spectra = ALTIMETER.spectra(cleaned)

    def status(uncleaned):
        return AltitudeTracker(ALTIMETER).process(spectra, received=ALTIMETER.spectra(uncleaned))["status"]

    assert np.any(status(cleaned) == Status.NORMAL)
    assert not np.any(status(received) == Status.NORMAL)
    assert np.all(status(np.full_like(cleaned, np.nan)) == Status.FAILURE)  # cleaned of what is no number
    # interference that hides everything says nothing against the altitude
    assert np.array_equal(status(cleaned + 1e3 * noise(rng, 400, 0.0)), status(cleaned))


def test_protection_level_holds_at_its_stated_risk():
    """At a risk of 2 % a wrong bound shows: 12 runs of 15 outputs close to the limit of detection."""
    rng = np.random.default_rng(6)
    settings = TrackerSettings(risk=0.02)
    events = trials = 0
    widths = []
    for _ in range(12):
        speed = rng.uniform(-10.0, 10.0)
        # to 5 cm: frames of equal altitude are made once
        path = np.round(20.0 * (rng.uniform(100.0, 900.0) + speed * np.arange(600) * T)) / 20.0
        outputs = tracked(flight(rng, path, rng.uniform(-36.0, -25.0), speed), settings=settings)
        true = path[outputs["frame_index"]] + 0.5 * speed * T
        normal = outputs["status"] == Status.NORMAL
        beyond = np.abs(outputs["altitude_m"] - true) > outputs["protection_level_m"]
        events, trials = events + int(np.sum(normal & beyond)), trials + int(normal.sum())
        widths.extend(outputs["protection_level_m"][normal])
    assert trials > 100
    assert clopper_pearson(events, trials)[0] <= 0.02
    assert np.median(widths) < 5.0  # and it says something


@pytest.mark.parametrize("fall_m", [6.0, 8.0])
def test_ground_whose_facets_interfere_anew_in_every_frame_keeps_its_altitude(fall_m):
    """Its peak moves by metres from block to block, and powers add: that is no second return within the peak."""
    rng, frames = np.random.default_rng(55), 600
    behind = np.linspace(0.0, 2.0 * fall_m, 17)
    sent = point_return(W, 180.0 + behind) * np.exp(-0.5 * behind / fall_m)[:, None].astype(np.float32)
    facets = rng.standard_normal((frames, behind.size, 2), dtype=np.float32).view(np.complex64)[..., 0] / 4.0
    out = tracked(facets @ sent + noise(rng, frames, 10.0))[2:]
    assert np.all(out["status"] == Status.NORMAL)
    assert np.all(np.abs(out["altitude_m"] - 180.0) < out["protection_level_m"])
    assert out["protection_level_m"].max() < 10.0


@pytest.mark.parametrize("step_m", [50.0, -150.0, 300.0])
def test_a_step_of_the_ground_is_found_again_and_never_called_normal_meanwhile(step_m):
    path = np.where(np.arange(800) < 410, 500.0, 500.0 + step_m)
    outputs = tracked(flight(np.random.default_rng(7), path, -10.0))
    error = np.abs(outputs["altitude_m"] - path[outputs["frame_index"]])
    normal = outputs["status"] == Status.NORMAL
    assert error[normal].max() < 1.0
    assert normal[outputs["frame_index"] > 410 + 4 * 40].all()


def test_a_step_in_the_last_frames_of_a_block_is_noticed_by_the_next_output():
    path = np.where(np.arange(800) < 438, 500.0, 600.0)
    outputs = tracked(flight(np.random.default_rng(8), path, -10.0))
    error_m = np.abs(outputs["altitude_m"] - path[outputs["frame_index"]])
    wrong = (outputs["status"] == Status.NORMAL) & (error_m > 5.0)
    assert wrong.sum() <= 1 and outputs["status"][-1] == Status.NORMAL


@pytest.mark.parametrize(
    ("frames", "after", "step_m", "snr_db", "seed"),
    [(200, 10, 100.0, -28.0, 25), (400, 12, 12.0, -26.0, 43), (400, 15, 12.0, -26.0, 43)],
)
def test_a_step_of_a_weak_return_is_contradicted_by_the_latest_frames(frames, after, step_m, snr_db, seed):
    """Of forty frames ten show 100 m more: too few for a second return. Or twelve 12 m: the block's peak stays."""
    path = np.where(np.arange(frames) < frames - after, 500.0, 500.0 + step_m)
    outputs = tracked(flight(np.random.default_rng(seed), path, snr_db))
    assert outputs["status"][-2] == Status.NORMAL and outputs["status"][-1] == Status.NO_COMPUTED_DATA


def test_a_lost_return_coasts_then_is_lost_and_no_altitude_is_given():
    rng = np.random.default_rng(9)
    frames = np.concatenate([flight(rng, np.full(400, 300.0), 0.0), noise(rng, 1280, 0.0)])
    outputs = tracked(frames)
    gone = outputs["frame_index"] >= 400
    assert np.all(outputs["status"][gone] == Status.NO_COMPUTED_DATA) and np.isnan(outputs["altitude_m"][-1])
    # noise within the gate, one block in a hundred, makes it coast longer
    outputs = tracked(frames, settings=TrackerSettings(gate_pfa=1e-5))
    assert np.all(outputs["status"][gone] == Status.NO_COMPUTED_DATA)
    states = outputs["state"][gone]
    assert states[0] == State.COAST and State.LOST in states and states[-1] in (State.SEARCH, State.CONFIRM)
    ages = outputs["age_s"][gone & (outputs["state"] == State.COAST)]
    np.testing.assert_allclose(np.diff(ages), 0.04, atol=1e-9)
    assert ages[0] == pytest.approx(0.06, abs=0.002)  # half a block, and one


def test_not_finite_and_missing_frames_are_failures_and_the_track_survives():
    rng = np.random.default_rng(10)
    frames = flight(rng, np.full(800, 300.0), 0.0)
    frames[240:360] = np.nan
    outputs = tracked(frames)
    assert np.all(outputs["status"][6:9] == Status.FAILURE) and outputs["status"][9] == Status.NORMAL
    kept = np.r_[0:240, 400:800]
    outputs = tracked(frames[kept], index=kept)
    assert len(outputs) == 20  # 25 a second, whatever is missing
    assert np.all(outputs["status"][6:10] == Status.FAILURE) and outputs["status"][10] == Status.NORMAL
    assert np.all(np.diff(outputs["frame_index"]) == 40)


@pytest.mark.parametrize("back_to", [0, 1215])
def test_an_index_that_runs_backwards_starts_anew(back_to):
    """To an earlier block, or by fifteen frames within the block that is being filled."""
    frames = flight(np.random.default_rng(11), np.full(470, 300.0), 0.0)
    outputs = tracked(frames, index=np.r_[1000:1230, back_to : back_to + 240])[5:]
    confirmed = np.nonzero(outputs["status"] == Status.NORMAL)[0]
    assert 2 <= confirmed[0] <= 3 and confirmed[-1] == len(outputs) - 1


@pytest.mark.parametrize(
    ("level_db", "apart_m", "frames"),
    [*((3.0, 100.0, 880), (10.0, 100.0, 880), (-3.0, 300.0, 880), (-8.0, -100.0, 880)), (13.0, 80.0, 2080)],
)
def test_a_second_return_that_could_be_the_ground_is_no_computed_data(level_db, apart_m, frames):
    """Spoofed in mid-track: the old altitude is still there, so neither is called NORMAL.
    Nor after 1.8 s at 13 dB: alone the stronger one would be called NORMAL, since the ground is far below it."""
    flown = flight(np.random.default_rng(12), np.full(frames, 500.0), 0.0)
    flown[280:] += 10.0 ** (level_db / 20.0) * point_return(W, 500.0 + apart_m)
    outputs = tracked(flown)
    assert np.all(outputs["status"][3:7] == Status.NORMAL)
    assert not np.any(outputs["status"][7 if level_db > 10.0 else 9 :] == Status.NORMAL)


@pytest.mark.parametrize(("altitude_m", "apart_m"), [(30, 16), (100, 16), (800, 16), (100, 21)])
def test_another_altimeter_a_resolution_cell_from_the_ground_leaves_few(altitude_m, apart_m):
    """Two peaks that overlap, of equal power and other speeds; docs/tracker.md has what 12 draws print."""
    draws = int(os.environ.get("RADALT_DRAWS", "1"))
    path, given, wrong, farthest_m = altitude_m + 2.0 * T * np.arange(480), 0, 0, 0.0
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        frames = flight(rng, path, 20.0, 2.0)
        frames += point_return(W, path + apart_m, vertical_speed_m_per_s=7.0, phase_cycles=rng.random())
        outputs = tracked(frames, settings=TrackerSettings(doppler=True))
        error_m = np.abs(outputs["altitude_m"] - path[outputs["frame_index"]])
        given += np.isfinite(error_m).sum()
        wrong += (error_m > outputs["protection_level_m"]).sum()
        farthest_m = max(farthest_m, np.nanmax(error_m, initial=0.0))
    print(
        f"{wrong} of {given} altitudes, {12 * draws} outputs, beyond their level, up to {farthest_m:.1f} m off"
    )
    assert wrong <= 0.5 * draws


def test_a_method_that_takes_the_ground_away_does_not_hand_the_track_to_a_stronger_return():
    """The received frames still show the ground, 13 dB below what the method has left."""
    rng = np.random.default_rng(24)
    received = flight(rng, np.full(1600, 500.0), 0.0)
    cleaned = received.copy()
    second = 10.0 ** (13.0 / 20.0) * point_return(W, 620.0)
    received[280:] += second
    cleaned[280:] = second + noise(rng, 1320, 0.0)
    tracker = AltitudeTracker(ALTIMETER)
    status = tracker.process(ALTIMETER.spectra(cleaned), received=ALTIMETER.spectra(received))["status"]
    assert np.all(status[3:7] == Status.NORMAL)
    assert not np.any(status[7:] == Status.NORMAL)


def test_an_altitude_beyond_all_that_are_possible_is_no_computed_data():
    """Half a resolution cell (10 m) beyond the span is searched; the protection level is 2.3 m there."""
    altimeter = Altimeter(W, AltimeterSettings(min_altitude_m=100.0, max_altitude_m=1000.0))
    rng = np.random.default_rng(23)
    for altitude_m, normal in ((93.0, False), (99.0, True), (999.0, True), (1007.0, False)):
        outputs = tracked(flight(rng, np.full(240, altitude_m), 0.0), altimeter)
        assert np.all(outputs["state"][:2] == State.CONFIRM)  # three blocks in a row have to agree
        assert np.all(outputs["status"][:2] == Status.NO_COMPUTED_DATA)
        assert np.all(outputs["state"][2:] == State.TRACK)
        assert np.all((outputs["status"][2:] == Status.NORMAL) == normal)


def test_side_lobes_of_a_radar_that_moves_in_from_beyond_the_span_are_no_altitude():
    """30 dB above the noise, 450 m/s by its clock: lobes of a half sweep reach the span before its lines do."""
    drift = -400.0 + 450.0 * np.arange(800) * T
    line = 10.0 * point_return(W, drift, vertical_speed_m_per_s=450.0, phase_cycles=0.3)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        assert not np.any(tracked(noise(rng, 800, 10.0) + line)["status"] == Status.NORMAL)


def test_a_line_beyond_the_span_takes_nothing_from_ground_above_its_side_lobes():
    """20 dB stronger, 18 resolution cells from it: the ground is 9 dB above such side lobes."""
    rng = np.random.default_rng(30)
    line = 10.0 * returns(rng, np.full(400, -200.0))
    outputs = tracked(flight(rng, np.full(400, 150.0), 0.0) + line)
    assert np.all(outputs["status"][3:] == Status.NORMAL)


def test_a_weak_second_return_above_the_ground_changes_nothing():
    rng = np.random.default_rng(13)
    frames = flight(rng, np.full(600, 500.0), 0.0) + 10.0 ** (-12 / 20) * point_return(W, 700.0)
    outputs = tracked(frames)
    assert np.all(outputs["status"][3:] == Status.NORMAL)


def test_speed_by_doppler_and_by_altitudes():
    """A beat shift has no Doppler: the tracker takes the speed from the altitudes, and says so by its settings."""
    rng = np.random.default_rng(14)
    path = 500.0 - 20.0 * np.arange(720) * T
    shifted = np.stack([W.beat_shifted(h) for h in path]) + noise(rng, path.size, 0.0)
    for frames, doppler in ((flight(rng, path, 0.0, -20.0), True), (shifted, False)):
        outputs = tracked(frames.astype(np.complex64), FAST, TrackerSettings(doppler=doppler))
        last = outputs[-1]
        assert last["status"] == Status.NORMAL
        assert last["vertical_speed_m_per_s"] == pytest.approx(-20.0, abs=1.0)
        assert last["altitude_m"] == pytest.approx(path[-1] - 0.5 * 20.0 * T, abs=0.5)


def test_timing_rest_is_taken_off():
    frames = flight(np.random.default_rng(16), np.full(320, 300.0), 0.0)
    tracker = AltitudeTracker(ALTIMETER)
    outputs = tracker.process(ALTIMETER.spectra(frames), timing_offset_s=2e-8)
    assert outputs["altitude_m"][-1] == pytest.approx(300.0 - 2.998, abs=0.05)


def test_a_base_stations_pattern_in_the_received_frames_is_no_rival():
    """5 MHz NR 60 dB above the return repeats every 20 ms: this draw has a false line of 5.5 deviations all along."""
    nr5 = NrEmitter(channel_bandwidth_hz=5e6, cell_id=402, frame_count=2, seed=43)
    stream = JammerStream(W, [Interferer(nr5, -60.0)], seed=1056364367, free_running=True, total_sir_db=None)
    stream.next_frame()
    altimeter = Altimeter(W)
    cleaned = flight(np.random.default_rng(32), np.full(200, 1000.0), 10.0)
    received = cleaned + np.stack([stream.next_frame() for _ in range(200)])
    spectra = (altimeter.spectra(x.astype(np.complex64)) for x in (cleaned, received))
    tracker = AltitudeTracker(altimeter)
    assert np.all(tracker.process(next(spectra), received=next(spectra))["status"][2:] == Status.NORMAL)


@pytest.mark.parametrize(
    ("first", "copy_m_per_s", "ground_m_per_s"),
    [
        (185, 12.0, -0.5),  # soon after confirmation, while the track's speed is least certain
        (300, 19.5, -9.7),  # 48 m apart at the end, where the copy's side lobes cover the ground
    ],
)
def test_a_coherent_copy_that_walks_off_with_the_gate_takes_no_track(first, copy_m_per_s, ground_m_per_s):
    """Range-gate pull-off. The track coasts next to the copy for a second; its end makes the copy no truer."""
    rng, frames = np.random.default_rng(44), 1960
    index = np.arange(frames)
    ground = np.round(20.0 * (500.0 + ground_m_per_s * T * index)) / 20.0  # to 5 cm, as above
    frames_of = flight(rng, ground, 10.0, ground_m_per_s)
    copy_m = ground[first] + copy_m_per_s * T * (index[first:] - first)
    copy = point_return(W, copy_m, vertical_speed_m_per_s=copy_m_per_s, phase_cycles=rng.random())
    frames_of[first:] += (10.0 * copy).astype(np.complex64)
    outputs = tracked(frames_of)
    assert np.all(outputs["status"][2 : first // 40] == Status.NORMAL)
    error = np.abs(outputs["altitude_m"] - ground[outputs["frame_index"]])
    assert not np.any(error > outputs["protection_level_m"])


def test_an_echo_within_the_peak_and_two_equal_grounds_stay_within_the_level_and_a_point_pays_little():
    """8 m behind and 6 dB weaker, or as strong and 18 m apart: in phase they are one peak, up to 9 m off."""
    for apart_m, level_db in ((8.0, -6.0), (18.0, 0.0), (0.0, None)):
        for seed in range(5):
            frames = point_return(W, 400.0) + noise(np.random.default_rng(seed), 200, 10.0)
            if level_db is not None:
                second = point_return(W, 400.0 + apart_m, phase_cycles=0.2 * seed)
                frames += 10.0 ** (level_db / 20.0) * second
            out = tracked(frames.astype(np.complex64))
            normal = out[out["status"] == Status.NORMAL]
            assert np.all(np.abs(normal["altitude_m"] - 400.0) <= normal["protection_level_m"])
            if level_db is None:
                assert normal.size == 3 and normal["protection_level_m"].max() < 2.6


def test_noise_is_normal_no_more_often_than_the_tracker_says():
    """At probabilities that a short test can count: a candidate in one block of ten, confirmed by one block in ten."""
    settings = TrackerSettings(output_s=0.016, search_pfa=0.1, gate_pfa=0.1, confirm_outputs=2)
    tracker, rng = AltitudeTracker(ALTIMETER, settings), np.random.default_rng(45)
    said = tracker.false_alarms_per_output
    assert said == pytest.approx(0.1 * 0.1 / 0.9 * (1.0 + 63.5 * 0.01))
    parts = [tracker.process(ALTIMETER.spectra(noise(rng, 320, 0.0))) for _ in range(10)]
    outputs = np.concatenate(parts)
    normal = int(np.sum(outputs["status"] == Status.NORMAL))
    assert np.any(outputs["state"] == State.TRACK)
    assert clopper_pearson(normal, len(outputs))[0] <= said
    assert AltitudeTracker(ALTIMETER).false_alarms_per_output < 1.1e-8


# -- the block --------------------------------------------------------------------------------------------------------
def test_block_tracks_in_any_chunks_and_says_so_in_messages():
    altitude = {"programme_m": [300.0], "frames": 400, "mode": "true_delay", "vertical_speed_m_per_s": -5.0}
    scene = parse_scene({"altitude": altitude})
    path = 300.0 - 5.0 * (np.arange(360) - 180) * T
    frames = flight(np.random.default_rng(17), path, 0.0, -5.0).astype(np.complex64)
    tags = [
        (k, pmt.intern("radalt_frame"), pmt.init_f64vector(6, [float(k), k * N, 0.0, np.nan, 1.0, 0.0]))
        for k in range(len(frames))
    ]
    kept = []
    for seed in (None, 1, 2):
        block, seen = radalt.altitude_tracker(scene), Messages()
        source = Ragged(frames, seed, tags)
        run(source, block, also=(seen,), wires=(((block, "tracked"), (seen, "in")),))
        kept.append((block.outputs(), block.results()))
        assert [m["status"] for m in seen.seen][-1] == "normal" and len(seen.seen) == 9
        assert seen.seen[-1]["line"].startswith("NORMAL  299.")
    alone = AltitudeTracker(block.altimeter, scene.tracker_settings)
    parts = [alone.process(block.altimeter.spectra(frames[at])) for at in (slice(0, 150), slice(150, None))]
    expected = np.concatenate(parts)
    for outputs, results in kept:
        assert outputs.tobytes() == expected.tobytes()
        assert len(results) == len(frames) and results["valid"].all()


def test_block_takes_the_received_frames_on_a_second_input():
    rng = np.random.default_rng(21)
    cleaned = flight(rng, np.full(240, 300.0), 0.0).astype(np.complex64)
    received = cleaned + returns(rng, np.full(240, 500.0))
    scene, outputs = parse_scene({}), []
    for uncleaned in (cleaned, received):
        block, straight = radalt.altitude_tracker(scene, "tcae", received=True), Ragged(uncleaned, 2)
        run(Ragged(cleaned, 1), block, also=(straight,), wires=((straight, (block, 1)),))
        outputs.append(block.outputs())
    assert outputs[0]["status"][-1] == Status.NORMAL
    assert not np.any(outputs[1]["status"] == Status.NORMAL)  # what a method took away


def test_block_says_failure_when_the_segmenter_loses_lock():
    block = radalt.altitude_tracker(parse_scene({}))
    said = []
    block.message_port_pub = lambda port, message: said.append(pmt.to_python(message))
    block._on_timing(pmt.to_pmt({"locked": True, "timing_verified": True}))
    assert not said
    for _ in range(3):  # once is enough
        block._on_timing(pmt.to_pmt({"locked": False, "timing_verified": False}))
    assert [m["status"] for m in said] == ["failure"] and np.isnan(said[0]["altitude_m"])
    assert said[0]["line"] == "FAILURE (lost)" and said[0]["timing_verified"] is False


def test_a_scene_settles_whether_speed_shows_as_doppler():
    assert parse_scene({}).tracker_settings.doppler is False
    assert parse_scene({"altitude": {"mode": "true_delay"}}).tracker_settings.doppler is True
    assert parse_scene({"tracker": {"doppler": True, "risk": 1e-3}}).tracker_settings.risk == 1e-3
