"""Mappings into typed, validated dataclasses and back: one mechanism for every section of a scene.

A wrong key, unit, range or type gives one line: key, value and what is allowed. Bounds of every quantity are here.
"""

import contextlib
import dataclasses
import functools
import inspect
import math
import re
import sys
import types
import typing
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from .messages import CONTROL, MINUS, allowed, shown

LARGEST = 1e12  # largest magnitude of a quantity in any unit: its square stays finite in float32
# largest magnitude by the unit that ends a name: wider than any use; powers of ten, squares and tables stay finite
_UNITS = {
    "_db": 200.0,
    "_dbi": 200.0,
    "_dbm": 200.0,
    "_deg": 3600.0,
    "_ppm": 1e6,
    "_m": 1e7,
    "_s": 1e5,
    "_w": 1e9,
    "_samples": 1e9,
    "_m_per_s": 1e5,
}
_UNIT = re.compile(r"(_m_per_s|_[a-z]+)(?:\[\d+\])*$")
_WHOLE = 2**63 - 1  # largest integer: int64


def whole(value: Any, where: str, low: int, high: int) -> int:
    """An integer within ``low..high``, or one line about what is allowed."""
    number = convert(int, value, where)
    if not low <= number <= high:
        raise ValueError(f"{where} is {shown(number)}; it has to be within {low}..{high}")
    return number


def build(
    cls: type,
    data: Any,
    where: str,
    special: dict[str, Callable[[Any, str], Any]] | None = None,
    *,
    renamed: dict[str, str] | None = None,
    also: Iterable[str] = (),
) -> Any:
    """Dataclass from a mapping: keys and types are checked here, ranges by its ``__post_init__``.

    ``where`` is the mapping's dotted path, empty for a whole file; ``special`` has converters ``(value, path) ->
    value`` of fields that the annotation does not describe, ``renamed`` keys of fields that have another name in files,
    ``also`` keys that the caller has taken out. Raises `ValueError`: one line with key, value and what is allowed.
    """
    if not isinstance(data, dict):
        raise ValueError(f"{where or 'the scene'} is {data!r}; expected a mapping of keys")
    hints = _hints(cls)
    fields = {(renamed or {}).get(f.name, f.name): f.name for f in dataclasses.fields(cls) if f.init}
    values = {}
    for key, value in data.items():
        if key not in fields:
            name = shown(key).strip("'")
            path = f"{where}.{name}" if where else name
            raise ValueError(f"unknown key {path!r}; {allowed(name, sorted({*fields, *also}))}")
        path, field = f"{where}.{key}" if where else key, fields[key]
        own = (special or {}).get(field)
        values[field] = own(value, path) if own else convert(hints.get(field), value, path)
    try:
        return cls(**values)
    except TypeError as error:
        raise ValueError(f"{where}: {error}") from None
    except ValueError as error:
        text = str(error)
        raise ValueError(text if not where or where.split(".")[-1] in text else f"{where}: {text}") from None


def convert(hint: Any, value: Any, where: str) -> Any:
    """A YAML value as the annotated type, or one line about what is allowed."""
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        options = typing.get_args(hint)
        if value is None and type(None) in options:
            return None
        return convert(_fitting([o for o in options if o is not type(None)], value), value, where)
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return build(hint, {} if value is None else value, where)
    if origin is tuple:
        inner = typing.get_args(hint)[0]
        one = isinstance(value, dict) and dataclasses.is_dataclass(inner)
        if one or isinstance(value, (str, bytes)) or not np.iterable(value):
            value = [value]
        if isinstance(value, dict):
            raise ValueError(f"{where} is {shown(value)}; expected a list")
        return tuple(convert(inner, v, f"{where}[{i}]") for i, v in enumerate(value))
    if origin is dict or hint is dict:
        if not isinstance(value, dict):
            raise ValueError(f"{where} is {shown(value)}; expected a mapping")
        return value
    return _scalar(hint, value, where)


def _fitting(options: list[Any], value: Any) -> Any:
    """The option of a union that fits: the dataclass with all keys of the mapping, else the first."""
    if isinstance(value, dict):
        for option in options:
            names = [f.name for f in dataclasses.fields(option)] if dataclasses.is_dataclass(option) else None
            if names is not None and value.keys() <= {*names}:
                return option
    if str in options and isinstance(value, str):  # a word, or a number that YAML gives as text
        return str if math.isnan(_number(value)) else next((o for o in options if o is not str), str)
    return options[0]


