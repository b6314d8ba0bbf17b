"""Aircraft trajectories: CSV tracks and ADS-B state vectors, interpolated with velocity and attitude."""

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.constants import foot, g
from scipy.interpolate import PchipInterpolator

from ...parsing import InputError, read_csv
from .geodesy import curvature_radii_m

_MOST_BYTES = 64 << 20  # largest CSV file, bytes: 400,000 state vectors

# column names in use (own files, OpenSky Network state vectors, common track exports), first match wins
COLUMNS = {
    "time": ("time_s", "time", "timestamp"),
    "latitude": ("latitude_deg", "latitude", "lat_deg", "lat"),
    "longitude": ("longitude_deg", "longitude", "lon_deg", "lon", "long", "lng"),
    "altitude": ("altitude_m", "altitude_ft", "alt_m", "alt_ft", "altitude", "alt"),
    "geo": ("geoaltitude", "geo_altitude", "alt_geom"),
    "baro": ("baroaltitude", "baro_altitude", "alt_baro"),
    "aircraft": ("icao24", "hex", "callsign"),
    "onground": ("onground", "on_ground"),
}
# Altitude columns that state their unit, and how columns of flight logs begin, whose altitudes may be in feet
# (OpenSky's own state vectors, which have `velocity`, are metric)
_UNITS = dict.fromkeys(("altitude_m", "alt_m"), "m")
_UNITS |= dict.fromkeys(("altitude_ft", "alt_ft", "alt_baro", "alt_geom"), "ft")
_LOGGED = tuple("gs gspeed ground speed vertical_rate vspeed baro_rate track course heading".split())
_LOGGED += ("kts", "knots", "tas", "ias", "squawk", "flight", "callsign")
_SLOW_M_PER_S = 25.0  # ground speed below which the path angle is no pitch: a rotorcraft rises level
_EMPTY = ("", "nan", "null", "none", "ground")  # cells without a number
_APART_M = 31.0  # largest difference of an altitude in metres and in feet, m: one is in hundreds of feet


class TrajectoryError(InputError):
    """A trajectory file or a query into it does not make sense; the message is one line."""


@dataclass(frozen=True)
class AircraftState:
    """Position, velocity and attitude at one instant.

    - ``time_s``, ``latitude_deg``, ``longitude_deg``: time on the trajectory's own clock, and geodetic position
    - ``heading_deg``, ``pitch_deg``, ``roll_deg``: True heading clockwise from north, nose up, right wing down
    """

    time_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_m: float  # altitude of the altimeter's antenna above mean sea level (the datum of the terrain)
    velocity_m_per_s: tuple[float, float, float] = (0.0, 0.0, 0.0)  # (tuple of 3 float): east, north and up
    heading_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0

    def body_axes(self) -> np.ndarray:
        """(3, 3) rows: nose, right wing and belly unit vectors in east, north, up (yaw-pitch-roll order)."""
        yaw, pitch, roll = np.radians([self.heading_deg, self.pitch_deg, self.roll_deg])
        sy, cy = np.sin(yaw), np.cos(yaw)
        sp, cp = np.sin(pitch), np.cos(pitch)
        sr, cr = np.sin(roll), np.cos(roll)
        nose = np.array([sy * cp, cy * cp, sp])
        wing = np.array([sy * sp * sr + cy * cr, cy * sp * sr - sy * cr, -cp * sr])
        return np.stack([nose, wing, np.cross(nose, wing)])


