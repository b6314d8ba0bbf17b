"""QPSK jammer source."""

from ..core.interference import Interferer, QpskEmitter
from ..core.scene import Scene
from ._jammer import JammerSource


class qpsk_jammer_source(JammerSource):
    """QPSK bursts at an exact SIR, averaged over the sweep, against a return of unit power.

    ``x(t) = a sum_k c_k p(t - k T) exp(j 2 pi f t)`` while the burst lasts, ``a`` such that the power averaged over the
    sweep is ``10^(-sir_db/10)``.

    Category: [RadAlt]/Interference. Ports: ``out: complex``.

    Parameters
    ----------
    scene : Scene
        Frame length, rate, programme (the jammer is silent while timing is acquired) and seed.
    bandwidth_hz : float
        Symbol rate (rectangular pulses) or occupied bandwidth (rrc).
    carrier_hz : float
        Carrier relative to the radar's centre.
    pulse : str
        ``"rectangular"`` or ``"rrc"``.
    rolloff : float
        Roll-off of the root-raised-cosine pulse, 0..1.
    overlap : float
        Active fraction of the sweep, 0..1. Live.
    sir_db : float
        Signal-to-interference ratio in dB, averaged over the sweep. Live.
    start : float, optional
        Burst start as a fraction of the sweep, 0..1; None draws it anew every sweep.
    free_running : bool
        Burst grid that is not synchronised to the sweep.
    frames : int
        Sweeps before the stream ends; 0 for endless.

    Example
    -------
    ``jam = radalt.qpsk_jammer_source(scene, bandwidth_hz=2e6, overlap=0.3, sir_db=-20)``
    """

    def __init__(
        self,
        scene: Scene,
        bandwidth_hz: float = 0.267 * 7.5e6,
        carrier_hz: float = 0.0,
        pulse: str = "rectangular",
        rolloff: float = 0.25,
        overlap: float = 1.0,
        sir_db: float = -10.0,
        start: float | None = None,
        free_running: bool = False,
        frames: int = 0,
    ) -> None:
        emitter = QpskEmitter(bandwidth_hz=bandwidth_hz, carrier_hz=carrier_hz, pulse=pulse, rolloff=rolloff)
        interferer = Interferer(emitter, sir_db=sir_db, overlap=overlap, start=start)
        super().__init__(
            "radalt_qpsk_jammer_source", scene, [interferer], free_running=free_running, frames=frames
        )
