"""What the sinks keep and send: a ring of rows, and results as plain values for messages."""

import json
import math
from typing import Any

import numpy as np

from ..core.altimeter.altimeter import RESULT_DTYPE, Reason


class Ring:
    """The last ``capacity`` rows of a structured array; one thread may append while others read."""

    def __init__(self, capacity: int, dtype: np.dtype) -> None:
        self._rows = np.zeros(capacity, dtype=dtype)
        self.count = 0  # rows since the start

    def append(self, rows: np.ndarray) -> None:
        """Store (n,) rows over the oldest ones."""
        self._rows[(self.count + np.arange(len(rows))) % self._rows.size] = rows
        self.count += len(rows)

    def last(self, count: int | None = None) -> np.ndarray:
        """Copy of the last ``count`` rows, all that are kept by default, in order of arrival."""
        now = self.count
        kept = min(now, self._rows.size) if count is None else count
        return self._rows[np.arange(now - kept, now) % self._rows.size]

    def since(self, count: int) -> tuple[int, np.ndarray]:
        """Rows after the first ``count``, unless overwritten, and the count for the next call.

        For other threads: neither the reader nor the writer waits.
        """
        now = self.count
        # only half of the ring is returned: the writer may overwrite the other half meanwhile
        first = max(0, count, now - self._rows.size // 2)
        return now, self._rows[np.arange(first, now) % self._rows.size]


def result_fields(result: np.void) -> dict[str, Any]:
    """Fields of one `RESULT_DTYPE` row as plain values, the reason by its name."""
    fields = dict(zip(RESULT_DTYPE.names, result.item(), strict=True))
    return fields | {"reason": Reason.NAMES[fields["reason"]]}


def json_text(message: dict[str, Any]) -> str:
    """JSON of a message, with null for numbers that JSON cannot hold."""
    return json.dumps(_finite(message))


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value
