"""What a batch of results is worth: probability of correct altitude with its interval, errors, bias.

A *trial* is a frame of the programme that the segmenter gave out. It counts as *detected* if the altimeter
declared an altitude, as *correct* if that lies within 5 m of the truth. A trial without detection counts
against Pd, never against the error of detections; the error over all trials uses the forced decision.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from ...core.programme import Programme

__all__ = ["CORRECT_LIMIT_M", "Score", "pool", "score", "wilson_interval"]

CORRECT_LIMIT_M = 5.0  # success criterion of the paper


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
    if not 0 <= successes <= trials:
        raise ValueError(f"{successes} successes of {trials} trials; expected 0 <= successes <= trials")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence is {confidence!r}; it has to lie between 0 and 1")
    if trials == 0:
        return 0.0, 1.0
    z2 = float(ndtri(0.5 + 0.5 * confidence)) ** 2
    p = successes / trials
    centre = p + z2 / (2 * trials)
    half = np.sqrt(z2 * (p * (1 - p) / trials + z2 / (4 * trials**2)))
    low, high = (centre - half) / (1 + z2 / trials), (centre + half) / (1 + z2 / trials)
    # at the ends the bound is the end itself; rounding must not step over it
    return (0.0 if successes == 0 else float(low)), (1.0 if successes == trials else float(high))


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
    squared_detected_m2: float = 0.0
    error_detected_m: float = 0.0
    squared_forced_m2: float = 0.0

    @property
    def pd(self) -> float:
        """Probability of correct altitude; NaN without trials."""
        return _ratio(self.correct, self.trials)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval of `pd`."""
        return wilson_interval(self.correct, self.trials)

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


def _ratio(total: float, count: int) -> float:
    return total / count if count else float("nan")


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
    valid = results["valid"]
    error = (results["altitude_m"] - truth)[valid]
    forced = (results["forced_altitude_m"] - truth)[np.isfinite(results["forced_altitude_m"])]
    return Score(
        trials=len(results),
        detections=int(valid.sum()),
        correct=int((np.abs(error) < CORRECT_LIMIT_M).sum()),
        forced=forced.size,
        lost=programme.trial_frames - len(results),
        squared_detected_m2=float(error @ error),
        error_detected_m=float(error.sum()),
        squared_forced_m2=float(forced @ forced),
    )


def pool(rows: list[dict]) -> Score:
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
        squared_detected_m2=total("detections", "rmse_detected_m", 2),
        error_detected_m=total("detections", "bias_m", 1),
        squared_forced_m2=total("forced", "rmse_forced_m", 2),
    )
