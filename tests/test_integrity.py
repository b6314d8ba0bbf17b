"""Integrity scores: counted by hand, and bounded where nothing was seen."""

import numpy as np
import pytest
from scipy import stats

from radalt.core.tracker.tracker_settings import OUTPUT_DTYPE, Status
from radalt.evaluation.results import integrity as times
from radalt.evaluation.results.integrity import Integrity, integrity, stanford
from radalt.evaluation.results.proportion import clopper_pearson


def outputs_of(status: str, error_m, level_m, truth_m=100.0) -> tuple[np.ndarray, np.ndarray]:
    """Outputs by letters N(ormal), - (no computed data), F(ailure), and their truth."""
    out = np.zeros(len(status), dtype=OUTPUT_DTYPE)
    codes = {"N": Status.NORMAL, "-": Status.NO_COMPUTED_DATA, "F": Status.FAILURE}
    out["status"] = [codes[letter] for letter in status]
    out["frame_index"] = 40 * np.arange(1, len(status) + 1) - 1
    truth = np.full(len(status), float(truth_m))
    normal = out["status"] == Status.NORMAL
    out["altitude_m"] = np.where(normal, truth + error_m, np.nan)
    out["protection_level_m"] = np.where(normal, level_m, np.nan)
    return out, truth


def test_clopper_pearson_is_the_exact_interval():
    for events, trials in ((0, 10), (0, 100_000), (3, 50), (50, 50)):
        low, high = clopper_pearson(events, trials)
        exact = stats.binomtest(events, trials).proportion_ci(method="exact")
        assert (low, high) == pytest.approx((exact.low, exact.high))
    assert clopper_pearson(0, 0) == (0.0, 1.0)
    assert clopper_pearson(0, 10_000)[1] == pytest.approx(1 - 0.025 ** (1 / 10_000))


def test_misleading_and_hazardous_are_told_apart():
    out, truth = outputs_of("NNNNN-F", [0, 3, 15, 15, 25, 0, 0], [1, 1, 1, 12, 30, 0, 0])
    score = integrity(out, truth, alert_limit_m=10.0)
    # errors 3 and 15 and 15 exceed 1, 1 and 12; 15 with a level of 1 is hazardous, with 12 the user was warned
    assert (score.computed, score.failures, score.outputs) == (5, 1, 7)
    assert (score.misleading, score.hazardous, score.unbounded) == (3, 1, 2)
    assert (score.wrong_5m, score.wrong_20m, score.interruptions, score.followed) == (3, 1, 1, 5)
    assert (score.availability, score.continuity) == pytest.approx((3 / 7, 0.8))


def test_an_altitude_without_a_return_is_wrong_by_every_limit():
    out, truth = outputs_of("N", 0.0, 5.0)
    score = integrity(out, np.full(1, np.nan), 10.0)
    assert (score.misleading, score.hazardous, score.wrong_20m, score.wrong_accuracy) == (1, 1, 1, 1)


def test_scores_add_and_empty_ones_say_nothing():
    out, truth = outputs_of("NN-", 0.0, 1.0)
    one = integrity(out, truth, 10.0)
    assert (one + one).outputs == 6 and (one + Integrity()) == one
    nothing = Integrity()
    assert np.isnan([nothing.availability, nothing.continuity, nothing.rate("computed")]).all()


def test_time_to_first_altitude_and_to_alert():
    out, truth = outputs_of("--NNN-N", [0, 0, 0, 50, 50, 0, 0], 1.0)
    assert times.time_to_first_s(out, 1e-3) == pytest.approx(0.12)
    assert np.isnan(times.time_to_first_s(out[:2], 1e-3))
    # the fault is at frame 130; the outputs at 159 and 199 are hazardous, the one at 239 is not given
    assert times.time_to_alert_s(out, truth, 10.0, 1e-3, fault_frame=130) == pytest.approx(0.11)
    assert times.time_to_alert_s(out[:5], truth[:5], 10.0, 1e-3, fault_frame=130) == np.inf
    assert times.time_to_alert_s(out, truth, 60.0, 1e-3, fault_frame=130) == 0.0


def test_stanford_diagram_counts_every_computed_output_once():
    out, truth = outputs_of("NNN-", [0.5, 3.0, 500.0, 0], [1.5, 0.5, 2.5, 0])
    counts = stanford(out, truth, np.array([0.0, 1.0, 2.0, 4.0]))
    assert counts.sum() == 3
    assert counts[0, 1] == counts[2, 0] == counts[2, 2] == 1
