"""5G NR downlink jammer source."""

from ..core.interference.emitters.nr import NrEmitter
from ..core.interference.placement import Interferer
from ..core.scene import Scene
from ._jammer import JammerSource


class nr_jammer_source(JammerSource):
    """5G NR downlink (TS 38.211, 15 kHz subcarriers) at an exact SIR against a return of unit power.

    Random windows of a cached frame with SSB, control and data channels, behind the radar's receiver filter. The SIR is
    averaged over the sweep.

    Category: [RadAlt]/Interference. Ports: ``out: complex``.

    Parameters
    ----------
    scene : Scene
        Frame length, rate, programme (the jammer is silent while timing is acquired) and seed.
    channel_bandwidth_hz : float
        5e6 (25 resource blocks), 10e6 (52) and so on to 50e6. For 30 kHz spacing, error vectors and other parameters
        use a scene and `mixture_jammer_source`.
    carrier_hz : float
        Centre of the NR carrier relative to the radar's.
    cell_id : int
        Physical cell identity, 0..1007.
    modulation : str
        ``"qpsk"``, ``"16qam"``, ``"64qam"``, ``"256qam"`` or ``"mixed"`` (per user) of the data.
    load : float
        Fraction of resource blocks with data, 0..1.
    overlap, sir_db, start, free_running, frames
        As in `qpsk_jammer_source`; overlap and SIR are live.

    Example
    -------
    ``jam = radalt.nr_jammer_source(scene, channel_bandwidth_hz=10e6, cell_id=17, sir_db=-20)``
    """

    def __init__(
        self,
        scene: Scene,
        channel_bandwidth_hz: float = 5e6,
        carrier_hz: float = 0.0,
        cell_id: int = 0,
        modulation: str = "64qam",
        load: float = 1.0,
        overlap: float = 1.0,
        sir_db: float = -10.0,
        start: float | None = None,
        free_running: bool = False,
        frames: int = 0,
    ) -> None:
        emitter = NrEmitter(
            channel_bandwidth_hz=channel_bandwidth_hz,
            carrier_hz=carrier_hz,
            cell_id=cell_id,
            modulation=modulation,
            load=load,
        )
        interferer = Interferer(emitter, sir_db=sir_db, overlap=overlap, start=start)
        super().__init__(
            "radalt_nr_jammer_source", scene, [interferer], free_running=free_running, frames=frames
        )
