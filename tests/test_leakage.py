"""The transmitter's own leakage: subtracted as calibrated, timing held on it, never taken for the ground."""

import re
from dataclasses import replace

import numpy as np
import pmt
import pytest
from frames import N, W, measured, noise
from test_slips import received

from radalt import AltimeterSettings, AltitudeTracker, TrackerSettings, Waveform, load_scene
from radalt.blocks.frame_segmenter import frame_segmenter
from radalt.core.altimeter.altimeter import shared_altimeter
from radalt.core.parsing import InputError
from radalt.core.programme import Programme
from radalt.core.returns.point import point_return
from radalt.core.scene import SceneError, parse_scene
from radalt.core.timing import leakage as limits
from radalt.core.timing.leakage import LeakageCalibration, LeakageCanceller, ground_is_apart
from radalt.core.timing.leakage_file import leakage_canceller, load_leakage, store_leakage
from radalt.core.timing.segmenter import FrameSegmenter
from radalt.core.tracker.tracker import Status
from radalt.core.waveform import altitude_to_delay_s, exp_cycles
from radalt.evaluation.flowgraph import FlowgraphError
from radalt.evaluation.overlap.report import build_report
from radalt.evaluation.radios.leakage_calibration import calibrate_leakage

SCENE = load_scene("leakage")
NOTHING = LeakageCalibration(W, np.zeros((2, 6), dtype=complex))


def line(level_db: float, distance_m: float) -> np.ndarray:
    return (10.0 ** (level_db / 20.0) * point_return(W, distance_m)).astype(np.complex64)


def power_db(x: np.ndarray) -> float:
    return float(10.0 * np.log10(np.mean(np.abs(x) ** 2)))


def known(leakage: np.ndarray) -> LeakageCanceller:
    """Calibrated without noise."""
    return LeakageCanceller(LeakageCalibration.measured(W, np.tile(leakage, (20, 1))))


def calibrated(leakage: np.ndarray, snr_db: float = 10.0, frames: int = 400) -> LeakageCanceller:
    rng = np.random.default_rng(9)
    return LeakageCanceller(LeakageCalibration.measured(W, leakage + noise(rng, frames, snr_db)))


# -- the shapes -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("offset_samples", [0.0, 0.37])
def test_six_shapes_per_half_sweep_hold_every_delay_within_reach(offset_samples):
    canceller = LeakageCanceller.uncalibrated(W)
    offset_s = offset_samples / W.rate_hz
    canceller.align(offset_s)
    delays = offset_s + altitude_to_delay_s(np.linspace(limits.NEAREST_M, limits.REACH_M, 19))
    frames = exp_cycles(W.phase_cycles(W.sample_times_s - delays[:, None]))
    assert max(power_db(x) for x in canceller.subtract(frames)) < -70.0


@pytest.mark.parametrize("speed", [0.0, -20.0])
def test_frames_are_right_under_40_db_of_leakage_and_20_db_of_landing_gear(speed):
    rng = np.random.default_rng(1)
    leakage = line(40.0, 1.0) + line(20.0, 4.5)
    altitude_m = np.repeat([10.0, 30.0, 100.0, 300.0, 1000.0], 8)
    ground = point_return(W, altitude_m, vertical_speed_m_per_s=speed, phase_cycles=rng.random(40))
    received = ground + leakage + noise(rng, 40, -10.0)
    altimeter = shared_altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=20.0))

    def right(frames):
        return int(np.sum(np.abs(altimeter.process(frames)["altitude_m"] - altitude_m) < 5.0))

    assert right(received) <= 8  # of 10 m, some of the leakage's own line
    assert right(calibrated(leakage, -10.0).subtract(received)) == 40


def test_the_ground_within_reach_of_the_leakage_keeps_what_it_has():
    canceller = calibrated(line(40.0, 1.0), snr_db=60.0, frames=40)
    ground = point_return(W, 4.5)
    rest = canceller.subtract((line(40.0, 1.0) + ground)[None])[0]
    inside = np.flatnonzero(rest)
    assert inside.size > 0.96 * N
    assert power_db(rest[inside] - ground[inside]) < -20.0


