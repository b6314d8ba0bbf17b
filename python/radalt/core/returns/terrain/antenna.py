"""Antenna patterns: a Gaussian beam in closed form, or any pattern from a file; one-way power gains."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from ...parsing import Settings, read_csv, setting

_MOST_BYTES = 16 << 20  # largest pattern file, bytes: a sphere in steps of half a degree


@dataclass(frozen=True)
class GaussianAntenna(Settings, where="antenna"):
    """Beam whose gain in decibels falls with the square of the angle: ``G = G0 - 12 (theta / beamwidth)^2`` dB."""

    beamwidth_deg: float = setting(40.0, 0.01, 120.0)
    """Full width between the -3 dB points. Rec. ITU-R M.2059 gives 40..60 degrees."""
    gain_dbi: float = setting(10.0, -20.0, 40.0)  # peak one-way gain
    two_way: bool = False
    """False: the width is that of one antenna (one-way), so transmit and receive together are 3 dB down at
    ``beamwidth / (2 sqrt 2)`` off boresight. True: the width is that of both together."""

    @property
    def one_way_beamwidth_rad(self) -> float:
        """Full one-way -3 dB width in radians."""
        return float(np.radians(self.beamwidth_deg)) * (np.sqrt(2.0) if self.two_way else 1.0)

    def gain(self, angle_rad: np.ndarray, azimuth_rad: np.ndarray) -> np.ndarray:
        """One-way power gain (linear, over isotropic) off boresight; azimuth from nose to right wing."""
        exponent = -4.0 * np.log(2.0) * (np.asarray(angle_rad) / self.one_way_beamwidth_rad) ** 2
        return 10.0 ** (self.gain_dbi / 10.0) * np.exp(exponent)

    def footprint_rad(self, drop_db: float) -> float:
        """Angle off boresight beyond which the two-way gain stays ``drop_db`` below its peak."""
        two_way_db = 20.0 * np.log10(2.0)  # 6.02 dB two-way at half the one-way width
        return float(0.5 * self.one_way_beamwidth_rad * np.sqrt(drop_db / two_way_db))


@dataclass(frozen=True)
class TabulatedAntenna:
    """Pattern from a table, linear in decibels between its points, held constant beyond the last angle."""

    angle_deg: np.ndarray  # (n,) float: angles off boresight, increasing from 0
    gain_dbi: np.ndarray  # (n, m) float: one-way gain by angle and azimuth
    azimuth_deg: np.ndarray
    """(m,) float: azimuths from the nose to the right wing, increasing within 0..360; a single one means
    symmetric."""

    @classmethod
    def load(cls, path: Path | str) -> "TabulatedAntenna":
        """Read a CSV file with columns ``angle_deg,gain_dbi`` or ``angle_deg,azimuth_deg,gain_dbi``.

        ``elevation_deg``, up from the horizon, may stand for ``angle_deg``, which then counts from the zenith. Lines
        beginning with ``#`` are comments. With azimuths, every angle needs every azimuth.

        Raises `ValueError` if the file, a column, a number or a point of the grid is missing.
        """
        path = Path(path)
        rows, names = read_csv(path, most_bytes=_MOST_BYTES, what="antenna file")
        elevation = "elevation_deg" in names and "angle_deg" not in names
        if not {"elevation_deg" if elevation else "angle_deg", "gain_dbi"} <= set(names):
            raise ValueError(
                f"antenna file {path} needs the columns angle_deg and gain_dbi (and azimuth_deg)"
            )
        points: dict[tuple[float, float], float] = {}
        for number, r in enumerate(rows, 1):
            try:
                angle = 90.0 - float(r["elevation_deg"]) if elevation else float(r["angle_deg"])
                place = angle, float(r.get("azimuth_deg") or 0.0) % 360.0
                gain_dbi = float(r["gain_dbi"])
            except (TypeError, ValueError) as error:
                raise ValueError(f"antenna file {path}: {error}; every cell has to be a number") from error
            if not (0 <= place[0] <= 180 and -200 <= gain_dbi <= 100 and np.isfinite(place[1])):
                said = f"row {number} is {place[0]:g} degrees, {gain_dbi:g} dBi; within 0..180, -200..100"
                raise ValueError(f"antenna file {path}: {said}")
            if place in points:
                raise ValueError(
                    f"antenna file {path}: row {number} gives angle {place[0]:g} again; leave one"
                )
            points[place] = gain_dbi
        angles, azimuths = sorted({a for a, _ in points}), sorted({z for _, z in points})
        absent = [(a, z) for a in angles for z in azimuths if (a, z) not in points]
        if absent or len(angles) < 2 or angles[0] != 0.0:
            hint = (
                f"angle {absent[0][0]:g} azimuth {absent[0][1]:g} deg is missing"
                if absent
                else "angles start at 0 (elevations at 90)"
            )
            raise ValueError(f"antenna file {path}: {hint}; give at least two angles and the whole grid")
        table = np.array([[points[a, z] for z in azimuths] for a in angles])
        return cls(np.array(angles), table, np.array(azimuths))

    def gain(self, angle_rad: np.ndarray, azimuth_rad: np.ndarray) -> np.ndarray:
        """See `GaussianAntenna`."""
        angle = np.clip(np.degrees(angle_rad), self.angle_deg[0], self.angle_deg[-1])
        if self.azimuth_deg.size == 1:
            return 10.0 ** (np.interp(angle, self.angle_deg, self.gain_dbi[:, 0]) / 10.0)
        start = self.azimuth_deg[0]  # wrap the azimuth axis once around
        wrapped = np.append(self.azimuth_deg, start + 360.0)
        table = np.concatenate([self.gain_dbi, self.gain_dbi[:, :1]], axis=1)
        azimuth = start + np.mod(np.degrees(azimuth_rad) - start, 360.0)
        gain_dbi = RegularGridInterpolator((self.angle_deg, wrapped), table)
        return 10.0 ** (gain_dbi(np.stack(np.broadcast_arrays(angle, azimuth), axis=-1)) / 10.0)

    def footprint_rad(self, drop_db: float) -> float:
        """See `GaussianAntenna`."""
        best = self.gain_dbi.max(axis=1)
        above = np.nonzero(2.0 * (best - best.max()) > -drop_db)[0]
        return float(np.radians(self.angle_deg[min(above[-1] + 1, self.angle_deg.size - 1)]))


Antenna = GaussianAntenna | TabulatedAntenna
