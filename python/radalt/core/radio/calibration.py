"""Loopback calibration: the fixed latency between transmitter and receiver, by (master clock, rate).

A B210's latency is the same at every start with a common start time, and depends on master clock and rate only. It is
measured once with a direct cable (and attenuators) from TX to RX, stored, and subtracted from every later measurement,
so that what remains is the path outside the radio.
"""

from __future__ import annotations

import os
from pathlib import Path

from ..parsing import InputError, load_yaml

__all__ = ["CalibrationError", "calibration_path", "load_latency_samples", "store_latency_samples"]


_MOST_SAMPLES = 1e9


class CalibrationError(ValueError):
    """A calibration that cannot be read or does not fit; the message is one line for the user."""


def calibration_path() -> Path:
    """``gr-radalt/calibration.yaml`` in the user's configuration folder (``XDG_CONFIG_HOME``, ``~/.config``)."""
    base = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(base) / "gr-radalt" / "calibration.yaml"


def _key(master_clock_hz: float, rate_hz: float) -> str:
    return f"{master_clock_hz:.0f}/{rate_hz:.0f}"


def _latency(value: object) -> bool:
    """Whether it can be a latency: a finite number of samples, within seconds."""
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
            f"calibration {path}: expected 'latency_samples' with numbers by '<master clock>/<rate>'; calibrate anew"
        )
    return {str(k): float(v) for k, v in table.items()}


def load_latency_samples(
    master_clock_hz: float, rate_hz: float, path: Path | str | None = None
) -> float | None:
    """Stored latency in samples, fraction included; None where this pair was never calibrated.

    Raises
    ------
    CalibrationError
        If the file exists but cannot be used.
    """
    table = _read(Path(path) if path else calibration_path())
    return table.get(_key(master_clock_hz, rate_hz))


def store_latency_samples(
    latency_samples: float, master_clock_hz: float, rate_hz: float, path: Path | str | None = None
) -> Path:
    """Store a latency beside those of other pairs; returns the file."""
    import yaml

    path = Path(path) if path else calibration_path()
    table = _read(path) | {_key(master_clock_hz, rate_hz): round(float(latency_samples), 6)}
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_suffix(".new")
    new.write_text(yaml.safe_dump({"latency_samples": table}), encoding="utf-8")
    new.replace(path)
    return path
