"""Temporal convolutional autoencoder, or any other network with the same contract, through ONNX Runtime."""

import hashlib
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..parsing import shown
from ..waveform import Waveform
from .any_sweep import layout_of, resampled, tables_of
from .base import Mitigation, MitigationError, PlotStyle, peak_scale
from .input_scaler import NORMALISATIONS, InputScaler
from .interference_detector import InterferenceDetector
from .onnx_network import PROVIDERS, OnnxNetwork, gpu_there, network_files
from .shift_check import ShiftCheck
from .trial_run import try_out

# metadata every model carries
CONTRACT_KEYS = (
    "radalt_frame_samples",
    "radalt_layout",
    "radalt_normalisation",
    "radalt_rate_hz",
    "radalt_centered",
)
_MOST_THREADS = 64
ANY = "any"  # in the metadata of a network that serves every sweep
LAYOUT = "iq_channels_first"  # float32 (batch, 2, N), channel 0 I, channel 1 Q
# Power next to the return over the return's in an output, dB, from which the altimeter alone is better in white noise.
LOST_DB = -1.0
# Stride in samples at which an output is checked: within 0.3 dB of all samples, prime to the filterbank's period, 30.
_EVERY = 7


def default_model_path(waveform: Waveform | None = None, *, gpu: bool = False) -> Path:
    """The model that `tcae` runs unless another is named: in-tree ``models/``, else the installed share.

    ``tcae.onnx`` for the sweep that it was trained on, or None; ``any_sweep.onnx`` for any other, and on a GPU: CUDA
    lacks an operator of the first for rows as long as a frame.
    """
    from ..paths import model_path

    own = waveform is None or replace(waveform, carrier_hz=Waveform.carrier_hz) == Waveform()
    return model_path("tcae.onnx" if own and not gpu else "any_sweep.onnx")


def _is_default(sha256: str) -> bool:
    """Whether a model is the shipped default, by its bytes: on a worker of a cluster every file is a copy."""
    try:
        return sha256 == hashlib.sha256(default_model_path().read_bytes()).hexdigest()
    except FileNotFoundError:  # nothing is shipped here
        return False


def _is_shipped(model: Path) -> bool:
    """Whether a model lies in the folder of the shipped ones; any other may be foreign code."""
    try:
        return model.resolve().parent == default_model_path().resolve().parent
    except OSError:
        return False


def _number(text: str) -> float:
    """A number from the metadata; NaN, which equals nothing, for any other text."""
    try:
        return float(text)
    except ValueError:
        return math.nan


