"""The landing scenario: geodesy, trajectory, terrain, antenna, ground reflectivity, and the radar return.

Nothing here is imported unless a scene asks for terrain.
"""

from .antenna import Antenna, GaussianAntenna, TabulatedAntenna
from .approach import OHARE_10C, Approach, Runway, synthetic_elevation_m
from .dted_cells import VOID_M, cell_posts
from .errors import TerrainError, TrajectoryError
from .facets import MIN_HEIGHT_M, Facets, GroundGrid
from .ground import LAND_TYPES, ConstantGamma, Morchin, Reflectivity, UlabyDobson, reflectivity
from .live import LandingProfile
from .radar_return import GroundReturn, RadarLink, TerrainReturn, ground_return, ground_returns
from .synthesis import synthesise, synthesise_directly
from .terrain import DtedCell, FlatTerrain, Terrain, TerrainModel
from .trajectory import AircraftState, Trajectory

__all__ = [
    "LAND_TYPES",
    "MIN_HEIGHT_M",
    "OHARE_10C",
    "VOID_M",
    "AircraftState",
    "Antenna",
    "Approach",
    "ConstantGamma",
    "DtedCell",
    "Facets",
    "FlatTerrain",
    "GaussianAntenna",
    "GroundGrid",
    "GroundReturn",
    "LandingProfile",
    "Morchin",
    "RadarLink",
    "Reflectivity",
    "Runway",
    "TabulatedAntenna",
    "Terrain",
    "TerrainError",
    "TerrainModel",
    "TerrainReturn",
    "Trajectory",
    "TrajectoryError",
    "UlabyDobson",
    "cell_posts",
    "ground_return",
    "ground_returns",
    "reflectivity",
    "synthesise",
    "synthesise_directly",
    "synthetic_elevation_m",
]