def test_a_sweep_whose_phase_runs_on_is_followed_from_frame_to_frame():
    w = Waveform(bandwidth_hz=7.3001e6, centered=False)  # B T_h is 3650.05 cycles
    assert w.cycles_per_frame == pytest.approx(0.05, abs=1e-6)
    index = np.arange(24)
    frames = 100.0 * point_return(w, np.full(24, 1.0), frame_index=index)
    found = LeakageCalibration.measured(w, frames, frame_index=index)
    assert power_db(LeakageCanceller(found).subtract(frames, index)) < 40.0 - 70.0
    # without noise frames repeat, here after twenty, which is no frozen receiver
    segmenter = FrameSegmenter(w, None, true_delay=True, leakage=LeakageCanceller(found), noise=False)
    rest = [f.samples for f in segmenter.push(frames.reshape(-1).astype(np.complex64))]
    assert len(rest) >= 20 and max(power_db(x) for x in rest) < -20.0


# -- learning ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("normal", "altitude_m", "level_m", "speed", "may"),
    [
        (True, 64.0, 3.0, -5.0, True),
        (True, 62.0, 3.0, -5.0, False),  # perhaps no more than 59 m
        (True, 80.0, 3.0, 0.0, False),
        (True, 104.0, 3.0, 0.0, True),
        (False, 200.0, 3.0, -5.0, False),
        (True, 3.0, 2.0, -5.0, False),
        (False, np.nan, np.nan, np.nan, False),
    ],
)
def test_leakage_is_learned_only_where_a_track_is_above_60_m(normal, altitude_m, level_m, speed, may):
    assert (limits.LEARN_ABOVE_M, limits.FITTED_ABOVE_M) == (60.0, 100.0)
    assert ground_is_apart(normal, altitude_m, level_m, speed) is may


@pytest.mark.parametrize(
    ("altitude_m", "speed", "least_db", "most_db"),
    [(40.0, 0.0, -14.0, -12.0), (60.0, 0.0, -1.6, -1.3), (100.0, 0.0, -0.7, -0.3), (60.0, 2.0, -0.01, 0.01)],
)
def test_a_hovering_ground_is_learned_and_a_moving_one_is_not(altitude_m, speed, least_db, most_db):
    """Why 60 m, and why the ground has to move there: what stands still is known apart by its delay alone."""
    canceller = LeakageCanceller(NOTHING)
    ground = point_return(W, altitude_m)
    canceller.remember(ground, 0)
    found, power = canceller._waiting.pop(0)
    for first in range(0, 4000, 400):
        for index in range(first, first + 400):
            phase = 2.0 * speed * index * W.sweep_s * W.carrier_hz / 299792458.0
            canceller._waiting[index] = found * np.exp(-2j * np.pi * phase), power
        canceller.learn(first, first + 399)
    rest = canceller.subtract(ground[None])[0]
    assert least_db < power_db(rest[rest != 0]) < most_db


def test_what_a_fit_leaves_of_a_ground_stands_elsewhere_and_not_from_100_m_on():
    altitude_m = np.array([60.0, 80.0, 100.0, 150.0])
    frames = LeakageCanceller.uncalibrated(W).subtract(point_return(W, altitude_m))
    error = np.abs(shared_altimeter(W, AltimeterSettings()).process(frames)["altitude_m"] - altitude_m)
    np.testing.assert_allclose(error, [3.7, 1.0, 0.2, 0.2], atol=0.3)


