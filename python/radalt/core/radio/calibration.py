"""Loopback calibration: the fixed latency between transmitter and receiver, by radio, master clock and rate.

A radio's latency is the same at every start with a common start time, and depends on the radio, its master clock and
its rate. It is measured once with a direct cable (and attenuators) from TX to RX, stored, and subtracted from every
later measurement, so that what remains is the path outside the radio.

The file maps ``<type>/<serial>/<master clock>/<rate>`` to samples. Entries of earlier versions,
``<master clock>/<rate>``, name no radio: they are kept, and used for none.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

__all__ = [
    "CalibrationError",
    "CalibrationKey",
    "calibration_path",
    "load_latency_samples",
    "store_latency_samples",
]


class CalibrationError(ValueError):
    """A calibration that cannot be read or does not fit; the message is one line for the user."""


@dataclass(frozen=True)
class CalibrationKey:
    """What a latency belongs to.

    Parameters
    ----------
    device_type : str
        What the radio calls itself (``B210``).
    serial : str
        Its serial number; empty where it tells none, and then nothing is stored or found.
    master_clock_hz, rate_hz : float
    """

    device_type: str
    serial: str
    master_clock_hz: float
    rate_hz: float

    def __str__(self) -> str:
        return f"{self.device_type}/{self.serial}/{self.without_radio}"

    @property
    def without_radio(self) -> str:
        """The key of earlier versions, which held for any radio."""
        return f"{self.master_clock_hz:.0f}/{self.rate_hz:.0f}"


def calibration_path() -> Path:
    """``gr-radalt/calibration.yaml`` in the user's configuration folder (``XDG_CONFIG_HOME``, ``~/.config``)."""
    base = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(base) / "gr-radalt" / "calibration.yaml"


def _read(path: Path) -> dict[str, float]:
    import yaml

    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = str(error).splitlines()[0]
        raise CalibrationError(
            f"calibration {path}: cannot be read ({reason}); repair it or calibrate anew"
        ) from None
    table = data.get("latency_samples") if isinstance(data, dict) else None
    if not isinstance(table, dict) or not all(isinstance(v, (int, float)) for v in table.values()):
        raise CalibrationError(
            f"calibration {path}: expected 'latency_samples' with numbers by '<type>/<serial>/<master clock>/<rate>'; "
            "calibrate anew"
        )
    return {str(k): float(v) for k, v in table.items()}


def load_latency_samples(key: CalibrationKey, path: Path | str | None = None) -> float | None:
    """Stored latency in samples, fraction included; None where this radio was never calibrated so.

    Raises
    ------
    CalibrationError
        If the file exists but cannot be used, or holds for this clock and rate nothing but an entry of an earlier
        version, which may be another radio's.
    """
    path = Path(path) if path else calibration_path()
    table = _read(path)
    if key.serial and str(key) in table:
        return table[str(key)]
    if key.without_radio in table:
        raise CalibrationError(
            f"calibration {path}: the entry {key.without_radio!r} names no radio; calibrate anew, or rename it to "
            f"'{key.device_type}/{key.serial or 'SERIAL'}/{key.without_radio}' if it is this one's, or remove it"
        )
    return None


def store_latency_samples(
    latency_samples: float, key: CalibrationKey, path: Path | str | None = None
) -> Path:
    """Store a latency beside the others; returns the file.

    Raises
    ------
    CalibrationError
        If the radio has no serial number, or the file exists but cannot be used.
    """
    import yaml

    if not key.serial:
        raise CalibrationError(
            f"calibration: this {key.device_type} tells no serial number; set radio.radar_serial in the scene"
        )
    path = Path(path) if path else calibration_path()
    table = _read(path) | {str(key): round(float(latency_samples), 6)}
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_suffix(".new")
    new.write_text(yaml.safe_dump({"latency_samples": table}), encoding="utf-8")
    new.replace(path)
    return path
