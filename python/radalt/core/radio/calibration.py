"""Loopback calibration: the fixed latency between transmitter and receiver, by radio, master clock and rate.

A radio's latency is the same at every start with a common start time, and depends on the radio, its master clock and
its rate. It is measured once with a direct cable (and attenuators) from TX to RX and stored. Every later measurement
subtracts it, so that the path outside the radio remains.

The file maps ``<type>/<serial>/<master clock>/<rate>`` to samples.
"""

import os
from dataclasses import dataclass
from pathlib import Path

from ..parsing import InputError, load_yaml, write_yaml

_MOST_SAMPLES = 1e9  # largest magnitude of a latency, samples: two minutes at 7.5 MS/s


class CalibrationError(ValueError):
    """A calibration that cannot be read or does not fit; the message is one line for the user."""


@dataclass(frozen=True)
class CalibrationKey:
    """Radio, master clock and rate to which a latency belongs."""

    device_type: str  # type that the radio reports (``B210``)
    serial: str  # serial number; empty where the radio reports none, and then nothing is stored or found
    master_clock_hz: float
    rate_hz: float

    def __str__(self) -> str:
        return f"{self.device_type}/{self.serial}/{self.master_clock_hz:.0f}/{self.rate_hz:.0f}"


def calibration_path() -> Path:
    """``gr-radalt/calibration.yaml`` in the user's configuration folder (``XDG_CONFIG_HOME``, ``~/.config``)."""
    base = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(base) / "gr-radalt" / "calibration.yaml"


def _latency(value: object) -> bool:
    """Whether a value can be a latency: a finite number of samples within `_MOST_SAMPLES`."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= _MOST_SAMPLES


def _read(path: Path) -> dict[str, float]:
    if not path.exists():
        return {}
    try:
        data = load_yaml(path, what="calibration") or {}
    except InputError as error:
        raise CalibrationError(f"{error}; repair it or calibrate anew") from None
    table = data.get("latency_samples") if isinstance(data, dict) else None
    if not isinstance(table, dict) or not all(_latency(v) for v in table.values()):
        raise CalibrationError(
            f"calibration {path}: expected 'latency_samples' with numbers by '<type>/<serial>/<master clock>/<rate>'; "
            "calibrate anew"
        )
    return {str(k): float(v) for k, v in table.items()}


def load_latency_samples(key: CalibrationKey, path: Path | str | None = None) -> float | None:
    """Stored latency in samples, fraction included; None without a calibration of this radio, clock and rate.

    Raises `CalibrationError` if the file exists but cannot be used.
    """
    table = _read(Path(path) if path else calibration_path())
    return table.get(str(key)) if key.serial else None


def store_latency_samples(
    latency_samples: float, key: CalibrationKey, path: Path | str | None = None
) -> Path:
    """Store a latency next to the others; returns the file.

    Raises `CalibrationError` if the radio has no serial number, or the file exists but cannot be used.
    """
    if not key.serial:
        raise CalibrationError(
            f"calibration: this {key.device_type} reports no serial number; set radio.radar_serial in the scene"
        )
    path = Path(path) if path else calibration_path()
    table = _read(path) | {str(key): round(float(latency_samples), 6)}
    return write_yaml(path, {"latency_samples": table})
