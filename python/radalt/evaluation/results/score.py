"""Score of altitudes against the truth, for every study.

A *trial* is a frame of the programme. It is *detected* if the altimeter declared an altitude, *correct* if the altitude
is within 5 m of the truth, *wrong and valid* if it is declared and not correct. A trial without detection counts
against Pd, never against the error of detections. *Pd, 5 m or 3 %* (``pd_3pct``) is by a second limit, the larger of
5 m and 3 % of the altitude: over spread ground a single frame's speckle alone moves the altitude by more than 5 m. The
error of the forced decision is over all frames that have one; an empty frame (silent, not finite, diverged) has none,
and ``forced`` is the number of the others.

*Peak-to-sidelobe ratio*: the main lobe of the range profile over the strongest cell outside it, in decibels, the mean
over forced decisions. It is 0 dB for an error of 20 m or more, where the peak is not the return.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ...core.programme import Programme
from .proportion import clopper_pearson_bound, wilson_interval
from .rows import bits

CORRECT_LIMIT_M = 5.0  # largest error of a correct altitude, m: the paper's success criterion
# the same as a share of the altitude, where that is more: docs/tracker.md, "Which altitude"
NEAR_SHARE = 0.03
FAR_LIMIT_M = 20.0  # error from which a detection is another target, m: a range cell of the default sweep
_FT_M = 0.3048  # international foot


def accuracy_limit_m(altitude_m: np.ndarray | float) -> np.ndarray:
    """Accuracy quoted at second hand of RTCA DO-155, which was not read: 3 ft, 3 % from 100 ft, 5 % above 500 ft."""
    altitude = np.abs(np.asarray(altitude_m, dtype=float))
    share = np.where(altitude > 500.0 * _FT_M, 0.05, 0.03)
    return np.maximum(3.0 * _FT_M, share * altitude)


@dataclass(frozen=True)
class Score:
    """Counts and error sums of a set of trials; sets are added with ``+``."""

    # see the module
    trials: int = 0
    detections: int = 0
    correct: int = 0
    forced: int = 0  # trials with a forced decision: all but those of empty or non-finite frames
    frames_lost: int = 0  # frames of the programme that the segmenter did not output; not in the other counts
    wrong_far: int = 0  # detections with an error of 20 m or more
    # sums over detections of the squared error and of the signed error (measured minus true)
    squared_detected_m2: float = 0.0
    error_detected_m: float = 0.0
    squared_forced_m2: float = 0.0  # sum over forced decisions of the squared error
    peak_to_sidelobe_sum_db: float = 0.0  # sum over forced decisions of the peak-to-sidelobe ratio
    near: float = 0.0  # detections within the second limit; NaN where a row does not have it

    def __add__(self, other: "Score") -> "Score":
        return Score(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    @property
    def pd(self) -> float:
        """Probability of correct altitude; NaN without trials."""
        return _ratio(self.correct, self.trials)

    @property
    def pd_3pct(self) -> float:
        """Probability of an altitude within the larger of 5 m and 3 %; NaN without trials."""
        return _ratio(self.near, self.trials)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval of `pd`."""
        return wilson_interval(self.correct, self.trials)

    @property
    def wrong(self) -> int:
        """Trials with a declared altitude whose error is 5 m or more."""
        return self.detections - self.correct

    @property
    def wrong_bound(self) -> float:
        """95 % upper bound (Clopper and Pearson) of the rate of wrong and valid altitudes per trial."""
        return clopper_pearson_bound(self.wrong, self.trials)

    @property
    def rmse_detected_m(self) -> float:
        """Root mean square error over detections; NaN without any."""
        return float(np.sqrt(_ratio(self.squared_detected_m2, self.detections)))

    @property
    def rmse_forced_m(self) -> float:
        """Root mean square error over forced decisions; NaN without any."""
        return float(np.sqrt(_ratio(self.squared_forced_m2, self.forced)))

    @property
    def bias_m(self) -> float:
        """Mean signed error over detections; NaN without any."""
        return _ratio(self.error_detected_m, self.detections)

    @property
    def peak_to_sidelobe_db(self) -> float:
        """Mean peak-to-sidelobe ratio over forced decisions, see the module; NaN without any."""
        return _ratio(self.peak_to_sidelobe_sum_db, self.forced)

    def row(self) -> dict[str, Any]:
        """The columns that every study's rows share, `SCORE_COLUMNS`."""
        ends = dict(zip(("pd_low", "pd_high"), self.interval, strict=True))
        return {name: ends[name] if name in ends else getattr(self, name) for name in _ROW}


def _ratio(total: float, count: int) -> float:
    return total / count if count else float("nan")