def _number(text: str) -> float:
    """A text as a number; NaN if it is none."""
    try:
        return float(text.replace(MINUS, "-"))
    except ValueError:
        return math.nan


def _scalar(hint: Any, value: Any, where: str) -> Any:
    if hint in (float, int):
        # YAML 1.1 takes 7.5e6 (no sign in the exponent) for text; users mean the number
        given = _number(value) if isinstance(value, str) else value
        good = isinstance(given, (int, float, np.number)) and not isinstance(given, bool)
        if hint is int or given is not value:  # text such as "nan" is no number
            good = good and math.isfinite(_float(given))
        if not good or (hint is int and given != int(given)):
            wanted = "a number, in the unit its name states" if hint is float else "a whole number"
            raise ValueError(f"{where} is {shown(value)}; expected {wanted}")
        if hint is float:
            return quantity(given, where)
        if abs(given) > _WHOLE:
            raise ValueError(
                f"{where} is {shown(value)}; expected a whole number of at most {len(str(_WHOLE))} digits"
            )
        return int(given)
    if hint is bool:
        if not isinstance(value, bool):
            raise ValueError(f"{where} is {shown(value)}; expected true or false")
        return value
    if hint is str:
        if not isinstance(value, str):
            quoted = ": quote it, since YAML takes it for another type" * isinstance(value, (int, float))
            raise ValueError(f"{where} is {shown(value)}; expected text{quoted}")
        if CONTROL.search(value):
            raise ValueError(f"{where} is {shown(value)}; expected text without control characters")
        return value
    return value


def quantity(value: Any, where: str) -> float:
    """A number as a float within what its unit allows; ``where`` ends in the unit: ``sir_db``, ``sweep_s[2]``.

    Raises `ValueError`: also for what is not finite.
    """
    unit = _UNIT.search(where)
    most = _UNITS.get(unit[1], LARGEST) if unit else LARGEST
    # compare first: an integer of hundreds of digits does not convert to float
    if not -most <= value <= most:
        finite = math.isfinite(_float(value))
        allowed = f"a number within {-most:g}..{most:g}" if finite else "a finite number"
        raise ValueError(f"{where} is {shown(value)}; expected {allowed}")
    return float(value)


def arguments(method: type, given: dict[str, Any], where: str) -> dict[str, Any]:
    """Keyword arguments of a class, behind its first argument, converted by the annotations of its constructor.

    Raises `ValueError`: one line with key, value and what is allowed.
    """
    parameters = list(inspect.signature(method).parameters.values())[1:]
    known = [p.name for p in parameters]
    hints = _hints(method.__init__)
    for key in given:
        if key not in known and not any(p.kind is p.VAR_KEYWORD for p in parameters):
            raise ValueError(f"{where}.{key} is unknown; {allowed(key, known)}")
    return {
        key: convert(hints[key], value, f"{where}.{key}")
        if key in hints and not isinstance(value, Path)
        else value
        for key, value in given.items()
    }


@functools.lru_cache(maxsize=512)
def _hints(owner: Any) -> dict[str, Any]:
    """Resolvable annotations of a class or function; those for type checkers alone are left out."""
    with contextlib.suppress(Exception):  # annotations of plugins may raise anything
        return typing.get_type_hints(owner)
    found: dict[str, Any] = {}
    for part in reversed(owner.__mro__) if isinstance(owner, type) else [owner]:
        names = getattr(part, "__globals__", None) or vars(sys.modules[part.__module__])
        for key, hint in inspect.get_annotations(part).items():
            with contextlib.suppress(Exception):
                alone = types.SimpleNamespace(__annotations__={key: hint})
                found |= typing.get_type_hints(alone, globalns=names)
    return found


def _float(value: Any) -> float:
    """As a float; an integer beyond its range becomes the largest float."""
    try:
        return float(value)
    except OverflowError:
        return sys.float_info.max if value > 0 else -sys.float_info.max


def plain(value: Any) -> Any:
    """Dataclasses as mappings, tuples as lists."""
    if dataclasses.is_dataclass(value):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value) if f.init}
    if isinstance(value, (tuple, list)):
        return [plain(v) for v in value]
    if isinstance(value, dict):
        return {key: plain(v) for key, v in value.items()}
    return value


def plain_json(value: Any) -> Any:
    """A value for JSON: NumPy numbers as Python's, tuples as lists, non-finite numbers as None."""
    if isinstance(value, dict):
        return {str(k): plain_json(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_json(v) for v in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
