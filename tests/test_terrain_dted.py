"""DTED: written by our code, read back bit-exact by an independent library; heights; defects."""

import dted
import numpy as np
import pytest
from _landing_scenario import cell_posts
from hostile import refused
from make_landing_data import main, write_dted

from radalt.core.returns.terrain import VOID_M, DtedCell, Terrain, TerrainError


def _relief(level: int, lat: int, lon: int, seed: int = 3) -> np.ndarray:
    posts_lat, posts_lon = cell_posts(level, lat, lon)
    rng = np.random.default_rng(seed)
    return rng.integers(-450, 3000, size=(posts_lon.size, posts_lat.size), dtype=np.int16)


@pytest.mark.parametrize(
    ("level", "lat", "lon", "shape"),
    [(0, 41, -88, (121, 121)), (0, -34, 151, (121, 121)), (0, 62, 24, (61, 121)), (1, 41, -88, (1201, 1201))],
)
def test_written_posts_come_back_bit_exact(tmp_path, level, lat, lon, shape):
    relief = _relief(level, lat, lon)
    assert relief.shape == shape
    relief[3, 5], relief[0, 0], relief[-1, -1] = VOID_M, -1, 32766
    path = write_dted(tmp_path / f"cell.dt{level}", relief, lat, lon, level)
    read = dted.Tile(path, warn=False)  # checks every record's checksum and sentinel
    assert np.array_equal(read.data, relief)
    assert read.dsi.south_west_corner == dted.LatLon(lat, lon)
    assert read.dsi.north_east_corner == dted.LatLon(lat + 1, lon + 1)
    assert read.uhl.shape == read.dsi.shape == shape
    assert read.dsi.product_level == f"DTED{level}"
    assert path.stat().st_size == 3428 + shape[0] * (12 + 2 * shape[1])


def test_shipped_files_are_what_the_command_writes(tmp_path, root):
    assert main(["--out", str(tmp_path)]) == 0
    shipped = root / "flowgraphs" / "landing"
    names = sorted(p.name for p in tmp_path.iterdir())
    assert len(names) == 5
    for name in names:
        assert (tmp_path / name).read_bytes() == (shipped / name).read_bytes(), name
    assert "SYNTHETIC" in (shipped / "approach_kord_10c.csv").read_text().splitlines()[0]


def test_height_is_exact_on_posts_and_bilinear_between(tmp_path):
    relief = _relief(0, 41, -88)
    ground = Terrain.load([write_dted(tmp_path / "a.dt0", relief, 41, -88, 0)])
    lat, lon = cell_posts(0, 41, -88)
    assert np.abs(ground.height_m(lat[None, :], lon[:, None]) - relief).max() < 1e-6
    i, j, fx, fy = 17, 88, 0.3, 0.65
    corner = relief[i : i + 2, j : j + 2].astype(float)
    expected = np.array([1 - fx, fx]) @ corner @ np.array([1 - fy, fy])
    height, east, north = ground.height_and_slope(lat[j] + fy / 120, lon[i] + fx / 120)
    assert height == pytest.approx(expected, abs=1e-6)
    # one post is 30 seconds of arc: 925.5 m north, 690 m east at 41.7 degrees
    assert north == pytest.approx((corner[:, 1] - corner[:, 0]) @ [1 - fx, fx] / 925.6, rel=2e-3)
    assert east == pytest.approx((corner[1] - corner[0]) @ [1 - fy, fy] / 691.5, rel=5e-3)


@pytest.mark.parametrize(("west", "east", "edge"), [(-89, -88, -88.0), (179, -180, 180.0)])
def test_neighbouring_cells_answer_across_their_edge(tmp_path, west, east, edge):
    cells = ((west, 100), (east, -32419))  # the second is -349 in two's complement
    posts = [np.full((121, 121), height, np.int16) for _, height in cells]
    files = [write_dted(tmp_path / f"{k}.dt0", posts[k], 41, cells[k][0], 0) for k in (0, 1)]
    lon = edge + np.array([-0.2, 0.1, 360.1, -360.2])
    assert Terrain.load(files).height_m(41.5, lon) == pytest.approx([100, -349, -349, 100])


def test_a_void_post_is_named_or_filled(tmp_path):
    relief = np.full((121, 121), 200, np.int16)
    relief[60, 60] = VOID_M
    path = write_dted(tmp_path / "void.dt0", relief, 41, -88, 0)
    ground = Terrain.load([path])
    assert ground.height_m(41.2, -87.8) == pytest.approx(200.0)  # voids elsewhere do no harm
    lat, lon = cell_posts(0, 41, -88)
    assert ground.height_m(lat[60], lon[59]) == pytest.approx(200.0)  # nor does a void whose weight is zero
    with pytest.raises(TerrainError, match=r"41\.503.*void.*void='fill'"):
        ground.height_m(41.503, -87.497)
    assert Terrain.load([path], void="fill").height_m(41.503, -87.497) == pytest.approx(200.0)


def test_defective_files_get_one_line(tmp_path):
    good = write_dted(tmp_path / "a.dt0", _relief(0, 41, -88), 41, -88, 0)
    data = good.read_bytes()
    cases = {
        "short.dt0": data[:9000],
        "cut.dt0": data[:500],
        "flipped.dt0": data[:5000] + bytes([data[5000] ^ 1]) + data[5001:],
        "other.dt0": b"not terrain at all" * 300,
        "empty.dt0": b"",
    }
    for name, content in cases.items():
        (tmp_path / name).write_bytes(content)
        with refused(TerrainError, name):
            DtedCell.load(tmp_path / name)
    with pytest.raises(TerrainError, match=r"missing\.dt0"):
        DtedCell.load(tmp_path / "missing.dt0")
    nothing = np.full((121, 121), VOID_M, np.int16)
    with pytest.raises(TerrainError, match="no elevation"):
        DtedCell.load(write_dted(tmp_path / "v.dt0", nothing, 41, -88, 0))
