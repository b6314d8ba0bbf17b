"""An ONNX file, or encoder and decoder, by ONNX Runtime.

onnxruntime is imported when a model is loaded, never at module level: a scene without a network does not need it.
"""

import logging
import os
import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np

from ..interrupts import ctrl_c_waits
from ..paths import remedy
from .base import MitigationError

# ONNX Runtime's packages report every session to their maker unless this is set before they are imported.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

_CPU = "CPUExecutionProvider"
# ONNX Runtime's execution providers by option, first choice first.
PROVIDERS = {"cpu": (_CPU,), "cuda": ("CUDAExecutionProvider", _CPU)}
_LOG = logging.getLogger(__name__)


def network_files(model: str | Path) -> tuple[Path, ...]:
    """The files of a network: one, or encoder and decoder of ``ENCODER.onnx+DECODER.onnx``.

    Examples
    --------
    >>> [path.name for path in network_files("c++/encoder.ONNX+c++/decoder.onnx")]
    ['encoder.ONNX', 'decoder.onnx']
    """
    if Path(model).exists():
        return (Path(model),)
    return tuple(map(Path, re.split(r"(?<=\.onnx)\+(?=.)", str(model), maxsplit=1, flags=re.IGNORECASE)))


class OnnxNetwork:
    """A network's session, or those of encoder and decoder.

    - ``model``: as of `network_files`; of two files the first one's output is the second one's input
    - ``threads``: Intra-op threads
    - ``provider``: ``"cpu"``, or ``"cuda"`` where the user's onnxruntime has it; elsewhere one line says so and the
      processor runs the network
    - ``metadata``: as the file carries it; of two files the first one's, completed by the second one's

    Raises `MitigationError` if onnxruntime is missing, a file is no readable model, or decoder does not fit encoder.
    """

    def __init__(self, model: Path, threads: int, provider: str = "cpu") -> None:
        self.model = model
        loaded = [_load(file, threads, provider) for file in network_files(model)]
        self._ort, self._session = loaded[-1]
        self._encoder = loaded[0][1] if len(loaded) == 2 else None
        if self._encoder is not None:
            _check_fit(model, self._encoder, self._session)
        self._input, self._output = self._session.get_inputs()[0].name, self._session.get_outputs()[0].name
        self.metadata: dict[str, str] = {}
        for _, session in reversed(loaded):
            self.metadata |= session.get_modelmeta().custom_metadata_map
        self._binding = self._session.io_binding()

    def bind(self, tables: Mapping[str, np.ndarray]) -> None:
        """Take the constants of a sweep for the inputs of these names."""
        self._tables = dict(tables)  # older releases of ONNX Runtime read them where they are
        for name in {entry.name for entry in self._session.get_inputs()} & tables.keys():
            self._binding.bind_ortvalue_input(name, self._ort.OrtValue.ortvalue_from_numpy(tables[name]))

    @property
    def providers(self) -> list[str]:
        """ONNX Runtime's execution providers."""
        return self._session.get_providers()

    def run(self, planes: np.ndarray) -> np.ndarray:
        """Output for (n, 2, N) float32 planes, contiguous."""
        try:
            self._binding.bind_cpu_input(
                self._input, planes if self._encoder is None else self._encoded(planes)
            )
            self._binding.bind_output(self._output)  # anew, or it would keep the shape of the last run's
            self._session.run_with_iobinding(self._binding)
            return self._binding.copy_outputs_to_cpu()[0]
        except Exception as error:  # onnxruntime raises a family of unrelated C++ exception types
            raise MitigationError(f"tcae model {self.model} failed to run: {_first_line(error)}") from None

    def _encoded(self, planes: np.ndarray) -> np.ndarray:
        """The encoder's output."""
        return self._encoder.run(None, {self._encoder.get_inputs()[0].name: planes})[0]


def gpu_there(provider: str) -> bool:
    """Whether a provider is one of a GPU that this onnxruntime has."""
    if PROVIDERS[provider] == PROVIDERS["cpu"]:
        return False
    try:
        return PROVIDERS[provider][0] in _onnxruntime().get_available_providers()
    except ImportError:
        return False  # loading says so


def _onnxruntime():  # noqa: ANN202 - the package is optional
    """The package; raises ImportError."""
    with ctrl_c_waits():
        import onnxruntime
    return onnxruntime


def _load(model: Path, threads: int, provider: str):  # noqa: ANN202 - the types live in the optional package
    """The package and a session, which is shared by all who run the same file: making one takes 0.1 s."""
    try:
        onnxruntime = _onnxruntime()
    except ImportError:
        raise MitigationError(
            f"tcae needs onnxruntime, which this Python lacks; {remedy('onnxruntime')}"
        ) from None
    if not model.is_file():
        raise MitigationError(f"tcae model {model} does not exist; name one with --model")
    wanted, there = PROVIDERS[provider], onnxruntime.get_available_providers()
    try:
        written = model.stat()
        names = tuple(name for name in wanted if name in there)
        session = _session(str(model), threads, names, (written.st_mtime_ns, written.st_size))
    except Exception as error:  # see OnnxNetwork.run
        if "xternal data" in str(error):
            raise MitigationError(
                f"tcae model {model} keeps weights outside its file, where no digest covers them; "
                "save it in one file: onnx.save(onnx.load(FILE), FILE)"
            ) from None
        raise MitigationError(f"tcae model {model} is no readable ONNX file: {_first_line(error)}") from None
    if wanted[0] not in session.get_providers():
        _LOG.warning("tcae: no %s in this onnxruntime; the network runs on the processor", wanted[0])
    return onnxruntime, session


@lru_cache(maxsize=4)
def _session(model: str, threads: int, providers: tuple[str, ...], written: tuple[int, int]):  # noqa: ANN202 - see _load
    import onnxruntime

    del written  # another file of the same name is another key
    content = Path(model).read_bytes()
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    # A digest of the file has to cover its weights: none is taken from files next to it.
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", os.devnull)
    return onnxruntime.InferenceSession(content, options, providers=list(providers))


def _check_fit(model: Path, encoder, decoder) -> None:  # noqa: ANN001 - see _load
    """Raise unless one input and one output each fit; lengths that a file leaves open are found in running."""
    if any(len(ends) != 1 for part in (encoder, decoder) for ends in (part.get_inputs(), part.get_outputs())):
        raise MitigationError(
            f"tcae model {model}: encoder and decoder have to have one input and one output each; "
            "join them with onnx.compose.merge_models"
        )
    given, taken = encoder.get_outputs()[0], decoder.get_inputs()[0]
    fits = given.type == taken.type and len(given.shape) == len(taken.shape)
    sizes = zip(given.shape, taken.shape, strict=False)
    if not fits or any(a != b for a, b in sizes if isinstance(a, int) and isinstance(b, int)):
        raise MitigationError(
            f"tcae model {model}: the encoder gives {given.type} {given.shape}, the decoder takes "
            f"{taken.type} {taken.shape}; name the files of one network"
        )


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0]
