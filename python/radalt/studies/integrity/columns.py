"""Tables of the integrity campaign, and the cells of its Stanford diagram."""

import numpy as np

from ...evaluation.results.integrity import COUNTS, Integrity
from ...evaluation.results.rows import Columns

EDGES = np.r_[0.0, np.logspace(-3.0, 2.0, 41)]  # bin edges of the Stanford diagram, in alert limits
_STATED = ("case", "kind", "batch", "method", "scene", "overlap", "sir_db", "snr_db")
FRAMES = ("trials", "detections", "correct", "near")
HOURS = ("altitude_m", "largest_m", "misleading_events", "hazardous_events")
_EVENT = ("frame_index", "altitude_m", "truth_m", "protection_level_m", "alert_limit_m")
EVENTS = Columns(("case", "seed", "batch", "method", *_EVENT, "cause", "replay"))
_TIMES = ("first_s", "alert_s", "unalerted")
_POOLED = (*_STATED[:2], *_STATED[3:], "parts", "after_start", *Integrity().row(), *_TIMES, *HOURS, *FRAMES)
_POOLED += ("pd", "pd_3pct", "wrong", "wrong_bound")
POOLED = Columns(tuple(dict.fromkeys(_POOLED)))
BY_KIND = Columns(("kind", "known_limit", "method", *POOLED.names[len(_STATED) - 1 :]))
ROWS = Columns(
    (*_STATED, *COUNTS, *_TIMES, *HOURS, *FRAMES, "events", "stanford", "ms_per_frame"),
    timing=frozenset({"ms_per_frame"}),
)
