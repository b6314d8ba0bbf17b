"""Jammer source of the scene's interference, one emitter or several."""

from ..core.scene import Scene
from ._jammer import JammerSource


class mixture_jammer_source(JammerSource):
    """The sum of all interferers of the scene, each at its overlap and SIR, the sum at the scene's total SIR.

    Category: [RadAlt]/Interference. Ports: ``out: complex``.

    Parameters
    ----------
    scene : Scene
        Interference, frame length, programme (silent while timing is acquired) and seed.
    overlap, sir_db : float, optional
        Override the scene's overlap (0..1) and total SIR in dB from the next sweep on; None keeps the scene's. Live.
    frames : int
        Sweeps before the stream ends; 0 for endless.

    Example
    -------
    ``jam = radalt.mixture_jammer_source(load_scene("mixture"))``
    """

    def __init__(
        self, scene: Scene, overlap: float | None = None, sir_db: float | None = None, frames: int = 0
    ) -> None:
        super().__init__(
            "radalt_mixture_jammer_source",
            scene,
            scene.interference,
            total_sir_db=scene.total_sir_db,
            free_running=any(i.free_running for i in scene.interference),
            frames=frames,
        )
        self._scene = scene
        self._overlap, self._sir_db = overlap, sir_db
        self._strongest_db = float("inf")
        self._apply()

    def hold_drive(self) -> None:
        """Limit bursts to the power of the scene's, for which a radio's converter is scaled.

        A lower SIR, or a shorter burst at the same SIR, is then replaced by the lowest SIR without clipping.
        """
        self._strongest_db = self._scene.burst_db
        self._apply()

    def set_overlap(self, overlap: float | None) -> None:
        """Active fraction from the next sweep on; None keeps the scene's."""
        self._overlap = overlap
        self._apply()

    def set_sir_db(self, sir_db: float | None) -> None:
        """Total SIR in dB from the next sweep on; None keeps the scene's."""
        self._sir_db = sir_db
        self._apply()

    def _apply(self) -> None:
        scene = self._scene.at(overlap=self._overlap, sir_db=self._sir_db)
        excess_db = scene.burst_db - self._strongest_db
        if excess_db > 0:
            scene = scene.at(sir_db=scene.sir_db + excess_db)
        self.stream.play(scene.interference, scene.total_sir_db)
