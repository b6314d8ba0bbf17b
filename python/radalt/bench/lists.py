"""Lists of cases: YAML files, each case a scene at its overlaps and levels (bench/*.yaml)."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..core.parsing import build, load_yaml, plain, shown
from ..core.paths import share_dir
from ..core.scene import Scene, parse_scene

_LIST_KEYS = ("list", "title", "seed", "base", "grid", "overlap", "cases")
_CASE_KEYS = ("title", "overlap", "grid", "limit_m")


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Levels of a case from high to low, and when an entry is not run further.

    Parameters
    ----------
    sir_db : tuple of float or str
        Levels in decibels, or ``first:last:step``, such as ``0:-62.5:-2.5``.
    stop_below_pd : float
        Pd below which a level counts as failed, 0..1.
    stop_after : int
        Failed levels in a row after which an entry is not run at lower ones.
    """

    sir_db: tuple[float, ...] | str = "0:-62.5:-2.5"
    stop_below_pd: float = 0.3
    stop_after: int = 2

    @property
    def levels_db(self) -> tuple[float, ...]:
        """Levels in decibels, highest first; raises ValueError, one line."""
        if not isinstance(self.sir_db, str):
            return tuple(sorted(self.sir_db, reverse=True))
        try:
            first, last, step = (float(part) for part in self.sir_db.split(":"))
            count = int(np.floor((last - first) / step + 1e-9)) + 1
            if not (step < 0 < count <= 1000):
                raise ValueError
        except (ValueError, ZeroDivisionError):
            raise ValueError(
                f"grid.sir_db is {shown(self.sir_db)}; give levels, or first:last:step with a falling step"
            ) from None
        return tuple((first + step * np.arange(count)).tolist())


@dataclass(frozen=True, eq=False)
class Case:
    """One scene under its name, at one overlap.

    Attributes
    ----------
    name, title : str
    overlap : float
    scene : Scene
        Without the level; `at` gives it.
    grid : Grid
    limit_m : float
        Largest error of a right altitude: the paper's 5 m, or a quarter of the range cell where that is more.
    """

    name: str
    title: str
    overlap: float
    scene: Scene
    grid: Grid
    limit_m: float

    @property
    def levels_db(self) -> tuple[float | None, ...]:
        """SIR levels, highest first; (None,) without interference."""
        return self.grid.levels_db if self.scene.interference else (None,)

    @property
    def trials(self) -> int:
        """Frames of a level."""
        return self.scene.altitude.programme.trial_frames

    def at(self, sir_db: float | None) -> Scene:
        """The scene of one level: returns are the same at all, noise and interference are not."""
        return self.scene.at(sir_db=sir_db, overlap=self.overlap, seed=seed_of(self.scene.seed, sir_db))


@dataclass(frozen=True, eq=False)
class CaseList:
    """A list with the digest of its parsed content, by which rows are compared."""

    name: str
    title: str
    digest: str
    cases: tuple[Case, ...] = field(repr=False)


def seed_of(*parts: object) -> int:
    """31 bits of a hash."""
    return int.from_bytes(hashlib.sha256(repr(parts).encode()).digest()[:4], "big") >> 1


def find_list(name: str | Path) -> Path:
    """Path of a list: a file, or the name of a shipped one. Raises ValueError that names those there are."""
    path = Path(name)
    if path.is_file():
        return path
    folder = share_dir() / "bench"
    shipped = folder / f"{name}.yaml"
    if shipped.is_file():
        return shipped
    there = ", ".join(sorted(file.stem for file in folder.glob("*.yaml")))
    raise ValueError(f"list {shown(str(name))}: no such file, and no shipped list; there are {there}")


def load_list(
    name: str | Path, *, frames: int | None = None, only: Sequence[str] = (), salt: str = ""
) -> CaseList:
    """Every case of a list at each of its overlaps.

    Parameters
    ----------
    name : str or Path
        Of a shipped list, or a YAML file.
    frames : int or None
        Frames of each level in place of the list's.
    only : sequence of str
        Names of cases; empty takes all.
    salt : str
        Changes every seed, for frames that nobody could have seen (``--confirm``).

    Raises
    ------
    ValueError
        One line: file, case, key, value and what is allowed.
    """
    path = find_list(name)
    data = load_yaml(path, what="list")
    _check_keys(data, _LIST_KEYS, path.name)
    if not isinstance(data.get("cases"), dict) or not data["cases"]:
        raise ValueError(
            f"{path.name}: cases is {shown(data.get('cases'))}; give a mapping of at least one case"
        )
    unknown = [case for case in only if case not in data["cases"]]
    if unknown:
        raise ValueError(f"{path.name}: no case {shown(unknown[0])}; there are {', '.join(data['cases'])}")
    digest = hashlib.sha256(json.dumps([data, frames, salt], sort_keys=True).encode()).hexdigest()[:16]
    cases = []
    for case, own in data["cases"].items():
        if only and case not in only:
            continue
        cases += _cases(data, case, own, f"{path.name}: {case}", frames, salt)
    return CaseList(str(data.get("list", path.stem)), str(data.get("title", "")), digest, tuple(cases))


def _cases(
    data: dict[str, Any], name: str, own: Any, where: str, frames: int | None, salt: str
) -> list[Case]:
    """A case at each of its overlaps."""
    if not isinstance(own, dict):
        raise ValueError(f"{where} is {shown(own)}; expected a mapping of scene keys")
    own = dict(own)
    try:
        grid = build(Grid, data.get("grid", {}) | (own.pop("grid", None) or {}), "grid")
        grid.levels_db  # noqa: B018 - checks them
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    overlaps = own.pop("overlap", data.get("overlap", [1.0]))
    title, limit_m = str(own.pop("title", name.replace("_", " "))), own.pop("limit_m", None)
    out = []
    for overlap in overlaps if isinstance(overlaps, list) else [overlaps]:
        seed = (
            seed_of(data.get("seed", 1), name, overlap, salt)
            if salt
            else seed_of(data.get("seed", 1), name, overlap)
        )
        mapping = _merged(data.get("base", {}), own) | {"name": f"{name}_{overlap:g}", "seed": seed}
        drawn = dict(mapping.get("altitude", {}).get("drawn", {})) | {"seed": seed}
        if frames is not None:
            drawn["frames"] = frames
        mapping["altitude"] = dict(mapping.get("altitude", {})) | {"drawn": drawn}
        scene = parse_scene(mapping, source=where)
        limit = limit_m or max(5.0, scene.waveform.range_resolution_m / 4)
        out.append(Case(name, title, float(overlap), scene.at(overlap=overlap), grid, float(limit)))
    return out


def _check_keys(data: Any, allowed: Sequence[str], where: str) -> None:
    if not isinstance(data, dict):
        raise ValueError(f"{where} is {shown(data)}; expected a mapping with the keys {', '.join(allowed)}")
    unknown = [key for key in data if key not in allowed]
    if unknown:
        raise ValueError(f"{where}: unknown key {shown(unknown[0])}; allowed: {', '.join(allowed)}")


def _merged(base: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Keys of a case over those of the list, section by section; interference is replaced as a whole."""
    out = {key: plain(value) for key, value in base.items()}
    for key, value in own.items():
        nested = isinstance(value, dict) and isinstance(out.get(key), dict) and key != "interference"
        out[key] = _merged(out[key], value) if nested else value
    return out
