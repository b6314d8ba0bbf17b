"""NumPy's usual treatment of floating-point errors, whatever a program has set by `numpy.seterr`."""

import contextlib
from collections.abc import Iterator

import numpy as np


@contextlib.contextmanager
def usual_errors() -> Iterator[None]:
    """Context or decorator: underflow to 0 in filters and windows is no error, and the rest warns."""
    with np.errstate(divide="warn", over="warn", under="ignore", invalid="warn"):
        yield
