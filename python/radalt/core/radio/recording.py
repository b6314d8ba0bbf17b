"""SigMF recordings of received IQ, by this and by other programs (sigmf.org, version 1).

The samples are ``cf32_le``. Each stretch without loss is one capture whose ``core:global_index`` is the sample counter
since the transmitter's start, so that a replay sees the same gaps. The namespace ``radalt`` adds the scene (global)
and, as annotations, altitude and jammer state by frame. sigmf is imported when a file is opened or closed.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from ..parsing import InputError, shown
from ..paths import extra
from ..scene import Scene, SceneError, parse_scene, scene_to_mapping
from ..sigmf_file import EXTENSIONS, SigmfFile, open_sigmf

_BLOCK = 1 << 18  # samples per read: 2 MB
_MAX_TERM = 4096  # largest term of a resampling ratio: beyond it the polyphase filter has millions of taps
# largest error of a stated rate against such a ratio, ppm: rounding, and tolerance of crystals
_RATE_PPM = 20.0
_MAX_RAISE = 16  # largest increase of the rate: a slower recording does not hold the sweep
# largest timing error after a gap, samples: 5 m of altitude, the criterion of a correct detection
_TIMED = 0.25
_TIME = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d{1,18}))?Z?")
_MOST_INDEX = 1 << 60  # largest sample counter: sums of two stay within 64 bits
# Settings for the replay of a radio's recording, and their limits: the latency that was subtracted, the full scale.
_RADIO_RANGES = {"calibration_samples": (-1e9, 1e9), "full_scale": (1e-9, 1e9)}


class RecordingError(ValueError):
    """A recording that cannot be read or written; the message is one line for the user."""


@dataclass(frozen=True)
class Stretch:
    """Samples without loss: position in the file, sample counter of the first, and number."""

    file_start: int
    global_index: int
    count: int


# -- writing ----------------------------------------------------------------------------------------------------------


def write_metadata(
    data_file: Path,
    scene: Scene,
    stretches: list[Stretch],
    *,
    latency_samples: float,
    recorder: str,
    radio: Mapping[str, float] | None = None,
) -> Path:
    """Write ``.sigmf-meta`` next to complex64 samples: scene, captures, and annotations of altitude and jammer.

    ``latency_samples`` leads from the counter's zero to the start of sweep 0; ``radio`` has settings of the segmenter
    that a scene does not give, ``calibration_samples`` and ``full_scale``.
    """
    w = scene.waveform
    recording = extra("sigmf").SigMFFile(
        data_file=str(data_file),
        global_info={
            "core:datatype": "cf32_le",
            "core:sample_rate": float(w.rate_hz),
            "core:version": "1.2.0",
            "core:description": f"{scene.name}: received IQ of an FMCW radar altimeter under interference",
            "core:recorder": recorder,
            "core:extensions": EXTENSIONS,
            "radalt:scene": scene_to_mapping(scene),
            "radalt:latency_samples": float(latency_samples),
            **{f"radalt:{key}": float(value) for key, value in (radio or {}).items()},
        },
    )
    for stretch in stretches:
        recording.add_capture(
            stretch.file_start,
            {"core:frequency": float(w.carrier_hz), "core:global_index": int(stretch.global_index)},
        )
    for start, length, fields in _annotations(scene, stretches, latency_samples):
        recording.add_annotation(start, length, dict(fields))  # it writes its start into it
    meta = data_file.with_suffix(".sigmf-meta")
    recording.tofile(str(meta), overwrite=True)
    return meta


def _annotations(
    scene: Scene, stretches: list[Stretch], latency_samples: float
) -> Iterator[tuple[int, int, dict[str, Any]]]:
    """(file start, length, fields) of every run of frames at one altitude, cut where samples are missing."""
    programme, n = scene.altitude.programme, scene.waveform.samples_per_frame
    index = np.arange(programme.total_frames)
    altitude, trial = programme.altitude_m(index), programme.is_trial(index)
    change = np.nonzero((np.diff(altitude) != 0) | (np.diff(trial.astype(int)) != 0))[0] + 1
    for first, last in zip(np.r_[0, change], np.r_[change, index.size], strict=True):
        playing = bool(trial[first]) and scene.has_jammer
        fields = {
            "core:label": f"{altitude[first]:g} m" if trial[first] else "timing",
            "radalt:altitude_m": float(altitude[first]),
            "radalt:first_frame": int(first),
            "radalt:frames": int(last - first),
            "radalt:jammer": {
                "on": playing,
                "waveform": scene.interference_name if playing else "none",
                "overlap": max((i.overlap for i in scene.interference), default=0.0) if playing else 0.0,
                "sir_db": float(scene.sir_db) if playing else None,
            },
        }
        low, high = (int(first) * n + round(latency_samples), int(last) * n + round(latency_samples))
        for s in stretches:
            a, b = max(low, s.global_index), min(high, s.global_index + s.count)
            if b > a:
                yield s.file_start + a - s.global_index, b - a, fields


# -- reading ----------------------------------------------------------------------------------------------------------


class Capture:
    """An opened recording; see `open_capture`.

    ``scene``: scene of the run, in a recording by this program; None in any other. ``radio``: ``radio`` of
    `write_metadata`, for a recording by radio; ``notes``: assumptions and omissions, one line each.
    """

    def __init__(self, file: SigmfFile, scene: Scene | None, radio: dict[str, float]) -> None:
        self.path, self.rate_hz, self.datatype = file.path, file.rate_hz, file.datatype
        self.scene, self.radio = scene, radio
        self.sample_count = file.sample_count
        self.notes: list[str] = [*file.notes]
        self._file = file
        self.stretches = self._find_stretches(file.captures)

    def _find_stretches(self, captures: list[dict[str, Any]]) -> tuple[Stretch, ...]:
        starts = [int(c.get("core:sample_start", 0)) for c in captures]
        out: list[Stretch] = []
        for k, (capture, start) in enumerate(zip(captures, starts, strict=True)):
            end = starts[k + 1] if k + 1 < len(starts) else self.sample_count
            if not 0 <= start < end <= self.sample_count:
                raise RecordingError(
                    f"{self.path}: capture {k} starts at sample {start}, the data hold {self.sample_count}; "
                    "the data file is truncated or belongs to another recording"
                )
            lost = 0 if "core:global_index" in capture else self._lost_by_time(captures, starts, k)
            if lost is None:
                break
            index = int(capture.get("core:global_index", start + lost))
            if not 0 <= index <= _MOST_INDEX:
                raise RecordingError(
                    f"{self.path}: capture {k} has core:global_index {shown(index)}; a sample counter is 0 or above"
                )
            out.append(Stretch(start, index, end - start))
        return tuple(out)

    def _lost_by_time(self, captures: list[dict[str, Any]], starts: list[int], k: int) -> int | None:
        """Samples lost before capture ``k`` by ``core:datetime``; None where its resolution is too coarse."""
        times = [_time(captures[j].get("core:datetime")) for j in (0, k)]
        if k == 0 or None in times:
            return 0
        (first, _), (now, digits) = times
        step = self.rate_hz * 10.0**-digits  # samples within which the time is known
        lost = float((now - first) * Fraction(self.rate_hz)) - (starts[k] - starts[0])
        if abs(lost) <= max(1.0, step):
            return 0
        if lost < 0:
            raise RecordingError(
                f"{self.path}: capture {k} begins before the one before it ends, by core:datetime"
            )
        if step > _TIMED:
            self.notes.append(
                f"{self.path}: what follows a gap at sample {starts[k]} is left out: core:datetime gives its length to "
                f"{step:.2g} samples, and timing needs {_TIMED:g}; state core:global_index"
            )
            return None
        return round(lost)

    def blocks(self, rate_hz: float) -> Iterator[tuple[int, np.ndarray]]:
        """(sample counter, complex64 samples) at ``rate_hz`` in order, at most 2^18 at a time.

        Other rates are resampled by the nearest ratio of whole numbers up to 4096 (polyphase, Kaiser window). A
        counter that does not continue the one before marks lost samples.

        Raises `RecordingError`: at once, if there is no such ratio.
        """
        ratio = Fraction(rate_hz / self.rate_hz).limit_denominator(_MAX_TERM)
        off_ppm = 1e6 * abs(float(ratio) * self.rate_hz / rate_hz - 1)
        if off_ppm > _RATE_PPM or ratio.numerator > _MAX_TERM:
            raise RecordingError(
                f"{self.path}: rate {self.rate_hz:g} S/s and the scene's {rate_hz:g} S/s have no ratio of "
                f"whole numbers up to {_MAX_TERM}; resample it first"
            )
        if ratio > _MAX_RAISE:
            raise RecordingError(
                f"{self.path}: recorded at {self.rate_hz:g} S/s; at the scene's {rate_hz:g} S/s that would be "
                f"{float(ratio * self.sample_count):.3g} samples ({float(ratio * self.sample_count) * 8 / 1e9:.3g} GB) "
                "without the sweep in them: record faster, or name the right scene with --scene"
            )
        if off_ppm > 1e-3:
            self.notes.append(
                f"{self.path}: core:sample_rate is {off_ppm:.2g} ppm off a ratio to the scene's rate, and taken for it"
            )
        return self._blocks(ratio)

    def _blocks(self, ratio: Fraction) -> Iterator[tuple[int, np.ndarray]]:
        for stretch in self.stretches:
            first = round(Fraction(stretch.global_index) * ratio)
            for samples in self._stretch(stretch, ratio):
                yield first, samples
                first += samples.size

    def _stretch(self, stretch: Stretch, ratio: Fraction) -> Iterator[np.ndarray]:
        up, down = ratio.numerator, ratio.denominator
        end = stretch.file_start + stretch.count
        if up == down:
            for at in range(stretch.file_start, end, _BLOCK):
                yield self._file.read(at, min(_BLOCK, end - at))
            return
        from scipy import signal  # see core/fir.py

        # whole periods of the polyphase filter, with its reach (scipy: 10 max(up, down) taps) on either side
        reach = -(-(10 * max(up, down)) // (up * down)) + 1
        step = max(1, _BLOCK // max(up, down)) * down
        for at in range(stretch.file_start, end, step):
            low = max(stretch.file_start, at - reach * down)
            high = min(end, at + step + reach * down)
            block = signal.resample_poly(self._file.read(low, high - low), up, down)
            skip = (at - low) // down * up
            count = -(-(min(at + step, end) - at) * up // down)
            yield block[skip : skip + count].astype(np.complex64)

    def what_is_missing(self) -> str:
        """Why the samples hold no signal, in words; empty where they may hold one."""
        finite = False
        for stretch in self.stretches:
            end = stretch.file_start + stretch.count
            for at in range(stretch.file_start, end, _BLOCK):
                samples = self._file.read(at, min(_BLOCK, end - at))
                good = samples[np.isfinite(samples)]
                finite = finite or good.size > 0
                if good.any():
                    return ""
        return "nothing but zeros is in it" if finite else "no sample in it is a finite number"


def _time(text: Any) -> tuple[Fraction, int] | None:
    """Seconds of an ISO 8601 time, exact, and its decimal digits; None where there is none."""
    found = _TIME.fullmatch(text) if isinstance(text, str) else None
    if found is None:
        return None
    try:
        whole = datetime.strptime(found[1], "%Y-%m-%dT%H:%M:%S").replace(tzinfo=timezone.utc)
    except ValueError:
        return None
    digits = found[2] or ""
    return Fraction(int(whole.timestamp())) + Fraction(int(digits or 0), 10 ** len(digits)), len(digits)


def open_capture(path: Path | str) -> Capture:
    """Open a SigMF recording and check it against its metadata (checksum, sizes, captures, annotations).

    ``path``: as in `open_sigmf`: a complex recording with one channel, any SigMF sample format. Raises
    `RecordingError`: what is missing, truncated or does not match.
    """
    try:
        file = open_sigmf(path)
    except InputError as error:
        raise RecordingError(str(error)) from None
    return _checked(file)


def _checked(file: SigmfFile) -> Capture:
    meta, head = file.path, file.head
    mapping = head.get("radalt:scene")
    try:
        scene = parse_scene(mapping, source=str(meta)) if mapping is not None else None
    except SceneError as error:
        raise RecordingError(f"{error}; the recording's scene is of another version, give --scene") from None
    if scene is not None:
        _check_ours(file, scene)
    radio = {}
    for key, (low, high) in _RADIO_RANGES.items():
        value = head.get(f"radalt:{key}")
        if value is None:
            continue
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
            raise RecordingError(
                f"{meta}: radalt:{key} is {shown(value)}; it has to be a finite number within {low:g}..{high:g}"
            )
        radio[key] = float(value)
    return Capture(file, scene, radio)


def _check_ours(file: SigmfFile, scene: Scene) -> None:
    """Refuse a recording with ``radalt:scene`` whose format or rate differs from what `write_metadata` writes."""
    meta, datatype, rate_hz = file.path, file.datatype, file.rate_hz
    if datatype != "cf32_le":
        raise RecordingError(
            f"{meta}: core:datatype is {datatype!r}, but a recording with radalt:scene holds cf32_le; if it was "
            "converted, remove radalt:scene and name the sweep with --scene"
        )
    if abs(rate_hz / scene.waveform.rate_hz - 1) > 1e-9:
        raise RecordingError(
            f"{meta}: core:sample_rate is {rate_hz:g}, but its radalt:scene was recorded at "
            f"{scene.waveform.rate_hz:g} S/s; if it was resampled, remove radalt:scene and name the sweep with --scene"
        )
