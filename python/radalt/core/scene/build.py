"""Objects of the signal path from a scene, for the blocks of a flowgraph and for runs without one."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..altimeter.altimeter import AltimeterSettings
from ..channel.auxiliary import AuxiliaryReceiver
from ..channel.simulated import SimulatedChannel
from ..interference.stream import JammerStream
from ..mitigation import Mitigation, create
from ..programme import SentAltitudes
from ..returns.landing import TerrainPlayer
from ..returns.sweeps import SentSweeps
from ..timing.auxiliary_cancel import AuxiliaryCancel
from ..timing.leakage_file import leakage_canceller
from ..timing.segmenter import FrameSegmenter
from .scene import Scene


def sweeps_of(scene: Scene) -> SentSweeps:
    """Transmitted sweeps of the radar."""
    synthetic = scene.altitude.mode == "synthetic"
    sent, silent = SentAltitudes(scene.altitude.programme), scene.return_model == "none"
    return SentSweeps(scene.waveform, sent, synthetic=synthetic, silent=silent)


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


def jammers_of(scene: Scene) -> list[JammerStream]:
    """A stream for each direction from which the two receive channels receive interference; one without them."""
    if scene.auxiliary is None or len(scene.auxiliary.directions) == 1:
        return [jammer_of(scene)] if scene.has_jammer else []
    streams = []
    for k, (one, power) in enumerate(zip(scene.interference, _powers(scene), strict=True)):
        sir_db = -10 * np.log10(max(power * one.overlap, 1e-20))
        alone = dataclasses.replace(one, sir_db=sir_db)
        seed = int(np.random.default_rng([scene.seed, k]).integers(2**31))
        own = dataclasses.replace(scene, interference=(alone,), auxiliary=None, total_sir_db=None, seed=seed)
        streams.append(jammer_of(own))
    return streams


def _powers(scene: Scene) -> list[float]:
    """Mean power of each interferer while it lasts, over the return's."""
    stated = np.array([10 ** (-one.sir_db / 10) for one in scene.interference])
    scale = 10 ** (-scene.sir_db / 10) / max(stated.sum(), 1e-300)
    return [float(p * scale / max(i.overlap, 1e-6)) for p, i in zip(stated, scene.interference, strict=True)]


def auxiliary_of(scene: Scene) -> AuxiliaryReceiver | None:
    """The second receive channel; None without."""
    if scene.auxiliary is None:
        return None
    powers = _powers(scene) if scene.has_jammer else []
    if len(scene.auxiliary.directions) == 1 and powers:
        powers = [sum(powers)]
    noise = 0.0 if scene.channel.snr_db is None else 10 ** (-scene.channel.snr_db / 10)
    return AuxiliaryReceiver(scene.waveform, scene.auxiliary, tuple(powers), noise, scene.seed)


def canceller_of(scene: Scene) -> AuxiliaryCancel | None:
    """What takes out of frames what both receive channels receive; None with one channel."""
    if scene.auxiliary is None:
        return None
    top_m = scene.altimeter_settings.max_altitude_m
    assert top_m is not None  # resolved
    return AuxiliaryCancel(scene.waveform, scene.auxiliary_cancel, max_altitude_m=top_m)


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
        auxiliary=auxiliary_of(scene),
    )


def method_of(
    scene: Scene,
    name: str,
    own: Mapping[str, Any] | None = None,
    *,
    settings: AltimeterSettings | None = None,
    drop_when_slow: bool = False,
) -> Mitigation:
    """A method with the scene's options and ``own`` over them; ``settings`` in place of the scene's altimeter."""
    given = {"drop_when_slow": drop_when_slow} | (scene.method_options.get(name) or {}) | dict(own or {})
    given["max_altitude_m"] = (settings or scene.altimeter_settings).max_altitude_m
    given["independent"] = scene.independent_frames
    return create(name, scene.waveform, **given)


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
