"""Tone jammer source."""

from ..core.interference import Interferer, ToneEmitter
from ..core.scene import Scene
from ._jammer import JammerSource


class tone_jammer_source(JammerSource):
    """Sum of K unmodulated carriers at an exact SIR, averaged over the sweep, against a return of unit power.

    ``x(t) = a sum_k exp(j (2 pi f_k t + phi_k))`` while the burst lasts; phases, and frequencies unless fixed, are
    drawn anew every sweep.

    Category: [RadAlt]/Interference. Ports: ``out: complex``.

    Parameters
    ----------
    scene : Scene
        Frame length, rate, programme (the jammer is silent while timing is acquired) and seed.
    count : int
        Number of tones if their frequencies are drawn.
    frequencies_hz : sequence of float
        Fixed frequencies relative to the radar's centre; empty draws ``count`` of them over ``span_hz``.
    span_hz : float
        Band in which frequencies are drawn; 0 for the sample rate.
    overlap, sir_db, start, free_running, frames
        As in `qpsk_jammer_source`; overlap and SIR are live.

    Example
    -------
    ``jam = radalt.tone_jammer_source(scene, count=5, sir_db=-30)``
    """

    def __init__(
        self,
        scene: Scene,
        count: int = 1,
        frequencies_hz: tuple[float, ...] = (),
        span_hz: float = 0.0,
        overlap: float = 1.0,
        sir_db: float = -10.0,
        start: float | None = None,
        free_running: bool = False,
        frames: int = 0,
    ) -> None:
        emitter = ToneEmitter(count=count, frequencies_hz=tuple(frequencies_hz), span_hz=span_hz)
        interferer = Interferer(emitter, sir_db=sir_db, overlap=overlap, start=start)
        super().__init__(
            "radalt_tone_jammer_source", scene, [interferer], free_running=free_running, frames=frames
        )
