"""Mitigation block for every registered method."""

from typing import Any

from ..core.mitigation import Mitigation, method_class
from ..core.scene import Scene
from ..core.scene.build import method_of
from ._mitigation import MitigationBlock


class mitigation(MitigationBlock):
    """One method by its name: any of `METHODS`, or ``custom`` for the user's method.

    Category: [RadAlt]/Mitigation. Ports: ``frames: complex vector of N > frames: complex vector of N``.

    Parameters
    ----------
    scene : Scene
        Waveform; ``method_options`` of the scene give the method's parameters.
    method : str
        Name as in `radalt.core.mitigation.create`. Live.
    options : dict, optional
        Parameters that override the scene's.
    drop_when_slow : bool
        As the frame segmenter's: where frames may be dropped, `hybrid` and `ofdm_cancel` search within a budget.
    Example
    -------
    ``clean = radalt.mitigation(scene, "whitening")``
    """

    def __init__(
        self,
        scene: Scene,
        method: str = "whitening",
        options: dict[str, Any] | None = None,
        drop_when_slow: bool = False,
    ) -> None:
        self._scene, self._name, self._options = scene, method, options or {}
        self._drop_when_slow = bool(drop_when_slow)
        super().__init__("radalt_mitigation", self._create(method), method_class(method).batch)

    def _create(self, method: str) -> Mitigation:
        return method_of(self._scene, method, self._options, drop_when_slow=self._drop_when_slow)

    def set_method(self, method: str) -> None:
        """Change the method from the next frames on; the new one starts without state."""
        if method != self._name:
            self.method, self._name = self._create(method), method
            self._batch = method_class(method).batch