def test_block_learns_from_a_trackers_outputs_and_not_at_power_up_near_the_ground():
    block = frame_segmenter(SCENE)
    canceller = block.segmenter._leakage.canceller

    def say(last, altitude_m, status="normal"):
        fields = {"frame_index": last, "status": status, "altitude_m": altitude_m}
        fields |= {"protection_level_m": 2.5, "vertical_speed_m_per_s": -5.0}
        block._on_tracked(pmt.to_pmt(fields))

    assert not canceller.following  # nothing is remembered for a tracker that is not there
    say(39, 3.0)
    for index in range(40, 200):
        canceller.clean(canceller.background, index)
    say(79, 3.0)
    say(119, float("nan"), "no_computed_data")
    assert canceller.learned_frames == 0
    say(159, 150.0)
    assert canceller.learned_frames == 40 and min(canceller._waiting) == 160


def test_a_slow_change_is_followed_and_frames_of_other_blocks_are_not_learned():
    leakage = line(30.0, 1.0)
    canceller = calibrated(leakage, 60.0, 40)
    canceller.following = True
    turned = leakage * np.complex64(np.exp(0.1j))
    for index in range(80):
        canceller.clean(turned, index)
    canceller.forget(39)
    canceller.learn(40, 59)
    assert canceller.learned_frames == 20
    before = power_db(turned - leakage)
    for block in range(40):
        for index in range(80 + 40 * block, 120 + 40 * block):
            canceller.clean(turned, index)
        canceller.learn(80 + 40 * block, 119 + 40 * block)
    rest = canceller.subtract(turned[None])[0]
    assert power_db(rest[rest != 0]) < before - 30.0


@pytest.mark.parametrize("amount_rad", [0.003, 0.054])
def test_what_is_left_of_a_leakage_whose_phase_has_changed(amount_rad):
    """0.003 rad is a phase walk of 0.003 rad per root second after a second, 0.054 rad a vibration by 0.3 mm."""
    assert 4 * np.pi * 0.3e-3 * W.carrier_hz / 299792458.0 == pytest.approx(0.054, abs=0.0005)
    canceller = calibrated(line(40.0, 1.0), 80.0, 40)
    rest = canceller.subtract((line(40.0, 1.0) * np.complex64(np.exp(1j * amount_rad)))[None])[0]
    expected_db = 40.0 + 20.0 * np.log10(amount_rad)
    assert power_db(rest[rest != 0]) == pytest.approx(expected_db, abs=0.5)


# -- timing -----------------------------------------------------------------------------------------------------------
def run(canceller: LeakageCanceller, level_db, gear_db, altitudes_m, seed: int, lost=(0, 0)):
    """(n,) altitudes, true ones, segmenter; ``lost``: a block, and samples missing from it without a tag."""
    programme, gap = Programme(altitudes_m, 16), slice(lost[0] * N, lost[0] * N + lost[1])
    leaks = {"leakage_db": level_db, "leakage_m": 1.0, "gear_db": gear_db}
    stream = np.delete(received(programme, True, 10.0, seed, **leaks), gap)
    segmenter = FrameSegmenter(W, programme, true_delay=True, leakage=canceller)
    frames = [f for at in range(0, stream.size, N) for f in segmenter.push(stream[at : at + N])]
    frames = [f for f in frames + segmenter.drain() if programme.is_trial(f.index)]
    if not frames:
        return np.zeros(0), np.zeros(0), segmenter
    altimeter = shared_altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=20.0))
    found = measured(frames, altimeter)
    return found["altitude_m"], programme.altitude_m(found["frame_index"]), segmenter


LEVELS = [(0.0, None), (10.0, None), (40.0, 20.0)]


@pytest.fixture(scope="module")
def cancellers():
    """By level: made by the same steps as the shipped calibration, 100 frames each."""
    out = {}
    for level_db, gear_db in LEVELS:
        channel = replace(SCENE.channel, leakage_db=level_db, gear_db=gear_db)
        out[level_db] = calibrate_leakage(replace(SCENE, channel=channel, seed=77), 100)
    return out


