"""Mitigation block for every registered method."""

from __future__ import annotations

from typing import Any

from ._mitigation import MitigationBlock
from .core.mitigation import create
from .core.scene import Scene

__all__ = ["mitigation"]


class mitigation(MitigationBlock):
    """One registered method (``none``, ``lms``, ``lms_reference_input``, ``nlms``, ``whitening``, ``blanking``).

    Category: [RadAlt]/Mitigation. Ports: ``frames: complex vector of N > frames: complex vector of N``.

    Parameters
    ----------
    scene : Scene
        Waveform; ``method_options`` of the scene give the method's parameters.
    method : str
        Registry name, see `gnuradio.radalt.core.mitigation.METHODS`.
    options : dict, optional
        Parameters that override the scene's.

    Example
    -------
    ``clean = radalt.mitigation(scene, "whitening")``
    """

    def __init__(
        self, scene: Scene, method: str = "whitening", options: dict[str, Any] | None = None
    ) -> None:
        parameters = {**scene.method_options.get(method, {}), **(options or {})}
        super().__init__("radalt_mitigation", create(method, scene.waveform, **parameters))
