"""Terrain heights: DTED cells with bilinear interpolation between posts, and an analytic flat earth."""

import struct
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...parsing import InputError, check_file
from ...paths import extra
from .geodesy import curvature_radii_m

VOID_M = -32767  # elevation that marks a post without data (MIL-PRF-89020B, 3.11.2)
# below it a post is a negative in two's complement, which some producers write for sign and size
_DEEPEST_M = -12000
_MOST_BYTES = 64 << 20  # largest DTED file, bytes: level 2 has 26 MB


class TerrainError(InputError):
    """Terrain is missing, void, not readable, or above the aircraft; the message is one line."""


@dataclass(frozen=True)
class FlatTerrain:
    """Constant height above mean sea level, everywhere."""

    elevation_m: float = 0.0

    def height_m(self, latitude_deg: np.ndarray, longitude_deg: np.ndarray) -> np.ndarray:
        """Heights above mean sea level in metres, same shape as the broadcast arguments."""
        return np.full(np.broadcast(latitude_deg, longitude_deg).shape, float(self.elevation_m))

    def height_and_slope(
        self, latitude_deg: np.ndarray, longitude_deg: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Heights in metres, and their slopes towards east and north (metres per metre)."""
        height = self.height_m(latitude_deg, longitude_deg)
        return height, np.zeros_like(height), np.zeros_like(height)


@dataclass(frozen=True)
class DtedCell:
    """Posts of one DTED file.

    ``south_deg``, ``west_deg``: Corner of the south-west post; ``step_lat_deg``, ``step_lon_deg``: post spacing.
    """

    south_deg: float
    west_deg: float
    step_lat_deg: float
    step_lon_deg: float
    elevation_m: np.ndarray  # (n_lon, n_lat) float: Elevations above mean sea level; NaN marks a void
    source: str = ""  # file name, for messages

    @property
    def north_deg(self) -> float:
        """Northern edge."""
        return self.south_deg + (self.elevation_m.shape[1] - 1) * self.step_lat_deg

    @property
    def east_deg(self) -> float:
        """Eastern edge."""
        return self.west_deg + (self.elevation_m.shape[0] - 1) * self.step_lon_deg

    @classmethod
    def load(cls, path: Path | str, *, void: str = "error") -> "DtedCell":
        """Read a DTED file of level 0, 1 or 2 through the `dted` library; ``void``: ``"error"`` or ``"fill"``.

        A query that needs a void raises, unless voids are filled from the nearest post that has data. Raises
        `TerrainError` if the file is missing, damaged (header, length or checksum), or holds nothing but voids.
        """
        dted = extra("dted")

        if void not in ("error", "fill"):
            raise TerrainError(f"void policy is {void!r}; allowed: error, fill")
        try:
            path = check_file(path, most_bytes=_MOST_BYTES, what="terrain file")
        except InputError as error:
            raise TerrainError(str(error)) from None
        try:
            tile = dted.Tile(path, warn=False)
        except OSError as error:
            raise TerrainError(f"terrain file {path}: {error.strerror or error}; name a DTED file") from error
        except (dted.errors.InvalidFileError, ValueError, IndexError, struct.error) as error:
            reason = " ".join(str(error).split())
            other = "fetch it again, or convert it (gdal_translate -of DTED)"
            raise TerrainError(f"terrain file {path} is not intact DTED ({reason}); {other}") from error
        posts = np.asarray(tile.data, dtype=float)
        posts[posts == VOID_M] = np.nan
        posts = np.where(posts < _DEEPEST_M, -32768.0 - posts, posts)
        voids = int(np.isnan(posts).sum())
        if voids == posts.size:
            raise TerrainError(f"terrain file {path} holds {voids} voids and no elevation")
        if void == "fill" and voids:
            from scipy.ndimage import distance_transform_edt

            nearest = distance_transform_edt(np.isnan(posts), return_distances=False, return_indices=True)
            posts = posts[tuple(nearest)]
        return cls(
            south_deg=tile.dsi.south_west_corner.latitude,
            west_deg=tile.dsi.south_west_corner.longitude,
            step_lat_deg=tile.dsi.latitude_interval / 3600.0,
            step_lon_deg=tile.dsi.longitude_interval / 3600.0,
            elevation_m=posts,
            source=path.name,
        )

    def inside(self, latitude_deg: np.ndarray, longitude_deg: np.ndarray) -> np.ndarray:
        """Boolean array: the point lies in the cell, edges included."""
        return (
            (latitude_deg >= self.south_deg)
            & (latitude_deg <= self.north_deg)
            & (self._east_of_edge_deg(longitude_deg) <= self.east_deg - self.west_deg)
        )

    def _east_of_edge_deg(self, longitude_deg: np.ndarray) -> np.ndarray:
        """Longitudes from the western edge, 0..360: across the 180 degree meridian as anywhere."""
        return (longitude_deg - self.west_deg) % 360.0

    def interpolate(self, latitude_deg: np.ndarray, longitude_deg: np.ndarray) -> tuple[np.ndarray, ...]:
        """Bilinear height, and its derivatives per degree of longitude and of latitude, of points inside."""
        x = self._east_of_edge_deg(longitude_deg) / self.step_lon_deg
        y = (latitude_deg - self.south_deg) / self.step_lat_deg
        i = np.clip(np.floor(x).astype(np.intp), 0, self.elevation_m.shape[0] - 2)
        j = np.clip(np.floor(y).astype(np.intp), 0, self.elevation_m.shape[1] - 2)
        fx, fy = x - i, y - j
        z = self.elevation_m
        flat = i * z.shape[1] + j
        values = z.ravel()
        z00, z01 = values[flat], values[flat + 1]
        z10, z11 = values[flat + z.shape[1]], values[flat + z.shape[1] + 1]
        west, east = _blend(z00, z01, fy), _blend(z10, z11, fy)
        height = _blend(west, east, fx)
        with np.errstate(invalid="ignore"):
            slope_lon = np.nan_to_num(east - west) / self.step_lon_deg
            slope_lat = np.nan_to_num((z01 - z00) * (1 - fx) + (z11 - z10) * fx) / self.step_lat_deg
        return height, slope_lon, slope_lat


def _blend(a: np.ndarray, b: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """Linear interpolation that ignores an end of no weight (below 1e-9, 0.1 mm), even if it is NaN."""
    mixed = a + (b - a) * fraction
    if not np.isnan(mixed).any():
        return mixed
    return np.where(fraction < 1e-9, a, np.where(fraction > 1 - 1e-9, b, mixed))


@dataclass(frozen=True)
class Terrain:
    """Several DTED cells side by side; on a shared edge the first cell is used.

    Heights between posts are bilinear in latitude and longitude, exact on the posts. A query outside all cells, or
    one that needs a void post, raises `TerrainError`.

    Examples
    --------
    >>> terrain = Terrain.load(["n41_w089.dt0", "n41_w088.dt0"])    # doctest: +SKIP
    >>> terrain.height_m(41.97, -87.93)                             # doctest: +SKIP
    array(204.)
    """

    cells: tuple[DtedCell, ...] = field(default=())

    @classmethod
    def load(cls, paths: Iterable[Path | str], *, void: str = "error") -> "Terrain":
        """Cells of several files; see `DtedCell.load`."""
        cells = tuple(DtedCell.load(path, void=void) for path in paths)
        if not cells:
            raise TerrainError("no terrain file was given; name at least one DTED file")
        return cls(cells)

    def height_m(self, latitude_deg: np.ndarray, longitude_deg: np.ndarray) -> np.ndarray:
        """See `FlatTerrain`."""
        return self.height_and_slope(latitude_deg, longitude_deg)[0]

    def height_and_slope(
        self, latitude_deg: np.ndarray, longitude_deg: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `FlatTerrain`."""
        lat, lon = np.broadcast_arrays(np.asarray(latitude_deg, float), np.asarray(longitude_deg, float))
        shape, lat, lon = lat.shape, lat.ravel(), lon.ravel()
        out = np.full((3, lat.size), np.nan)
        missing = np.ones(lat.size, bool)
        for cell in self.cells:
            take = missing & cell.inside(lat, lon)
            if take.all():
                out[:] = cell.interpolate(lat, lon)
            elif take.any():
                out[:, take] = cell.interpolate(lat[take], lon[take])
            missing &= ~take
            if not missing.any():
                break
        if missing.any():
            self._raise_uncovered(lat[missing][0], lon[missing][0])
        if np.isnan(out[0]).any():
            first = int(np.argmax(np.isnan(out[0])))
            raise TerrainError(
                f"terrain at {lat[first]:.5f}, {lon[first]:.5f} deg is void in the DTED file; "
                "load it with void='fill' or supply a file without the void"
            )
        meridian, prime = curvature_radii_m(lat)
        per_radian = 180.0 / np.pi
        slope_east = out[1] * per_radian / (prime * np.cos(np.radians(lat)))
        slope_north = out[2] * per_radian / meridian
        return out[0].reshape(shape), slope_east.reshape(shape), slope_north.reshape(shape)

    def _raise_uncovered(self, latitude_deg: float, longitude_deg: float) -> None:
        covered = "; ".join(
            f"{c.source or 'cell'}: {c.south_deg:g}..{c.north_deg:g} N, {c.west_deg:g}..{c.east_deg:g} E"
            for c in self.cells
        )
        raise TerrainError(
            f"terrain does not cover {latitude_deg:.5f}, {longitude_deg:.5f} deg "
            f"(it covers {covered or 'nothing'}); add the DTED cell there"
        )


TerrainModel = FlatTerrain | Terrain
