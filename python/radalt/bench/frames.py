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
    truth_m: np.ndarray  # (trials,) float: altitudes; infinite without a return, where none is right
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
        raise RuntimeError(f"{case.name}: no frame segmented; see channel.start_offset_samples and the SNR")
    samples = np.stack([frame.samples for frame in kept])
    quality = FrameQuality(scene.waveform, scene.altimeter_settings.max_altitude_m)(samples)
    offset_s = np.array([frame.offset_s for frame in kept])
    alone = scene.return_model == "none"
    truth_m = np.full(trial.sum(), np.inf) if alone else np.asarray(programme.altitude_m(index[trial]))
    lost = programme.trial_frames - int(np.count_nonzero(trial))
    return Frames(scene, samples, quality, index, offset_s, trial, truth_m, lost)
