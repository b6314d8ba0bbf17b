"""SigMF files of one complex channel by any program (sigmf.org, version 1): validation, and samples by number.

Keys of namespaces other than ``core`` and ``radalt``, and keys without a value, are ignored, headers before captures
(``core:header_bytes``) are skipped, no archive is extracted to a disk. sigmf is imported when a file is opened.
"""

import contextlib
import hashlib
import io
import json
import tarfile
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .parsing import LARGEST, InputError, check_file, read_bytes, shown
from .paths import extra
from .raw_file import RawFile, as_rails, value_type

# to the core's keys, as SigMF declares them
EXTENSIONS = [{"name": "radalt", "version": "1.0.0", "optional": True}]
_NAMESPACES, _ENDINGS = ("core", "radalt"), (".sigmf-meta", ".sigmf-data")
_META_BYTES = 64 << 20  # largest metadata, bytes: some 100,000 annotations
_DATA_BYTES = 1 << 40  # largest data file, bytes: five hours at 7.5 MS/s, complex64
_ARCHIVES = (".sigmf", ".sigmf.gz", ".sigmf.xz", ".sigmf.zip")
_UNPACKED_BYTES = 1 << 30  # largest member of a compressed archive, bytes: it is unpacked into memory


@dataclass(frozen=True)
class _Data:
    """Location of the samples: a data file, a member of an archive, or unpacked."""

    source: Path | io.BytesIO
    offset: int
    size: int

    def content(self) -> np.ndarray:
        """(size,) uint8 view of the samples."""
        if isinstance(self.source, Path):
            return np.memmap(self.source, np.uint8, "r", self.offset, (self.size,))
        return np.frombuffer(self.source.getbuffer(), np.uint8)


class SigmfFile:
    """An opened file; see `open_sigmf`.

    ``path``: Path of the metadata, or of the archive; ``head``: the metadata's object ``global``; ``sample_count``:
    number of samples, headers excluded; ``notes``: what the metadata promise and the data lack, one line each.
    """

    def __init__(self, path: Path, content: dict[str, Any], data: _Data, sample_count: int) -> None:
        self.path, self.head, self.sample_count = path, content["global"], sample_count
        self.captures: list[dict[str, Any]] = content["captures"] or [{"core:sample_start": 0}]
        self.datatype = self.head["core:datatype"]
        self.rate_hz = float(self.head["core:sample_rate"])
        self.notes: list[str] = []
        # (first sample, reader by the file's sample numbers) after each header
        self._readers: list[tuple[int, RawFile]] = []
        skipped = 0
        for capture in self.captures:
            header = int(capture.get("core:header_bytes", 0))
            skipped += header
            if header or not self._readers:
                rails = as_rails(data.content()[skipped:], value_type(self.datatype))
                self._readers.append((int(capture.get("core:sample_start", 0)), RawFile(rails, self.rate_hz)))

    def read(self, start: int, count: int) -> np.ndarray:
        """(count,) complex64 from sample ``start`` on; integers scaled to -1..1."""
        parts = []
        ends = [first for first, _ in self._readers[1:]] + [self.sample_count]
        for (first, reader), end in zip(self._readers, ends, strict=True):
            low, high = max(start, first), min(start + count, end)
            if high > low:
                parts.append(reader.read(low, high - low))
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


def open_sigmf(path: Path | str) -> SigmfFile:
    """Open a SigMF file and check it against its metadata (checksum, sizes, schema).

    ``path``: ``.sigmf-meta``, ``.sigmf-data``, or an archive ``.sigmf``, ``.sigmf.gz``, ``.sigmf.xz``,
    ``.sigmf.zip``. Raises `InputError`: what is missing, truncated or does not match.
    """
    sigmf, path = extra("sigmf"), Path(path)
    archive = path.name.endswith(_ARCHIVES) and path.is_file()
    meta = path if archive else path.with_suffix(".sigmf-meta")
    if not meta.is_file():
        raise InputError(f"{path}: no SigMF recording: {meta.name} is not there; give the .sigmf-meta file")
    try:
        text, data = (
            _archived(path) if archive else (read_bytes(meta, most_bytes=_META_BYTES, what="recording"), None)
        )
        content = _check_header(meta, json.loads(text))  # bytes: with or without a byte order mark
        head = content["global"]
        head["core:extensions"] = EXTENSIONS  # the others are ignored, and some programs write an object
        data = data or _beside(meta, head.get("core:dataset"))
        if path.is_file() and path not in (meta, data.source):
            raise InputError(f"{path}: {meta.name} is of {data.source}; name that, or give rate_hz")
        recording = sigmf.SigMFFile(metadata=content)
        notes, captures = recording.get_annotations(), recording.get_captures()
        with contextlib.suppress(AttributeError, KeyError, TypeError):  # validate() names what is wrong
            notes.sort(key=lambda annotation: annotation["core:sample_start"])
        recording.validate()
        other = sum(int(c.get("core:header_bytes", 0)) for c in captures) + head.get("core:trailing_bytes", 0)
        width = 2 * np.dtype(value_type(head["core:datatype"])).itemsize
        held, torn = divmod(max(0, data.size - int(other)), width)
        if torn:  # a replay must not score truncated data
            raise ValueError(f"core:datatype has {width} bytes a sample, and {torn} are left over at the end")
        stated = head.get("core:sha512")
        if stated and hashlib.sha512(data.content()).hexdigest() != stated.lower():
            raise ValueError("core:sha512 is another one")
    except InputError:
        raise
    except Exception as error:  # sigmf, jsonschema, json, archives, OS and NumPy each bring their own kinds
        key = "".join(f"{part}: " for part in getattr(error, "absolute_path", ()))
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        reason = reason if len(reason) <= 120 else f"{reason[:50]} ... {reason[-60:]}"
        raise InputError(
            f"{meta}: {key}{reason}; not SigMF's metadata, or data that are missing, truncated or another recording's"
        ) from None
    if held <= max((c["core:sample_start"] for c in captures), default=0):
        raise InputError(f"{meta}: {held} samples are in the data file, and a capture begins behind them")
    opened = SigmfFile(meta, content, data, held)
    if any(note["core:sample_start"] + note.get("core:sample_count", 0) > held for note in notes):
        opened.notes.append(f"{meta}: annotations go on behind the last sample; are the data whole?")
    return opened


