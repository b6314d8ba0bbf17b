"""Reading files that users name: regular files of bounded size, and YAML by a strict reader."""

import csv
import functools
import re
import stat
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .messages import CONTROL, InputError, shown

_MEGA = 1 << 20  # bytes in a MiB
_YAML_BYTES = _MEGA  # largest YAML file, bytes: ten times the longest scene; PyYAML takes 15 s for it


def check_file(path: Path | str, *, most_bytes: int, what: str, remedy: str = "name another file") -> Path:
    """Check that a path is a regular file of bounded size, without reading it: a pipe or device may never end.

    Raises `InputError`: ``what`` it is, file, reason, ``remedy``.
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
        said = "cannot be read (not text in UTF-8); save it so, or"
        raise InputError(f"{what} {_name(path)}: {said} {remedy}") from None


def read_csv(path: Path | str, *, most_bytes: int, what: str) -> tuple[list[dict[str, str]], list[str]]:
    """Rows of a CSV file by column, and the columns' names; lines that begin with ``#`` are comments.

    Names are in lower case with an underscore for other signs: ``Altitude (ft)`` is ``altitude_ft``.
    """
    text = read_text(path, most_bytes=most_bytes, what=what, remedy="name a CSV file").removeprefix("\ufeff")
    lines = [line for line in text.splitlines(keepends=True) if line.strip() and not line.startswith("#")]
    reader = csv.DictReader(lines, restval="", delimiter=max(",;\t", key="".join(lines[:1]).count))
    try:
        reader.fieldnames = [re.sub(r"\W+", "_", name.lower()).strip("_") for name in reader.fieldnames or []]
        if twice := [name for name in reader.fieldnames if name and reader.fieldnames.count(name) > 1]:
            raise InputError(f"{what} {_name(path)}: two columns are called {shown(twice[0])}; leave one")
        return list(reader), reader.fieldnames
    except csv.Error as error:
        raise InputError(f"{what} {_name(path)}: {error}; name a CSV file") from None


def _name(path: Path | str) -> str:
    """A path for a message: printable, and the end of a long one."""
    text = "".join(c if c.isprintable() else "?" for c in str(path))
    return text if len(text) <= 100 else "..." + text[-97:]


def load_yaml(path: Path | str, *, what: str, remedy: str = "name a YAML file") -> Any:
    """Content of a YAML file, by a strict reader: plain values, each key once.

    Errors besides invalid YAML are a key twice in one mapping (YAML keeps the last without a word), aliases (a few
    lines of them expand to a billion values), and tags other than those of JSON's types. Dates stay text, and so does
    1:30, 90 in YAML 1.1. Raises `InputError`: file, line where there is one, what is wrong.
    """
    import yaml

    text = read_text(path, most_bytes=_YAML_BYTES, what=what, remedy=remedy)
    try:
        return yaml.load(text, Loader=_loader())  # a subclass of SafeLoader
    except RecursionError:
        raise InputError(f"{what} {_name(path)}: not valid YAML: nested too deep") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}" if mark else ""
        problem = " ".join(str(getattr(error, "problem", None) or getattr(error, "reason", error)).split())
        raise InputError(f"{what} {_name(path)}: not valid YAML{where}: {problem[:120]}") from None


def write_yaml(path: Path | str, data: Any, **style: Any) -> Path:
    """Write plain values as YAML, all or nothing; ``style`` as of `yaml.safe_dump`. Returns the file."""
    import yaml

    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_suffix(".new")
    new.write_text(yaml.safe_dump(data, **style), encoding="utf-8")
    new.replace(path)
    return path


@functools.cache
def _loader() -> type:
    """The YAML loader class, built on first use since PyYAML is imported lazily."""
    import yaml

    def refuse(mark: Any, problem: str) -> typing.NoReturn:
        raise yaml.constructor.ConstructorError(None, None, problem, mark)

    class Loader(yaml.SafeLoader):
        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                refuse(self.peek_event().start_mark, "aliases are not read; write the value again")
            return super().compose_node(parent, index)

        def compose_mapping_node(self, anchor: Any) -> Any:
            node = super().compose_mapping_node(anchor)
            seen = set()
            for key, _ in node.value:
                name = (key.tag, key.value) if isinstance(key, yaml.ScalarNode) else key
                if name in seen:
                    refuse(key.start_mark, f"the key {shown(key.value)} is there twice; leave one")
                seen.add(name)
            return node

    def text(loader: Any, node: Any) -> str:
        value = loader.construct_scalar(node)
        if CONTROL.search(value):  # a terminal would obey them
            refuse(node.start_mark, f"control characters in {shown(value)}")
        return value

    def number(kind: str) -> Callable[[Any, Any], Any]:
        construct = getattr(yaml.SafeLoader, f"construct_yaml_{kind}")

        def made(loader: Any, node: Any) -> Any:
            value = loader.construct_scalar(node)
            if ":" in value:
                return value
            if kind == "int" and re.match(r"[-+]?0[\d_]", value):  # octal to YAML: 010 would be 8
                refuse(node.start_mark, f"{shown(value)} begins with 0; quote it, or leave the 0 out")
            try:
                return construct(loader, node)
            except (ValueError, KeyError, OverflowError, IndexError):  # IndexError: "_" has no digit
                refuse(node.start_mark, f"{shown(value)} is no {kind}")

        return made

    Loader.add_constructor("tag:yaml.org,2002:str", text)
    for kind in ("int", "float", "bool"):
        Loader.add_constructor(f"tag:yaml.org,2002:{kind}", number(kind))
    for kind in ("timestamp", "binary", "set", "omap", "pairs"):
        Loader.add_constructor(f"tag:yaml.org,2002:{kind}", yaml.SafeLoader.construct_undefined)
    Loader.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith(":timestamp")]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    return Loader
