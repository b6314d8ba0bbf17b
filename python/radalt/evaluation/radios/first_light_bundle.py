"""What the first hour found, in one zip of at most 50 MB: report, rows, recordings, versions; and reading one."""

import csv
import io
import lzma
import re
import zipfile
import zlib
from collections.abc import Collection, Sequence
from pathlib import Path

from ...core.parsing import InputError
from ...core.scene import scene_to_mapping
from ...core.text import one_line
from ..results.folder import RunFolder, replace_file, versions
from ..results.page import write_pages
from ..results.table import table
from .first_light import STEPS, Bench, Check

MOST_BYTES = 50 << 20
_MOST_FILES, _MOST_UNPACKED = 100, 100 << 20
_MOST_REPORT = 1 << 20  # of the report, which goes to a terminal; one of 49 checks has 5 kB
_CAPTURE_BYTES = 44 << 20  # of recordings, which noise does not let shrink; the rest is report and rows
_NAME = re.compile(r"(captures/)?[a-zA-Z0-9][a-zA-Z0-9_.-]{0,80}\.(md|html|csv|json|svg|sigmf-(meta|data))")
_RUN = {"command": "radalt first-light"}
_COLUMNS = ("step", "what", "value", "unit", "low", "high", "verdict", "cause")


class BundleError(InputError):
    """A bundle that cannot be written or read; the message is one line for the user."""


def verdict_of(checks: Sequence[Check]) -> str:
    """``12 passed, 1 failed, 2 skipped``."""
    names = {"pass": "passed", "fail": "failed", "skipped": "skipped"}
    return ", ".join(f"{sum(c.verdict == v for c in checks)} {word}" for v, word in names.items())


def bundle_of(folder: Path) -> Path:
    """The zip beside a folder."""
    return folder.with_name(f"{folder.name}.zip")


def open_folder(bench: Bench) -> RunFolder:
    """The result folder of a bench; raises BundleError or FolderError where something else is in its place."""
    if (bench.folder / "run.json").exists() or bundle_of(bench.folder).exists():
        raise BundleError(
            f"{bench.folder} or {bundle_of(bench.folder)} exists from another hour; name another --out"
        )
    made_with = versions(with_network=bench.scene.has_jammer)
    if not bench.simulated:
        from gnuradio import uhd

        made_with["uhd"] = uhd.get_version_string()
    source = "simulated" if bench.simulated else "air"
    head = {
        "study": "first_light",
        "source": source,
        "versions": made_with,
        "scene": scene_to_mapping(bench.scene),
    }
    return RunFolder(
        bench.folder, head | {name: getattr(bench, name) for name in ("frames", "starts", "minutes")}
    )


def write_bundle(
    folder: RunFolder, checks: Sequence[Check], title: str, hidden: Collection[str] = ()
) -> Path:
    """Report, rows, and the zip beside the folder without the serials ``hidden``; returns the zip.

    Raises `BundleError` if it would exceed 50 MB.
    """
    rows = io.StringIO()
    values = ([getattr(check, column) for column in _COLUMNS] for check in checks)
    csv.writer(rows, lineterminator="\n").writerows([_COLUMNS, *values])
    folder.write_text("rows.csv", rows.getvalue())
    here = Path(__file__).parent
    folder.write_text("cabling.svg", (here / "first_light.svg").read_text(encoding="utf-8"))
    captures = sorted(folder.path.glob("captures/*.sigmf-data"), key=lambda p: p.stat().st_size)
    out: list[str] = []
    while sum(p.stat().st_size for p in captures) > _CAPTURE_BYTES:
        out.append(captures.pop().stem)
    page = {"title": title, "verdict": verdict_of(checks), "steps": STEPS, "out": out, "run": _RUN}
    page["parts"] = {name: _table([c for c in checks if c.step == name]) for name in STEPS}
    write_pages(folder, here / "first_light.md.j2", page)
    bundle, packed = bundle_of(folder.path), io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(folder.path.rglob("*")):
            name = file.relative_to(folder.path).as_posix()
            if file.is_dir() or not _NAME.fullmatch(name) or file.stem in out:
                continue
            content = file.read_bytes()
            for k, serial in enumerate(sorted(filter(None, hidden)) if file not in captures else (), 1):
                pattern = rf"(?<![0-9A-Za-z]){serial}(?![0-9A-Za-z])".encode()
                content = re.sub(pattern, f"SERIAL{k}".encode(), content)
            archive.writestr(name, content)
    if packed.tell() > MOST_BYTES:
        raise BundleError(f"{bundle}: larger than {MOST_BYTES >> 20} MB; repeat with fewer --frames")
    replace_file(bundle, packed.getvalue())
    return bundle


def _table(checks: Sequence[Check]) -> str:
    """Checks as Markdown; a cause is that of a value beyond its limits."""
    rows = [(c.what, c.shown, c.limit, c.verdict, "" if c.verdict == "pass" else c.cause) for c in checks]
    rows = [[cell.replace("|", "/") for cell in row] for row in rows]
    return table(("measured", "value", "limit", "verdict", "likely cause"), rows) if rows else ""


def read_bundle(path: Path, out: Path | None = None) -> str:
    """The report of a bundle, from anybody, as text for a terminal; its files are unpacked into ``out``, if given.

    Raises `BundleError`: not a bundle, a file of another name, too many or too large; or ``out`` is not new or empty.
    """
    if out is not None and out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise BundleError(f"--out {out} exists and is not an empty folder; name a new one")
    files = _files_of(path)
    for name, content in files.items() if out is not None else ():
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(content)
    lines = files["report.md"].decode(errors="replace").splitlines()
    shown = ["".join(c if c.isprintable() else " " for c in line) for line in lines]
    return "\n".join([*shown, "", *(f"{len(content):>10}  {name}" for name, content in files.items())])


def _files_of(path: Path) -> dict[str, bytes]:
    """Content by name. Number, names and sizes are checked first, and no more is read than a file states."""
    if not path.is_file() or path.stat().st_size > MOST_BYTES:
        raise BundleError(
            f"{path}: no such file, or one of more than {MOST_BYTES >> 20} MB; give the first-light-DATE.zip"
        )
    files: dict[str, bytes] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            if len(entries) > _MOST_FILES or sum(e.file_size for e in entries) > _MOST_UNPACKED:
                raise BundleError(f"{path}: more than {_MOST_FILES} files or {_MOST_UNPACKED >> 20} MB in it")
            for entry in entries:
                if not _NAME.fullmatch(entry.filename) or entry.filename in files:
                    shown = one_line(ascii(entry.filename))[:80]
                    raise BundleError(f"{path}: it holds {shown}, which no bundle does; nothing was unpacked")
                if entry.filename == "report.md" and entry.file_size > _MOST_REPORT:
                    raise BundleError(
                        f"{path}: its report.md has {entry.file_size} bytes; at most {_MOST_REPORT}"
                    )
                with archive.open(entry) as stream:
                    files[entry.filename] = stream.read(entry.file_size)
    except (
        zipfile.BadZipFile,
        zlib.error,
        lzma.LZMAError,
        OSError,
        NotImplementedError,
        EOFError,
        RuntimeError,
    ) as error:
        raise BundleError(
            f"{path}: not a readable zip ({one_line(str(error))}); have it sent again"
        ) from None
    if "report.md" not in files:
        raise BundleError(f"{path}: no report.md in it; not a bundle of radalt first-light")
    return files
