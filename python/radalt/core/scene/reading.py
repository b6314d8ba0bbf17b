"""Scenes from YAML, from flowgraph parameters, and back to plain mappings.

A wrong key, unit, range or type gives one line that names file, key, value and what is allowed.
"""

import dataclasses
import os
import re
import typing
from pathlib import Path
from typing import Any

from ..interference.effects import KEYS as EFFECTS
from ..interference.effects import impaired, parts
from ..interference.emitters import NamedEmitter, emitter_class, emitter_names
from ..interference.placement import Interferer
from ..parsing import InputError, allowed, build, convert, did_you_mean, load_yaml, plain, shown
from ..paths import scene_names, scene_path, share_dir
from ..text import one_line
from .scene import Scene
from .sections import MOST_SIR_DB

_LEAST_HZ = 100.0  # least frequency of an interferer but 0, Hz: megahertz written as hertz
_LEAST_SIR_DB = -200.0  # lowest SIR, dB: the bound of every quantity in decibels
# keys that name files, with the folder of shipped ones; None: there is none, and it has to be at hand
_FILES = {
    r"interference(\.\d+)?\.recording\.file|method_options\.[^.]+\.(model|file)|landing\.folder": None,
    r"landing\.(trajectory\.file|terrain\.files\.\d+|antenna\.pattern)": "landing",
    r"segmenter\.leakage_calibration": "calibrations",
}
_RENAMED = {"return_model": "return"}  # a keyword of Python
_PLACEMENT = ("sir_db", "overlap", "start", "free_running")


class SceneError(ValueError):
    """A scene that cannot be used; the message is one line for the user."""