class Tcae(Mitigation):
    """A network that maps an IQ frame to a cleaned IQ frame.

    A frame of constant modulus (a 1-bit converter, a hard limiter, a return without noise) passes as it is, counted
    in ``flat_frames``. Networks read interference from the modulus, and would take the whole frame for interference.

    - ``model``: ONNX file, or ``ENCODER.onnx+DECODER.onnx``; default `default_model_path`. Its metadata states frame
      length, layout, normalisation, rate and centering; whatever does not fit the waveform is refused on construction
      in one line. A network for ``any`` sweep takes the sweep's tables as inputs (`any_sweep`); frames are resampled
      where their length asks for it.
    - ``threads``: Intra-op threads; 1 is fastest inside a flowgraph, whose other blocks want the cores
    - ``skip_clean``: frames that show no interference pass unchanged, without the network; see `InterferenceDetector`
      for what it misses
    - ``dither_db``: white noise added before the network, relative to the frame's power, a function of the frame.
      Networks see noise in training; on a frame almost without any (SNR above 50 dB) the shipped one lost the
      altitude or made one up, and with -50 dB it does not.
    - ``shift_check``: whether a frame whose altitude does not move with it is silenced, which makes it invalid
      (`ShiftCheck`), and counted in ``unconfirmed_frames``. It costs a second run of the network in frames that show
      interference and an altitude. None: on for every model but the shipped default, which docs/stability.md shows to
      pass without.
    - ``skip_white``: frames that hold nothing but a return and white noise pass unchanged
      (`InterferenceDetector.white`), counted in ``skipped_frames``: untouched frames cost no time and hold no false
      return. None: on for a network of any sweep. 5G wider than the sweep is white, too.
    - ``skip_lost``: a frame in white noise passes unchanged only where the network leaves nearly as much next to the
      return as the return's power: the altimeter alone reads more of these. None: on for the shipped default.

    Raises `MitigationError` if onnxruntime is missing, the file is unreadable, or the contract does not fit.
    """

    name = "tcae"
    style = PlotStyle("#0072B2", "*")
    batch = 1  # a network's last bits depend on the batch
    runs_network = True

    def __init__(
        self,
        waveform: Waveform,
        *,
        model: str | Path | None = None,
        threads: int = 1,
        skip_clean: bool = False,
        dither_db: float | None = -50.0,
        shift_check: bool | None = None,
        skip_white: bool | None = None,
        skip_lost: bool | None = None,
        provider: str = "cpu",
        span_m: float | None = None,
    ) -> None:
        choices = {"shift_check": shift_check, "skip_white": skip_white, "skip_lost": skip_lost}
        for name, value in choices.items():
            if value not in (True, False, None):
                raise MitigationError(f"tcae.{name} is {value!r}; it has to be true, false or none")
        if dither_db is not None and not -120 <= dither_db <= 0:
            raise MitigationError(f"tcae.dither_db is {dither_db!r}; it has to be within -120..0, or none")
        self._detector = InterferenceDetector(waveform) if skip_clean else None
        if not 1 <= threads <= _MOST_THREADS:
            raise MitigationError(f"tcae.threads is {threads!r}; it has to be within 1..{_MOST_THREADS}")
        if provider not in PROVIDERS:
            raise MitigationError(f"tcae.provider is {provider!r}; one of {', '.join(PROVIDERS)}")
        self.model = Path(model) if model else default_model_path(waveform, gpu=gpu_there(provider))
        self.threads = threads
        self.files = network_files(self.model)
        if all(file.is_file() for file in self.files) and not all(map(_is_shipped, self.files)):
            try_out("tcae model", waveform, *self.files)
        self._network = OnnxNetwork(self.model, threads, provider)
        self.metadata = self._network.metadata
        self._check(waveform)
        self._samples = waveform.samples_per_frame  # inside the network
        any_sweep = self.metadata["radalt_frame_samples"] == ANY
        if any_sweep:
            layout = layout_of(waveform, span_m)
            self._samples = layout.samples
            self._network.bind(tables_of(waveform, layout))
        self._scaler = InputScaler(self.metadata["radalt_normalisation"], self._samples, dither_db)
        self.sha256 = hashlib.sha256(b"".join(file.read_bytes() for file in self.files)).hexdigest()
        default = _is_default(self.sha256)
        skips = any_sweep if skip_white is None else skip_white
        self._white = InterferenceDetector(waveform) if skips else None
        doubts = default if skip_lost is None else skip_lost
        self._doubt = InterferenceDetector(waveform) if doubts else None
        super().__init__(waveform)
        self._probe()
        wanted = not default if shift_check is None else shift_check
        self._shift_check = ShiftCheck(waveform) if wanted else None

    @property
    def placeholder(self) -> bool:
        """True if the model says of itself that it is untrained."""
        return self.metadata.get("radalt_placeholder", "0") == "1"

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
            if have == ANY and key != "radalt_layout":
                continue
            same = _number(have) == float(wanted) if key == "radalt_rate_hz" else have == wanted
            if not same:
                raise MitigationError(
                    f"tcae model {self.model} does not fit the scene: {key} is {shown(have)}, the scene needs "
                    f"{wanted}; use a model trained for this waveform, or leave model out"
                )
        if self.metadata["radalt_normalisation"] not in NORMALISATIONS:
            raise MitigationError(
                f"tcae model {self.model}: radalt_normalisation is {self.metadata['radalt_normalisation']!r}; "
                f"known: {', '.join(NORMALISATIONS)}"
            )

    def _probe(self) -> None:
        """One frame through the network: shape and finiteness, before any flowgraph starts."""
        wanted = 1, 2, self._samples
        shape = self._network.run(np.ones(wanted, np.float32)).shape
        if shape != wanted:
            raise MitigationError(f"tcae model {self.model} gives shape {shape}; expected {wanted}")
        if not np.isfinite(self._infer(self.waveform.reference[None]).view(np.float32)).all():
            raise MitigationError(f"tcae model {self.model} gives values that are not finite")

    def reset(self) -> None:
        """See `Mitigation.reset`."""
        super().reset()
        self.skipped_frames = 0
        self.unconfirmed_frames = 0
        self.flat_frames = 0

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        flat = _constant_modulus(batch)
        self.flat_frames += int(np.count_nonzero(flat))
        present = ~flat
        if self._detector is not None:
            present &= self._detector.present(batch)
        if self._white is not None:
            present &= ~self._white.white(batch)
        self.skipped_frames += int(np.count_nonzero(~(present | flat)))
        if present.all():
            return self._confirmed(batch)
        out = batch.copy()
        if present.any():
            out[present] = self._confirmed(np.ascontiguousarray(batch[present]))
        return out

    def _confirmed(self, batch: np.ndarray) -> np.ndarray:
        out = self._infer(batch)
        lost = self._skip_lost(batch, out)
        if self._shift_check is not None:
            # with a detector only frames that show interference come here
            known = self._detector is not None
            false_returns = ~(lost | self._shift_check.holds(batch, out, self._infer, disturbed=known))
            self.unconfirmed_frames += int(false_returns.sum())
            out[false_returns] = 0
        return out

    def _skip_lost(self, batch: np.ndarray, out: np.ndarray) -> np.ndarray:
        """Put frames (n, N) in white noise of which the network left no clear return into its output; which, (n,)."""
        lost = np.zeros(len(batch), dtype=bool)
        if self._doubt is not None:
            lost = self._doubt.residual_db(out, _EVERY) > LOST_DB
            if lost.any():
                lost[lost] = self._doubt.white(batch[lost])
                self.skipped_frames += int(np.count_nonzero(lost))
                out[lost] = batch[lost]
        return lost

    def _infer(self, batch: np.ndarray) -> np.ndarray:
        if batch.shape[1] == self._samples:
            return self._run(batch)
        scale = peak_scale(batch)  # squares may overflow
        longer = resampled(batch / scale, self._samples).astype(np.complex64, copy=False)
        return (resampled(self._run(longer), batch.shape[1]) * scale).astype(np.complex64, copy=False)

    def _run(self, batch: np.ndarray) -> np.ndarray:
        """(n, N) complex64 of the network's length through it."""
        out, planes = np.empty_like(batch), np.empty((len(batch), 2, self._samples), dtype=np.float32)
        # one scale per frame, or one per rail
        scales = np.array(list(map(self._scaler.fill, planes, batch)), dtype=np.float32).reshape(len(out), -1)
        cleaned = self._network.run(planes)
        with np.errstate(over="ignore"):  # a network's output for 1e38 may exceed float32
            for frame, rails, factor in zip(out, cleaned, scales, strict=True):  # each stays in the cache
                np.multiply(rails[0], factor[0], out=frame.real)
                np.multiply(rails[1], factor[-1], out=frame.imag)
        return out

    def status(self) -> dict[str, object]:
        """See `Mitigation.status`: model file, hash, providers, threads."""
        return super().status() | {
            "model": "+".join(file.name for file in self.files),
            "sha256": self.sha256,
            "placeholder": self.placeholder,
            "skipped_frames": self.skipped_frames,
            "shift_check": self._shift_check is not None,
            "unconfirmed_frames": self.unconfirmed_frames,
            "flat_frames": self.flat_frames,
            "providers": self._network.providers,
            "threads": self.threads,
        }


def _constant_modulus(batch: np.ndarray) -> np.ndarray:
    """(n,) bool: frames (n, N) whose modulus stays within a thousandth; a few samples decide for almost all."""
    flat = _even(np.abs(batch[:, ::500].astype(np.complex128)))  # squares of float32 fit a double
    if flat.any():
        flat[flat] = _even(np.abs(batch[flat].astype(np.complex128)))
    return flat


def _even(modulus: np.ndarray) -> np.ndarray:
    top = modulus.max(axis=1)
    return top - modulus.min(axis=1) <= 1e-3 * top
