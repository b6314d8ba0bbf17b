"""NumPy's usual treatment of floating-point errors, whatever a program has set by `numpy.seterr`."""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numpy as np

_P, _R = ParamSpec("_P"), TypeVar("_R")


def usual_errors(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Decorator: underflow to 0 in filters and windows is no error, and the rest warns."""

    @functools.wraps(function)
    def usual(*args: _P.args, **options: _P.kwargs) -> _R:
        with np.errstate(divide="warn", over="warn", under="ignore", invalid="warn"):
            return function(*args, **options)

    return usual
