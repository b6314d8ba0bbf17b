"""Prices of the receiver's steps in FFTs of 7,500 points, as measured: the same on every machine."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

ITERATION_FFTS = 31.0  # of one iteration of the receiver's loop; other steps cost about as much, or a part
Result = TypeVar("Result")


def costs(iterations: int) -> Callable[[Callable[..., Result]], Callable[..., Result]]:
    """Decorator for a step of a receiver: adds the price of so many iterations to the receiver's ``ffts``."""

    def priced(step: Callable[..., Result]) -> Callable[..., Result]:
        @wraps(step)
        def run(receiver: Any, *args: object, **options: object) -> Result:
            out = step(receiver, *args, **options)
            receiver.ffts += iterations * ITERATION_FFTS
            return out

        return run

    return priced
