"""Altitude strip: rolling charts of the last seconds from streams of altitudes."""

from collections.abc import Callable

import numpy as np
from gnuradio import gr

from ..core.scene.live import AltitudeStrip
from ._frames import read_frame_tags
from ._guard import guarded


class altitude_strip(gr.decim_block):
    """The last ``points * every`` frames of the true altitude and of every input, for a vector sink.

    Category: [RadAlt]/Displays. Ports: ``in0..: float`` (metres, one per frame, NaN for no detection) ``> true: float
    vector of points``, ``out0..: float vector of points`` (newest last; ``OFF_CHART_M``, far below every chart, where
    there is no altitude, since a vector sink never recovers from a NaN).

    Parameters
    ----------
    altitude_m : float
        True altitude in metres. Live. `set_truth` gives it frame by frame instead.
    inputs : int
        Number of altimeters.
    points : int
        Values across the chart.
    every : int
        Frames between two values.
    Example
    -------
    ``strip = radalt.altitude_strip(altitude_m=300.0, inputs=2)``
    """

    OFF_CHART_M = -1e6

    def __init__(self, altitude_m: float = 0.0, inputs: int = 2, points: int = 512, every: int = 20) -> None:
        self.strip = AltitudeStrip(1 + inputs, points, every)
        gr.decim_block.__init__(
            self,
            "radalt_altitude_strip",
            [np.float32] * inputs,
            [(np.float32, points)] * (1 + inputs),
            decim=every,
        )
        self._every = every
        self._truth: Callable[[np.ndarray], np.ndarray] | None = None
        self.set_altitude(altitude_m)
        self.set_tag_propagation_policy(gr.TPP_DONT)

    def set_altitude(self, altitude_m: float) -> None:
        """True altitude in metres from the next frame on."""
        self._true_m = float(altitude_m)

    def set_truth(self, altitude_m: Callable[[np.ndarray], np.ndarray]) -> None:
        """True altitudes by sweep index (`fmcw_chirp_source.altitude_m`), exact for any delay of the frames."""
        self._truth = altitude_m

    def _true_altitudes(self, count: int) -> np.ndarray:
        """(count,) true altitudes of the next frames; the value of `set_altitude` where a frame has no index."""
        out = np.full(count, self._true_m)
        if self._truth is not None:
            index = read_frame_tags(self, count)[:, 0]
            known = np.isfinite(index)
            out[known] = self._truth(index[known].astype(np.int64))
        return out

    @guarded
    def work(self, input_items, output_items) -> int:  # noqa: ANN001
        """One chart per ``every`` frames."""
        count = len(output_items[0])
        true = self._true_altitudes(count * self._every)
        for step in range(count):
            span = slice(step * self._every, (step + 1) * self._every)
            self.strip.push(np.stack([true[span], *(items[span] for items in input_items)]))
            for output, row in zip(output_items, self.strip.rows, strict=True):
                output[step] = np.nan_to_num(row, nan=self.OFF_CHART_M)
        return count
