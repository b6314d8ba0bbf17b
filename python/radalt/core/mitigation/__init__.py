"""Mitigation methods: complex frames in, cleaned frames of the same shape out, one registry for all of them.

>>> from radalt.core.mitigation import create
>>> from radalt.core.waveform import Waveform
>>> create("whitening", Waveform()).name
'whitening'
"""

import importlib
import inspect
import pkgutil
import re

from ..altimeter.altimeter_settings import AltimeterSettings
from ..altimeter.frame_quality import FrameQuality
from ..cores import allowed_cores
from ..parsing import allowed, arguments, shown
from ..plugins import load_plugins
from ..waveform import Waveform
from .base import METHODS, Mitigation, MitigationError, PlotStyle, register
from .blanking import Blanking
from .custom import Custom
from .hybrid import Hybrid
from .identity import Identity
from .imat import Imat
from .lms import BlockLms, BlockLmsReferenceInput, Nlms
from .ofdm_cancel import OfdmCancel
from .own_process import OwnProcess
from .prediction import LinearPrediction, NlmsPredictor
from .qpsk_cancel import QpskCancel
from .stft_cfar import StftCfar
from .tcae import Tcae
from .time_frequency import TimeFrequency
from .whitening import Whitening

__all__ = [
    "CUSTOM",
    "METHODS",
    "Mitigation",
    "MitigationError",
    "PlotStyle",
    "create",
    "method_class",
    "name_method",
    "register",
]

# The method of a user's Python file; not among METHODS, since it needs the file.
CUSTOM = Custom.name

for _method in (
    Identity,
    BlockLms,
    BlockLmsReferenceInput,
    Nlms,
    NlmsPredictor,
    LinearPrediction,
    Whitening,
    TimeFrequency,
    Blanking,
    StftCfar,
    Imat,
    OfdmCancel,
    QpskCancel,
    Tcae,
    Hybrid,
):  # in the order of reports
    register(_method)


def method_class(name: str) -> type[Mitigation]:
    """The class of a method by its registry name, `CUSTOM` included.

    Raises `MitigationError` for an unknown name; names those that are known.
    """
    if name == CUSTOM:
        return Custom
    if name not in METHODS:
        raise MitigationError(f"unknown mitigation method {shown(name)}; {allowed(name, METHODS)}")
    return METHODS[name]


_NAMED: dict[str, type[Mitigation]] = {}  # by `name_method`
_NAME = re.compile(r"[a-z][a-z0-9_]{0,30}")
# Solid lines, so that a user's own method stands out in a figure.
_OWN_STYLES = (PlotStyle("#1B7837", "s"), PlotStyle("#762A83", "P"), PlotStyle("#A6611A", "<"))


def name_method(name: str, kind: str) -> None:
    """Make a network (``kind`` `tcae`) or a method file (`custom`) a method of its own name, in this process.

    A scene does so where ``method_options`` of a name say ``method: tcae`` or ``method: custom``.

    Raises `MitigationError` if the name is a shipped method's, or none that a block can have.
    """
    if kind not in (Tcae.name, CUSTOM):
        raise MitigationError(
            f"method_options.{name}.method is {kind!r}; it has to be {Tcae.name} or {CUSTOM}"
        )
    base = Tcae if kind == Tcae.name else Custom
    if name in _NAMED and issubclass(_NAMED[name], base):
        return
    if not _NAME.fullmatch(name) or (name in METHODS and name not in _NAMED) or name == CUSTOM:
        raise MitigationError(
            f"a method of your own cannot be called {name!r}; take a new name of lower-case letters, digits and _"
        )
    style = _OWN_STYLES[len(_NAMED) % len(_OWN_STYLES)]
    METHODS.pop(name, None)  # a name may stand for another kind after this
    _NAMED[name] = register(type(base.__name__, (base,), {"name": name, "style": style}))


def create(
    name: str,
    waveform: Waveform,
    *,
    own_process: bool = False,
    batch: int = 4,
    max_altitude_m: float | None = None,
    drop_when_slow: bool = False,
    independent: bool = False,
    **parameters: object,
) -> Mitigation:
    """A fresh method by its registry name; ``"custom"`` with ``file=`` is one of your own (`Custom`).

    - ``own_process``: compute in a process of its own, ``batch`` frames at a time (`OwnProcess`). Without effect where
      this process may use one core only, since the two would only take turns
    - ``max_altitude_m``: highest altitude that the altimeter searches; None takes the altimeter's default. It is the
      default of ``span_m``, where the method has one. A frame with ground beyond it passes unchanged (`BeyondSpan`)
    - ``drop_when_slow``: whether the frame segmenter drops frames where the method is too slow, for methods that then
      do less
    - ``independent``: whether frames have nothing to do with each other (`Mitigation.independent`)
    - ``**parameters``: of the method

    Raises `MitigationError` for an unknown name or parameter; names what is allowed.
    """
    if "method" in parameters:
        name_method(name, parameters["method"])
    method = method_class(name)
    if isinstance(batch, bool) or not isinstance(batch, int) or not 1 <= batch <= 64:
        raise MitigationError(f"{name}.batch is {batch!r}; it has to be a whole number within 1..64")
    known = inspect.signature(method).parameters
    if max_altitude_m is not None and "span_m" in known:
        parameters = {"span_m": max_altitude_m, **parameters}
    if "drop_when_slow" in known:
        parameters["drop_when_slow"] = drop_when_slow
    if not isinstance(own_process, bool):
        raise MitigationError(f"{name}.own_process is {own_process!r}; it has to be true or false")
    if own_process and len(allowed_cores()) > 1:
        return OwnProcess(
            name, waveform, batch=batch, max_altitude_m=max_altitude_m, independent=independent, **parameters
        )
    parameters.pop("method", None)
    try:
        if isinstance(method, type):
            parameters = arguments(method, parameters, name)
        built = method(waveform, **parameters)
    except MitigationError:
        raise
    except (TypeError, ValueError) as error:
        text = str(error)
        raise MitigationError(text if text.startswith(name) else f"mitigation {name!r}: {text}") from None
    built.independent = independent
    if name != Identity.name:
        span_m = (
            max_altitude_m
            or parameters.get("span_m")
            or AltimeterSettings().resolved(waveform).max_altitude_m
        )
        built.frame_quality = FrameQuality(waveform, span_m)
    return built


# other files in this folder, and plugins outside, register themselves
for _file in pkgutil.iter_modules(__path__):
    importlib.import_module(f".{_file.name}", __name__)
load_plugins()
