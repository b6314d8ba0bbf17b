"""Complex samples of files without metadata: raw, NumPy arrays, two-channel WAV. Other containers are refused."""

import re
import struct
import warnings
from pathlib import Path

import numpy as np

from .parsing import InputError, shown

# First bytes of files that hold more than samples. MATLAB 4 begins with four numbers and the length of a name.
_CONTAINERS = {
    "a zip archive (such as .npz)": rb"PK\x03\x04",
    "HDF5": rb"\x89HDF",
    "a MATLAB file": rb"MATLAB|..\0\0.{8}[\0\x01]\0{3}[\x02-\x40]\0{3}[A-Za-z]\w*\0",
    "compressed": rb"\x1f\x8b|BZh|\xfd7zXZ|\x28\xb5\x2f\xfd|fLaC",
    "another program's format": rb"PAR1|BLUE|\x80[\4\5]\x95.{5}\0{3}|%PDF|\x89PNG|OggS|....ftyp",
    "text": rb"(\xef\xbb\xbf)?[\t\r\n -~]{64}|[\t\r\n -~]+\Z",
}
_REMEDY = "save the samples as .npy (give rate_hz), two-channel WAV, or raw (give rate_hz and datatype)"
_PART = 1 << 16  # bytes by which a file is judged
_FLOATS = 1e-20, 1e15  # what receivers write lies within it, and four of ten 32-bit patterns


class RawFile:
    """An opened file: ``rate_hz``, ``sample_count``, and ``head`` and ``notes``, which are empty; see `open_raw`."""

    def __init__(self, rails: np.ndarray, rate_hz: float) -> None:
        self.head: dict[str, object] = {}
        self.notes: list[str] = []
        self.rate_hz, self.sample_count, self._rails = float(rate_hz), len(rails), rails

    def read(self, start: int, count: int) -> np.ndarray:
        """(count,) complex64 from sample ``start`` on; integers scaled to -1..1."""
        rails, kind = self._rails[start : start + count], self._rails.dtype
        if kind.kind != "f":
            rails = rails / 2.0 ** (8 * kind.itemsize - 1) - (kind.kind == "u")
        with np.errstate(over="ignore"):
            return np.ascontiguousarray(rails, dtype=np.float32).view(np.complex64)[:, 0]


def value_type(datatype: object) -> np.dtype | None:
    """NumPy's type of the values of SigMF's complex types; None of any other."""
    named = isinstance(datatype, str) and re.fullmatch(r"c(f|i|u)(8|16|32|64)(?:_(le|be))?", datatype)
    if not named or named[1] + named[2] in ("f8", "f16", "i64", "u64"):
        return None
    return np.dtype(f"{'>' if named[3] == 'be' else '<'}{named[1]}{int(named[2]) // 8}")


def as_rails(content: np.ndarray, kind: np.dtype) -> np.ndarray:
    """(n, 2) values of uint8 ``content``; an incomplete sample at its end is left out."""
    return content[: content.size // (2 * kind.itemsize) * 2 * kind.itemsize].view(kind).reshape(-1, 2)


def open_raw(path: Path, datatype: str = "", rate_hz: float | None = None) -> RawFile:
    """Open NumPy's ``.npy``, complex or real of shape (n, 2), a WAV of two channels, I and Q, or raw samples.

    ``datatype`` is that of raw samples, as in SigMF (``cf32_le``, ``ci16_le``, ``cu8``). Only a WAV states a rate.

    Raises `InputError`: what is missing, another container, or samples that are of another type.
    """
    with path.open("rb") as file:
        first = file.read(_PART)
        file.seek(path.stat().st_size // 32 * 16)  # the middle, at a whole sample of any type
        middle = file.read(_PART)
    try:
        if first.startswith(b"\x93NUMPY"):
            rails = np.load(path, mmap_mode="r", allow_pickle=False)
        elif first[:4] in (b"RIFF", b"RIFX", b"RF64"):
            from scipy.io import wavfile

            with warnings.catch_warnings():
                warnings.simplefilter("ignore", wavfile.WavFileWarning)  # chunks of other programs
                mapped = first[34:36] != b"\x18\0"  # 24 bits cannot be
                stated_hz, rails = wavfile.read(path, mmap=mapped)
            rate_hz = rate_hz or stated_hz
        else:
            kind = next((n for n, start in _CONTAINERS.items() if re.match(start, first, re.DOTALL)), "")
            if kind:
                raise ValueError(f"it is {kind}")
            rails = as_rails(np.memmap(path, np.uint8, "r"), _checked_type(datatype, middle))
        if rails.dtype.kind == "c" and rails.size == max(rails.shape):
            rails = rails.reshape(-1).view(rails.real.dtype).reshape(-1, 2)
        if rails.dtype.kind not in "fiu" or rails.ndim != 2 or rails.shape[1] != 2:
            raise ValueError(f"{rails.dtype} of shape {rails.shape}; complex (n,) or real (n, 2) is read")
    except (ValueError, OSError, EOFError, struct.error) as error:
        raise InputError(f"{path}: not read: {' '.join(str(error).split())[:200]}; {_REMEDY}") from None
    if datatype and first.startswith((b"\x93NUMPY", b"RIFF", b"RIFX", b"RF64")):
        raise InputError(f"{path}: its header states the type; leave recording.datatype out")
    if rate_hz is None:
        raise InputError(f"{path}: no rate is stated; give recording.rate_hz, in samples per second")
    return RawFile(rails, rate_hz)


def _checked_type(datatype: str, part: bytes) -> np.dtype:
    """Type of raw values; ValueError if these ``part`` of them cannot be meant."""
    kind = value_type(datatype)
    if kind is None:
        given = f"is {shown(datatype)}" if datatype else "is missing"
        raise ValueError(f"recording.datatype {given}; for raw samples cf32_le, ci16_le, cu8 or the like")
    likely = [f"cf{bits}_le" for bits in (32, 64) if _as_floats(part, np.dtype(f"<f{bits // 8}")) > 0.99]
    wrong = (
        _as_floats(part, kind) < 0.9 or (kind == "<f8" and "cf32_le" in likely)
        if kind.kind == "f"
        else likely
    )
    if wrong:
        raise ValueError(f"its samples are not {datatype}; are they {(likely or ['ci16_le'])[0]}?")
    if kind.itemsize == 1:
        zeros = (("i1", 0.0), ("u1", 127.5))
        away = [np.abs(np.frombuffer(part, name) - zero).mean() for name, zero in zeros]
        if away[kind.kind == "u"] > 3 * away[kind.kind == "i"]:
            raise ValueError(
                f"its samples are not {datatype}; are they {'cu8' if kind.kind == 'i' else 'ci8'}?"
            )
    return kind


def _as_floats(part: bytes, kind: np.dtype) -> float:
    """Share of the values other than 0 that a receiver writes; NaN of too few."""
    values = np.abs(np.frombuffer(part[: len(part) // 8 * 8], kind))
    values = values[values != 0]
    with np.errstate(invalid="ignore"):
        return float(np.mean((values > _FLOATS[0]) & (values < _FLOATS[1]))) if values.size > 64 else np.nan
