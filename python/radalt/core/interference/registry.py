"""Every emitter by its name in a scene; a module is imported when a scene names it."""

from __future__ import annotations

import importlib
from typing import Any

from ..parsing import build
from .placement import Emitter, Interferer, QpskEmitter

__all__ = [
    "EMITTER_NAMES",
    "emitter_class",
    "emitter_label",
    "emitter_name",
    "faded",
    "interference_notes",
    "unfaded",
]

_PLACES = {
    "qpsk": ("placement", "QpskEmitter"),
    "tones": ("placement", "ToneEmitter"),
    "nr": ("nr", "NrEmitter"),
    "fmcw": ("radars", "FmcwEmitter"),
    "pulsed_radar": ("radars", "PulsedRadarEmitter"),
    "faa_91_220": ("faa_91_220", "FaaMask"),
}
EMITTER_NAMES = tuple(_PLACES)


def emitter_class(name: str) -> type:
    """Emitter dataclass by its name in a scene."""
    module, attribute = _PLACES[name]
    return getattr(importlib.import_module(f".{module}", __package__), attribute)


def emitter_name(emitter: Emitter) -> str:
    """Name of an emitter in a scene."""
    names = {attribute: name for name, (_, attribute) in _PLACES.items()}
    return names[type(emitter).__name__]


def emitter_label(emitter: Emitter) -> str:
    """Short label for rows and figures."""
    inner, channel = unfaded(emitter)
    label = emitter_name(inner)
    if isinstance(inner, QpskEmitter):
        label = f"{label}_{inner.pulse}"
    elif label == "nr":
        label = f"nr{inner.channel_bandwidth_hz / 1e6:g}"
    return label if channel is None else f"{label}_{channel.profile}"


def faded(emitter: Emitter, data: Any, where: str) -> Emitter:
    """The emitter heard through a multipath profile (`FadingChannel`) given as a mapping."""
    from .multipath import FadedEmitter, FadingChannel

    return FadedEmitter(emitter=emitter, channel=build(FadingChannel, data, where))


def unfaded(emitter: Emitter) -> tuple[Emitter, Any]:
    """The emitter itself and its multipath channel, None without."""
    if type(emitter).__name__ == "FadedEmitter":
        return emitter.emitter, emitter.channel
    return emitter, None


def interference_notes(interferers: tuple[Interferer, ...]) -> list[str]:
    """Link budgets of emitters whose level a standard gives (I/N and SIR), one line each, for reports."""
    notes = []
    for interferer in interferers:
        emitter, _ = unfaded(interferer.emitter)
        if hasattr(emitter, "report"):
            r = emitter.report()
            notes.append(
                f"{emitter_name(emitter)}: interference {r.total_dbm:.1f} dBm (in band {r.in_band_dbm:.1f}, "
                f"out of band {r.out_of_band_dbm:.1f} after the receiver's filter), noise {r.noise_dbm:.1f} dBm, "
                f"return {r.return_dbm:.1f} dBm: I/N {r.i_over_n_db:+.1f} dB, SIR {r.sir_db:+.1f} dB, "
                f"SNR {r.snr_db:+.1f} dB"
            )
    return notes
