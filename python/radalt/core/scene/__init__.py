"""Scenes: one YAML file describes everything on which a run depends."""

from .reading import (
    SceneError,
    interference_from_yaml,
    interferer_to_mapping,
    load_scene,
    parse_scene,
    scene_from_parameters,
    scene_to_mapping,
)
from .scene import Scene, burst_db
from .sections import AltitudeSpec, RadioSpec, SweepSpec

__all__ = [
    "AltitudeSpec",
    "RadioSpec",
    "Scene",
    "SceneError",
    "SweepSpec",
    "burst_db",
    "interference_from_yaml",
    "interferer_to_mapping",
    "load_scene",
    "parse_scene",
    "scene_from_parameters",
    "scene_to_mapping",
]
