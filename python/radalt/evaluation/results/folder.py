"""The result folder of a run: one writer, a marker that identifies the run, and a journal of measured rows.

``run.json`` is the marker: everything on which a row depends, versions included. ``points.jsonl`` is the journal with
the rows of each measured point, every line with a digest of the line and the marker. The tables (``rows.csv`` and
others) are written from it, so that a resumed run has the measured rows of this run only.
"""

import contextlib
import hashlib
import json
import os
import platform
import tempfile
from collections.abc import Callable, Iterator, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from ...core.parsing import InputError, plain_json, read_bytes, shown

SCHEMA = 2  # of report.json
_JOURNAL_VERSION = 3  # part of the digest: lines of another format are rejected
_MARKER, _JOURNAL, _LOCK, _REPORT = "run.json", "points.jsonl", ".lock", "report.json"
TEMPORARY = ".tmp"  # suffix of files that are being written
MAX_REPORT_BYTES = 256 << 20  # largest file of a result folder for reading, bytes: a million rows


class FolderError(ValueError):
    """A result folder that cannot be used; the message is one line for the user."""


def versions(with_network: bool) -> dict[str, str]:
    """Versions on which a result depends; onnxruntime only with a network."""
    import numpy
    import scipy

    from ... import __version__

    out = {"radalt": __version__, "python": platform.python_version()}
    out |= {"numpy": numpy.__version__, "scipy": scipy.__version__}
    try:
        from gnuradio import gr
    except ImportError:  # results without a flowgraph need no GNU Radio
        pass
    else:
        out["gnuradio"] = gr.version()
    if with_network:
        out["onnxruntime"] = metadata.version("onnxruntime")
    return out


def flatten(value: Any, prefix: str = "") -> dict[str, Any]:
    """Nested mappings as one mapping with dotted keys; lists are values."""
    if not isinstance(value, dict) or not value:
        return {prefix: value}
    out: dict[str, Any] = {}
    for key, item in value.items():
        out |= flatten(item, f"{prefix}.{key}" if prefix else str(key))
    return out


def write_json(path: Path, content: Any) -> None:
    """Replace a JSON file atomically: readers find the old or the new content."""
    text = json.dumps(plain_json(content), indent=1, allow_nan=False) + "\n"
    replace_file(path, text.encode())


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Name the file in an error of a write, which names none itself."""
    try:
        yield
    except OSError as error:
        error.filename = str(path)
        raise


def replace_file(path: Path, content: bytes) -> None:
    """Write a file atomically: where the disk is full, the old one stays, or none."""
    # created exclusively under a random name, so that no link is followed; with the permissions of any new file
    descriptor, fresh = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=TEMPORARY)
    try:
        with writing(path), open(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        umask = os.umask(0o077)
        os.umask(umask)
        os.chmod(fresh, 0o666 & ~umask)
        os.replace(fresh, path)
    except BaseException:
        os.unlink(fresh)
        raise


def check_writable(option: str, path: Path) -> None:
    """Raise FolderError, one line, if a folder can be neither written into nor made; leaves nothing."""
    there = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
    try:
        # permissions say nothing of /proc and of the user root
        tempfile.TemporaryDirectory(dir=there).cleanup()
    except OSError as error:
        raise FolderError(
            f"{option} {path} cannot be written ({error.strerror}); name another folder"
        ) from None


def _lock_alone(file: int) -> None:
    """Lock an open file for this process until it is closed; raises OSError if another process has the lock."""
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

    Raises FolderError, one line: the part that is missing, unfinished or cannot be read.
    """
    if (path / _MARKER).is_file() and not (path / _REPORT).exists():
        raise FolderError(
            f"{path}: no report: the run is not finished (repeat its command with --resume), or a replay and has none"
        )
    return _read_json(path / _REPORT, "name the folder of a finished run")