def load_scene(name: str | Path) -> Scene:
    """Read and validate a scene by path, or by the name of a shipped one.

    Relative names of files in it are sought next to the scene, then in the working folder.

    Raises
    ------
    SceneError
        One line: file, key, value, what is allowed.
    """
    try:
        path = scene_path(name)
        near = did_you_mean(name, scene_names())
        data = load_yaml(path, what="scene", remedy=f"{near}give a YAML file or a shipped scene's name")
    # InputError, no text, a NUL or thousands of letters in the name
    except (OSError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise SceneError(str(error)) from None
        reason = getattr(error, "strerror", None) or error
        raise SceneError(
            f"scene {shown(str(name))}: {reason}; give a YAML file or a shipped scene's name"
        ) from None
    return parse_scene(data if data is not None else {}, source=str(path), folder=path.parent)


def _located(value: Any, folder: Path, where: str) -> Any:
    """Part of a scene with the files of ``folder`` by their paths; raises ValueError for one that is nowhere."""
    if isinstance(value, dict):
        own = where == "landing" and value.get("folder")  # of which the other names are parts
        return {
            key: part if own and key != "folder" else _located(part, folder, f"{where}.{key}".lstrip("."))
            for key, part in value.items()
        }
    if isinstance(value, list):
        return [_located(part, folder, f"{where}.{number}") for number, part in enumerate(value)]
    kind = next((kind for keys, kind in _FILES.items() if re.fullmatch(keys, where)), "")
    if kind == "" or not isinstance(value, str) or not value or os.path.isabs(value):
        return value
    if "+" in value and not os.path.exists(folder / value):  # a network's encoder and decoder
        return "+".join(_located(part, folder, where) for part in value.split("+"))
    at = next((place / value for place in (folder, Path()) if os.path.exists(place / value)), None)
    if at is not None:
        return str(at.absolute() if kind == "landing" else at)
    shipped = share_dir() / "flowgraphs"
    known = kind and os.path.exists(shipped / kind / value)
    if known or kind == "calibrations" or folder.resolve() == shipped / "scenes":
        return value
    raise ValueError(
        f"{where} is {shown(value)}; it is neither in {folder.resolve()}, next to the scene, nor in {Path.cwd()}"
    )


def parse_scene(data: dict[str, Any], *, source: str = "scene", folder: Path | None = None) -> Scene:
    """A validated `Scene` from nested mappings as YAML gives them; files are sought in ``folder`` first."""
    try:
        data = data if folder is None else _located(data, folder, "")
        scene: Scene = build(Scene, data, "", {"interference": interference_from_yaml}, renamed=_RENAMED)
        if scene.landing is not None and "programme_m" not in (data.get("altitude") or {}):
            scene = _with_landing(scene)
        return scene
    except (ValueError, OSError) as error:
        raise SceneError(one_line(f"{source}: {error}")) from None


def _with_landing(scene: Scene) -> Scene:
    """The altitudes of the scene's landing, one per frame, from first to last."""
    assert scene.landing is not None
    profile = scene.landing.profile(scene.waveform, scene.altitude.landing_frames, scene.seed)
    altitudes = tuple(float(max(0.0, a)) for a in profile.altitude_m)
    return dataclasses.replace(scene, altitude=dataclasses.replace(scene.altitude, programme_m=altitudes))


def interference_from_yaml(value: Any, where: str) -> tuple[Interferer, ...]:
    """Interferers of ``{kind: {...}}``, or of a list of mappings of this form."""
    if value is None:
        return ()
    if isinstance(value, dict):
        value = [{kind: params} for kind, params in value.items()]
    if not isinstance(value, list):
        raise ValueError(f"{where} is {shown(value)}; expected a mapping 'kind: {{...}}' or a list of them")
    return tuple(_interferer(item, where) for item in value)


def _interferer(item: Any, where: str) -> Interferer:
    """One ``{kind: {emitter and placement keys}}``."""
    if not (isinstance(item, dict) and len(item) == 1):
        raise ValueError(f"{where} holds {shown(item)}; expected one 'kind: {{...}}' an entry")
    kind, params = next(iter(item.items()))
    path = f"{where}.{kind}"
    if kind not in emitter_names():
        raise ValueError(f"unknown interferer {shown(path)}; {allowed(kind, emitter_names())}")
    params = {} if params is None else params
    if not isinstance(params, dict):
        raise ValueError(f"{path} is {shown(params)}; expected a mapping of keys")
    hints = typing.get_type_hints(Interferer)
    placement = {k: convert(hints[k], v, f"{path}.{k}") for k, v in params.items() if k in _PLACEMENT}
    if (sir_db := placement.get("sir_db", 0.0)) > MOST_SIR_DB:
        raise ValueError(f"{path}.sir_db is {sir_db:g}; at most {MOST_SIR_DB:g}: did you mean {-sir_db:g}?")
    others = (*_PLACEMENT, *EFFECTS)
    own = {k: v for k, v in params.items() if k not in others}
    built = build(emitter_class(kind), own, path, also=others)
    emitter = impaired(built, params, path)
    for key, given in plain(built).items():
        for value in given if isinstance(given, list) else [given]:
            if key.endswith("_hz") and 0 < abs(value or 0.0) < _LEAST_HZ:
                near = f"0, or at least {_LEAST_HZ:g}: did you mean {value * 1e6:g}?"
                raise ValueError(f"{path}.{key} is {value:g}; it has to be {near}")
    stated_db = typing.cast(NamedEmitter, emitter).stated_sir_db
    if "sir_db" not in placement and stated_db is not None:
        placement["sir_db"] = stated_db
    try:
        return Interferer(emitter, **placement)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def scene_from_parameters(
    name: Scene | str | Path,
    overlap: float | str | None = None,
    sir_db: float | str | None = None,
    seed: int | str | None = None,
) -> Scene:
    """A scene by flowgraph parameters: numbers, or numbers as text; None or ``"scene"`` keeps the scene's value.

    Raises `SceneError`, one line: parameter, value, what is allowed.
    """
    given = {"overlap": overlap, "sir_db": sir_db, "seed": seed}
    changes: dict[str, Any] = {}
    for key, value in given.items():
        if value in (None, "scene"):
            continue
        try:
            changes[key] = int(value) if key == "seed" else float(value)
        except ValueError:
            raise SceneError(
                f"{key} is {shown(value)}; give a number, or scene for the scene's own"
            ) from None
    level_db = changes.get("sir_db", 0.0)
    if not _LEAST_SIR_DB <= level_db <= MOST_SIR_DB:
        raise SceneError(
            f"sir_db is {level_db:g}; it has to be within {_LEAST_SIR_DB:g}..{MOST_SIR_DB:g}, or scene for the scene's "
            "own" + f": did you mean {-level_db:g}?" * (level_db > MOST_SIR_DB)
        )
    scene = name if isinstance(name, Scene) else load_scene(name)
    try:
        return scene.at(**changes) if changes else scene
    except ValueError as error:
        raise SceneError(one_line(f"{getattr(name, 'name', name)}: {error}")) from None


def scene_to_mapping(scene: Scene) -> dict[str, Any]:
    """A scene as plain mappings, lists and numbers; the inverse of `parse_scene`."""
    mapping = {f.name: plain(getattr(scene, f.name)) for f in dataclasses.fields(scene)}
    mapping |= {key: mapping.pop(name) for name, key in _RENAMED.items()}
    mapping["interference"] = [interferer_to_mapping(i) for i in scene.interference]
    return mapping


def interferer_to_mapping(interferer: Interferer) -> dict[str, Any]:
    """``{kind: {emitter and placement keys}}`` of one interferer."""
    emitter, effects = parts(interferer.emitter)
    keys = {key: plain(getattr(interferer, key)) for key in _PLACEMENT} | plain(emitter)
    return {typing.cast(NamedEmitter, emitter).scene_name: keys | effects}
