"""Objects of the signal path from a scene, for the blocks of a flowgraph and for runs without one."""

from ..channel.simulated import SimulatedChannel
from ..interference.stream import JammerStream
from ..programme import SentAltitudes
from ..receiver.leakage_file import leakage_canceller
from ..receiver.segmenter import FrameSegmenter
from ..returns.landing import TerrainPlayer
from ..returns.sweeps import SentSweeps
from .scene import Scene


def sweeps_of(scene: Scene) -> SentSweeps:
    """Transmitted sweeps of the radar."""
    synthetic = scene.altitude.mode == "synthetic"
    silent = scene.return_model == "none"
    return SentSweeps(
        scene.waveform, SentAltitudes(scene.altitude.programme), synthetic=synthetic, silent=silent
    )


def jammer_of(scene: Scene) -> JammerStream:
    """The sum of all interferers at the scene's total SIR, silent while the segmenter takes its timing."""
    return JammerStream(
        scene.waveform,
        scene.interference,
        programme=scene.altitude.programme,
        seed=scene.seed,
        free_running=any(i.free_running for i in scene.interference),
        total_sir_db=scene.total_sir_db,
    )


def channel_of(scene: Scene) -> SimulatedChannel:
    """Air and front ends; raises ValueError where the scene's settings do not fit each other."""
    programme = scene.altitude.programme
    terrain = None
    if scene.return_model == "terrain":
        assert scene.landing is not None  # checked by the scene
        terrain = TerrainPlayer(scene.landing, programme, scene.waveform, scene.seed)
    return SimulatedChannel(
        scene.waveform,
        scene.channel,
        seed=scene.seed,
        true_delay=programme if scene.altitude.mode == "true_delay" and terrain is None else None,
        terrain=terrain,
        frames=programme.total_frames,
    )


def segmenter_of(scene: Scene, *, follow_programme: bool = True) -> FrameSegmenter:
    """Timing and frames; ``follow_programme`` False accepts any altitude within the altimeter's span."""
    top_m = scene.altimeter.resolved(scene.waveform).max_altitude_m
    assert top_m is not None  # resolved
    return FrameSegmenter(
        scene.waveform,
        scene.altitude.programme if follow_programme else None,
        scene.segmenter,
        max_altitude_m=max(top_m, scene.reach_m),
        true_delay=scene.altitude.mode == "true_delay" or scene.altitude.drawn is not None,
        point_target=scene.return_model == "point",
        leakage=leakage_canceller(scene.segmenter.leakage_calibration, scene.waveform),
        noise=scene.has_noise,
    )
