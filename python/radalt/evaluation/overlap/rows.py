"""Rows of the main study: one per method and point."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...core.programme import Programme
from ..results.integrity import Integrity, alert_limit_m, integrity
from ..results.rows import Columns
from ..results.score import BITS
from .points import OverlapPoint

POINT = ("method", "interference", "overlap", "sir_db", "snr_db")  # columns that name a method and a point

COUNTERS = ("diverged_frames", "discontinuities", "lock_losses")  # of the signal path, besides `Score`

COLUMNS = Columns(
    names=(
        *POINT,
        *("trials", "detections", "correct", "pd", "pd_low", "pd_high", "rmse_detected_m", "rmse_forced_m"),
        *("bias_m", "forced", "frames_lost", *COUNTERS, "seed"),
        *("ms_per_frame_median", "ms_per_frame_p99", "real_time_factor", "wrong_far", "wrong_bound"),
        *("peak_to_sidelobe_db", "pd_3pct", *BITS),
    ),
    timing=frozenset({"ms_per_frame_median", "ms_per_frame_p99", "real_time_factor"}),
)


TRACKED_COLUMNS = Columns((*POINT, *Integrity().row(), "seed"))


def place_of(method: str, interference: str, point: OverlapPoint) -> dict[str, Any]:
    """Columns that name a method and a point; None for no interference and for no noise."""
    return dict(zip(POINT, (method, interference, point.overlap, point.sir_db, point.snr_db), strict=True))


def make_row(
    method: str,
    interference: str,
    point: OverlapPoint,
    seed: int,
    found: Mapping[str, Any],
    *,
    diverged_frames: int,
    segmenter: Mapping[str, Any],
    ms_per_frame: np.ndarray,
    real_time_factor: float,
) -> dict[str, Any]:
    """One row; ``found`` holds `frame_columns`, ``segmenter`` counters of the signal path, common to all methods."""
    times = np.asarray(ms_per_frame, dtype=float)
    place = place_of(method, interference, point)
    counters = {name: segmenter.get(name, 0) for name in COUNTERS} | {"diverged_frames": diverged_frames}
    cost = {"ms_per_frame_median": np.median, "ms_per_frame_p99": lambda of: np.percentile(of, 99)}
    cost = {name: float(of(times)) if times.size else 0.0 for name, of in cost.items()}
    return COLUMNS.row(
        {**place, **found, **counters, "seed": seed, **cost, "real_time_factor": real_time_factor}
    )


def tracked_row(
    method: str, interference: str, point: OverlapPoint, seed: int, outputs: np.ndarray, programme: Programme
) -> dict[str, Any]:
    """Row of a tracker's outputs without those that end in a frame of synchronisation."""
    outputs = outputs[programme.is_trial(outputs["frame_index"])]
    truth_m = programme.altitude_m(outputs["frame_index"])
    counts = integrity(outputs, truth_m, alert_limit_m(truth_m)).row()
    return TRACKED_COLUMNS.row({**place_of(method, interference, point), **counts, "seed": seed})
