"""Bundle of the first hour's results: report, rows, captures and versions in one file; and reading of received bundles.

A bundle is a zip of at most 50 MB. Its content is not trusted: number, names, kinds and sizes of the files are checked
before anything is unpacked, and bytes are counted while unpacking.
"""

from __future__ import annotations

import csv
import io
import re
import zipfile
import zlib
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

from ...core.parsing import InputError
from ...core.scene import scene_to_mapping
from ...core.text import one_line
from ..results.folder import RunFolder, versions
from ..results.page import write_page
from ..results.table import table
from .first_light import Bench, Check, Step

__all__ = ["MOST_BYTES", "BundleError", "read_bundle", "verdict_of", "write_bundle"]

MOST_BYTES = 50 << 20  # largest bundle, bytes: within the limits of mail and issue trackers
# limits of a bundle's content: files, bytes of all files and of one text; several times those of a regular bundle
_MOST_FILES, _MOST_UNPACKED, _MOST_TEXT = 100, 200 << 20, 2 << 20
_CAPTURE_BYTES = (
    44 << 20
)  # recordings in a bundle, bytes: noise is not compressible; the rest is for report and rows
_NAME = re.compile(r"(captures/)?[A-Za-z0-9][\w.-]{0,80}\.(md|html|csv|json|yaml|svg|sigmf-meta|sigmf-data)")
_COLUMNS = ("step", "what", "value", "unit", "low", "high", "verdict", "cause")
_DATA = ".sigmf-data"
_PLACEHOLDER = "SERIAL"


class BundleError(InputError):
    """A bundle that cannot be read; the message is one line for the user."""


def verdict_of(checks: Sequence[Check]) -> str:
    """``12 passed, 1 failed, 2 skipped``."""
    names = ("pass", "fail", "skipped")
    count = {name: sum(c.verdict == name for c in checks) for name in names}
    return f"{count['pass']} passed, {count['fail']} failed, {count['skipped']} skipped"


def open_folder(bench: Bench) -> RunFolder:
    """The result folder of a bench; raises FolderError where it holds something else."""
    with_uhd = versions(False)
    if not bench.simulated:
        from gnuradio import uhd

        with_uhd["uhd"] = uhd.get_version_string()
    head = {
        "study": "first_light",
        "source": "simulated" if bench.simulated else "air",
        "scene": scene_to_mapping(bench.scene),
        "frames": bench.frames,
        "starts": bench.starts,
        "minutes": bench.minutes,
        "versions": with_uhd,
    }
    return RunFolder(bench.folder, head)


