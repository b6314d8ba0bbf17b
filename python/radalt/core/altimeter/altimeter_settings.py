"""Settings of the altimeter, and the record of one frame's result."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..parsing import LARGEST, Settings, setting
from ..waveform import Waveform

# Vertical speed allowed per frame where neither scene nor settings name one, in m/s: 3,900 ft/min, more than approaches
# and climbs have
SPEED_M_PER_S = 20.0
FASTEST_M_PER_S = 150.0  # no aircraft descends or climbs faster
STRATEGIES = ("strongest", "leading_edge", "centroid")


class Reason:
    """Why a frame has or has no altitude: the values of the ``reason`` field, and by them `NAMES`."""

    OK = 0
    NO_DETECTION = 1
    SWEEPS_DISAGREE = 2
    NOT_FINITE = 3
    NO_SIGNAL = 4
    UNLOCKED = 5
    OUT_OF_RANGE = 6
    AMBIGUOUS = 7

    NAMES = (
        *("ok", "no_detection", "sweeps_disagree", "not_finite", "no_signal", "unlocked", "out_of_range"),
        "ambiguous",
    )


RESULT_DTYPE = np.dtype(
    [
        ("frame_index", np.int64),
        ("valid", np.bool_),
        ("reason", np.int8),
        ("altitude_m", np.float64),
        ("vertical_speed_m_per_s", np.float64),
        ("beat_up_hz", np.float64),
        ("beat_down_hz", np.float64),
        ("snr_db", np.float64),
        ("forced_altitude_m", np.float64),
        ("ambiguity_db", np.float64),
        ("peak_to_sidelobe_db", np.float64),
    ]
)


@dataclass(frozen=True)
class AltimeterSettings(Settings, where="altimeter"):
    """How the altimeter searches for a return."""

    max_altitude_m: float | None = setting(None, -LARGEST, LARGEST)
    """Upper end of the search span; beat band, decimation and FFT size follow from the span. None takes what a scene
    flies (`Scene.altimeter_settings`), else 1500 m, or the waveform's limit where that is lower."""
    min_altitude_m: float = setting(0.0, -LARGEST, LARGEST)
    """Lower end of the search span."""
    max_vertical_speed_m_per_s: float | None = setting(None, 0.0, LARGEST)
    """Largest range rate: how far the two sweeps' beats may differ and still be one target. None takes what a scene
    flies, else 20 m/s per frame, and 150 m/s in a track or where a call names a speed. At equal false alarms 150 m/s
    costs 1 dB of sensitivity. Where a method leaves holes in the sweep, one half's grating lobe next to the other's
    peak also passes for a speed. A caller that knows the speed better gives it per call (`Altimeter.process`)."""
    window: str = setting("boxcar", among=("hann", "hamming", "blackman", "boxcar"))
    """Over each half sweep. A taper lowers side lobes but weights the middle of the sweep, where an interferer at the
    radar's centre sits: a Hann window costs 5.6 dB against one there, and a factor 1.6 in error."""
    pfa_per_frame: float = setting(0.0155, 1e-9, 0.5)
    """False altitudes per frame of white noise, at most, over all altitudes and speeds that are searched, whatever
    the sweep."""
    train_cells: float = setting(16.0, 1, 256)
    """Training cells on each side, in resolution cells (2 kHz, 20 m by default), where the noise is not white
    (`Cfar`)."""
    guard_cells: float = setting(1.5, 0, 256)
    """Guard cells between, on each side."""
    strategy: str = setting("strongest", among=STRATEGIES)
    """``"strongest"`` point target; ``"leading_edge"`` nearest edge of an extended return, the -6 dB point of the
    rise, corrected so that a point target is unbiased; ``"centroid"`` power centroid."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_altitude_m is not None and not self.max_altitude_m > self.min_altitude_m:
            raise ValueError(
                f"altimeter.max_altitude_m {self.max_altitude_m:g} has to be above min_altitude_m "
                f"{self.min_altitude_m:g}"
            )

    def resolved(
        self,
        waveform: Waveform,
        *,
        highest_altitude_m: float = 1500.0,
        vertical_speed_m_per_s: float | None = None,
    ) -> "AltimeterSettings":
        """The same settings with numbers in place of None: the given ones, the altitude within the waveform's limit."""
        span: dict[str, Any] = {}
        if self.max_altitude_m is None:
            floor = self.min_altitude_m + waveform.range_resolution_m
            span["max_altitude_m"] = min(max(highest_altitude_m, floor), waveform.max_unambiguous_altitude_m)
        if self.max_vertical_speed_m_per_s is None and vertical_speed_m_per_s is not None:
            span["max_vertical_speed_m_per_s"] = abs(vertical_speed_m_per_s)
        return replace(self, **span) if span else self