class RunFolder:
    """The folder of one run, locked by this process.

    Raises FolderError if it holds other files, another run (the first difference is named), or another process writes
    to it.

    Parameters
    ----------
    path : Path
        Created if missing. It has to be new, empty, or, with ``resume``, hold this run.
    head : dict
        Everything on which a row depends; JSON.
    resume : bool
        Whether the folder may hold a part of this run.
    replace : bool
        Whether it may hold another result of the study, which is then replaced.
    dry : bool
        Check all of this and write nothing.
    holds : callable
        Whether an entry of the journal (``point``, ``rows``) is valid for this run.
    """

    def __init__(
        self,
        path: Path,
        head: dict[str, Any],
        *,
        resume: bool = False,
        replace: bool = False,
        dry: bool = False,
        holds: Callable[[dict[str, Any]], bool] = lambda entry: True,
    ) -> None:
        self.path, self._replaces, self._dry = path, replace, dry
        whole = {"schema": SCHEMA, "journal": _JOURNAL_VERSION} | head
        self.head = json.loads(json.dumps(plain_json(whole)))  # as it is read back from JSON
        self._seal = hashlib.sha256(json.dumps(self.head, sort_keys=True).encode())
        self.done: dict[str, list[dict[str, Any]]] = {}  # rows of the journal by point
        # lines that are cut, changed or of another run; their points are measured again
        self.rejected: list[str] = []
        if path.exists() and not path.is_dir():
            raise FolderError(f"--out {path} is a file; name a folder")
        if dry:
            check_writable("--out", path)
            if path.exists():
                self._check_files()
                self._claim(resume, holds)
            return
        try:
            path.mkdir(parents=True, exist_ok=True)
            self._check_files()
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

    def _check_files(self) -> None:
        """Refuse another's files, links, through which files elsewhere would be overwritten, and pipes, which block."""
        files = [] if (self.path / _MARKER).exists() else self.path.iterdir()
        strange = sorted(f.name for f in files if f.name != _LOCK and not f.name.endswith(TEMPORARY))
        if strange:
            raise FolderError(
                f"--out {self.path} holds files that are no run of ours ({strange[0][:60]}"
                f"{' and others' if len(strange) > 1 else ''}); name a new or an empty folder"
            )
        for found in self.path.rglob("*"):
            if found.is_symlink():
                raise FolderError(
                    f"{found} is a link, through which files elsewhere would be overwritten; remove it"
                )
        for name in (_LOCK, _MARKER, _JOURNAL, _REPORT):
            path = self.path / name
            if path.exists() and not path.is_file():
                raise FolderError(f"{path} is a folder, pipe or device; name another --out")

    def _claim(self, resume: bool, holds: Callable[[dict[str, Any]], bool]) -> None:
        marker = self.path / _MARKER
        if marker.exists():
            held = _read_json(marker, "name another --out")
            if self._replaces and not self._dry and held.get("study") == self.head.get("study"):
                (self.path / _JOURNAL).unlink(missing_ok=True)
                write_json(marker, self.head)
                return
            if not resume:
                complete = "" if self._replaces else "add --resume to complete it, or "
                raise FolderError(f"{self.path} holds a run already; {complete}name another --out")
            self._check(held)
            self._read(holds)
            return
        if not self._dry:
            write_json(marker, self.head)

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
                self.done[entry["point"]] = entry["rows"]
                kept.append(line)
        if self.rejected and not self._dry:
            replace_file(journal, "".join(kept).encode())

    def add(self, point: str, rows: Sequence[dict[str, Any]]) -> None:
        """Append the rows of a point to the journal; they are on disk when it returns."""
        content = {"point": point, "rows": list(rows)}
        line = json.dumps(content | {"digest": self._digest(content)}, allow_nan=False) + "\n"
        journal = self.path / _JOURNAL
        with writing(journal), journal.open("a", encoding="utf-8") as file:
            file.write(line)
            file.flush()
            os.fsync(file.fileno())
        self.done[point] = json.loads(line)["rows"]

    def write_text(self, name: str, text: str) -> Path:
        """Write a file of the folder atomically."""
        path = self.path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, text.encode())
        return path

    def write_report(self, report: dict[str, Any]) -> None:
        """Write ``report.json``, last of all, since it marks a finished run."""
        write_json(self.path / _REPORT, report)

    def close(self) -> None:
        """Release the lock."""
        self._lock.close()

    def _digest(self, content: dict[str, Any]) -> str:
        digest = self._seal.copy()
        digest.update(json.dumps(content, sort_keys=True).encode())
        return digest.hexdigest()[:16]

    def _entry(self, line: str) -> dict[str, Any] | None:
        """A line of the journal; None if it is cut, changed or of another run."""
        if not line.endswith("\n"):  # a cut number may be a valid one
            return None
        try:
            entry = json.loads(line)
            digest = entry.pop("digest")
            if digest != self._digest(entry) or set(entry) != {"point", "rows"}:
                return None
        except (ValueError, KeyError, AttributeError, TypeError, RecursionError):
            return None
        return entry if (type(entry["point"]), type(entry["rows"])) == (str, list) else None
