"""Transmit interlock: the air is regulated, 4.2-4.4 GHz is a safety-of-life band (DESIGN.md 6.9)."""

from __future__ import annotations

from .scene import Scene

__all__ = ["InterlockError", "require_enclosure"]


class InterlockError(ValueError):
    """Transmission refused; the message is one line for the user."""


def require_enclosure(scene: Scene, transmit: bool, *, radios: bool = True) -> None:
    """Refuse to build transmitters unless both the scene and the command line allow it.

    Parameters
    ----------
    scene : Scene
        ``radio.enclosure`` has to be ``cabled`` (with its ``attenuation_db``) or ``shielded``.
    transmit : bool
        What the command line says (``--transmit``).
    radios : bool
        False where the flowgraph holds no radio (simulation): nothing to refuse.

    Raises
    ------
    InterlockError
    """
    if not radios:
        return
    radio = scene.radio
    if radio.enclosure == "none":
        raise InterlockError(
            "transmit refused: 4.2-4.4 GHz is a safety-of-life band and radio.enclosure is 'none'; state 'cabled' with "
            "attenuation_db, or 'shielded', in the scene"
        )
    if radio.enclosure == "cabled" and radio.attenuation_db < 30:
        raise InterlockError(
            f"transmit refused: radio.attenuation_db is {radio.attenuation_db:g} with a cabled set-up; a B210 receiver "
            "is damaged above -15 dBm and transmits up to +20 dBm: use at least 30 dB (40 dB is usual)"
        )
    if not transmit:
        raise InterlockError(
            "transmit is off: add --transmit (or set the flowgraph's parameter transmit to 1)"
        )
