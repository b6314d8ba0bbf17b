"""Settings of the frame segmenter."""

from dataclasses import dataclass

from ..parsing import Settings, setting


@dataclass(frozen=True)
class SegmenterSettings(Settings, where="segmenter"):
    """How timing is acquired and checked."""

    acquisition_frames: int = setting(4, 1, 4)
    """Frames averaged coherently for one acquisition."""
    lock_threshold: float = 25.0
    """Correlation peak over mean power from which the sweep counts as present. Noise alone exceeds 25 once in about
    1e7 frames where the filter is coherent over the frame. Where its halves add in power, 0.6 times this value is the
    threshold, and noise exceeds it more rarely still."""
    confirm_frames: int = setting(2, 1, 8)
    """Consecutive frames that have to agree on another timing before the lock is lost; as many frames are held back
    while the timing is in doubt."""
    monitor: bool = True
    """Check every frame (default). Without it only tagged discontinuities are noticed."""
    leakage_calibration: str = ""
    """Stored leakage of the installation, subtracted from every frame: a file, or a shipped one's name
    (docs/leakage.md). ``uncalibrated`` fits it to every frame instead, for altitudes from 100 m on. Empty: no leakage
    is subtracted. Only with true delays."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lock_threshold < 10:
            raise ValueError(f"segmenter.lock_threshold is {self.lock_threshold:g}; below 10 noise locks")