@dataclass(frozen=True)
class Trajectory:
    """A track through given points, interpolated so that the velocity is continuous and nothing overshoots.

    Latitude, longitude and altitude are piecewise cubic Hermite polynomials with monotone slopes (F. N. Fritsch and
    R. E. Carlson, SIAM J. Numer. Anal. 17(2), 1980), so a flare never dips below its points. Velocity is the
    derivative on the ellipsoid; heading follows the track, pitch is the path angle plus the angle of attack, and roll
    that of a coordinated turn, ``tan(roll) = V d(track)/dt / g``.

    - ``time_s``, ``latitude_deg``, ``longitude_deg``, ``altitude_m`` (n,) float: points, n >= 4, times strictly
      increasing; altitudes above mean sea level
    - ``max_speed_m_per_s``, ``max_vertical_speed_m_per_s``: largest speed over ground, and vertical speed, from one
      point to the next

    Raises `TrajectoryError` if there are too few points, time runs backwards or is no seconds, a gap is too long, or
    a position or speed is impossible.
    """

    time_s: np.ndarray
    latitude_deg: np.ndarray
    longitude_deg: np.ndarray
    altitude_m: np.ndarray
    angle_of_attack_deg: float = 5.0
    """Added to the path angle; airliners fly a 3 degree approach nose up by about 2."""
    max_gap_s: float = 15.0  # longest step between points that is interpolated across
    max_speed_m_per_s: float = 700.0
    max_vertical_speed_m_per_s: float = 60.0
    source: str = "trajectory"  # file name, for messages

    def __post_init__(self) -> None:
        t = np.asarray(self.time_s, dtype=float)
        if t.size < 4:
            raise TrajectoryError(f"{self.source}: {t.size} usable points; a trajectory needs at least 4")
        limits = {"time_s": np.inf, "latitude_deg": 89.0, "longitude_deg": 360.0, "altitude_m": 1e5}
        for name, most in limits.items():
            values = np.asarray(getattr(self, name), dtype=float)
            if values.shape != t.shape or not np.isfinite(values).all():
                raise TrajectoryError(
                    f"{self.source}: {name} has to hold {t.size} finite numbers, one per point"
                )
            if np.abs(values).max() > most:
                raise TrajectoryError(f"{self.source}: {name} has to be within +/-{most:g}")
            object.__setattr__(self, name, values)
        step = np.diff(t)
        if np.any(step <= 0):
            k = int(np.argmax(step <= 0))
            raise TrajectoryError(
                f"{self.source}: time goes from {t[k]:g} s to {t[k + 1]:g} s at point {k + 2}; "
                f"{'leave one of them out' if step[k] == 0 else 'sort the rows by time'}"
            )
        meridian, prime = curvature_radii_m(self.latitude_deg[1:])
        east = prime * np.cos(np.radians(self.latitude_deg[1:])) * np.radians(np.diff(self._longitude_deg))
        moved = np.hypot(meridian * np.radians(np.diff(self.latitude_deg)), east)
        # 300 m/s by a clock of milliseconds is 0.3 m/s, at which nothing flies a kilometre; 1e11 s is the year 5138
        slow = moved.sum() < 0.3 * (t[-1] - t[0]) and (moved.sum() > 1e3 or np.median(step) > self.max_gap_s)
        fast = np.median(step) < 1.0 and np.median(moved / step) > self.max_speed_m_per_s
        if slow or fast or t[0] > 1e11:
            raise TrajectoryError(
                f"{self.source}: from {t[0]:.12g} to {t[1]:.12g} it moves {moved[0]:.3g} m, so the times look like "
                f"{'minutes or hours' if fast else 'milliseconds'}; give seconds"
            )
        if step.max() > self.max_gap_s:
            k = int(np.argmax(step))
            raise TrajectoryError(
                f"{self.source}: no points for {step[k]:.3g} s after t = {t[k]:g} s, more than max_gap_s = "
                f"{self.max_gap_s:g} s; cut the file there or raise max_gap_s"
            )
        climbed = np.abs(np.diff(self.altitude_m))
        for name, way in {"max_speed_m_per_s": moved, "max_vertical_speed_m_per_s": climbed}.items():
            # over a second at least, since positions and altitudes are rounded
            rate, limit = way / np.maximum(step, 1.0), getattr(self, name)
            if rate.max() > limit:
                k = int(np.argmax(rate))
                raise TrajectoryError(
                    f"{self.source}: {rate[k]:.0f} m/s from t = {t[k]:.12g} s to point {k + 2}, t = {t[k + 1]:.12g} s, "
                    f"more than {name} = {limit:g}; leave the wrong row out, or raise the limit"
                )
        steep = climbed / np.maximum(moved, _SLOW_M_PER_S * np.maximum(step, 1.0))
        if steep.max() > 1.0:
            k = int(np.argmax(steep))
            raise TrajectoryError(
                f"{self.source}: {climbed[k]:.0f} m up or down over {moved[k]:.3g} m of ground from t = {t[k]:.12g} s "
                f"to point {k + 2}, steeper than 45 degrees; leave the wrong row out"
            )

    @classmethod
    def load(
        cls,
        path: Path | str,
        *,
        aircraft: str | None = None,
        altitude: str | None = None,
        altitude_unit: str | None = None,
        altitude_offset_m: float = 0.0,
        **settings: float,
    ) -> "Trajectory":
        """Read a track from CSV; lines beginning with ``#`` are comments.

        The columns distinguish a plain track (time, latitude, longitude, altitude_m or altitude_ft) from ADS-B state
        vectors of the OpenSky Network (time, icao24, lat, lon, velocity, heading, vertrate, onground, baroaltitude,
        geoaltitude; metres, seconds) and of receivers (alt_baro, alt_geom; feet). State vectors on the ground,
        without position or altitude, or with the position of the row before (stale) are left out.

        All else is as of `core.returns.landing.TrajectorySpec`. An altitude without a unit in its name is in metres,
        and refused in a flight log (`_LOGGED`). What is added to GNSS altitudes is minus the geoid undulation (+34 m
        around Chicago), and to barometric ones the pressure correction.

        Raises `TrajectoryError`: as the class, and if the file cannot be read, lacks a column, or holds several
        aircraft.
        """
        path = Path(path)
        try:
            rows, names = read_csv(path, most_bytes=_MOST_BYTES, what="trajectory file")
        except InputError as error:
            raise TrajectoryError(str(error)) from None
        column = {key: next((n for n in options if n in names), None) for key, options in COLUMNS.items()}
        for name, value, allowed in (("", altitude, ("geo", "baro")), ("_unit", altitude_unit, ("m", "ft"))):
            if value not in (None, *allowed):
                raise TrajectoryError(
                    f"trajectory.altitude{name} is {value!r}; allowed: {', '.join(allowed)}"
                )
        height = column[altitude] if altitude else column["altitude"] or column["geo"] or column["baro"]
        missing = [k for k in ("time", "latitude", "longitude") if column[k] is None]
        missing += [] if height else [f"altitude: {altitude}" if altitude else "altitude"]
        if missing:
            wanted = {min(COLUMNS[k], key=len): COLUMNS[k][0] for k in missing if k in COLUMNS}
            other = (
                f"; convert {n} to {own}"
                for stem, own in wanted.items()
                for n in names
                if n.startswith(stem) and "agl" not in n
            )
            raise TrajectoryError(
                f"{path.name}: no column for {', '.join(missing)}; found {', '.join(sorted(names))}{next(other, '')}"
            )
        metres = foot if _unit(path, height, names, altitude_unit) == "ft" else 1.0
        rows = _one_aircraft(path, rows, column["aircraft"], aircraft)
        points = np.array(_usable(path, rows, column, height), dtype=float).reshape(-1, 4).T
        height_m = points[3] * metres + altitude_offset_m
        return cls(*points[:3], height_m, source=path.name, **settings)

    @property
    def start_s(self) -> float:
        """First instant."""
        return float(self.time_s[0])

    @property
    def end_s(self) -> float:
        """Last instant."""
        return float(self.time_s[-1])

    @cached_property
    def _longitude_deg(self) -> np.ndarray:
        """(n,) longitudes without a step at the 180 degree meridian."""
        return np.unwrap(self.longitude_deg, period=360.0)

    @cached_property
    def _position(self) -> PchipInterpolator:
        points = np.stack([self.latitude_deg, self._longitude_deg, self.altitude_m], axis=1)
        return PchipInterpolator(self.time_s, points)

    def _velocity(self, time_s: np.ndarray) -> np.ndarray:
        """(n, 3) east, north, up velocities."""
        lat, _, altitude = self._position(time_s).T
        dlat, dlon, dalt = self._position(time_s, 1).T
        meridian, prime = curvature_radii_m(lat)
        east = (prime + altitude) * np.cos(np.radians(lat)) * np.radians(dlon)
        return np.stack([east, (meridian + altitude) * np.radians(dlat), dalt], axis=1)

    def states(self, time_s: np.ndarray) -> list[AircraftState]:
        """States at (n,) instants within ``start_s..end_s``.

        Raises `TrajectoryError` if an instant lies outside the trajectory.
        """
        time_s = np.atleast_1d(np.asarray(time_s, dtype=float))
        outside = (time_s < self.start_s) | (time_s > self.end_s)
        if outside.any():
            raise TrajectoryError(
                f"{self.source}: t = {time_s[outside][0]:g} s is outside {self.start_s:g}..{self.end_s:g} s"
            )
        position, velocity = self._position(time_s), self._velocity(time_s)
        ground = np.hypot(velocity[:, 0], velocity[:, 1])
        track = np.arctan2(velocity[:, 0], velocity[:, 1])
        # turn rate by a central difference of the track over 2 s: reported points carry jitter
        before = self._velocity(np.clip(time_s - 1.0, self.start_s, self.end_s))
        after = self._velocity(np.clip(time_s + 1.0, self.start_s, self.end_s))
        span = np.clip(time_s + 1.0, None, self.end_s) - np.clip(time_s - 1.0, self.start_s, None)
        cross = before[:, 1] * after[:, 0] - before[:, 0] * after[:, 1]
        turn = np.arctan2(cross, np.sum(before[:, :2] * after[:, :2], axis=1)) / span
        roll = np.degrees(np.arctan(ground * turn / g))
        forward = np.maximum(ground, _SLOW_M_PER_S)
        pitch = np.degrees(np.arctan2(velocity[:, 2], forward)) + self.angle_of_attack_deg
        longitude = (position[:, 1] + 180.0) % 360.0 - 180.0
        heading = np.degrees(track) % 360.0
        table = np.column_stack([time_s, position[:, 0], longitude, position[:, 2], heading, pitch, roll])
        return [
            AircraftState(*row[:4], tuple(v), *row[4:])
            for row, v in zip(table.tolist(), velocity.tolist(), strict=True)
        ]

    def state(self, time_s: float) -> AircraftState:
        """`states` of one instant."""
        return self.states(np.array([time_s]))[0]