def _beside(meta: Path, named: Any) -> _Data:
    """The data file of ``meta``; ``core:dataset`` may name another one in its folder."""
    data = meta.with_suffix(".sigmf-data")
    if not data.exists() and named is not None:
        if not isinstance(named, str) or Path(named).name != named:
            raise InputError(f"{meta}: core:dataset is {shown(named)}; name a file next to it, no folder")
        data = meta.parent / named
    check_file(data, most_bytes=_DATA_BYTES, what="recording's data", remedy=f"put it next to {meta.name}")
    return _Data(data, 0, data.stat().st_size)


def _archived(path: Path) -> tuple[bytes, _Data]:
    """Metadata and samples in an archive of one recording; compressed samples are unpacked into memory."""
    zipped, plain = path.suffix == ".zip", path.suffix == ".sigmf"
    with zipfile.ZipFile(path) if zipped else tarfile.open(path, "r:" if plain else "r:*") as archive:
        found: dict[str, list[Any]] = {ending: [] for ending in _ENDINGS}
        for member in archive.infolist() if zipped else archive:
            name, size = (member.filename, member.file_size) if zipped else (member.name, member.size)
            ending = Path(name).suffix
            # macOS packs its own notes as ._NAME
            if ending not in found or Path(name).name.startswith("._") or not (zipped or member.isfile()):
                continue
            most = _META_BYTES if ending == ".sigmf-meta" else _DATA_BYTES if plain else _UNPACKED_BYTES
            if size > most:
                raise ValueError(
                    f"{shown(name)} has {size >> 20} MiB, at most {most >> 20} are unpacked: extract it"
                )
            found[ending].append(member)
        meta, data = found.values()
        if len(meta) != 1 or len(data) != 1:
            raise ValueError(f"{len(meta)} .sigmf-meta and {len(data)} .sigmf-data are in it")
        opened = archive.open if zipped else archive.extractfile
        text = opened(meta[0]).read()
        if plain and not data[0].issparse():
            return text, _Data(path, data[0].offset_data, data[0].size)
        samples = io.BytesIO(opened(data[0]).read())
        return text, _Data(samples, 0, samples.getbuffer().nbytes)


def _known_keys(value: Any) -> Any:
    """Metadata without the keys of other programs' namespaces and without null."""
    if isinstance(value, dict):
        known = {k: v for k, v in value.items() if k.partition(":")[0] in _NAMESPACES or ":" not in k}
        return {k: _known_keys(v) for k, v in known.items() if v is not None}
    return [_known_keys(v) for v in value] if isinstance(value, list) else value


def _check_header(meta: Path, content: Any) -> dict[str, Any]:
    """Metadata with the keys that a replay needs; the messages name the file's keys, unlike sigmf's."""
    data = _known_keys(content)
    head = data.get("global") if isinstance(data, dict) else None
    if not isinstance(head, dict):
        raise InputError(f"{meta}: not SigMF metadata, an object 'global' is missing")
    datatype, rate, channels = (head.get(f"core:{k}") for k in ("datatype", "sample_rate", "num_channels"))
    if value_type(datatype) is None:
        raise InputError(
            f"{meta}: core:datatype is {shown(datatype)}; complex samples are needed (cf32_le, ci16_le, ...)"
        )
    if isinstance(rate, bool) or not isinstance(rate, (int, float)) or not 0 < rate <= LARGEST:
        raise InputError(f"{meta}: core:sample_rate is {shown(rate)}; state the rate in samples per second")
    if channels not in (None, 1):
        raise InputError(f"{meta}: {shown(channels)} channels; recordings of one channel are taken")
    return data