@pytest.mark.parametrize(("level_db", "gear_db"), LEVELS)
def test_frames_through_the_channel_are_right_from_3_m_to_1000_m(cancellers, level_db, gear_db):
    canceller, altitudes_m = LeakageCanceller(cancellers[level_db]), (1000.0, 100.0, 20.0, 3.0)
    found, truth, segmenter = run(canceller, level_db, gear_db, altitudes_m, 5)
    assert found.size == 64 and segmenter.timing_verified
    assert np.max(np.abs(found - truth)) < 1.5  # NaN would fail as well


@pytest.mark.parametrize("level_db", [-10.0, 0.0, 10.0])
def test_no_altitude_near_the_ground_is_taken_for_a_loss(level_db):
    """There the return merges with the leakage, and no sample separates them."""
    rng = np.random.default_rng(7)
    leakage, altitudes_m = line(level_db, 1.0), (2.0, 4.0, 5.0, 8.5, 13.0, 21.0, 33.0, 60.0)
    programme = Programme(altitudes_m, 3)
    index = np.arange(programme.total_frames)
    ground = programme.is_trial(index)[:, None] * point_return(W, programme.altitude_m(index))
    frames = leakage + ground + noise(rng, index.size, 10.0)
    segmenter = FrameSegmenter(W, programme, true_delay=True, leakage=known(leakage))
    segmenter.push(frames.ravel().astype(np.complex64))
    assert segmenter.counters["lock_losses"] == 0 and segmenter.counters["frames"] >= 28


@pytest.mark.parametrize(
    ("level_db", "gear_db", "lost"),
    [*((*LEVELS[1], lost) for lost in (1, 7499, 2000)), (*LEVELS[0], 1), (*LEVELS[2], 1)],
)
def test_lost_samples_end_the_lock_and_no_altitude_is_wrong(cancellers, level_db, gear_db, lost):
    for altitude_m in (10.0, 300.0):
        canceller = LeakageCanceller(cancellers[level_db])
        found, truth, segmenter = run(canceller, level_db, gear_db, (altitude_m,), 3, (15, lost))
        assert segmenter.counters["lock_losses"] == 1
        assert found.size >= 4 and not np.any(np.abs(found - truth) > 5.0)


@pytest.mark.parametrize("level_db", [20.0, 40.0])
def test_without_a_calibration_frames_above_100_m_come_through_and_losses_are_noticed(level_db):
    fitted = LeakageCanceller.uncalibrated(W)
    found, truth, segmenter = run(fitted, level_db, None, (600.0, 150.0), 6)
    assert found.size == 32 and segmenter.counters["lock_losses"] == 0
    assert np.max(np.abs(found - truth)) < 2.0  # the leakage's path of 1 m among it
    found, truth, segmenter = run(fitted, level_db, None, (300.0,), 6, (15, 700))
    assert segmenter.counters["lock_losses"] == 1 and not np.any(np.abs(found - truth) > 5.0)


@pytest.mark.parametrize(("level_db", "ground_m"), [(20.0, 2.0), (0.0, 8.5), (0.0, 13.0)])
def test_leakage_is_located_by_what_the_ground_cannot_be_if_that_is_enough(level_db, ground_m):
    """A metre from it the ground can be nearly all of it, and is weaker; 8 m off it can be some, and is as strong."""
    leakage = line(level_db, 1.0)
    timing = FrameSegmenter(W, None, true_delay=True, leakage=known(leakage))._leakage
    ground = point_return(W, np.full(6, ground_m), phase_cycles=np.arange(6) / 6)
    frames = np.roll(leakage + ground + noise(np.random.default_rng(1), 6, 10.0), 3, axis=1)
    assert [timing.slip(frame, 0, (ground_m, 0.0)) for frame in frames] == [3.0] * 6


def test_leakage_a_sample_off_its_place_does_not_verify_the_timing_of_a_narrow_sweep():
    """Half as wide as the sampled band, it is two samples wide, and more than half like itself a sample off."""
    w = Waveform(bandwidth_hz=5e6, rate_hz=10e6)
    leakage = (10.0 * point_return(w, 1.0)).astype(np.complex64)
    known = LeakageCanceller(LeakageCalibration.measured(w, np.tile(leakage, (20, 1))))
    timing = FrameSegmenter(w, None, true_delay=True, leakage=known)._leakage
    assert timing.slip(leakage) == 0.0 != timing.slip(np.roll(leakage, 1))


