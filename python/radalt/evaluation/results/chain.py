"""Processing chain of studies without a flowgraph: method and altimeter."""

import dataclasses
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ...core.altimeter.altimeter import AltimeterSettings, Spectra, shared_altimeter
from ...core.altimeter.frame_quality import FrameQuality
from ...core.mitigation import Mitigation, create
from ...core.waveform import Waveform

_CHUNK = 20  # frames per call: 1.2 MB at the default waveform, within the second-level cache


@dataclass(frozen=True)
class Chain:
    """One way from frames to altitudes."""

    label: str  # label in reports
    method: str  # registry name
    options: tuple[tuple[str, Any], ...] = ()  # of the method
    precision: str = "float32"  # arithmetic precision of the method; a model's metadata override it
    settings: AltimeterSettings = field(default_factory=AltimeterSettings)
    looks: int = 1  # consecutive frames whose power spectra are averaged for one altitude

    @classmethod
    def of_model(cls, model: Path) -> "Chain":
        """A network, by the method `tcae`."""
        precision = next((p for p in ("int8", "fp16") if p in model.stem), "float32")
        label = "tcae" if model.stem == "tcae" else f"tcae_{model.stem}"
        return cls(label, "tcae", (("model", str(model)),), precision)

    def build(self, waveform: Waveform) -> Mitigation:
        """A new method; raises `MitigationError` if it does not fit the waveform."""
        span_m = self.settings.resolved(waveform).max_altitude_m
        return create(self.method, waveform, max_altitude_m=span_m, **dict(self.options))

    @property
    def model(self) -> Path | None:
        """The network's file; None for the classical methods."""
        model = dict(self.options).get("model")
        return Path(model) if model else None

    def with_model(self, model: Path) -> "Chain":
        """The chain with its network at another path."""
        options = tuple((k, str(model) if k == "model" else v) for k, v in self.options)
        return dataclasses.replace(self, options=options)

    def head(self, waveform: Waveform) -> dict[str, Any]:
        """Everything on which its rows depend, a network by its hash, not its path; raises `MitigationError`."""
        options = dict(self.options) | ({"model": self.model.name} if self.model else {})
        sha256 = getattr(self.build(waveform), "sha256", None)
        return vars(self) | {
            "options": options,
            "settings": dataclasses.asdict(self.settings),
            **({"sha256": sha256} if sha256 else {}),
        }

    def results(self, frames: np.ndarray, waveform: Waveform) -> tuple[np.ndarray, Mitigation]:
        """Altimeter results of ``(n, N)`` frames after a reset of the method, and the method.

        There are ``n / looks`` of them. The method is built once per process and reset before the first frame.
        """
        method = method_of(self, waveform)
        method.reset()
        altimeter = shared_altimeter(waveform, self.settings)
        examine = FrameQuality(waveform, altimeter.settings.max_altitude_m)
        step = self.looks * max(1, _CHUNK // self.looks)
        parts = []
        for k in range(0, len(frames), step):
            given = np.asarray(frames[k : k + step], dtype=np.complex64)
            quality = examine(given)
            spectra = altimeter.spectra(method.process(given, quality), quality)
            if self.looks > 1:
                spectra = _averaged(spectra, self.looks)
            parts.append(altimeter.detect(spectra))
        return np.concatenate(parts), method


def _averaged(spectra: Spectra, looks: int) -> Spectra:
    """Mean power spectra of groups of looks; the CFAR keeps its threshold for one look, which is conservative."""
    # spectra are scaled to unit peak: restore the scale, so that looks are weighted by their power
    power = spectra.power * (spectra.scale**2)[:, None, None]
    power = power.reshape(-1, looks, *power.shape[1:]).mean(axis=1)
    scale = np.sqrt(power.max(axis=(1, 2)))
    power = (power / np.where(scale > 0, scale, 1.0)[:, None, None] ** 2).astype(np.float32)
    support = spectra.support.reshape(-1, looks, 2).mean(axis=1)
    return Spectra(power, support, spectra.beat_hz, scale)


@lru_cache(maxsize=64)
def method_of(chain: Chain, waveform: Waveform) -> Mitigation:
    """The chain's method, built once per process; its state is that of its last use."""
    return chain.build(waveform)
