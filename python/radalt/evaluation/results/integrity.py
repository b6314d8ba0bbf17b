"""Performance of a tracker's outputs: integrity, continuity, availability, time to alert.

An output is *computed* if its status is NORMAL. A computed one is *misleading* if its error exceeds its protection
level, *hazardous* if the error exceeds the alert limit while the protection level is within it, so without a warning
(terms of RTCA DO-229 for satellite navigation, and of the Stanford diagram). Rates have Clopper-Pearson intervals,
whose upper bound is above zero for zero events as well.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ...core.tracker.tracker_settings import Status
from .proportion import clopper_pearson_bound
from .score import CORRECT_LIMIT_M, FAR_LIMIT_M, accuracy_limit_m

_LEAST_ALERT_M = 10.0  # least alert limit, m: half a range cell of the default sweep


def alert_limit_m(altitude_m: np.ndarray | float) -> np.ndarray:
    """Alert limit of the campaigns in metres: the accuracy of DO-155, at least 10 m; 10 m without a return.

    The floor is half a range cell of 20 m: two closer returns are one peak.
    """
    return np.maximum(_LEAST_ALERT_M, accuracy_limit_m(np.nan_to_num(altitude_m)))


def error_m(outputs: np.ndarray, truth_m: np.ndarray) -> np.ndarray:
    """(n,) error of each computed altitude, NaN for others; infinite where there is no return (truth NaN)."""
    error = np.where(np.isfinite(truth_m), np.abs(outputs["altitude_m"] - truth_m), np.inf)
    return np.where(outputs["status"] == Status.NORMAL, error, np.nan)


def is_hazardous(outputs: np.ndarray, truth_m: np.ndarray, limit_m: np.ndarray | float) -> np.ndarray:
    """(n,) bool: status NORMAL, error above the alert limit, protection level within it."""
    return (error_m(outputs, truth_m) > limit_m) & (outputs["protection_level_m"] <= limit_m)


@dataclass(frozen=True)
class Integrity:
    """Counts over a set of outputs; sets are added with ``+``."""

    # all outputs with a known truth; those with status NORMAL
    outputs: int = 0
    computed: int = 0
    failures: int = 0  # outputs with status FAILURE
    # see the module
    misleading: int = 0
    hazardous: int = 0
    # computed outputs whose error is at least 5 m, 20 m, or beyond the accuracy of DO-155 at the true altitude
    wrong_5m: int = 0
    wrong_20m: int = 0
    wrong_accuracy: int = 0
    interruptions: int = 0  # computed outputs whose next output is not computed
    followed: int = 0  # computed outputs that have a next output
    unbounded: int = 0  # computed outputs whose protection level exceeds the alert limit: not available

    def __add__(self, other: "Integrity") -> "Integrity":
        return Integrity(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def rate(self, name: str) -> float:
        """A count over all outputs, computed or not; NaN without any."""
        return getattr(self, name) / self.outputs if self.outputs else float("nan")

    def bound(self, name: str) -> float:
        """95 % upper bound (Clopper and Pearson, one-sided) of `rate`."""
        return clopper_pearson_bound(getattr(self, name), self.outputs)

    @classmethod
    def of_row(cls, row: Mapping[str, Any]) -> "Integrity":
        """Counts of a report's row."""
        return cls(*(row[name] for name in COUNTS))

    def row(self) -> dict[str, Any]:
        """Counts, availability, continuity, and upper bounds of the rates of errors."""
        names = ("misleading", "hazardous", "wrong_5m", "wrong_20m", "wrong_accuracy")
        bounds = {f"{name}_bound": self.bound(name) for name in names}
        return vars(self) | {"availability": self.availability, "continuity": self.continuity} | bounds

    @property
    def availability(self) -> float:
        """Share of outputs computed with a protection level within the alert limit; NaN without outputs."""
        return (self.computed - self.unbounded) / self.outputs if self.outputs else float("nan")

    @property
    def continuity(self) -> float:
        """Share of computed outputs with a next output whose next output is computed; NaN without any."""
        return 1.0 - self.interruptions / self.followed if self.followed else float("nan")


COUNTS = tuple(f.name for f in fields(Integrity))


def integrity(outputs: np.ndarray, truth_m: np.ndarray, alert_limit_m: np.ndarray | float) -> Integrity:
    """Counts of the (n,) outputs of one run, in the order of time, those of synchronisation left out.

    ``truth_m`` is NaN where there is no return at all: whatever is computed there is wrong by every limit, and
    hazardous where its protection level is within the alert limit, the largest error without a warning.
    """
    truth = np.asarray(truth_m, dtype=float)
    computed = outputs["status"] == Status.NORMAL
    error, level = error_m(outputs, truth), outputs["protection_level_m"]

    def count(which: np.ndarray) -> int:
        return int(np.count_nonzero(computed & which))

    accuracy = np.where(np.isfinite(truth), accuracy_limit_m(np.nan_to_num(truth)), 0.0)
    return Integrity(
        outputs=len(outputs),
        computed=int(computed.sum()),
        failures=int(np.count_nonzero(outputs["status"] == Status.FAILURE)),
        misleading=count(error > level),
        hazardous=count(is_hazardous(outputs, truth, alert_limit_m)),
        wrong_5m=count(error >= CORRECT_LIMIT_M),
        wrong_20m=count(error >= FAR_LIMIT_M),
        wrong_accuracy=count(error > accuracy),
        interruptions=int(np.count_nonzero(computed[:-1] & ~computed[1:])),
        followed=int(np.count_nonzero(computed[:-1])),
        unbounded=count(level > alert_limit_m),
    )


def time_to_first_s(outputs: np.ndarray, sweep_s: float) -> float:
    """Seconds from the start of the flight to the end of the first computed output; NaN without one."""
    computed = outputs["status"] == Status.NORMAL
    if not computed.any():
        return float("nan")
    return float((outputs["frame_index"][computed][0] + 1) * sweep_s)


def time_to_alert_s(
    outputs: np.ndarray,
    truth_m: np.ndarray,
    alert_limit_m: np.ndarray | float,
    sweep_s: float,
    *,
    fault_frame: int,
) -> float:
    """Seconds from a fault to the end of the last hazardous output; 0 without one, infinite if the last output is."""
    hazardous = is_hazardous(outputs, np.asarray(truth_m, dtype=float), alert_limit_m)
    hazardous &= outputs["frame_index"] >= fault_frame
    if not hazardous.any():
        return 0.0
    last = int(np.nonzero(hazardous)[0][-1])
    if last + 1 == len(outputs):
        return float("inf")
    return float((outputs["frame_index"][last + 1] + 1 - fault_frame) * sweep_s)


def stanford(
    outputs: np.ndarray, truth_m: np.ndarray, edges_m: np.ndarray, unit_m: np.ndarray | float = 1.0
) -> np.ndarray:
    """(k, k) counts of computed outputs by error (rows) and protection level (columns): the Stanford diagram.

    ``edges_m`` (k + 1,) rise from 0, in units of ``unit_m``, such as each output's alert limit; values beyond the last
    one count in the last bin.
    """
    edges = np.asarray(edges_m, dtype=float)
    computed = outputs["status"] == Status.NORMAL
    error = (error_m(outputs, np.asarray(truth_m, dtype=float)) / unit_m)[computed]
    level = (outputs["protection_level_m"] / unit_m)[computed]
    top = np.nextafter(edges[-1], 0.0)
    counts, _, _ = np.histogram2d(np.minimum(error, top), np.minimum(level, top), bins=(edges, edges))
    return counts.astype(np.int64)
