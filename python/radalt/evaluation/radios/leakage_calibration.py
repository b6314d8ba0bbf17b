"""Leakage calibration of a scene's simulated installation, by the steps of a real one."""

import dataclasses

import numpy as np

from ...core.altimeter.altimeter import Altimeter
from ...core.channel.settings import DropSettings
from ...core.channel.simulated import SimulatedChannel
from ...core.programme import Programme
from ...core.scene import Scene, SceneError
from ...core.timing.frame import Frame
from ...core.timing.leakage import LeakageCalibration, LeakageCanceller
from ...core.timing.segmenter import FrameSegmenter

_KNOWN_M = 300.0  # altitude for the installation delay, m: beyond the leakage's side lobes
# frames dropped while the lock settles, and frames at the known altitude: a mean error of a few centimetres
_SETTLE_FRAMES, _KNOWN_FRAMES = 8, 60


def calibrate_leakage(scene: Scene, frames: int = 400) -> LeakageCalibration:
    """Measure the leakage without a return over ``frames``, then the installation delay at a known altitude.

    The scene has ``channel.leakage_db``; its noise and seed are used, its interference and lost samples are not.
    Raises SceneError if it has no leakage, or its sweep is not found.
    """
    if scene.channel.leakage_db is None:
        raise SceneError("calibrate_leakage: the scene plays no leakage; set channel.leakage_db")
    programme = Programme((min(_KNOWN_M, scene.altimeter_settings.max_altitude_m),), _KNOWN_FRAMES)
    alone = dataclasses.replace(programme, preamble_frames=frames + 2 * _SETTLE_FRAMES)
    played = [f for f in _play(scene, alone, None) if not alone.is_trial(f.index)]
    played = played[_SETTLE_FRAMES : _SETTLE_FRAMES + frames]
    if len(played) < frames:
        raise SceneError("calibrate_leakage: the leakage is not found; raise channel.leakage_db or snr_db")
    found = LeakageCalibration.measured(
        scene.waveform,
        np.stack([f.samples for f in played]),
        timing_offset_s=played[0].offset_s,
        frame_index=np.array([f.index for f in played]),
    )
    known = [f for f in _play(scene, programme, LeakageCanceller(found)) if programme.is_trial(f.index)]
    results = Altimeter(scene.waveform, scene.altimeter_settings).process(
        np.stack([f.samples for f in known]), timing_offset_s=np.array([f.offset_s for f in known])
    )
    return found.with_installation(results["altitude_m"], programme.altitudes_m[0])


def _play(scene: Scene, programme: Programme, leakage: LeakageCanceller | None) -> list[Frame]:
    """Frames of a programme through the scene's channel."""
    w, channel = scene.waveform, dataclasses.replace(scene.channel, drops=DropSettings())
    # without monitoring: the return in the trials would end a lock on an unknown leakage
    settings = dataclasses.replace(scene.segmenter, monitor=False)
    source = SimulatedChannel(
        w, channel, seed=scene.seed, true_delay=programme, frames=programme.total_frames
    )
    segmenter = FrameSegmenter(w, programme, settings, true_delay=True, leakage=leakage)
    out: list[Frame] = []
    for index in range(programme.total_frames):
        sweep = (w.reference * w.frame_rotation(index)).astype(np.complex64)
        for _, samples in source.process(sweep):
            out += segmenter.push(samples)
    return out
