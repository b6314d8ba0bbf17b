"""No mitigation: the row every method is measured against."""

import numpy as np

from .base import Mitigation, PlotStyle


class Identity(Mitigation):
    """Frames pass unchanged."""

    name = "none"
    style = PlotStyle("#000000", "o")

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        return batch.copy()