def test_a_return_is_no_leakage_to_take_timing_on():
    segmenter = FrameSegmenter(W, None, true_delay=True, leakage=known(line(0.0, 1.0)))
    rng = np.random.default_rng(2)
    ground = point_return(W, 150.0, phase_cycles=0.3) * 3.0
    assert segmenter.push((ground + noise(rng, 12, 20.0)).reshape(-1)) == []
    assert segmenter.counters["acquisitions"] == 0


def test_with_a_beat_shift_leakage_is_off_and_the_reason_is_said():
    with pytest.raises(ValueError, match="a beat shift moves the leakage with the return"):
        FrameSegmenter(W, Programme(), leakage=LeakageCanceller(NOTHING))
    for section in ({"segmenter": {"leakage_calibration": "leakage"}}, {"channel": {"leakage_db": 10.0}}):
        with pytest.raises(SceneError, match=r"needs altitude\.mode: true_delay"):
            parse_scene(section)


# -- without a calibration --------------------------------------------------------------------------------------------
def tracked(altitude_m, leakage, settings, canceller=None, speed=-5.0, blocks=8, **span):
    """Outputs of a descent next to leakage, and the true altitude at the end of each."""
    rng = np.random.default_rng(1)
    altimeter = shared_altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=20.0, **span))
    tracker, out = AltitudeTracker(altimeter, settings), []
    for block in range(blocks):
        at = altitude_m + speed * 1e-3 * (np.arange(40) + 40 * block)
        frames = point_return(W, at, vertical_speed_m_per_s=speed) + leakage + noise(rng, 40, 10.0)
        out.append(tracker.process(altimeter.spectra(canceller.subtract(frames) if canceller else frames)))
    ends = altitude_m + speed * 1e-3 * (40 * np.arange(1, blocks + 1) - 0.5)
    return np.concatenate(out), ends


@pytest.mark.parametrize(
    ("altitude_m", "level_db", "distance_m"),
    [(300.0, 15.0, 1.0), (300.0, 25.0, 1.0), (60.0, 20.0, 1.0), (200.0, 10.0, 4.5), (30.0, 10.0, 4.5)],
)
def test_neither_leakage_nor_landing_gear_is_an_altitude(altitude_m, level_db, distance_m):
    leakage = line(level_db, distance_m)
    # as if nothing stood there but ground
    before, truth = tracked(altitude_m, leakage, TrackerSettings(leakage_m=0.0))
    assert np.sum(np.abs(before["altitude_m"] - truth) > 5.0) >= 5
    out, _ = tracked(altitude_m, leakage, TrackerSettings())
    assert not np.any(out["status"] == Status.NORMAL)


@pytest.mark.parametrize("level_db", [20.0, 40.0])
def test_leakage_that_is_fitted_leaves_altitudes_above_100_m_and_none_below(level_db):
    fitted = LeakageCanceller.uncalibrated(W)
    for altitude_m, some in ((110.0, True), (80.0, False), (40.0, False)):
        slow = {"speed": -2.0, "min_altitude_m": 100.0}
        out, truth = tracked(altitude_m, line(level_db, 1.0), TrackerSettings(), fitted, **slow)
        normal = out["status"] == Status.NORMAL
        assert normal.sum() >= 4 if some else not normal.any()
        assert not np.any(np.abs(out["altitude_m"] - truth)[normal] > 1.0)


def test_a_track_from_above_goes_on_where_none_starts():
    out, truth = tracked(17.0, np.zeros(N, np.complex64), TrackerSettings(), speed=-10.0, blocks=12)
    normal = out["status"] == Status.NORMAL
    assert truth[-1] < 13.0 and normal[-3:].all() and np.abs(out["altitude_m"] - truth)[-1] < 1.0
    started, _ = tracked(12.0, np.zeros(N, np.complex64), TrackerSettings(), speed=0.0)
    assert not np.any(started["status"] == Status.NORMAL)


