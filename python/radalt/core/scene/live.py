"""Displays of a live view: the range profile with its threshold, and a strip of altitudes."""

import dataclasses
from typing import Any

import numpy as np

from ..altimeter.altimeter import Altimeter, AltimeterSettings, Spectra
from ..channel.settings import DropSettings
from ..waveform import Waveform
from .scene import Scene

_FLOOR_DB = -200.0  # value shown for zero power, dB


def by_hand(scene: Scene) -> Scene:
    """The scene for a flowgraph without end whose altitude a person sets, up to the highest that is searched.

    There is one preamble (altitude zero, jammer silent). Lost samples and the jammer's clock drift are off, since the
    simulated channel needs the length of the run for them; leakage, since a beat shift would move it with the return.
    """
    still: Any = {"mode": "synthetic", "vertical_speed_m_per_s": 0.0, "sync_every_frames": 0}
    altitude = dataclasses.replace(scene.altitude, **still, hold_last=True)
    off: Any = {"drops": DropSettings(), "jammer_clock_ppm": 0.0, "leakage_db": None, "gear_db": None}
    channel = dataclasses.replace(scene.channel, **off)
    segmenter = dataclasses.replace(scene.segmenter, leakage_calibration="")
    altimeter = scene.altimeter.resolved(scene.waveform, vertical_speed_m_per_s=0.0)
    parts: Any = {"altitude": altitude, "channel": channel, "segmenter": segmenter, "altimeter": altimeter}
    return dataclasses.replace(scene, **parts, return_model="point", landing=None)


class RangeProfile:
    """Beat spectrum and CFAR threshold of frames in decibels, at ``points`` from altitude 0 to the highest searched.

    The profile is the mean power of both half sweeps, 0 dB being a return of unit amplitude. The threshold drawn is
    ``profile - 10 log10(r / r_T)``. ``r`` is the power over noise at which two equal half sweeps have the joint
    significance found; ``r_T`` is the power over noise at the altimeter's joint threshold. The profile therefore
    exceeds the threshold where the joint significance exceeds the altimeter's threshold (a target without Doppler).

    This is the altimeter's first test. Its further tests of the detected cell are not drawn: a higher level where the
    cells beyond the span have less power, a lower threshold for continuous noise, and a level without the return's side
    lobes (`PairSearch`).

    >>> from radalt.core.returns.point import point_return
    >>> w = Waveform()
    >>> profile = RangeProfile(w)
    >>> power_db, _ = profile.process(point_return(w, np.array([300.0])))
    >>> bool(abs(profile.altitude_m[power_db[0].argmax()] - 300.0) < 10.0)
    True
    """

    def __init__(
        self,
        waveform: Waveform,
        settings: AltimeterSettings = AltimeterSettings(),  # noqa: B008 - frozen
        points: int = 512,
    ) -> None:
        if points < 2:
            raise ValueError(f"range_profile.points is {points}; it has to be at least 2")
        self.altimeter = Altimeter(waveform, settings)
        top_m = self.altimeter.settings.max_altitude_m
        assert top_m is not None  # resolved
        self.altitude_m = np.linspace(0.0, top_m, points)
        margin = self.altimeter.cfar.margin
        cells_hz = self.altimeter.beat_hz[margin:-margin]
        at = (waveform.altitude_to_beat_hz(self.altitude_m) - cells_hz[0]) / self.altimeter.cell_hz
        self._cell = np.clip(at.astype(int), 0, cells_hz.size - 2)
        self._part = at - self._cell
        self._unit_db = self._power_db(self.altimeter.spectra(waveform.reference[None])).max()

    def process(self, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Profile and threshold of ``(n, N)`` frames: two (n, points) float32 arrays in dB."""
        spectra = self.altimeter.spectra(frames)
        cells = self.altimeter.significance(spectra)
        # joint significance K log(1 + r/K) of two equal half sweeps, solved for the power over noise r
        looks = 2.0 * cells.looks.mean(axis=1, keepdims=True)
        ratio = np.expm1(cells.value.sum(axis=1) / looks)
        needed = np.expm1((self.altimeter.pair_threshold - cells.uncounted[:, None]) / looks)
        profile = self._power_db(spectra) - self._unit_db
        with np.errstate(divide="ignore", invalid="ignore"):
            threshold = profile - 10.0 * np.log10(ratio / needed)
        return self._resample(profile), self._resample(threshold)

    def _power_db(self, spectra: Spectra) -> np.ndarray:
        """(n, cells) mean power of both half sweeps, without the margin of the CFAR."""
        margin = self.altimeter.cfar.margin
        power = spectra.power[..., margin:-margin].mean(axis=1, dtype=float)
        with np.errstate(divide="ignore", invalid="ignore"):
            return 10.0 * np.log10(power * spectra.scale[:, None].astype(float) ** 2)

    def _resample(self, cells_db: np.ndarray) -> np.ndarray:
        """(n, points) values interpolated between cells; non-finite ones become `_FLOOR_DB`."""
        cells_db = np.where(np.isfinite(cells_db), cells_db, _FLOOR_DB)
        left, right = cells_db[:, self._cell], cells_db[:, self._cell + 1]
        return (left + self._part * (right - left)).astype(np.float32)


class AltitudeStrip:
    """The last seconds of several altitudes, rolling: ``points`` values per trace, the newest last.

    A value is that of one frame in ``every``: the others are dropped, never averaged, so that an error stays visible.
    """

    def __init__(self, traces: int, points: int = 512, every: int = 20) -> None:
        if min(traces, points, every) < 1:
            raise ValueError(
                f"altitude_strip.traces {traces}, points {points} and every {every} have to be at least 1"
            )
        self._rows = np.full((traces, points), np.nan, dtype=np.float32)
        self._every, self._seen = every, 0

    def push(self, altitudes_m: np.ndarray) -> int:
        """Append ``(traces, n)`` altitudes of n frames; returns the number of new values per row."""
        first = -self._seen % self._every
        self._seen += altitudes_m.shape[1]
        taken = altitudes_m[:, first :: self._every][:, -self._rows.shape[1] :]
        count = taken.shape[1]
        if count:
            self._rows[:, :-count] = self._rows[:, count:].copy()
            self._rows[:, self._rows.shape[1] - count :] = taken
        return count

    @property
    def rows(self) -> np.ndarray:
        """(traces, points) float32 in metres, NaN where there was no detection; a view, valid until the next `push`."""
        return self._rows