def _unit(path: Path, column: str, names: list[str], given: str | None) -> str:
    """``m`` or ``ft``, of an altitude column."""
    stated = _UNITS.get(column)
    if stated and given not in (None, stated):
        raise TrajectoryError(f"{path.name}: {column} is in {stated}, altitude_unit is {given}; leave it out")
    logged = sorted(name for name in names if name.startswith(_LOGGED))
    if not (stated or given) and logged and "velocity" not in names:
        raise TrajectoryError(
            f"{path.name}: column {column} may be in feet or metres, as the file has {', '.join(logged)}; "
            "give trajectory.altitude_unit: ft, or m"
        )
    return stated or given or "m"


def _one_aircraft(
    path: Path, rows: list[dict[str, str]], column: str | None, wanted: str | None
) -> list[dict[str, str]]:
    named = [row[column].strip().lower() if column else "" for row in rows]
    seen = [name or "(none)" for name, _ in Counter(named).most_common()]
    listed = "no column of aircraft"
    if column:
        listed = f"{len(seen)} aircraft in column {column} ({', '.join(seen[:8])})"
    if wanted is None:
        if len(seen) > 1:
            raise TrajectoryError(f"{path.name}: {listed}; choose one: aircraft=")
        return rows
    if wanted.strip().lower() not in named:
        raise TrajectoryError(f"{path.name}: no aircraft {wanted!r}; it has {listed}")
    return [row for row, name in zip(rows, named, strict=True) if name == wanted.strip().lower()]


