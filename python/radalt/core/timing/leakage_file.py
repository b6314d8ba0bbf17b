"""Stored calibrations of the leakage: YAML files, and the canceller that a scene names."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np

from ..parsing import InputError, convert, load_yaml, write_yaml
from ..paths import share_dir
from ..waveform import Waveform
from .leakage import SHAPES, LeakageCalibration, LeakageCanceller

__all__ = ["UNCALIBRATED", "leakage_canceller", "leakage_path", "load_leakage", "store_leakage"]

UNCALIBRATED = "uncalibrated"  # name that stands for a fit to every frame
_KEYS = {"waveform", "installation_delay_m", "up", "down"}
_FARTHEST_M = 100.0  # longer than any aircraft's cables
_LARGEST = 1e9  # of a coefficient, 120 dB above the shipped ones: its power stays far within float32


def store_leakage(calibration: LeakageCalibration, path: Path | str) -> Path:
    """Write a calibration as YAML; returns the file."""
    w = calibration.waveform
    table = {
        "waveform": {f.name: getattr(w, f.name) for f in fields(w)},
        "installation_delay_m": round(float(calibration.installation_delay_m), 4),
    }
    for name, row in zip(("up", "down"), calibration.coefficients, strict=True):
        table[name] = [[float(f"{c.real:.6g}"), float(f"{c.imag:.6g}")] for c in row]
    return write_yaml(path, table, sort_keys=False, default_flow_style=None)


def leakage_path(name: Path | str) -> Path:
    """File of a calibration: a path, or the name of a shipped one."""
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or path.exists():
        return path
    return share_dir() / "flowgraphs" / "calibrations" / f"{name}.yaml"


def load_leakage(name: Path | str, waveform: Waveform) -> LeakageCalibration:
    """A stored calibration by path, or by the name of a shipped one.

    Raises `InputError` if it cannot be read or belongs to another sweep.
    """
    path = leakage_path(name)
    what, remedy = "leakage calibration", "calibrate anew (docs/leakage.md)"
    data = load_yaml(path, what=what, remedy=remedy)
    if not isinstance(data, dict) or set(data) != _KEYS:
        raise InputError(f"{what} {path}: expected the keys {', '.join(sorted(_KEYS))}; {remedy}")
    try:
        own = convert(Waveform, data["waveform"], "waveform")
        delay_m = convert(float, data["installation_delay_m"], "installation_delay_m")
        rows = np.array([[[float(x) for x in pair] for pair in data[half]] for half in ("up", "down")])
        if rows.shape != (2, SHAPES, 2) or not np.abs(rows).max() <= _LARGEST:
            raise ValueError(f"up and down have to hold {SHAPES} pairs of numbers each, up to {_LARGEST:g}")
        if not abs(delay_m) <= _FARTHEST_M:
            raise ValueError(f"installation_delay_m is {delay_m:g}; it has to be within +/-{_FARTHEST_M:g} m")
    except (ValueError, TypeError) as error:
        raise InputError(f"{what} {path}: {error}; {remedy}") from None
    if own != waveform:
        raise InputError(f"{what} {path}: it was measured with another sweep ({own}); {remedy}")
    return LeakageCalibration(own, rows[..., 0] + 1j * rows[..., 1], delay_m)


def leakage_canceller(name: str, waveform: Waveform) -> LeakageCanceller | None:
    """What ``segmenter.leakage_calibration`` names; None for an empty name. Raises InputError as `load_leakage`."""
    if not name:
        return None
    if name == UNCALIBRATED:
        return LeakageCanceller.uncalibrated(waveform)
    return LeakageCanceller(load_leakage(name, waveform))
