"""What comes from outside, on its way in: files, YAML, numbers, mappings into typed, validated dataclasses, and back.

One generic mechanism for every section of a scene: a wrong key, unit, range or type gives one line that names key,
value and what is allowed. `read_bytes` and `load_yaml` are the one way in for files: regular ones of bounded size, and
of YAML the part that means one thing only. Bounds on numbers that hold for every quantity are here, too.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import functools
import inspect
import math
import re
import reprlib
import stat
import sys
import types
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

__all__ = [
    "LARGEST",
    "InputError",
    "arguments",
    "build",
    "check_file",
    "convert",
    "load_yaml",
    "plain",
    "quantity",
    "read_bytes",
    "read_text",
    "shown",
    "whole",
]

LARGEST = 1e12  # no quantity of a scene or an option is larger, whatever its unit
# what a quantity can be at most, either way, by the unit its name ends in; wider than any use, so that powers of ten,
# squares and tables made from it stay numbers
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
_WHOLE = 2**63 - 1
_DIGITS = 19  # of an integer in YAML
_MEGA = 1 << 20
_YAML_BYTES = _MEGA  # ten times the longest of use; a reader written in Python takes 15 s for it
_DEPTH, _NODES = 40, 1_000_000  # of a YAML document, aliases followed
_TAGS = ("str", "int", "float", "bool", "null", "seq", "map")

# a NUL ends a file name, others change a terminal; lone surrogates cannot be written
_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff]")
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


def check_file(path: Path | str, *, most_bytes: int, what: str, remedy: str = "name another file") -> Path:
    """A regular file of bounded size, nothing of it read.

    Parameters
    ----------
    path : path
    most_bytes : int
        Size above which it is refused.
    what : str
        What the file is, for messages: "scene".
    remedy : str
        End of the message where it cannot be read.

    Raises
    ------
    InputError
        One line: file, reason, remedy. A pipe or device is refused, since reading may never end.
    """
    try:
        path = Path(path)
        status = path.stat()
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise _unreadable(path, what, error, remedy) from None
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe or device"
        raise InputError(f"{what} {_name(path)}: cannot be read (it is {kind}); {remedy}")
    if status.st_size > most_bytes:
        raise InputError(
            f"{what} {_name(path)}: holds {status.st_size / _MEGA:.1f} MiB, at most {most_bytes / _MEGA:g} MiB are "
            "read; is it the right file?"
        )
    return path


def read_bytes(path: Path | str, *, most_bytes: int, what: str, remedy: str = "name another file") -> bytes:
    """Content of such a file; see `check_file`."""
    path = check_file(path, most_bytes=most_bytes, what=what, remedy=remedy)
    try:
        with path.open("rb") as file:
            return file.read(most_bytes)  # no more, should it have grown meanwhile
    except OSError as error:
        raise _unreadable(path, what, error, remedy) from None


def _unreadable(path: Path | str, what: str, error: Exception, remedy: str) -> InputError:
    reason = getattr(error, "strerror", None) or str(error)
    return InputError(f"{what} {_name(path)}: cannot be read ({reason}); {remedy}")


def read_text(path: Path | str, *, most_bytes: int, what: str, remedy: str = "name another file") -> str:
    """Like `read_bytes`, as UTF-8 text."""
    try:
        return read_bytes(path, most_bytes=most_bytes, what=what, remedy=remedy).decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{what} {_name(path)}: cannot be read (not a text file); {remedy}") from None


def _name(path: Path | str) -> str:
    """A path for a message: printable, and the end of a long one."""
    text = "".join(c if c.isprintable() else "?" for c in str(path))
    return text if len(text) <= 100 else "..." + text[-97:]


def load_yaml(path: Path | str, *, what: str, remedy: str = "name a YAML file") -> Any:
    """What a YAML file holds, read by the strictest of readers: plain values, each key once.

    Refused besides what is not YAML: a key twice in one mapping (the last would win in silence), other tags than
    those of JSON's types, more than 40 levels, aliases that multiply to more than a million values or hold themselves,
    integers of more than 19 digits, control characters. A date stays text, and so does 1:30, which YAML 1.1 would read
    as 90.

    Raises
    ------
    InputError
        One line: file, line where there is one, what is wrong.
    """
    import yaml

    text = read_text(path, most_bytes=_YAML_BYTES, what=what, remedy=remedy)
    try:
        return yaml.load(text, Loader=_loader())  # a SafeLoader that takes less
    except RecursionError:  # levels of aliases are counted after they were followed
        raise InputError(f"{what} {_name(path)}: not valid YAML: more than {_DEPTH} levels") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}" if mark else ""
        problem = " ".join(str(getattr(error, "problem", None) or getattr(error, "reason", error)).split())
        raise InputError(f"{what} {_name(path)}: not valid YAML{where}: {problem[:120]}") from None


@functools.cache
def _loader() -> type:
    """The reader of `load_yaml`; made when YAML is first read."""
    import yaml

    def refuse(node: Any, problem: str) -> typing.NoReturn:
        raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)

    class Loader(yaml.SafeLoader):
        depth = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            self.depth += 1
            if self.depth > _DEPTH:
                mark = self.peek_event().start_mark
                raise yaml.composer.ComposerError(None, None, f"more than {_DEPTH} levels", mark)
            node = super().compose_node(parent, index)
            self.depth -= 1
            return node

        def compose_mapping_node(self, anchor: Any) -> Any:
            node = super().compose_mapping_node(anchor)
            seen = set()
            for key, _ in node.value:
                name = (key.tag, key.value) if isinstance(key, yaml.ScalarNode) else key
                if name in seen:
                    refuse(key, f"the key {shown(key.value)} is there twice; leave one")
                seen.add(name)
            return node

        def get_single_node(self) -> Any:
            node = super().get_single_node()
            if node is not None:
                values, levels = _expanded(node, {})
                if values > _NODES or levels > _DEPTH:
                    refuse(node, f"aliases make more than {_NODES} values or {_DEPTH} levels of it")
            return node

    def text(loader: Any, node: Any) -> str:
        value = loader.construct_scalar(node)
        if _CONTROL.search(value):
            refuse(node, f"control characters in {shown(value)}")
        return value

    def number(kind: str) -> Callable[[Any, Any], Any]:
        construct = getattr(yaml.SafeLoader, f"construct_yaml_{kind}")

        def made(loader: Any, node: Any) -> Any:
            value = loader.construct_scalar(node)
            if ":" in value:
                return value
            if kind == "int" and sum(c.isalnum() for c in value) > _DIGITS:
                refuse(node, f"the number {shown(value)} has more than {_DIGITS} digits")
            try:
                return construct(loader, node)
            except (ValueError, KeyError, OverflowError, IndexError):  # IndexError: of "_" no digit is left
                refuse(node, f"{shown(value)} is no {kind}")

        return made

    tags = {tag: f"tag:yaml.org,2002:{tag}" for tag in _TAGS}
    Loader.yaml_constructors = {
        tag: make
        for tag, make in yaml.SafeLoader.yaml_constructors.items()
        if tag is None or tag in tags.values()
    }
    Loader.add_constructor(tags["str"], text)
    for kind in ("int", "float", "bool"):
        Loader.add_constructor(tags[kind], number(kind))
    Loader.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith(":timestamp")]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    return Loader


def _expanded(node: Any, known: dict[int, tuple[float, float]]) -> tuple[float, float]:
    """Values and levels of a composed YAML node with every alias followed; infinite where it holds itself."""
    if not isinstance(node.value, list):
        return 1, 1
    if id(node) not in known:
        known[id(node)] = math.inf, math.inf
        children = [c for item in node.value for c in (item if isinstance(item, tuple) else (item,))]
        below = [_expanded(child, known) for child in children]
        known[id(node)] = 1 + sum(n for n, _ in below), 1 + max((d for _, d in below), default=0)
    return known[id(node)]


def whole(value: Any, where: str, low: int, high: int, remedy: str = "") -> int:
    """An integer within ``low..high``, or one line about what is allowed."""
    number = convert(int, value, where)
    if not low <= number <= high:
        raise ValueError(f"{where} is {shown(number)}; it has to be within {low}..{high}{remedy}")
    return number


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
    hints = _hints(cls)
    fields = {f.name for f in dataclasses.fields(cls) if f.init}
    values = {}
    for key, value in data.items():
        if key not in fields:
            name = shown(key).strip("'")
            close = difflib.get_close_matches(name, fields, 1)
            hint = f"did you mean {close[0]!r}? " if close else ""
            path = f"{where}.{name}" if where else name
            raise ValueError(f"unknown key {path!r}; {hint}allowed: {_listed(sorted(fields))}")
        path = f"{where}.{key}" if where else key
        convert_field = (special or {}).get(key)
        values[key] = convert_field(value, path) if convert_field else convert(hints.get(key), value, path)
    try:
        return cls(**values)
    except TypeError as error:
        raise ValueError(f"{where}: {error}") from None
    except ValueError as error:
        text = str(error)
        raise ValueError(text if not where or where.split(".")[-1] in text else f"{where}: {text}") from None


def _listed(names: list[str]) -> str:
    """Names with commas, as many as fit a line."""
    text = ", ".join(names)
    return text if len(text) <= 140 else text[:140].rpartition(",")[0] + ", ..."


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
        if isinstance(value, dict):
            raise ValueError(f"{where} is {shown(value)}; expected a list")
        return tuple(convert(inner, v, f"{where}[{i}]") for i, v in enumerate(value))
    if origin is dict or hint is dict:
        if not isinstance(value, dict):
            raise ValueError(f"{where} is {shown(value)}; expected a mapping")
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
                    f"{where} is {shown(value)}; expected a number, in the unit its name states"
                ) from None
        if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
            raise ValueError(f"{where} is {shown(value)}; expected a number, in the unit its name states")
        return quantity(value, where)
    if hint is int:
        if isinstance(value, str):
            try:
                value = float(value)
            except ValueError:
                raise ValueError(f"{where} is {shown(value)}; expected a whole number") from None
        number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
        if not number or not math.isfinite(_float(value)) or value != int(value):
            raise ValueError(f"{where} is {shown(value)}; expected a whole number")
        if abs(value) > _WHOLE:
            raise ValueError(
                f"{where} is {shown(value)}; expected a whole number of at most {_DIGITS} digits"
            )
        return int(value)
    if hint is bool:
        if not isinstance(value, bool):
            raise ValueError(f"{where} is {shown(value)}; expected true or false")
        return value
    if hint is str:
        if not isinstance(value, str):
            raise ValueError(f"{where} is {shown(value)}; expected text")
        if _CONTROL.search(value):
            raise ValueError(f"{where} is {shown(value)}; expected text without control characters")
        return value
    return value


def quantity(value: Any, where: str) -> float:
    """A number as a float within what its unit allows; ``where`` ends in the unit: ``sir_db``, ``sweep_s[2]``.

    Raises
    ------
    ValueError
        One line, also for what is not finite.
    """
    unit = _UNIT.search(where)
    most = _UNITS.get(unit[1], LARGEST) if unit else LARGEST
    # an integer of hundreds of digits is no float: compared before it becomes one
    if not -most <= value <= most:
        finite = math.isfinite(_float(value))
        allowed = f"a number within {-most:g}..{most:g}" if finite else "a finite number"
        raise ValueError(f"{where} is {shown(value)}; expected {allowed}")
    return float(value)


def arguments(function: Callable[..., Any], given: dict[str, Any], where: str) -> dict[str, Any]:
    """Keyword arguments as the function's annotations have them; what it does not know stays, for it to refuse.

    Raises
    ------
    ValueError
        One line with key, value and what is allowed.
    """
    hints = _hints(function)
    return {
        key: convert(hints[key], value, f"{where}.{key}")
        if key in hints and not isinstance(value, Path)
        else value
        for key, value in given.items()
    }


def _hints(owner: Any) -> dict[str, Any]:
    """Annotations of a class or function; what exists for type checkers alone is left out, and converts nothing."""
    with contextlib.suppress(Exception):  # somebody else's annotations: anything can come
        return typing.get_type_hints(owner)
    found = {}
    for part in reversed(owner.__mro__) if isinstance(owner, type) else [owner]:
        names = getattr(part, "__globals__", None) or vars(sys.modules[part.__module__])
        for key, hint in inspect.get_annotations(part).items():
            with contextlib.suppress(Exception):
                alone = types.SimpleNamespace(__annotations__={key: hint})
                found |= typing.get_type_hints(alone, globalns=names)
    return found


def _float(value: Any) -> float:
    """As a float, of any size: what is too large for one is the largest."""
    try:
        return float(value)
    except OverflowError:
        return math.copysign(np.finfo(float).max, value)


def plain(value: Any) -> Any:
    """Dataclasses as mappings, tuples as lists."""
    if dataclasses.is_dataclass(value):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value) if f.init}
    if isinstance(value, (tuple, list)):
        return [plain(v) for v in value]
    if isinstance(value, dict):
        return {key: plain(v) for key, v in value.items()}
    return value
