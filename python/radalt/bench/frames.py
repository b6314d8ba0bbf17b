"""The one frame maker: sources, channel and segmenter of a case's scene, as in the flowgraph."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..core.altimeter.frame_quality import FrameQuality
from ..core.scene import Scene
from ..core.scene.build import segmenter_of
from ..evaluation.simulation import segmented
from .lists import Case


@dataclass(frozen=True, eq=False)
class Frames:
    """Aligned frames of a case at a level: the preamble, which methods see as in the flowgraph, and the trials."""

    scene: Scene
    samples: np.ndarray  # (n, N) complex64
    quality: np.ndarray  # (n,) of QUALITY_DTYPE
    index: np.ndarray  # (n,) int: frame numbers
    offset_s: np.ndarray  # (n,) float: timing that the segmenter found
    trial: np.ndarray  # (n,) bool
    truth_m: (
        np.ndarray
    )  # (trials,) float: altitudes of the trials; infinite without a return, where none is right
    lost: int  # trials that the segmenter did not give


@lru_cache(maxsize=2)  # the entries of a level take the same frames, 60 KB each
def frames_of(case: Case, level_db: float | None) -> Frames:
    """Frames of a case at a level, in order. Raises RuntimeError where the timing is not acquired."""
    scene = case.at(level_db)
    programme = scene.altitude.programme
    kept = [frame for part in segmented(scene, segmenter_of(scene)) for frame in part]
    index = np.array([frame.index for frame in kept], dtype=int)
    trial = programme.is_trial(index)
    if not trial.any():
        raise RuntimeError(
            f"{case.name}: no frame was segmented; look at channel.start_offset_samples and the SNR"
        )
    samples = np.stack([frame.samples for frame in kept])
    return Frames(
        scene=scene,
        samples=samples,
        index=index,
        offset_s=np.array([frame.offset_s for frame in kept]),
        trial=trial,
        quality=FrameQuality(scene.waveform, scene.altimeter_settings.max_altitude_m)(samples),
        truth_m=_truth_m(scene, index[trial]),
        lost=programme.trial_frames - int(np.count_nonzero(trial)),
    )


def _truth_m(scene: Scene, index: np.ndarray) -> np.ndarray:
    if scene.return_model == "none":
        return np.full(index.size, np.inf)
    return np.asarray(scene.altitude.programme.altitude_m(index))
