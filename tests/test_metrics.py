"""Pd, its interval and errors against independent statistics; points and seeds of a sweep."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from radalt.core.altimeter.altimeter import RESULT_DTYPE
from radalt.core.interference import Interferer, QpskEmitter
from radalt.core.programme import Programme
from radalt.core.scene import Scene, SweepSpec
from radalt.evaluation.overlap.points import OverlapPoint, parse_axis, point_seed, scene_at, sweep_points
from radalt.evaluation.overlap.rows import make_row
from radalt.evaluation.results.proportion import wilson_interval
from radalt.evaluation.results.score import pool, score

PROGRAMME = Programme(altitudes_m=(600.0, 100.0), frames_per_step=4, preamble_frames=6)


def results(altitude_m, *, valid=None, index=None):
    """Results of the programme's trials (or of given frame indices) with given altitudes."""
    altitude_m = np.asarray(altitude_m, dtype=float)
    out = np.zeros(altitude_m.size, dtype=RESULT_DTYPE)
    out["frame_index"] = np.arange(6, 6 + altitude_m.size) if index is None else index
    out["valid"] = True if valid is None else valid
    out["forced_altitude_m"] = altitude_m
    out["altitude_m"] = np.where(out["valid"], altitude_m, np.nan)
    return out


@pytest.mark.parametrize("trials", [1, 7, 150, 10_000])
def test_wilson_agrees_with_scipy(trials):
    for successes in sorted({0, 1, trials // 3, trials - 1, trials}):
        expected = stats.binomtest(successes, trials).proportion_ci(0.95, method="wilson")
        assert wilson_interval(successes, trials) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_a_missing_detection_counts_against_pd_but_not_against_detected_errors():
    truth = np.repeat([600.0, 100.0], 4)
    error = np.array([0.0, 3.0, -4.0, 300.0, 0.0, 0.0, 6.0, 1.0])
    valid = np.array([1, 1, 1, 0, 1, 1, 1, 1], dtype=bool)
    s = score(results(truth + error, valid=valid), PROGRAMME)
    assert (s.trials, s.detections, s.correct, s.forced, s.frames_lost) == (8, 7, 6, 8, 0)
    assert s.pd == 6 / 8
    assert s.rmse_detected_m == pytest.approx(np.sqrt(np.mean(error[valid] ** 2)))
    assert s.rmse_forced_m == pytest.approx(np.sqrt(np.mean(error**2)))
    assert s.bias_m == pytest.approx(error[valid].mean())


def test_peak_to_sidelobe_ratio_is_0_db_where_the_peak_is_not_the_return_and_pools_as_the_mean():
    truth = np.repeat([600.0, 100.0], 4)
    found = results(truth + np.array([0.0, 3.0, 19.0, 21.0, 0.0, 0.0, -400.0, np.nan]))
    found["peak_to_sidelobe_db"] = [13.0, 12.0, 6.0, 9.0, 13.0, 13.0, 5.0, np.nan]
    s = score(found, PROGRAMME)
    assert s.peak_to_sidelobe_db == pytest.approx((13 + 12 + 6 + 13 + 13) / 7)
    rows = [score(found[:4], PROGRAMME).row(), score(found[4:], PROGRAMME).row()]
    assert pool(rows).peak_to_sidelobe_db == pytest.approx(s.peak_to_sidelobe_db)


def test_correct_means_strictly_within_5_m():
    truth = np.repeat([600.0, 100.0], 4)
    s = score(results(truth + np.array([4.999, -4.999, 5.0, -5.0, 0, 0, 0, 0])), PROGRAMME)
    assert s.correct == 6


def test_the_second_limit_is_the_larger_of_5_m_and_3_percent_of_the_altitude():
    truth = np.repeat([600.0, 100.0], 4)
    s = score(results(truth + np.array([17.9, -18.1, 6.0, 300.0, 4.9, 5.1, 0, 0])), PROGRAMME)
    assert (s.pd, s.pd_3pct) == (3 / 8, 5 / 8)
    rows = [s.row(), s.row()]
    assert pool(rows).pd_3pct == 5 / 8
    del rows[0]["pd_3pct"]  # of an earlier release
    assert np.isnan(pool(rows).pd_3pct) and pool(rows).pd == 3 / 8


def test_only_trials_count_and_frames_that_never_came_out_are_lost():
    # preamble, a trial twice, two trials, one frame past the end, one without index
    index = [5, 7, 7, 8, 10, 14, -1]
    altitude = [0.0, 600.0, 0.0, 600.0, 100.0, 0.0, 600.0]
    s = score(results(altitude, index=index), PROGRAMME)
    assert (s.trials, s.correct, s.frames_lost) == (3, 3, 5)


def test_a_frame_without_forced_decision_is_left_out_of_its_error_only():
    r = results(np.repeat([600.0, 100.0], 4))
    r["valid"][0], r["altitude_m"][0], r["forced_altitude_m"][0] = False, np.nan, np.nan
    s = score(r, PROGRAMME)
    assert (s.trials, s.forced, s.rmse_forced_m) == (8, 7, 0.0)


def test_without_any_trial_there_is_no_pd():
    s = score(results([]), PROGRAMME)
    assert (s.trials, s.frames_lost, s.interval) == (0, 8, (0.0, 1.0))
    assert np.isnan([s.pd, s.rmse_detected_m, s.rmse_forced_m, s.bias_m]).all()


def test_pooled_rows_equal_the_score_of_all_trials_together():
    rng = np.random.default_rng(7)
    programme = Programme(altitudes_m=(300.0,), frames_per_step=40, preamble_frames=6)
    altitude = 300.0 + rng.normal(0.5, 4.0, 40)
    valid = rng.random(40) < 0.7
    everything = results(altitude, valid=valid, index=np.arange(6, 46))
    whole = score(everything, programme)
    halves, at = [], OverlapPoint.at(0.5, -10, 10)
    for part in (everything[:13], everything[13:]):
        s = replace(score(part, programme), frames_lost=0)
        timing = {"ms_per_frame": np.ones(3), "real_time_factor": 1.0}
        halves.append(make_row("none", "x", at, 1, s.row(), diverged_frames=0, segmenter={}, **timing))
    pooled = pool(halves)
    for name in "trials detections correct forced rmse_detected_m rmse_forced_m bias_m".split():
        assert getattr(pooled, name) == pytest.approx(getattr(whole, name), rel=1e-7)


def test_axis_accepts_lists_and_inclusive_spans():
    assert parse_axis("0,0.3,1", "--overlap") == (0.0, 0.3, 1.0)
    assert parse_axis("0:1:0.1", "--overlap") == tuple(round(0.1 * k, 9) for k in range(11))
    assert parse_axis("-10:-30:-10, -28", "--sir-db") == (-10.0, -20.0, -30.0, -28.0)

    for text in ("", "a", "1:2", "0:1:0", "0:1:-0.1", "nan", "0:1e9:1"):
        with pytest.raises(ValueError, match="--overlap"):
            parse_axis(text, "--overlap")


def scene_with(**sweep):
    return Scene(interference=(Interferer(QpskEmitter(), -20.0, 0.5),), sweep=SweepSpec(**sweep))


def test_points_are_every_overlap_at_every_sir():
    points = sweep_points(scene_with(overlap=(0.0, 1.0), sir_db=(-10.0, -28.0)))
    assert [(p.sir_db, p.overlap) for p in points] == [(-10, 0), (-10, 1), (-28, 0), (-28, 1)]
    assert sweep_points(scene_with()) == (OverlapPoint.at(0.5, -20.0, 10.0, frames=150),)
    assert sweep_points(Scene()) == (OverlapPoint.at(0.0, None, 10.0, frames=150),)
    with pytest.raises(ValueError, match="needs interference"):
        sweep_points(Scene(sweep=SweepSpec(overlap=(0.5,))))


def test_seeds_differ_between_points_and_depend_on_nothing_else():
    points = sweep_points(scene_with(overlap=(0.1, 0.2, 1.0), sir_db=(-10.0, -28.0), snr_db=(0.0, 10.0)))
    seeds = [point_seed(seed, p) for seed in (1, 2) for p in points]
    assert len(set(seeds)) == len(seeds) and 0 <= min(seeds) and max(seeds) < 2**31
    assert point_seed(1, OverlapPoint.at(0.1, -10.0, 0.0)) == seeds[0]
    # without interference the SIR makes no difference
    assert point_seed(3, OverlapPoint.at(0.0, -10.0, 10.0)) == point_seed(3, OverlapPoint.at(0.0, None, 10.0))


def test_the_scene_of_a_point_has_its_overlap_sir_snr_and_no_sweep():
    scene = scene_with(overlap=(0.1,), sir_db=(-30.0,), snr_db=(3.0,))
    placed = scene_at(scene, sweep_points(scene)[0])
    (interferer,) = placed.interference
    assert (interferer.overlap, placed.total_sir_db, placed.channel.snr_db) == (0.1, -30.0, 3.0)
    assert placed.sweep == SweepSpec()
