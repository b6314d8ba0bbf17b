"""Jammer source of a recording."""

from ..core.interference.emitters.recording import RecordingEmitter
from ..core.interference.placement import Interferer
from ..core.scene import Scene
from ._jammer import JammerSource


class recording_jammer_source(JammerSource):
    """Samples of a file, shifted and resampled into the band, at an exact SIR against a return of unit power.

    Category: [RadAlt]/Interference. Ports: ``out: complex``.

    Parameters
    ----------
    scene : Scene
        Frame length, rate, programme (the jammer is silent while timing is acquired) and seed.
    file : str
        A ``.sigmf-meta`` of one complex channel, or raw samples if ``rate_hz`` and ``datatype`` are given.
    offset_hz : float
        Frequency shift of the recording.
    start_s, seconds : float
        Part of the file that is repeated, at most 1 s.
    rate_hz : float, optional
        Sample rate of raw samples; None for SigMF.
    datatype : str
        Format of raw samples: ``"cf32_le"``, ``"ci16_le"``, ``"ci8"``, ``"cu8"``; empty for SigMF.
    overlap, sir_db, start, free_running, frames
        As in `qpsk_jammer_source`; overlap and SIR are live.

    Raises
    ------
    ValueError
        One line: the parameter or the part of the file that is missing or does not fit.

    Example
    -------
    ``jam = radalt.recording_jammer_source(scene, "downlink.sigmf-meta", offset_hz=0.5e6, sir_db=-30)``
    """

    def __init__(
        self,
        scene: Scene,
        file: str,
        offset_hz: float = 0.0,
        start_s: float = 0.0,
        seconds: float = 0.1,
        rate_hz: float | None = None,
        datatype: str = "",
        overlap: float = 1.0,
        sir_db: float = -10.0,
        start: float | None = None,
        free_running: bool = False,
        frames: int = 0,
    ) -> None:
        emitter = RecordingEmitter(
            file=file,
            offset_hz=offset_hz,
            start_s=start_s,
            seconds=seconds,
            rate_hz=rate_hz,
            datatype=datatype,
        )
        interferer = Interferer(emitter, sir_db=sir_db, overlap=overlap, start=start)
        super().__init__(
            "radalt_recording_jammer_source", scene, [interferer], free_running=free_running, frames=frames
        )
