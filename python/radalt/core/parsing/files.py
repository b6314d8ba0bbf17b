"""Reading files that users name: regular files of bounded size, and YAML by a strict reader."""

import functools
import math
import stat
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .messages import CONTROL, InputError, shown

_DIGITS = 19  # longest integer in YAML, digits: as many as 64 bits hold
_MEGA = 1 << 20  # bytes in a MiB
_YAML_BYTES = _MEGA  # largest YAML file, bytes: ten times the longest scene; PyYAML takes 15 s for it
# deepest nesting and most values of a YAML document, aliases expanded: far above any scene, below Python's stack
_DEPTH, _NODES = 40, 1_000_000
_TAGS = ("str", "int", "float", "bool", "null", "seq", "map")


def check_file(path: Path | str, *, most_bytes: int, what: str, remedy: str = "name another file") -> Path:
    """Check that a path is a regular file of bounded size, without reading it.

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
    """Content of a regular file of bounded size; parameters and errors as in `check_file`."""
    path = check_file(path, most_bytes=most_bytes, what=what, remedy=remedy)
    try:
        with path.open("rb") as file:
            return file.read(most_bytes)  # the file may have grown since its size was checked
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
    """Content of a YAML file, by a strict reader: plain values, each key once.

    These are errors beside invalid YAML: a key twice in one mapping (YAML keeps the last without a word), tags other
    than those of JSON's types, more than 40 levels, aliases that expand to more than a million values or refer to
    themselves, integers of more than 19 digits, control characters. Dates stay text, and so does 1:30, which YAML 1.1
    defines as 90.

    Raises
    ------
    InputError
        One line: file, line where there is one, what is wrong.
    """
    import yaml

    text = read_text(path, most_bytes=_YAML_BYTES, what=what, remedy=remedy)
    try:
        return yaml.load(text, Loader=_loader())  # a subclass of SafeLoader
    except RecursionError:  # nested aliases are counted only after they are expanded
        raise InputError(f"{what} {_name(path)}: not valid YAML: more than {_DEPTH} levels") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}" if mark else ""
        problem = " ".join(str(getattr(error, "problem", None) or getattr(error, "reason", error)).split())
        raise InputError(f"{what} {_name(path)}: not valid YAML{where}: {problem[:120]}") from None


@functools.cache
def _loader() -> type:
    """The YAML loader class, built on first use since PyYAML is imported lazily."""
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
        if CONTROL.search(value):
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
            except (ValueError, KeyError, OverflowError, IndexError):  # IndexError: "_" has no digit
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
    """Values and levels of a composed YAML node with its aliases expanded; infinite where it refers to itself."""
    if not isinstance(node.value, list):
        return 1, 1
    if id(node) not in known:
        known[id(node)] = math.inf, math.inf
        children = [c for item in node.value for c in (item if isinstance(item, tuple) else (item,))]
        below = [_expanded(child, known) for child in children]
        known[id(node)] = 1 + sum(n for n, _ in below), 1 + max((d for _, d in below), default=0)
    return known[id(node)]