_ROW = (
    *("trials", "detections", "correct", "pd", "pd_low", "pd_high", "rmse_detected_m", "rmse_forced_m"),
    *("bias_m", "forced", "frames_lost", "wrong_far", "wrong_bound", "peak_to_sidelobe_db", "pd_3pct"),
)
SCORE_COLUMNS = _ROW[:-1]  # stored rows of the bench have no `pd_3pct`
_COUNTS = ("trials", "detections", "correct", "forced", "frames_lost", "wrong_far")
BITS = ("right", "declared")  # a bit per trial: whether its altitude is correct, whether one is declared


def frame_columns(
    trials: np.ndarray, truth_m: np.ndarray, *, lost: int = 0, limit_m: float = CORRECT_LIMIT_M
) -> dict[str, Any]:
    """The columns of a row of frames, in the bench and in the main study: `Score.row` and `BITS`; as `score_frames`."""
    right = trials["valid"] & (np.abs(trials["altitude_m"] - truth_m) < limit_m)
    found = score_frames(trials, truth_m, lost=lost, limit_m=limit_m).row()
    return found | dict(zip(BITS, map(bits, (right, trials["valid"])), strict=True))


def score_frames(
    results: np.ndarray, truth_m: np.ndarray, *, lost: int = 0, limit_m: float = CORRECT_LIMIT_M
) -> Score:
    """Score altimeter results (`RESULT_DTYPE`) against true altitudes in metres.

    ``lost``: frames of the programme that are missing in the results. ``limit_m``: largest error of a correct altitude.
    """
    valid = results["valid"]
    error = (results["altitude_m"] - truth_m)[valid]
    forced = results["forced_altitude_m"] - truth_m
    decided = np.isfinite(forced)
    forced = forced[decided]
    sidelobe_db = results["peak_to_sidelobe_db"][decided]
    size = np.abs(error)
    near_m = np.maximum(limit_m, NEAR_SHARE * np.broadcast_to(truth_m, valid.shape)[valid])
    return Score(
        trials=len(results),
        detections=int(valid.sum()),
        correct=int((size < limit_m).sum()),
        forced=forced.size,
        frames_lost=lost,
        wrong_far=int((size >= FAR_LIMIT_M).sum()),
        squared_detected_m2=float(error @ error),
        error_detected_m=float(error.sum()),
        squared_forced_m2=float(forced @ forced),
        peak_to_sidelobe_sum_db=float(sidelobe_db[np.abs(forced) < FAR_LIMIT_M].sum()),
        near=float((size < near_m).sum()),
    )


def score(results: np.ndarray, programme: Programme, truth_m: np.ndarray | None = None) -> Score:
    """Score one method's results against the programme.

    Parameters
    ----------
    results : (n,) structured array of `RESULT_DTYPE`
        In any order; frames outside the trials (preamble, synchronisation, past the end) and repetitions of a frame
        index do not count.
    programme : Programme
        True altitudes by frame.
    truth_m : (n,) metres, optional
        True altitudes instead of the programme's, where altitudes were set by hand.
    """
    counted, true = trials_of(results, programme, truth_m)
    return score_frames(counted, true, lost=programme.trial_frames - len(counted))


def trials_of(
    results: np.ndarray, programme: Programme, truth_m: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Results of the trials, one each, and their true altitudes in metres; parameters as in `score`."""
    if truth_m is None:
        truth_m = programme.altitude_m(results["frame_index"])
    trials = np.flatnonzero(programme.is_trial(results["frame_index"]))
    _, first = np.unique(results["frame_index"][trials], return_index=True)
    return results[trials[first]], truth_m[trials[first]]


def pool(rows: Sequence[dict[str, Any]]) -> Score:
    """Pooled `Score` of rows of reports: sums of counts, error sums from means."""

    def total(count: str, mean: str, power: int) -> float:
        # a row without detections has no mean
        return float(sum(row[count] * row[mean] ** power for row in rows if row[count]))

    def stated(name: str, count: str) -> bool:
        # without the column in one row, the pool has no value
        return all(row.get(name) is not None for row in rows if row[count])

    return Score(
        **{name: sum(row[name] for row in rows) for name in _COUNTS},
        squared_detected_m2=total("detections", "rmse_detected_m", 2),
        error_detected_m=total("detections", "bias_m", 1),
        squared_forced_m2=total("forced", "rmse_forced_m", 2),
        peak_to_sidelobe_sum_db=total("forced", "peak_to_sidelobe_db", 1)
        if stated("peak_to_sidelobe_db", "forced")
        else float("nan"),
        near=total("trials", "pd_3pct", 1) if stated("pd_3pct", "trials") else float("nan"),
    )