def _usable(
    path: Path, rows: list[dict[str, str]], column: dict[str, str | None], height: str
) -> list[list[float]]:
    """Points (time, latitude, longitude, altitude) of rows that are in the air, complete and not stale."""
    kept: list[list[float]] = []
    names = [column["time"], column["latitude"], column["longitude"], height]
    state_vectors = height in COLUMNS["geo"] + COLUMNS["baro"]
    for number, row in enumerate(rows, start=1):
        cells = [(row[name] or "").strip() for name in names]
        grounded = column["onground"] and row[column["onground"]].strip().lower() in ("true", "1", "t")
        if grounded or any(cell.lower() in _EMPTY for cell in cells):
            continue
        both = {name: row.get(name, "").strip() for name in COLUMNS["altitude"] if name in _UNITS}
        both = {name: cell for name, cell in both.items() if height in both and cell.lower() not in _EMPTY}
        try:
            point = [float(cell) for cell in cells]
            metres = [float(cell) * (foot if _UNITS[name] == "ft" else 1.0) for name, cell in both.items()]
        except ValueError as error:
            raise TrajectoryError(f"{path.name}: data row {number}: {error}; give numbers") from error
        if both and max(metres) - min(metres) > _APART_M:
            said = " and ".join(f"{name} {cell}" for name, cell in both.items())
            raise TrajectoryError(f"{path.name}: data row {number}: {said} are two altitudes; leave one")
        if not (state_vectors and kept and kept[-1][1:3] == point[1:3]):
            kept.append(point)
    return kept
