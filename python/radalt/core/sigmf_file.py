"""SigMF files of one complex channel by any program (sigmf.org, version 1): validation, and samples by number.

Keys of namespaces other than ``core`` and ``radalt`` are ignored, headers before captures (``core:header_bytes``) are
skipped, archives are not extracted. The package sigmf is imported when a file is opened.
"""

import hashlib
import json
import re
import tarfile
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .parsing import LARGEST, InputError, check_file, read_text, shown
from .paths import remedy

_COMPLEX = re.compile(r"c(f(32|64)|[iu](8|16|32))(?:_le|_be)?")
_NAMESPACES, _ENDINGS = ("core", "radalt"), (".sigmf-meta", ".sigmf-data")
_META_BYTES = 64 << 20  # largest metadata, bytes: some 100,000 annotations
_DATA_BYTES = 1 << 40  # largest data file, bytes: five hours at 7.5 MS/s, complex64


@dataclass(frozen=True)
class _Data:
    """Location of the samples: a data file, or a member of an archive."""

    file: Path
    offset: int
    size: int


class SigmfFile:
    """An opened file; see `open_sigmf`.

    Attributes
    ----------
    path : Path
        Path of the metadata, or of the archive.
    head : dict
        The metadata's object ``global``.
    captures : list of dict
    datatype : str
    rate_hz : float
    sample_count : int
        Number of samples, headers excluded.
    """

    def __init__(self, path: Path, content: dict[str, Any], data: _Data, sample_count: int) -> None:
        self.path, self.head, self.sample_count = path, content["global"], sample_count
        self.captures: list[dict[str, Any]] = content["captures"] or [{"core:sample_start": 0}]
        self.datatype = self.head["core:datatype"]
        self.rate_hz = float(self.head["core:sample_rate"])
        # (first sample, reader by the file's sample numbers) after each header
        self._readers: list[tuple[int, Any]] = []
        skipped = 0
        for capture in self.captures:
            header = int(capture.get("core:header_bytes", 0))
            skipped += header
            if header or not self._readers:
                self._readers.append((int(capture.get("core:sample_start", 0)), self._reader(data, skipped)))

    def _reader(self, data: _Data, skipped: int) -> Any:
        import sigmf

        reader = sigmf.SigMFFile(
            global_info={"core:datatype": self.datatype, "core:sample_rate": self.rate_hz}
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # sizes have been checked
            part = {"offset": data.offset + skipped, "size_bytes": data.size - skipped}
            reader.set_data_file(str(data.file), skip_checksum=True, **part)
        return reader

    def read(self, start: int, count: int) -> np.ndarray:
        """(count,) complex64 from sample ``start`` on; integers scaled to -1..1."""
        parts = []
        ends = [first for first, _ in self._readers[1:]] + [self.sample_count]
        for (first, reader), end in zip(self._readers, ends, strict=True):
            low, high = max(start, first), min(start + count, end)
            if high > low:
                parts.append(np.ascontiguousarray(reader.read_samples(low, high - low), dtype=np.complex64))
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


def open_sigmf(path: Path | str) -> SigmfFile:
    """Open a SigMF file and check it against its metadata (checksum, sizes, schema).

    Parameters
    ----------
    path : path
        ``.sigmf-meta``, ``.sigmf-data`` or an archive ``.sigmf``.

    Raises
    ------
    InputError
        One line: what is missing, truncated or does not match.
    """
    try:
        import sigmf
    except ImportError:
        raise InputError(f"SigMF needs the package sigmf; {remedy('sigmf')}") from None
    path = Path(path)
    archive = path.suffix == ".sigmf" and path.is_file()
    meta = path if archive else path.with_suffix(".sigmf-meta")
    if not meta.is_file():
        raise InputError(f"{meta}: no such recording; give the .sigmf-meta file")
    text, data = (
        _archived(meta) if archive else (read_text(meta, most_bytes=_META_BYTES, what="recording"), None)
    )
    content = _check_header(meta, text)
    data = data or _beside(meta, content["global"].get("core:dataset"))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # sigmf warns of truncated data, which a replay must not score
            recording = sigmf.SigMFFile(metadata=content)
            other = sum(int(c.get("core:header_bytes", 0)) for c in recording.get_captures())
            held = max(0, data.size - other - int(content["global"].get("core:trailing_bytes", 0)))
            recording.set_data_file(str(data.file), skip_checksum=True, offset=data.offset, size_bytes=held)
            recording.validate()
        _check_sum(data, content["global"].get("core:sha512"))
    except Exception as error:  # sigmf, jsonschema, json, OS and warnings each bring their own kinds
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        reason = reason if len(reason) <= 120 else f"{reason[:50]} ... {reason[-60:]}"
        raise InputError(
            f"{meta}: {reason}; not SigMF's metadata, or data that are missing, truncated or another recording's"
        ) from None
    if recording.sample_count == 0:
        raise InputError(f"{meta}: the data file holds no samples")
    return SigmfFile(meta, content, data, int(recording.sample_count))


def open_raw(path: Path, datatype: str, rate_hz: float) -> SigmfFile:
    """Open a raw file of complex samples; ``datatype`` as in SigMF (``cf32_le``, ``ci16_le``, ``cu8``).

    Raises
    ------
    InputError
        One line.
    """
    content = {"global": {"core:datatype": datatype, "core:sample_rate": rate_hz}, "captures": []}
    _check_header(path, json.dumps(content))
    size, bits = path.stat().st_size, int(_COMPLEX.fullmatch(datatype)[3] or _COMPLEX.fullmatch(datatype)[2])
    return SigmfFile(path, content, _Data(path, 0, size), size // (bits // 4))


def _beside(meta: Path, named: Any) -> _Data:
    """The data file of ``meta``; ``core:dataset`` may name another one in its folder."""
    data = meta.with_suffix(".sigmf-data")
    if not data.exists() and named is not None:
        if not isinstance(named, str) or Path(named).name != named:
            raise InputError(f"{meta}: core:dataset is {shown(named)}; name a file beside it, no folder")
        data = meta.parent / named
    check_file(data, most_bytes=_DATA_BYTES, what="recording's data", remedy=f"put it beside {meta.name}")
    return _Data(data, 0, data.stat().st_size)


def _archived(path: Path) -> tuple[str, _Data]:
    """Metadata and place of the data in an archive of one recording; nothing is extracted."""
    try:
        with tarfile.open(path, "r:") as tar:
            meta, data = ([m for m in tar if m.isfile() and m.name.endswith(ending)] for ending in _ENDINGS)
            if len(meta) != 1 or len(data) != 1 or meta[0].size > _META_BYTES:
                raise ValueError(f"{len(meta)} .sigmf-meta and {len(data)} .sigmf-data are in it")
            text = tar.extractfile(meta[0]).read().decode()
            return text, _Data(path, data[0].offset_data, data[0].size)
    except (tarfile.TarError, ValueError, OSError) as error:
        raise InputError(
            f"{path}: no archive of one recording ({str(error)[:100]}); extract it and name its .sigmf-meta"
        ) from None


def _check_sum(data: _Data, stated: Any) -> None:
    """Compare the samples with ``core:sha512``, where it is stated."""
    if stated is None:
        return
    digest = hashlib.sha512()
    with data.file.open("rb") as file:
        file.seek(data.offset)
        left = data.size
        while left > 0 and (block := file.read(min(1 << 20, left))):
            digest.update(block)
            left -= len(block)
    if digest.hexdigest() != stated:
        raise ValueError("core:sha512 is another one")


def _known_keys(value: Any) -> Any:
    """Metadata without the keys of other programs' namespaces."""
    if isinstance(value, dict):
        return {
            k: _known_keys(v) for k, v in value.items() if k.partition(":")[0] in _NAMESPACES or ":" not in k
        }
    return [_known_keys(v) for v in value] if isinstance(value, list) else value


def _check_header(meta: Path, text: str) -> dict[str, Any]:
    """Metadata with the keys that a replay needs; the messages name the file's keys, unlike sigmf's."""
    try:
        data = _known_keys(json.loads(text))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{meta}: not readable as JSON ({str(error)[:100]})") from None
    head = data.get("global") if isinstance(data, dict) else None
    if not isinstance(head, dict):
        raise InputError(f"{meta}: not SigMF metadata, an object 'global' is missing")
    datatype, rate, channels = (head.get(f"core:{k}") for k in ("datatype", "sample_rate", "num_channels"))
    if not isinstance(datatype, str) or not _COMPLEX.fullmatch(datatype):
        raise InputError(
            f"{meta}: core:datatype is {shown(datatype)}; complex samples are needed (cf32_le, ci16_le, ...)"
        )
    if isinstance(rate, bool) or not isinstance(rate, (int, float)) or not 0 < rate <= LARGEST:
        raise InputError(f"{meta}: core:sample_rate is {shown(rate)}; state the rate in samples per second")
    if channels not in (None, 1):
        raise InputError(f"{meta}: {shown(channels)} channels; recordings of one channel are taken")
    return data
