"""The result folder of a run: one writer, one marker that says whose run it holds, and what has been measured so far.

``run.json`` is the marker: everything that a row depends on, versions included. ``points.jsonl`` keeps the rows of each
point as it is measured, every line with a digest of it and of the marker; the tables (``rows.csv`` and others) are
written from it, so that what is resumed is what was measured, and for this run.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import tempfile
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from ...core.parsing import InputError, read_bytes, shown

__all__ = [
    "SCHEMA",
    "FolderError",
    "RunFolder",
    "flatten",
    "plain_json",
    "read_report",
    "versions",
    "write_json",
]

SCHEMA = 2
_JOURNAL_VERSION = 2  # a digest without the marker would let rows of another run in
_MARKER, _JOURNAL, _LOCK, _REPORT = "run.json", "points.jsonl", ".lock", "report.json"
TEMPORARY = ".tmp"  # how names of files end that are still being written
MAX_REPORT_BYTES = 256 << 20  # of any file of a result folder that is read back


class FolderError(ValueError):
    """A result folder that cannot be used; the message is one line for the user."""


def versions(with_network: bool) -> dict[str, str]:
    """Versions of what a result depends on; onnxruntime only where a network runs."""
    import numpy
    import scipy

    from ... import __version__

    out = {"radalt": __version__, "python": platform.python_version()}
    out |= {"numpy": numpy.__version__, "scipy": scipy.__version__}
    try:
        from gnuradio import gr
    except ImportError:  # pooling reports of others needs no GNU Radio
        pass
    else:
        out["gnuradio"] = gr.version()
    if with_network:
        out["onnxruntime"] = metadata.version("onnxruntime")
    return out


def flatten(value: Any, prefix: str = "") -> dict[str, Any]:
    """Nested mappings as one, keys joined by dots; lists are values."""
    if not isinstance(value, dict) or not value:
        return {prefix: value}
    out: dict[str, Any] = {}
    for key, item in value.items():
        out |= flatten(item, f"{prefix}.{key}" if prefix else str(key))
    return out


def plain_json(value: Any) -> Any:
    """What JSON can hold: NumPy numbers as Python's, tuples as lists, what is not finite as None."""
    if isinstance(value, dict):
        return {str(k): plain_json(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_json(v) for v in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_json(path: Path, content: Any) -> None:
    """Replace a JSON file in one step: whoever reads it finds the old or the new, never half of one."""
    _replace(path, json.dumps(plain_json(content), indent=1, allow_nan=False) + "\n")


def _replace(path: Path, text: str) -> None:
    # made exclusively, under a name that nobody can have put a link at; with the rights of any new file
    descriptor, fresh = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=TEMPORARY)
    try:
        with open(descriptor, "w", encoding="utf-8", newline="") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        umask = os.umask(0o077)
        os.umask(umask)
        os.chmod(fresh, 0o666 & ~umask)
        os.replace(fresh, path)
    except BaseException:
        os.unlink(fresh)
        raise


def _lock_alone(file: int) -> None:
    """Lock an open file for this process alone, until it is closed; raises OSError where another process has it."""
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined, unused-ignore]
    else:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _read(file: Path, hint: str) -> bytes:
    try:
        return read_bytes(file, most_bytes=MAX_REPORT_BYTES, what="file", remedy=hint)
    except InputError as error:
        raise FolderError(str(error)) from None


def _read_json(file: Path, hint: str) -> dict[str, Any]:
    text = _read(file, hint)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        raise FolderError(f"{file}: cannot be read (not valid JSON); {hint}") from None
    if not isinstance(content, dict) or "schema" not in content:
        raise FolderError(f"{file}: not a report of ours (no 'schema'); {hint}")
    return content


def read_report(path: Path) -> dict[str, Any]:
    """``report.json`` of the folder of a finished run.

    Raises
    ------
    FolderError
        One line: what is missing, unfinished or cannot be read.
    """
    if (path / _MARKER).is_file() and not (path / _REPORT).exists():
        raise FolderError(
            f"{path}: no report: the run is not finished (repeat its command with --resume), or a replay, which has none"
        )
    return _read_json(path / _REPORT, "name the folder of a finished run")


