"""Messages about unusable input: the error class, and values on one line."""

import difflib
import re
import reprlib
from collections.abc import Iterable
from numbers import Real
from typing import Any

# a NUL ends a file name, others change a terminal; lone surrogates cannot be written
CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff]")
MINUS = "\u2212"  # the minus sign of texts and figures, which no number of Python has
# limits of a value in a message, so that a line has room for the limit and the remedy, too
_SHOWN = reprlib.Repr()
_SHOWN.maxlevel, _SHOWN.maxstring, _SHOWN.maxother, _SHOWN.maxlong = 2, 60, 60, 40
_SHOWN.maxlist = _SHOWN.maxtuple = _SHOWN.maxdict = _SHOWN.maxset = 4


class InputError(ValueError):
    """Input that cannot be used; the message is one line for the user."""


def shown(value: Any) -> str:
    """Any value for a message, on one line and cut: at most 80 characters."""
    try:
        text = _SHOWN.repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, a list within itself
        text = f"a {type(value).__name__} too long to show"
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= 80 else text[:77] + "..."


def _near(name: Any, known: Iterable[str]) -> list[str]:
    """Known names that may have been meant, the nearest first."""
    known, text = list(known), shown(name).strip("'")
    lower = {k.lower(): k for k in known}
    close = [lower[k] for k in difflib.get_close_matches(text.lower(), lower, max(1, len(known)), 0.61)]
    return list(dict.fromkeys([*close, *(k for k in known if len(text) > 2 and text in k)]))


def did_you_mean(name: Any, known: Iterable[str]) -> str:
    """A sentence with the known name that is nearest, and a space behind it; empty if none is near."""
    near = _near(name, known)
    return f"did you mean {near[0]!r}? " if near else ""


def allowed(name: Any, known: Iterable[str]) -> str:
    """A sentence with all known names, near ones first, and with the one that was probably meant."""
    known = list(known)
    names = dict.fromkeys([*_near(name, known), *known])
    return f"{did_you_mean(name, known)}allowed: {', '.join(names) or 'nothing'}"


def check_range(where: str, owner: object, **limits: tuple[float, ...]) -> None:
    """Check attributes of ``owner`` against their (lowest, highest), both allowed; None is no value and passes.

    A third limit is the least magnitude of what is not 0. Raises `ValueError`: ``where.name``, value, limits, and of
    a frequency below them the value in MHz, kHz or GHz that lies within; also for NaN.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> check_range("radio", SimpleNamespace(gain_db=99.0), gain_db=(0.0, 89.75))
    Traceback (most recent call last):
    ValueError: radio.gain_db is 99; it has to be within 0..89.75
    """
    for name, (low, high, *least) in limits.items():
        value = getattr(owner, name)
        if value is None:
            continue
        if not isinstance(value, Real):
            raise ValueError(f"{where}.{name} is {shown(value)}; expected a number")
        read = [value, *(value * unit for unit in (1e6, 1e3, 1e9) if name.endswith("_hz"))]
        fitting = [v for v in read if low <= v <= high and not 0 < abs(v) < sum(least)]
        if value not in fitting:
            span = f"{low:g}..{high:g}" + "".join(f", 0 or at least {size:g} either way" for size in least)
            hint = f"; did you mean {fitting[0]:g}?" if fitting else ""
            raise ValueError(f"{where}.{name} is {value:g}; it has to be within {span}{hint}")
