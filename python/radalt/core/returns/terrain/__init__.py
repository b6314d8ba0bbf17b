"""The landing scenario: geodesy, trajectory, terrain, antenna, ground reflectivity, and the radar return.

Nothing here is imported unless a scene asks for terrain.
"""

from .antenna import Antenna, GaussianAntenna, TabulatedAntenna
from .facets import MIN_HEIGHT_M, Facets, GroundGrid
from .ground import LAND_TYPES, ConstantGamma, Morchin, Reflectivity, UlabyDobson, reflectivity
from .live import LandingProfile
from .radar_return import GroundReturn, TerrainReturn
from .synthesis import synthesise
from .terrain import VOID_M, DtedCell, FlatTerrain, Terrain, TerrainError, TerrainModel
from .trajectory import AircraftState, Trajectory, TrajectoryError
