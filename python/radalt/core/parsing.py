"""Typed, validated dataclasses from plain mappings (YAML), and back.

One generic mechanism for every section of a scene: a wrong key, unit, range or type gives one line that names key,
value and what is allowed.
"""

from __future__ import annotations

import dataclasses
import difflib
import types
import typing
from collections.abc import Callable
from typing import Any

import numpy as np

__all__ = ["build", "convert", "plain"]


def build(
    cls: type, data: Any, where: str, special: dict[str, Callable[[Any, str], Any]] | None = None
) -> Any:
    """Dataclass from a mapping: keys, types and ranges are checked, ``__post_init__`` has the last word.

    Parameters
    ----------
    cls : type
        Dataclass with annotated fields.
    data : mapping
        As YAML gives it.
    where : str
        Dotted path of the mapping, for messages; empty for the whole file.
    special : dict, optional
        Converters ``(value, path) -> field value`` for fields that the annotation does not describe.

    Raises
    ------
    ValueError
        One line with key, value and what is allowed.
    """
    if not isinstance(data, dict):
        raise ValueError(f"{where or 'the scene'} is {data!r}; expected a mapping of keys")
    hints = typing.get_type_hints(cls)
    fields = {f.name for f in dataclasses.fields(cls) if f.init}
    values = {}
    for key, value in data.items():
        path = f"{where}.{key}" if where else str(key)
        if key not in fields:
            close = difflib.get_close_matches(str(key), fields, 1)
            hint = f"did you mean {close[0]!r}? " if close else ""
            raise ValueError(f"unknown key {path!r}; {hint}allowed: {', '.join(sorted(fields))}")
        convert_field = (special or {}).get(key)
        values[key] = convert_field(value, path) if convert_field else convert(hints[key], value, path)
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
    if dataclasses.is_dataclass(hint):
        return build(hint, {} if value is None else value, where)
    if origin is tuple:
        if isinstance(value, (str, bytes)) or not hasattr(value, "__iter__"):
            value = [value]
        inner = typing.get_args(hint)[0]
        return tuple(convert(inner, v, f"{where}[{i}]") for i, v in enumerate(value))
    if origin is dict or hint is dict:
        if not isinstance(value, dict):
            raise ValueError(f"{where} is {value!r}; expected a mapping")
        return value
    return _scalar(hint, value, where)


def _fitting(options: list[Any], value: Any) -> Any:
    """Of several dataclasses the one that has all keys of the mapping; the first option otherwise."""
    if isinstance(value, dict):
        for option in options:
            if dataclasses.is_dataclass(option) and value.keys() <= {
                f.name for f in dataclasses.fields(option)
            }:
                return option
    return options[0]


def _scalar(hint: Any, value: Any, where: str) -> Any:
    if hint is float:
        # YAML 1.1 reads 7.5e6 (no sign in the exponent) as text; users mean the number
        if isinstance(value, str):
            try:
                value = float(value)
            except ValueError:
                raise ValueError(
                    f"{where} is {value!r}; expected a number, in the unit its name states"
                ) from None
        if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
            raise ValueError(f"{where} is {value!r}; expected a number, in the unit its name states")
        if not np.isfinite(value):
            raise ValueError(f"{where} is {value!r}; expected a finite number")
        return float(value)
    if hint is int:
        if isinstance(value, str):
            try:
                value = float(value)
            except ValueError:
                raise ValueError(f"{where} is {value!r}; expected a whole number") from None
        whole = isinstance(value, (int, float)) and np.isfinite(value) and value == int(value)
        if isinstance(value, bool) or not whole:
            raise ValueError(f"{where} is {value!r}; expected a whole number")
        return int(value)
    if hint is bool:
        if not isinstance(value, bool):
            raise ValueError(f"{where} is {value!r}; expected true or false")
        return value
    if hint is str:
        if not isinstance(value, str):
            raise ValueError(f"{where} is {value!r}; expected text")
        return value
    return value


def plain(value: Any) -> Any:
    """Dataclasses as mappings, tuples as lists."""
    if dataclasses.is_dataclass(value):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value) if f.init}
    if isinstance(value, (tuple, list)):
        return [plain(v) for v in value]
    if isinstance(value, dict):
        return {key: plain(v) for key, v in value.items()}
    return value
