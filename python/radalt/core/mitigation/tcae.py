"""Temporal convolutional autoencoder, or any other network with the same contract, through ONNX Runtime.

onnxruntime is imported when a model is loaded, never at module level: a scene without a network does not need it.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from ..detector import InterferenceDetector
from ..waveform import Waveform
from .base import Mitigation, MitigationError

__all__ = ["Tcae", "default_model_path", "CONTRACT_KEYS"]

# metadata every model carries; DESIGN.md 5
CONTRACT_KEYS = (
    "radalt_frame_samples",
    "radalt_layout",
    "radalt_normalisation",
    "radalt_rate_hz",
    "radalt_centered",
)
LAYOUT = "iq_channels_first"  # float32 (batch, 2, N), channel 0 I, channel 1 Q
NORMALISATIONS = ("joint_peak", "per_channel_peak", "joint_rms", "none")


def default_model_path() -> Path:
    """The model that `tcae` runs unless another is named: in-tree ``models/``, else the installed share."""
    from ..paths import model_path

    return model_path("tcae.onnx")


class Tcae(Mitigation):
    """A network that maps an IQ frame to a cleaned IQ frame.

    Parameters
    ----------
    model : path, optional
        ONNX file, default `default_model_path`. Its metadata states frame length, layout, normalisation, rate and
        centering; whatever does not fit the waveform is refused on construction in one line.
    threads : int
        Intra-op threads; 1 is fastest inside a flowgraph (FIELD_NOTES).
    skip_clean : bool
        Frames that show no interference pass unchanged, without the network; see `InterferenceDetector` for what it
        misses.
    dither_db : float or None
        White noise added before the network, relative to the frame's power, the same in every frame. Networks see
        noise in training; on a frame almost without any (SNR above 50 dB) the shipped one lost the altitude or made
        one up, and with -50 dB it does not.

    Raises
    ------
    MitigationError
        If onnxruntime is missing, the file is unreadable, or the contract does not fit.
    """

    name = "tcae"

    def __init__(
        self,
        waveform: Waveform,
        *,
        model: str | Path | None = None,
        threads: int = 1,
        skip_clean: bool = False,
        dither_db: float | None = -50.0,
    ) -> None:
        if dither_db is not None and not -120 <= dither_db <= 0:
            raise MitigationError(f"tcae.dither_db is {dither_db!r}; it has to be within -120..0, or none")
        self._detector = InterferenceDetector(waveform) if skip_clean else None
        self.model = Path(model) if model else default_model_path()
        self._session = self._load(threads)
        self._dither = None if dither_db is None else _dither(waveform.samples_per_frame, dither_db)
        self.metadata = dict(self._session.get_modelmeta().custom_metadata_map)
        self._check(waveform)
        self.normalisation = self.metadata["radalt_normalisation"]
        self.sha256 = hashlib.sha256(self.model.read_bytes()).hexdigest()
        super().__init__(waveform)
        self._probe()

    @property
    def placeholder(self) -> bool:
        """True if the model says of itself that it is untrained."""
        return self.metadata.get("radalt_placeholder", "0") == "1"

    def _load(self, threads: int):  # noqa: ANN202 - the type lives in the optional package
        try:
            import onnxruntime
        except ImportError:
            raise MitigationError(
                "tcae needs onnxruntime, which this Python lacks; run 'make setup' and use .venv/bin/python"
            ) from None
        if not self.model.is_file():
            raise MitigationError(f"tcae model {self.model} does not exist; name one with --model")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.log_severity_level = 3
        try:
            return onnxruntime.InferenceSession(str(self.model), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime raises a family of unrelated C++ exception types
            first_line = str(error).splitlines()[0]
            raise MitigationError(f"tcae model {self.model} is no readable ONNX file: {first_line}") from None

    def _check(self, waveform: Waveform) -> None:
        missing = [key for key in CONTRACT_KEYS if key not in self.metadata]
        if missing:
            raise MitigationError(
                f"tcae model {self.model} lacks the metadata {', '.join(missing)}; export it with training/"
            )
        expected = {
            "radalt_frame_samples": str(waveform.samples_per_frame),
            "radalt_layout": LAYOUT,
            "radalt_rate_hz": f"{waveform.rate_hz:g}",
            "radalt_centered": "1" if waveform.centered else "0",
        }
        for key, wanted in expected.items():
            have = self.metadata[key]
            same = float(have) == float(wanted) if key == "radalt_rate_hz" else have == wanted
            if not same:
                raise MitigationError(
                    f"tcae model {self.model} does not fit the scene: {key} is {have}, the scene needs {wanted}; "
                    "use a model trained for this waveform"
                )
        if self.metadata["radalt_normalisation"] not in NORMALISATIONS:
            raise MitigationError(
                f"tcae model {self.model}: radalt_normalisation is {self.metadata['radalt_normalisation']!r}; "
                f"known: {', '.join(NORMALISATIONS)}"
            )

    def _probe(self) -> None:
        """One frame through the network: shape and finiteness, before any flowgraph starts."""
        frame = self.waveform.reference[None]
        out = self._infer(frame)
        if out.shape != frame.shape or not np.isfinite(out.view(np.float32)).all():
            raise MitigationError(f"tcae model {self.model} gives {out.shape} or values that are not finite")

    def reset(self) -> None:
        """See `Mitigation.reset`."""
        super().reset()
        self.skipped_frames = 0

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        if self._detector is None:
            return self._infer(batch)
        out = batch.copy()
        present = self._detector.present(batch)
        self.skipped_frames += int(np.count_nonzero(~present))
        if present.any():
            out[present] = self._infer(np.ascontiguousarray(batch[present]))
        return out

    def _infer(self, batch: np.ndarray) -> np.ndarray:
        n, samples = batch.shape
        planes = np.ascontiguousarray(batch.view(np.float32).reshape(n, samples, 2).transpose(0, 2, 1))
        scale = self._scale(planes)
        empty = _peak(planes, (1, 2)) < np.finfo(np.float32).tiny
        planes /= scale
        if self._dither is not None:
            planes += self._dither * np.sqrt(2 * np.mean(planes**2, axis=(1, 2), keepdims=True))
        session = self._session
        try:
            cleaned = session.run(None, {session.get_inputs()[0].name: planes})[0]
        except Exception as error:  # see _load
            raise MitigationError(
                f"tcae model {self.model} failed to run: {str(error).splitlines()[0]}"
            ) from None
        if cleaned.shape != planes.shape:
            raise MitigationError(
                f"tcae model {self.model} gives shape {cleaned.shape}; expected {planes.shape}"
            )
        # a network may make something of nothing; and what it makes of 1e38 need not fit a float32
        with np.errstate(over="ignore"):
            cleaned = cleaned * np.where(empty, np.float32(0), scale)
        out = np.empty((n, samples), dtype=np.complex64)
        out.real, out.imag = cleaned[:, 0], cleaned[:, 1]
        return out

    def _scale(self, planes: np.ndarray) -> np.ndarray:
        """(n, 1|2, 1) factor by which the frame is divided before, and multiplied after, the network."""
        if self.normalisation == "none":
            return np.ones((planes.shape[0], 1, 1), dtype=np.float32)
        if self.normalisation == "joint_rms":
            peak = _peak(planes, (1, 2))  # first, so that squares cannot overflow
            peak = np.where(peak >= np.finfo(np.float32).tiny, peak, np.float32(1))
            return peak * np.sqrt(2 * np.mean((planes / peak) ** 2, axis=(1, 2), keepdims=True)).clip(1e-30)
        axes = (2,) if self.normalisation == "per_channel_peak" else (1, 2)
        peak = _peak(planes, axes)
        return np.where(peak >= np.finfo(np.float32).tiny, peak, np.float32(1))

    def status(self) -> dict[str, object]:
        """See `Mitigation.status`: model file, hash, providers, threads."""
        return super().status() | {
            "model": self.model.name,
            "sha256": self.sha256,
            "placeholder": self.placeholder,
            "skipped_frames": self.skipped_frames,
            "providers": self._session.get_providers(),
        }


def _peak(planes: np.ndarray, axes: tuple[int, ...]) -> np.ndarray:
    """Largest magnitude along axes, which stay; a third of the time of ``max(abs())``, which makes an array."""
    return np.maximum(planes.max(axis=axes, keepdims=True), -planes.min(axis=axes, keepdims=True))


def _dither(samples: int, level_db: float) -> np.ndarray:
    """(2, samples) float32 white noise of a fixed seed, complex power ``level_db``."""
    noise = np.random.default_rng(0x7CAE).standard_normal((2, samples))
    return (noise * 10.0 ** (level_db / 20.0) / np.sqrt(2.0)).astype(np.float32)