class RunFolder:
    """A folder that belongs to one run, and to this process while it lives.

    Parameters
    ----------
    path : Path
        Made if it is not there. It has to be new, empty, or hold this very run and ``resume`` be set.
    head : dict
        Everything that a row depends on; JSON.
    resume : bool
        Whether the folder may hold a part of this very run.
    replace : bool
        Whether it may hold another result of the same study, which this one replaces.
    holds : callable
        Whether an entry of the journal (``point``, ``batch``, ``rows``) is one that this run could have written.

    Attributes
    ----------
    done : dict of (point, batch) -> list of dict
        Rows that are there.
    rejected : list of str
        Lines that did not hold (cut, changed, of another run); their points are measured again.

    Raises
    ------
    FolderError
        If it holds something else, another run (the first difference is named), or another process writes to it.
    """

    def __init__(
        self,
        path: Path,
        head: dict[str, Any],
        *,
        resume: bool = False,
        replace: bool = False,
        holds: Callable[[dict[str, Any]], bool] = lambda entry: True,
    ) -> None:
        self.path, self._replaces = path, replace
        whole = {"schema": SCHEMA, "journal": _JOURNAL_VERSION} | head
        self.head = json.loads(json.dumps(plain_json(whole)))  # as JSON gives it back
        self._seal = hashlib.sha256(json.dumps(self.head, sort_keys=True).encode())
        self.done: dict[tuple[str, int], list[dict[str, Any]]] = {}
        self.rejected: list[str] = []
        if path.exists() and not path.is_dir():
            raise FolderError(f"--out {path} is a file; name a folder")
        try:
            path.mkdir(parents=True, exist_ok=True)
            self._check_links()
            self._check_kinds()
            self._lock = (path / _LOCK).open("a")
        except FolderError:
            raise
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise FolderError(f"--out {path} cannot be written ({reason}); name another folder") from None
        try:
            _lock_alone(self._lock.fileno())
        except OSError:
            raise FolderError(
                f"another process writes into {path}; wait for it, or name another --out"
            ) from None
        self._claim(resume, holds)

    def _check_links(self) -> None:
        """No file in it leads elsewhere: what is written here would be written through it."""
        for found in self.path.rglob("*"):
            if found.is_symlink():
                raise FolderError(f"{found} is a link, through which files elsewhere would be overwritten; remove it")

    def _check_kinds(self) -> None:
        """Every file of ours is a file: a pipe would be waited at for ever."""
        for name in (_LOCK, _MARKER, _JOURNAL, _REPORT):
            path = self.path / name
            if path.exists() and not path.is_file():
                raise FolderError(f"{path} is a folder, pipe or device; name another --out")

    def _claim(self, resume: bool, holds: Callable[[dict[str, Any]], bool]) -> None:
        marker = self.path / _MARKER
        if marker.exists():
            held = _read_json(marker, "name another --out")
            if self._replaces and held.get("study") == self.head.get("study"):
                (self.path / _JOURNAL).unlink(missing_ok=True)
                _replace(marker, json.dumps(self.head, indent=1) + "\n")
                return
            if not resume:
                raise FolderError(
                    f"{self.path} holds a run already; add --resume to complete it, or name another --out"
                )
            self._check(held)
            self._read(holds)
            return
        strange = sorted(f.name for f in self.path.iterdir() if f.name != _LOCK and not f.name.endswith(TEMPORARY))
        if strange:
            raise FolderError(
                f"--out {self.path} holds files that are no run of ours ({strange[0][:60]}"
                f"{' and others' if len(strange) > 1 else ''}); name a new or an empty folder"
            )
        _replace(marker, json.dumps(self.head, indent=1) + "\n")

    def _check(self, held: dict[str, Any]) -> None:
        try:
            mine, have = flatten(self.head), flatten(held)
        except RecursionError:
            raise FolderError(
                f"{self.path} holds another run: run.json is nested too deep; name another --out"
            ) from None
        for key in [*mine, *(k for k in have if k not in mine)]:
            if mine.get(key) != have.get(key):
                there, here = (shown(side.get(key)) for side in (have, mine))
                raise FolderError(
                    f"{self.path} holds another run: {key[:60]} is {there} there and {here} here; "
                    "repeat that run's options, or name another --out"
                )

    def _read(self, holds: Callable[[dict[str, Any]], bool]) -> None:
        journal = self.path / _JOURNAL
        if not journal.exists():
            return
        text = _read(journal, "name another --out").decode("utf-8", errors="replace")
        kept = []
        for number, line in enumerate(text.splitlines(keepends=True), start=1):
            entry = self._entry(line)
            if entry is None or not holds(entry):
                self.rejected.append(f"{journal}:{number}")
            else:
                self.done[entry["point"], entry["batch"]] = entry["rows"]
                kept.append(line)
        if self.rejected:
            _replace(journal, "".join(kept))

    def add(self, point: str, batch: int, rows: Sequence[dict[str, Any]]) -> None:
        """Keep the rows of a point, on the disk before this returns."""
        content = {"point": point, "batch": batch, "rows": list(rows)}
        line = json.dumps(content | {"digest": self._digest(content)}, allow_nan=False) + "\n"
        with (self.path / _JOURNAL).open("a", encoding="utf-8") as file:
            file.write(line)
            file.flush()
            os.fsync(file.fileno())
        self.done[point, batch] = json.loads(line)["rows"]

    def write_text(self, name: str, text: str) -> Path:
        """Write a file of the folder in one step."""
        path = self.path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        _replace(path, text)
        return path

    def write_report(self, report: dict[str, Any]) -> None:
        """Write ``report.json``; last of all, since it says that everything else is there."""
        write_json(self.path / _REPORT, report)

    def close(self) -> None:
        """Let others write into the folder."""
        self._lock.close()

    def _digest(self, content: dict[str, Any]) -> str:
        digest = self._seal.copy()
        digest.update(json.dumps(content, sort_keys=True).encode())
        return digest.hexdigest()[:16]

    def _entry(self, line: str) -> dict[str, Any] | None:
        """A line of the journal, None where it is cut, was changed or is another run's."""
        if not line.endswith("\n"):  # a cut inside a number leaves a shorter, valid one
            return None
        try:
            entry = json.loads(line)
            digest = entry.pop("digest")
            if digest != self._digest(entry) or set(entry) != {"point", "batch", "rows"}:
                return None
        except (ValueError, KeyError, AttributeError, TypeError, RecursionError):
            return None
        kinds = (type(entry["point"]), type(entry["batch"]), type(entry["rows"]))
        return entry if kinds == (str, int, list) else None
