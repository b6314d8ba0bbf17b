"""Results by altitude: rows that add up to the study's, the errors' distribution, and intervals of RMSE."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from radalt.core.altimeter.altimeter import RESULT_DTYPE
from radalt.core.programme import Programme
from radalt.core.scene import Scene
from radalt.evaluation.overlap import altitudes
from radalt.evaluation.overlap.altitudes import ERRORS_M, altitude_rows, rmse_interval
from radalt.evaluation.overlap.figures import draw_error_cdf, draw_pd_by_altitude
from radalt.evaluation.overlap.points import OverlapPoint
from radalt.evaluation.results.score import score

POINT = OverlapPoint.at(0.5, -20.0, 10.0)


def scene_of(altitudes_m: tuple[float, ...], frames: int) -> Scene:
    altitude = replace(Scene().altitude, programme_m=altitudes_m, frames=frames)
    return replace(Scene(), altitude=altitude, methods=("none",))


def measured(programme: Programme, seed: int = 1) -> np.ndarray:
    """Results of a whole programme: errors of a metre, a fifth false peaks, not all declared, one frame silent."""
    rng = np.random.default_rng(seed)
    out = np.zeros(programme.total_frames, dtype=RESULT_DTYPE)
    out["frame_index"] = np.arange(out.size)
    truth = programme.altitude_m(out["frame_index"])
    error = np.where(rng.random(out.size) < 0.2, rng.uniform(-400, 400, out.size), rng.normal(0, 1, out.size))
    out["forced_altitude_m"] = truth + error
    out["forced_altitude_m"][-1] = np.nan
    out["valid"] = rng.random(out.size) < 0.7
    out["altitude_m"] = np.where(out["valid"], out["forced_altitude_m"], np.nan)
    out["valid"][-1] = False
    return out


def test_rows_by_altitude_add_up_to_the_studys():
    scene = scene_of((900.0, 300.0, 40.0), 50)
    results = measured(scene.altitude.programme)
    rows = altitude_rows(scene, POINT, {"none": results})
    assert [(r["altitude_low_m"], r["trials"]) for r in rows] == [(40.0, 50), (300.0, 50), (900.0, 50)]
    whole, expected = altitudes.pool_altitudes(rows), score(results, scene.altitude.programme).row()
    for name in ("trials", "detections", "correct", "forced", "wrong_far", "wrong_bound"):
        assert whole[name] == expected[name], name
    for name in ("pd", "pd_low", "pd_high", "rmse_detected_m", "rmse_forced_m", "bias_m"):
        assert whole[name] == pytest.approx(expected[name], rel=1e-6), name


def test_distribution_counts_trials_within_each_error():
    scene = scene_of((300.0,), 400)
    results = measured(scene.altitude.programme)
    (row,) = altitude_rows(scene, POINT, {"none": results})
    off = np.abs(results["forced_altitude_m"][8:] - 300.0)
    counts = [row[f"within_{error:g}_m"] for error in ERRORS_M]
    assert counts == [int((off <= error).sum()) for error in ERRORS_M]
    assert counts[-1] == row["forced"] == 399 and row["trials"] == 400  # the silent frame has no error at all


def test_a_landing_is_taken_together_in_bands():
    scene = scene_of(tuple(float(a) for a in range(200, 0, -1)), 1)
    rows = altitude_rows(scene, POINT, {"none": measured(scene.altitude.programme)})
    assert len(rows) == 10 and sum(r["trials"] for r in rows) == 200
    assert (rows[0]["altitude_low_m"], rows[0]["altitude_high_m"]) == (1.0, 20.0)
    assert all(a["altitude_high_m"] < b["altitude_low_m"] for a, b in zip(rows, rows[1:], strict=False))


def test_rmse_interval_covers_the_true_value():
    """Normal errors of 2 m, 150 frames, 2,000 repetitions: 95 % within two standard deviations."""
    rng = np.random.default_rng(3)
    moments = ((np.sqrt(np.mean(e**2)), np.mean(e**4)) for e in rng.normal(0.0, 2.0, (2000, 150)))
    rows = [{"forced": 150, "rmse_forced_m": rms, "fourth_forced_m4": fourth} for rms, fourth in moments]
    low, high = np.transpose([rmse_interval(row) for row in rows])
    assert 0.93 <= np.mean((low <= 2.0) & (high >= 2.0)) <= 0.97


def test_rmse_without_a_decision_has_no_interval():
    row = {"forced": 0, "rmse_forced_m": None, "fourth_forced_m4": None}
    assert np.isnan(rmse_interval(row)).all()
    scene = scene_of((300.0,), 20)
    results = measured(scene.altitude.programme)
    results["forced_altitude_m"] = np.nan
    rows = altitude_rows(scene, POINT, {"none": results})
    study = {key: rows[0][key] for key in ("method", "interference", "overlap", "sir_db", "snr_db")}
    assert altitudes.with_intervals([study], rows) == [study | {"rmse_low_m": None, "rmse_high_m": None}]
    assert altitudes.with_intervals([study], []) == [study]


def test_figures_by_altitude_have_at_most_six_panels_from_the_first_sir_to_the_last(tmp_path, undrawn):
    scene = scene_of((900.0, 300.0), 10)
    results = {"none": measured(scene.altitude.programme)}
    points = [OverlapPoint.at(1.0, sir_db, 10.0) for sir_db in range(-48, 1, 4)]
    rows = [row for point in points for row in altitude_rows(scene, point, results)]
    for draw in (partial(draw_pd_by_altitude, title="one"), draw_error_cdf):
        figure = draw(rows, tmp_path / "drawn.png", settings="many")
        titles = [axis.get_title() for axis in figure.axes]
        assert len(titles) == 6 and ("\N{MINUS SIGN}48" in titles[0], titles[-1]) == (True, "SIR 0 dB")
        assert "6 of 13 panels" in figure.get_supxlabel()