def test_a_scene_says_where_a_track_may_start():
    leaks = {"altitude": {"mode": "true_delay"}, "channel": {"leakage_db": 20.0}}
    scenes = SCENE, *map(parse_scene, ({}, leaks, leaks | {"tracker": {"leakage_m": 20.0}}))
    assert [scene.tracker_settings.leakage_m for scene in scenes] == [0.0, 0.0, None, 20.0]
    with pytest.raises(SceneError, match=r"needs altimeter\.min_altitude_m of 100"):
        parse_scene(leaks | {"segmenter": {"leakage_calibration": "uncalibrated"}})


# -- calibrations -----------------------------------------------------------------------------------------------------
def test_the_shipped_calibration_is_what_its_command_measures():
    shipped = load_leakage("leakage", W)
    again = calibrate_leakage(SCENE, 60)
    apart = np.sum(np.abs(again.coefficients - shipped.coefficients) ** 2)
    assert apart < 1e-4 * np.sum(np.abs(shipped.coefficients) ** 2)
    assert again.installation_delay_m == pytest.approx(shipped.installation_delay_m, abs=0.1)


def test_installation_delay_is_calibrated_and_subtracted():
    rng = np.random.default_rng(3)
    cables_m = 12.2  # 40 ft
    found = LeakageCalibration.measured(W, np.tile(line(10.0, 0.0), (20, 1)))
    found = found.with_installation(300.0 + cables_m + 0.3 * rng.standard_normal(60), 300.0)
    assert found.installation_delay_m == pytest.approx(cables_m, abs=0.2)
    leakage, ground = line(10.0, 0.0), point_return(W, 50.0 + cables_m)
    alone = [leakage + noise(rng, 1, 20.0)[0] for _ in range(8)]
    flown = [leakage + ground + noise(rng, 1, 20.0)[0] for _ in range(8)]
    segmenter = FrameSegmenter(W, None, true_delay=True, leakage=LeakageCanceller(found))
    frames = segmenter.push(np.concatenate([np.zeros(500, np.complex64), *alone, *flown]))[-4:]
    np.testing.assert_allclose(measured(frames)["altitude_m"], 50.0, atol=0.5)


def test_a_stored_calibration_comes_back_and_another_sweeps_is_refused(tmp_path):
    found = LeakageCalibration.measured(W, np.tile(line(30.0, 1.0), (20, 1)))
    path = store_leakage(replace(found, installation_delay_m=-0.97), tmp_path / "new" / "mine.yaml")
    again = load_leakage(path, W)
    assert again.installation_delay_m == -0.97
    np.testing.assert_allclose(again.coefficients, found.coefficients, rtol=1e-5)
    with pytest.raises(InputError, match="another sweep.*calibrate anew"):
        load_leakage(path, Waveform(sweep_s=2e-3))
    text = path.read_text()
    far, loud = text.replace("-0.97", "-5000.0"), re.sub(r"- \[[^,]+", "- [1.0e+308", text, count=1)
    renamed, nan = text.replace("up:", "aloft:"), text.replace("- [", "- [.nan, ", 1)
    for wrong in (renamed, nan, "[1, 2]", "{", far, loud):
        path.write_text(wrong)
        with pytest.raises(InputError, match="leakage calibration"):
            load_leakage(path, W)
    assert leakage_canceller("", W) is None
    assert not leakage_canceller("uncalibrated", W).calibrated
    assert leakage_canceller("leakage", W).calibrated


def test_a_run_without_a_frame_ends_in_one_line():
    rows = [{"trials": 0, "lock_losses": 1, "pd": None}]
    with pytest.raises(FlowgraphError, match="no frame: timing not acquired"):
        build_report({}, None, {"rows": rows}, None)
