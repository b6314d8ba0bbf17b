"""What a batch of altitudes is worth against the truth: one scorer for every study.

A *trial* is a frame that was asked for an altitude. It is *detected* if the altimeter declared one, *correct* if that
lies within 5 m of the truth, *wrong and valid* if it was declared and does not. A trial without detection counts
against Pd, never against the error of detections. The error of the forced decision is over all frames that have one; a
frame that held nothing (silent, not finite, diverged) has none, and ``forced`` says how many did.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from scipy.special import betaincinv, ndtri

from ...core.programme import Programme

__all__ = [
    "CORRECT_LIMIT_M",
    "FAR_LIMIT_M",
    "SCORE_COLUMNS",
    "Score",
    "clopper_pearson_bound",
    "pool",
    "score",
    "score_frames",
    "wilson_interval",
]

CORRECT_LIMIT_M = 5.0  # success criterion of the paper
FAR_LIMIT_M = 20.0  # a range cell of the default radar: beyond it, it is another target


def wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Score interval of a binomial proportion; (0, 1) without trials.

    E. B. Wilson, "Probable inference, the law of succession, and statistical inference", J. Am. Stat. Assoc.
    22, 1927. Unlike the normal interval it stays within 0..1 and keeps its width at 0 and at 1.

    Parameters
    ----------
    successes, trials : int
        ``0 <= successes <= trials``.
    confidence : float
        Coverage, within 0..1 exclusive.

    Raises
    ------
    ValueError
        If a count or the confidence is out of range.

    Examples
    --------
    >>> low, high = wilson_interval(8, 10)
    >>> round(low, 3), round(high, 3)
    (0.49, 0.943)
    """
    _check_counts(successes, trials, confidence)
    if trials == 0:
        return 0.0, 1.0
    z2 = float(ndtri(0.5 + 0.5 * confidence)) ** 2
    p = successes / trials
    centre = p + z2 / (2 * trials)
    half = np.sqrt(z2 * (p * (1 - p) / trials + z2 / (4 * trials**2)))
    low, high = (centre - half) / (1 + z2 / trials), (centre + half) / (1 + z2 / trials)
    # at the ends the bound is the end itself; rounding must not step over it
    return (0.0 if successes == 0 else float(low)), (1.0 if successes == trials else float(high))


def clopper_pearson_bound(events: int, trials: int, confidence: float = 0.95) -> float:
    """One-sided upper bound of a rate; 1 without trials. Zero events give a bound too, about 3 / trials.

    C. J. Clopper and E. S. Pearson, "The use of confidence or fiducial limits illustrated in the case of the
    binomial", Biometrika 26, 1934: exact, never below the stated confidence.

    Raises
    ------
    ValueError
        If a count or the confidence is out of range.

    Examples
    --------
    >>> round(clopper_pearson_bound(0, 300), 5)
    0.00994
    """
    _check_counts(events, trials, confidence)
    return 1.0 if events >= trials else float(betaincinv(events + 1, trials - events, confidence))


def _check_counts(successes: int, trials: int, confidence: float) -> None:
    if not 0 <= successes <= trials:
        raise ValueError(f"{successes} successes of {trials} trials; expected 0 <= successes <= trials")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence is {confidence!r}; it has to lie between 0 and 1")


@dataclass(frozen=True)
class Score:
    """Counts and error sums of a set of trials; sums rather than means, so that sets can be added.

    Attributes
    ----------
    trials, detections, correct : int
        See the module.
    forced : int
        Trials with a forced decision: all but those whose frame held nothing or was not finite.
    lost : int
        Frames of the programme that never came out of the segmenter; in none of the other counts.
    far : int
        Detections at least 20 m off.
    squared_detected_m2, error_detected_m : float
        Sums over detections of the squared error and of the signed error (measured minus true).
    squared_forced_m2 : float
        Sum over forced decisions of the squared error.
    """

    trials: int = 0
    detections: int = 0
    correct: int = 0
    forced: int = 0
    lost: int = 0
    far: int = 0
    squared_detected_m2: float = 0.0
    error_detected_m: float = 0.0
    squared_forced_m2: float = 0.0

    def __add__(self, other: Score) -> Score:
        return Score(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    @property
    def pd(self) -> float:
        """Probability of correct altitude; NaN without trials."""
        return _ratio(self.correct, self.trials)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval of `pd`."""
        return wilson_interval(self.correct, self.trials)

    @property
    def wrong(self) -> int:
        """Trials whose declared altitude was wrong: valid, and 5 m off or more."""
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

    def row(self) -> dict[str, Any]:
        """The columns that every study's rows share, `SCORE_COLUMNS`."""
        low, high = self.interval
        return {
            "trials": self.trials,
            "detections": self.detections,
            "correct": self.correct,
            "pd": self.pd,
            "pd_low": low,
            "pd_high": high,
            "rmse_detected_m": self.rmse_detected_m,
            "rmse_forced_m": self.rmse_forced_m,
            "bias_m": self.bias_m,
            "forced": self.forced,
            "frames_lost": self.lost,
            "wrong_far": self.far,
            "wrong_bound": self.wrong_bound,
        }


def _ratio(total: float, count: int) -> float:
    return total / count if count else float("nan")


SCORE_COLUMNS = tuple(Score().row())


def score_frames(results: np.ndarray, truth_m: np.ndarray, *, lost: int = 0) -> Score:
    """Judge results against the altitudes that were true.

    Parameters
    ----------
    results : (n,) structured array of the altimeter's `RESULT_DTYPE`
    truth_m : (n,) metres
    lost : int
        Frames that were flown and are not among the results.
    """
    valid = results["valid"]
    error = (results["altitude_m"] - truth_m)[valid]
    forced = results["forced_altitude_m"] - truth_m
    forced = forced[np.isfinite(forced)]
    size = np.abs(error)
    return Score(
        trials=len(results),
        detections=int(valid.sum()),
        correct=int((size < CORRECT_LIMIT_M).sum()),
        forced=forced.size,
        lost=lost,
        far=int((size >= FAR_LIMIT_M).sum()),
        squared_detected_m2=float(error @ error),
        error_detected_m=float(error.sum()),
        squared_forced_m2=float(forced @ forced),
    )


def score(results: np.ndarray, programme: Programme) -> Score:
    """Judge one method's results against the programme.

    Parameters
    ----------
    results : (n,) structured array of `RESULT_DTYPE`
        Any order; frames outside the trials (preamble, synchronisation, past the end) do not count, and of a
        frame index that occurs twice only the first.
    programme : Programme
        Which altitude was flown in which frame.
    """
    results = results[programme.is_trial(results["frame_index"])]
    _, first = np.unique(results["frame_index"], return_index=True)
    results = results[first]
    truth = programme.altitude_m(results["frame_index"])
    return score_frames(results, truth, lost=programme.trial_frames - len(results))


def pool(rows: Sequence[dict[str, Any]]) -> Score:
    """The `Score` of several rows of reports together: counts added, error sums rebuilt from means."""

    def total(count: str, mean: str, power: int) -> float:
        # a row without detections has no mean and adds nothing
        return float(sum(row[count] * row[mean] ** power for row in rows if row[count]))

    def counted(name: str) -> int:
        return sum(row[name] for row in rows)

    return Score(
        trials=counted("trials"),
        detections=counted("detections"),
        correct=counted("correct"),
        forced=counted("forced"),
        lost=counted("frames_lost"),
        far=counted("wrong_far"),
        squared_detected_m2=total("detections", "rmse_detected_m", 2),
        error_detected_m=total("detections", "bias_m", 1),
        squared_forced_m2=total("forced", "rmse_forced_m", 2),
    )
