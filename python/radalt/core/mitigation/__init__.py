"""Mitigation methods: complex frames in, cleaned frames of the same shape out, one registry for all of them.

>>> from radalt.core.mitigation import METHODS, create
>>> from radalt.core.waveform import Waveform
>>> sorted(METHODS)
['blanking', 'linear_prediction', 'lms', 'lms_reference_input', 'nlms', 'nlms_predictor', 'none', 'tcae', 'whitening']
>>> create("whitening", Waveform()).name
'whitening'
"""

from __future__ import annotations

from collections.abc import Callable

from ..cores import allowed_cores
from ..waveform import Waveform
from .base import Mitigation, MitigationError
from .blanking import Blanking
from .custom import Custom
from .identity import Identity
from .lms import BlockLms, Nlms
from .own_process import OwnProcess
from .prediction import LinearPrediction, NlmsPredictor
from .tcae import Tcae
from .whitening import Whitening

__all__ = ["CUSTOM", "METHODS", "Mitigation", "MitigationError", "create"]

METHODS: dict[str, Callable[..., Mitigation]] = {
    "none": Identity,
    "lms": BlockLms,
    "lms_reference_input": lambda waveform, **kw: BlockLms(
        waveform, **({"wiring": "reference_input", "length": 96, "restart": True} | kw)
    ),
    "nlms": Nlms,
    "nlms_predictor": NlmsPredictor,
    "linear_prediction": LinearPrediction,
    "whitening": Whitening,
    "blanking": Blanking,
    "tcae": Tcae,
}

# a method of the user's own, from a Python file: not among METHODS, since it is nothing without its file
CUSTOM = Custom.name


def create(
    name: str, waveform: Waveform, *, own_process: bool = False, batch: int = 4, **parameters: object
) -> Mitigation:
    """A fresh method by its registry name; ``"custom"`` with ``file=`` is one of your own (`Custom`).

    Parameters
    ----------
    name : str
    waveform : Waveform
    own_process : bool
        Compute in a process of its own, ``batch`` frames at a time (`OwnProcess`). Without effect where this process
        may use one core only, since the two would but take turns.
    batch : int
    **parameters
        Of the method.

    Raises
    ------
    MitigationError
        For an unknown name or parameter; names what is allowed.
    """
    if name not in METHODS and name != CUSTOM:
        raise MitigationError(f"unknown mitigation method {name!r}; known: {', '.join(METHODS)}")
    if not isinstance(own_process, bool):
        raise MitigationError(f"{name}.own_process is {own_process!r}; it has to be true or false")
    if own_process and len(allowed_cores()) > 1:
        return OwnProcess(name, waveform, batch=batch, **parameters)
    try:
        return (METHODS | {CUSTOM: Custom})[name](waveform, **parameters)
    except TypeError as error:
        raise MitigationError(f"mitigation {name!r}: {error}") from None