def write_bundle(
    folder: RunFolder,
    checks: Sequence[Check],
    steps: Sequence[Step],
    *,
    title: str,
    hidden: Collection[str] = (),
) -> Path:
    """Report, rows and the zip beside the folder; returns the zip.

    Parameters
    ----------
    folder : RunFolder
        Of `open_folder`; recordings lie in its ``captures``.
    checks : sequence of Check
    steps : sequence of Step
        Their titles head the report's parts.
    title : str
    hidden : collection of str
        Serial numbers that are left out of every file of the zip.

    Raises
    ------
    BundleError
        If the zip would exceed 50 MB.
    """
    folder.write_text("rows.csv", _rows(checks))
    drawing = Path(__file__).with_name("first_light.svg").read_text(encoding="utf-8")
    folder.write_text("cabling.svg", drawing)
    out = _left_out(folder.path)
    write_page(folder, _report(checks, steps, title, out), {"command": "radalt first-light"})
    bundle = folder.path.with_name(f"{folder.path.name}.zip")
    marks = {serial: f"{_PLACEHOLDER}{k}" for k, serial in enumerate(sorted(hidden), 1) if serial}
    with zipfile.ZipFile(bundle, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(p for p in folder.path.rglob("*") if p.is_file()):
            name = file.relative_to(folder.path).as_posix()
            if not _NAME.fullmatch(name) or file.stem in out:
                continue
            if file.suffix == _DATA:
                archive.write(file, name)
            else:
                archive.writestr(name, _without(file.read_text(encoding="utf-8"), marks))
    if bundle.stat().st_size > MOST_BYTES:
        bundle.unlink()
        raise BundleError(f"{bundle}: larger than {MOST_BYTES >> 20} MB; repeat with fewer --frames")
    return bundle


def _left_out(folder: Path) -> list[str]:
    """Names of the recordings, largest first, without which the others fit into a bundle."""
    files = sorted((folder / "captures").glob(f"*{_DATA}"), key=lambda p: p.stat().st_size)
    out, total = [], sum(p.stat().st_size for p in files)
    while total > _CAPTURE_BYTES:
        total -= files[-1].stat().st_size
        out.append(files.pop().stem)
    return out


def _without(text: str, marks: dict[str, str]) -> str:
    for serial, mark in marks.items():
        text = re.sub(rf"(?<![0-9A-Za-z]){re.escape(serial)}(?![0-9A-Za-z])", mark, text)
    return text


def _rows(checks: Sequence[Check]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for check in checks:
        writer.writerow([getattr(check, column) for column in _COLUMNS])
    return out.getvalue()


def _report(checks: Sequence[Check], steps: Sequence[Step], title: str, out: Sequence[str]) -> str:
    lines = [f"# First light, {title}", "", f"{verdict_of(checks)}.", ""]
    lines += ["![Cabling](cabling.svg)", ""]
    for step in steps:
        mine = [c for c in checks if c.step == step.name]
        if not mine:
            continue
        # the cause applies to values beyond their limits
        rows = [
            (c.what, c.shown, c.limit, c.verdict, "" if c.verdict == "pass" else c.cause.replace("|", "/"))
            for c in mine
        ]
        header = ("measured", "value", "limit", "verdict", "likely cause")
        lines += [f"## {step.title}", "", f"Connect: {step.connect}.", "", table(header, rows), ""]
    if out:
        lines += [f"Too large for the bundle, in the folder alone: {', '.join(sorted(out))}.", ""]
    return "\n".join(lines)


def read_bundle(path: Path, out: Path | None = None) -> str:
    """The report of a bundle, as text for a terminal; with ``out`` its files are unpacked there.

    Parameters
    ----------
    path : Path
        A zip, from anybody.
    out : Path, optional
        New or empty folder.

    Raises
    ------
    BundleError
        One line: not a bundle, a file of another name or kind, too many or too large.
    """
    if out is not None and out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise BundleError(f"--out {out} exists and is not an empty folder; name a new one")
    if not path.is_file() or path.stat().st_size > MOST_BYTES:
        raise BundleError(f"{path}: no file of at most {MOST_BYTES >> 20} MB; give the first-light-DATE.zip")
    try:
        with zipfile.ZipFile(path) as archive:
            listed = _checked(path, archive)
            if "report.md" not in listed:
                raise BundleError(f"{path}: no report.md in it; not a bundle of radalt first-light")
            text = b"".join(_bytes_of(path, archive, listed["report.md"], _MOST_TEXT)).decode(
                errors="replace"
            )
            if out is not None:
                for name, info in listed.items():
                    _unpack(path, archive, info, out / name)
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, EOFError, RuntimeError) as error:
        raise BundleError(
            f"{path}: not a readable zip ({one_line(str(error))}); have it sent again"
        ) from None
    lines = ["".join(c if c.isprintable() else " " for c in line) for line in text.splitlines()]
    return "\n".join([*lines, "", *(f"{i.file_size:>10}  {name}" for name, i in listed.items())])


def _checked(path: Path, archive: zipfile.ZipFile) -> dict[str, Any]:
    """Entries by name, all of them of a name, kind, number and size that a bundle has."""
    entries = archive.infolist()
    if len(entries) > _MOST_FILES or sum(e.file_size for e in entries) > _MOST_UNPACKED:
        raise BundleError(
            f"{path}: more than {_MOST_FILES} files or {_MOST_UNPACKED >> 20} MB in it; not a bundle"
        )
    listed: dict[str, Any] = {}
    for entry in entries:
        if not _NAME.fullmatch(entry.filename) or ".." in entry.filename or entry.filename in listed:
            shown = one_line(ascii(entry.filename))[:80]
            raise BundleError(f"{path}: it holds {shown}, which no bundle does; nothing was unpacked")
        listed[entry.filename] = entry
    return listed


def _bytes_of(path: Path, archive: zipfile.ZipFile, entry: Any, most: int) -> Iterator[bytes]:
    """A file's bytes in pieces; no more than it states, whatever its stream holds."""
    left = min(entry.file_size, most)
    if entry.file_size > most:
        raise BundleError(f"{path}: {entry.filename} is larger than {most >> 20} MB; not a bundle")
    with archive.open(entry) as stream:
        while left >= 0:
            piece = stream.read(min(1 << 20, left + 1))
            left -= len(piece)
            if not piece:
                return
            yield piece
    raise BundleError(f"{path}: {entry.filename} is larger than it states; not a bundle")


def _unpack(path: Path, archive: zipfile.ZipFile, entry: Any, to: Path) -> None:
    to.parent.mkdir(parents=True, exist_ok=True)
    with to.open("xb") as file:
        for piece in _bytes_of(path, archive, entry, _MOST_UNPACKED):
            file.write(piece)
