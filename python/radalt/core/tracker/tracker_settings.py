"""Settings and outputs of the altitude tracker."""

from dataclasses import dataclass

import numpy as np

from ..parsing import Settings, setting


class Status:
    """Status of an output, as the sign/status matrix of an ARINC 429 BNR word has it; ``status`` field.

    `FAILURE` is the equipment's: samples that are not finite, nothing but zeros, no frames. `NO_COMPUTED_DATA` is the
    world's: no return, too much interference, or more than one altitude that could be true.
    """

    FAILURE = 0  # 00, failure warning
    NO_COMPUTED_DATA = 1  # 01
    NORMAL = 3  # 11; 10 is functional test, which nothing here makes

    NAMES = ("failure", "no_computed_data", "functional_test", "normal")


class State:
    """State of the tracker; ``state`` field."""

    SEARCH = 0
    CONFIRM = 1
    TRACK = 2
    COAST = 3
    LOST = 4

    NAMES = ("search", "confirm", "track", "coast", "lost")


OUTPUT_DTYPE = np.dtype(
    [
        ("frame_index", np.int64),  # last frame that the output stands for: altitude at its end
        ("status", np.int8),
        ("state", np.int8),
        ("altitude_m", np.float64),
        ("vertical_speed_m_per_s", np.float64),
        ("protection_level_m", np.float64),
        ("age_s", np.float64),  # from the middle of the last measurement to the end of frame_index
        ("strength", np.float64),  # the block's best return in standard deviations of the noise
        ("frames", np.int16),  # usable frames in the block
    ]
)


@dataclass(frozen=True)
class TrackerSettings(Settings, where="tracker"):
    """How frames become altitudes that can be trusted."""

    output_s: float = setting(0.04, 1e-4, 10.0)
    """Time between outputs, and of the integration; 40 ms is 25 outputs per second."""
    doppler: bool | None = None
    """Whether a range rate shows as Doppler. That of a synthetic altitude does not. None takes what a scene plays
    (`Scene.tracker_settings`), else true."""
    max_vertical_speed_m_per_s: float = setting(150.0, 0.0, 1000.0)
    """Rate limit of a track; with ``doppler`` the altimeter's holds where that names a lower one."""
    acceleration_m_per_s2: float = setting(5.0, 0.01, 1000.0)
    """Standard deviation of the change of range rate, terrain slopes included (white in time, one value per output)."""
    search_pfa: float = setting(1e-4, 1e-9, 0.1)
    """Probability that noise alone gives a detection in one block, over the whole span."""
    gate_pfa: float = setting(1e-2, 1e-9, 0.1)
    """Probability that noise alone gives a detection in one block, within the gate of a track."""
    confirm_outputs: int = setting(3, 2, 25)
    """Consecutive blocks that must agree before an altitude is called valid."""
    coast_s: float = setting(1.0, 0.0, 60.0)
    """Seconds without measurement after which a track is deleted."""
    risk: float = setting(1e-5, 1e-9, 0.1)
    """Probability that the error exceeds the protection level, per output called NORMAL."""
    max_protection_m: float = setting(60.0, 1.0, 10_000.0)
    """An altitude with a higher protection level is not given."""
    leakage_m: float | None = setting(None, 0.0, 1000.0)
    """Altitude below which no track starts: the transmitter's own leakage and the landing gear lie there
    (docs/leakage.md). A track that comes from above continues. None is 15 m where range rates show as Doppler, and 0
    with a beat shift, which moves the leakage. A scene sets 0, unless it plays leakage without a calibration."""
