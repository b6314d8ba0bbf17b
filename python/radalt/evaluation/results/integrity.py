"""What a tracker's outputs are worth to whoever flies by them: integrity, continuity, availability, time to alert.

An output is *computed* if its status is NORMAL. A computed one is *misleading* if its error exceeds its protection
level, *hazardous* if the error exceeds the alert limit while the protection level is within it: nobody was warned (the
terms of RTCA DO-229 for satellite navigation, and of the Stanford diagram). Rates carry Clopper-Pearson intervals,
whose upper bound says something for zero events as well.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ...core.receiver.tracker_settings import Status
from .proportion import clopper_pearson
from .score import CORRECT_LIMIT_M, FAR_LIMIT_M, accuracy_limit_m

__all__ = [
    "Integrity",
    "integrity",
    "stanford",
    "time_to_alert_s",
    "time_to_first_s",
]



@dataclass(frozen=True)
class Integrity:
    """Counts over a set of outputs; counts rather than rates, so that sets can be added with ``+``.

    Attributes
    ----------
    outputs, computed : int
        All outputs with a known truth; those called NORMAL.
    failures : int
        Outputs called FAILURE.
    misleading, hazardous : int
        See the module.
    wrong_5m, wrong_20m, wrong_accuracy : int
        Computed outputs whose error is at least 5 m, 20 m, or beyond the accuracy of DO-155 at the true altitude.
    interruptions : int
        Computed outputs whose next one is not.
    followed : int
        Computed outputs that have a next one.
    unbounded : int
        Computed outputs whose protection level exceeds the alert limit: given, but not to be used.
    """

    outputs: int = 0
    computed: int = 0
    failures: int = 0
    misleading: int = 0
    hazardous: int = 0
    wrong_5m: int = 0
    wrong_20m: int = 0
    wrong_accuracy: int = 0
    interruptions: int = 0
    followed: int = 0
    unbounded: int = 0

    def __add__(self, other: Integrity) -> Integrity:
        return Integrity(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def rate(self, name: str) -> float:
        """A count over all outputs, computed or not; NaN without any."""
        return getattr(self, name) / self.outputs if self.outputs else float("nan")

    def interval(self, name: str, confidence: float = 0.95) -> tuple[float, float]:
        """Clopper-Pearson interval of `rate`."""
        return clopper_pearson(getattr(self, name), self.outputs, confidence)

    @property
    def availability(self) -> float:
        """Share of outputs that are computed with a protection level within the alert limit; NaN without outputs."""
        return (self.computed - self.unbounded) / self.outputs if self.outputs else float("nan")

    @property
    def continuity(self) -> float:
        """Probability that a computed output is followed by another; NaN where none was followed at all."""
        return 1.0 - self.interruptions / self.followed if self.followed else float("nan")


def integrity(outputs: np.ndarray, truth_m: np.ndarray, alert_limit_m: np.ndarray | float) -> Integrity:
    """Judge the outputs of one run, in the order of time.

    Parameters
    ----------
    outputs : (n,) structured array of `tracker.OUTPUT_DTYPE`
    truth_m : (n,) float
        True altitude at each output's time. NaN where there is no return at all: whatever is computed there is
        misleading, hazardous and wrong by every limit. An output without a meaning (a frame of synchronisation) has to
        be left out by the caller.
    alert_limit_m : (n,) or scalar, > 0
        Error that must not go unnoticed.

    Raises
    ------
    ValueError
        If the lengths differ or an alert limit is not above 0.
    """
    truth = np.asarray(truth_m, dtype=float)
    if truth.shape != outputs.shape:
        raise ValueError(
            f"truth_m has shape {truth.shape}, outputs {outputs.shape}; they have to be one to one"
        )
    limit = np.broadcast_to(np.asarray(alert_limit_m, dtype=float), truth.shape)
    if not np.all(limit > 0):
        raise ValueError(f"alert_limit_m holds {limit[~(limit > 0)][0]!r}; it has to be above 0")
    computed = outputs["status"] == Status.NORMAL
    error = np.where(np.isfinite(truth), np.abs(outputs["altitude_m"] - truth), np.inf)
    level = outputs["protection_level_m"]

    def count(which: np.ndarray) -> int:
        return int(np.count_nonzero(computed & which))

    accuracy = np.where(np.isfinite(truth), accuracy_limit_m(np.nan_to_num(truth)), 0.0)
    return Integrity(
        outputs=len(outputs),
        computed=int(computed.sum()),
        failures=int(np.count_nonzero(outputs["status"] == Status.FAILURE)),
        misleading=count(error > level),
        hazardous=count((error > limit) & (level <= limit)),
        wrong_5m=count(error >= CORRECT_LIMIT_M),
        wrong_20m=count(error >= FAR_LIMIT_M),
        wrong_accuracy=count(error > accuracy),
        interruptions=int(np.count_nonzero(computed[:-1] & ~computed[1:])),
        followed=int(np.count_nonzero(computed[:-1])),
        unbounded=count(level > limit),
    )


def time_to_first_s(outputs: np.ndarray, sweep_s: float, *, from_frame: int = 0) -> float:
    """Seconds from the start of a frame to the end of the first computed output; NaN if there is none."""
    computed = (outputs["status"] == Status.NORMAL) & (outputs["frame_index"] >= from_frame)
    if not computed.any():
        return float("nan")
    return float((outputs["frame_index"][computed][0] + 1 - from_frame) * sweep_s)


def time_to_alert_s(
    outputs: np.ndarray,
    truth_m: np.ndarray,
    alert_limit_m: np.ndarray | float,
    sweep_s: float,
    *,
    fault_frame: int,
) -> float:
    """Seconds from a fault to the first output from which on none is hazardous any more; 0 if none ever was.

    Infinite where the last output still is.

    Parameters
    ----------
    outputs, truth_m, alert_limit_m
        As in `integrity`.
    sweep_s : float
        Seconds per frame.
    fault_frame : int
        First frame that the fault touches.
    """
    truth = np.asarray(truth_m, dtype=float)
    error = np.where(np.isfinite(truth), np.abs(outputs["altitude_m"] - truth), np.inf)
    hazardous = (outputs["status"] == Status.NORMAL) & (error > alert_limit_m)
    hazardous &= (outputs["protection_level_m"] <= alert_limit_m) & (outputs["frame_index"] >= fault_frame)
    if not hazardous.any():
        return 0.0
    last = int(np.nonzero(hazardous)[0][-1])
    if last + 1 == len(outputs):
        return float("inf")
    return float((outputs["frame_index"][last + 1] + 1 - fault_frame) * sweep_s)


def stanford(outputs: np.ndarray, truth_m: np.ndarray, edges_m: np.ndarray) -> np.ndarray:
    """(k, k) counts of computed outputs by error (rows) and protection level (columns): the Stanford diagram.

    Parameters
    ----------
    outputs, truth_m
        As in `integrity`.
    edges_m : (k + 1,) float
        Rising bin edges from 0; what lies beyond the last counts in the last bin.
    """
    edges = np.asarray(edges_m, dtype=float)
    truth = np.asarray(truth_m, dtype=float)
    computed = outputs["status"] == Status.NORMAL
    error = np.where(np.isfinite(truth), np.abs(outputs["altitude_m"] - truth), np.inf)[computed]
    level = outputs["protection_level_m"][computed]
    top = np.nextafter(edges[-1], 0.0)
    counts, _, _ = np.histogram2d(np.minimum(error, top), np.minimum(level, top), bins=(edges, edges))
    return counts.astype(np.int64)
