"""Errors of the landing scenario; each message names the value, the limit and the remedy in one line."""

from __future__ import annotations

__all__ = ["TerrainError", "TrajectoryError"]


class TerrainError(ValueError):
    """Terrain is missing, void, not readable, or above the aircraft."""


class TrajectoryError(ValueError):
    """A trajectory file or a query into it does not make sense."""
