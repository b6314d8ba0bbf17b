"""A user's function as a method, for `radalt.method` and `radalt.evaluate`."""

import contextlib
import hashlib
import inspect
from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar, TypeAlias, cast

import numpy as np

from ..waveform import Waveform
from .base import METHODS, Mitigation, MitigationError

# a registry name, a class of method, or a function of (n, N) complex64 frames and the waveform
_Function: TypeAlias = Callable[[np.ndarray, Waveform], np.ndarray]
MethodLike: TypeAlias = str | type[Mitigation] | _Function


def function_method(function: _Function) -> type[Mitigation]:
    """The method of a function ``mitigate(frames, waveform)``, under the function's name.

    Raises `MitigationError` if it is not callable or has no name, as a ``lambda``.
    """
    called = getattr(function, "__name__", "")
    if not callable(function) or not called.isidentifier():
        raise MitigationError(
            f"method {str(function)[:60]!r} has no name for the report; write def NAME(frames, waveform), or give the "
            "name of a registered method"
        )

    class Function(Mitigation):
        __doc__ = function.__doc__
        name = called
        sha256: ClassVar[str] = _digest(function)

        def _clean(self, batch: np.ndarray) -> np.ndarray:
            out = np.asarray(function(batch.copy(), self.waveform))  # it may work in place
            if out.shape != batch.shape or out.dtype.kind not in "fc":
                raise MitigationError(
                    f"method {called} gives {out.dtype} of shape {out.shape}; expected complex frames of shape "
                    f"{batch.shape}"
                )
            return out.astype(np.complex64)

        def status(self) -> dict[str, object]:
            return super().status() | {"model": f"{called}()", "sha256": self.sha256}

    return Function


def _digest(function: Callable[..., Any]) -> str:
    """What a report keeps of a function, which distinguishes two runs."""
    try:
        text = inspect.getsource(function)
    except (OSError, TypeError):  # typed at a prompt, or no Python function
        text = repr(getattr(function, "__code__", function))
    return hashlib.sha256(text.encode()).hexdigest()


@contextlib.contextmanager
def as_methods(methods: Sequence[MethodLike]) -> Iterator[tuple[str, ...]]:
    """Names of methods that the registry knows while this block lasts, functions and classes included.

    Raises `MitigationError` if a function or class has the name of another method.
    """
    added: list[str] = []
    names: list[str] = []
    try:
        for method in methods:
            if not isinstance(method, str):
                known = isinstance(method, type) and issubclass(method, Mitigation)
                cls = cast("type[Mitigation]", method) if known else function_method(cast(_Function, method))
                if METHODS.get(cls.name) is not cls:
                    if cls.name in METHODS:
                        raise MitigationError(
                            f"there is a method {cls.name!r} already; give yours another name"
                        )
                    METHODS[cls.name] = cls
                    added.append(cls.name)
                method = cls.name
            names.append(method)
        yield tuple(names)
    finally:
        for name in added:
            del METHODS[name]
