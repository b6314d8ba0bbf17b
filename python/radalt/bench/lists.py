"""Lists of cases: YAML files, each case a scene at its overlaps and levels (bench/*.yaml)."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..core.parsing import build, convert, load_yaml, plain, shown, whole
from ..core.paths import share_dir
from ..core.scene import Scene, parse_scene
from ..evaluation.overlap.points import parse_axis

_LIST_KEYS = ("list", "title", "seed", "base", "grid", "overlap", "entries", "turns", "cases", "extends")
_AXES = ("sir_db", "sinr_db", "inr_db", "snr_db")  # of a grid, one of them


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Levels of a case from high to low on one axis, and when an entry is not run further.

    - ``sir_db``, ``sinr_db``, ``inr_db``, ``snr_db``: levels in decibels, or ``first:last:step``, such as
      ``0:-62.5:-2.5``: of the return over the interference, or over interference and noise, of the interference over
      the noise, of the return over the noise. Default: ``sir_db`` as in the example.
    """

    sir_db: tuple[float, ...] | str | None = None
    sinr_db: tuple[float, ...] | str | None = None
    inr_db: tuple[float, ...] | str | None = None
    snr_db: tuple[float, ...] | str | None = None
    stop_below_pd: float = 0.3  # Pd below which a level counts as failed, 0..1; 0 runs every level
    stop_after: int = 2  # failed levels in a row after which an entry is not run at lower ones

    @property
    def axis(self) -> str:
        """Name of the axis; raises ValueError where there are two."""
        given = [name for name in _AXES if getattr(self, name) is not None] or ["sir_db"]
        if len(given) > 1:
            raise ValueError(f"grid has {' and '.join(given)}; give one of them")
        return given[0]

    @property
    def levels_db(self) -> tuple[float, ...]:
        """Levels in decibels, highest first; raises ValueError, one line."""
        levels = getattr(self, self.axis) or "0:-62.5:-2.5"
        if isinstance(levels, str):
            levels = parse_axis(levels, f"grid.{self.axis}")
        return tuple(sorted(levels, reverse=True))

    def powers_db(self, level_db: float, snr_db: float | None) -> dict[str, float]:
        """SIR or SNR of a level, as `Scene.at` takes them; raises ValueError, one line, where there is none."""
        if self.axis in ("sir_db", "snr_db"):
            return {self.axis: level_db}
        if snr_db is None:
            raise ValueError(f"grid.{self.axis} needs a noise: give channel.snr_db")
        if self.axis == "inr_db":
            return {"sir_db": snr_db - level_db}
        rest = 10.0 ** (-level_db / 10.0) - 10.0 ** (-snr_db / 10.0)
        if rest <= 0:
            raise ValueError(f"grid.sinr_db {level_db:g} is not below channel.snr_db {snr_db:g}; lower it")
        return {"sir_db": -10.0 * math.log10(rest)}


@dataclass(frozen=True, eq=False)
class Case:
    """One scene under its name, at one overlap."""

    name: str
    title: str
    overlap: float
    scene: Scene  # without the level; `at` gives it
    grid: Grid
    limit_m: float
    """Largest error of a right altitude: the paper's 5 m, or a quarter of the range cell where that is more."""

    @property
    def levels_db(self) -> tuple[float | None, ...]:
        """Levels on the grid's axis, highest first; (None,) without interference, unless the axis is the SNR."""
        return self.grid.levels_db if self.scene.interference or self.grid.axis == "snr_db" else (None,)

    @property
    def trials(self) -> int:
        """Frames of a level."""
        return self.scene.altitude.programme.trial_frames

    def at(self, level_db: float | None) -> Scene:
        """The scene of one level: returns are the same at all, noise and interference are not."""
        powers = {} if level_db is None else self.grid.powers_db(level_db, self.scene.channel.snr_db)
        return self.scene.at(**powers, overlap=self.overlap, seed=seed_of(self.scene.seed, level_db))


@dataclass(frozen=True, eq=False)
class CaseList:
    """A list with the digest of its parsed content, by which rows are compared.

    ``entries`` are those that it is run with unless others are named, ``turns`` how often all are timed in turn.
    """

    name: str
    title: str
    digest: str
    entries: Mapping[str, Mapping[str, Any]] = field(repr=False)
    turns: int
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

    ``name``: of a shipped list, or a YAML file; ``frames``: frames of each level in place of the list's; ``only``:
    names of cases; empty takes all; ``salt``: changes every seed, for frames that nobody could have seen
    (``--confirm``). Raises `ValueError`: file, case, key, value and what is allowed.
    """
    path = find_list(name)
    data = _extended(path)
    if not (isinstance(data.get("cases"), dict) and data["cases"] and all(map(_is_name, data["cases"]))):
        raise ValueError(
            f"{path.name}: cases is {shown(data.get('cases'))}; give a mapping of at least one case, by names"
        )
    unknown = [case for case in only if case not in data["cases"]]
    if unknown:
        raise ValueError(f"{path.name}: no case {shown(unknown[0])}; there are {', '.join(data['cases'])}")
    digest = hashlib.sha256(json.dumps([data, frames, salt], sort_keys=True).encode()).hexdigest()[:16]
    cases = []
    for case, own in data["cases"].items():
        if only and case not in only:
            continue
        where = f"{path.name}: {case}"
        cases += _cases(data, case, _like(data["cases"], own, where), where, frames, salt)
    entries = data.get("entries", {})
    if isinstance(entries, list):  # names of methods
        entries = {entry: {} for entry in entries}
    if not (isinstance(entries, dict) and all(isinstance(v or {}, dict) for v in entries.values())):
        raise ValueError(
            f"{path.name}: entries is {shown(entries)}; give names of methods, or name: {{method: ...}}"
        )
    turns = whole(data.get("turns", 0), f"{path.name}: turns", 0, 10_000)
    entries = {str(name): dict(keys or {}) for name, keys in entries.items()}
    return CaseList(
        str(data.get("list", path.stem)), str(data.get("title", "")), digest, entries, turns, tuple(cases)
    )


def _extended(path: Path) -> dict[str, Any]:
    """Content of a list, and of the one whose base, grid and overlap it takes where it has none."""
    data = load_yaml(path, what="list")
    _check_keys(data, _LIST_KEYS, path.name)
    if "extends" not in data:
        return data
    near = path.with_name(f"{data['extends']}.yaml")
    other = load_yaml(near if near.is_file() else find_list(str(data["extends"])), what="list")
    _check_keys(other, _LIST_KEYS[:-1], f"{path.name}: extends {data['extends']}")  # it extends none itself
    taken = {key: other[key] for key in ("grid", "overlap") if key in other}
    own = {key: value for key, value in data.items() if key != "extends"}
    return taken | own | {"base": _merged(other.get("base", {}), own.get("base", {}))}


def _like(cases: dict[str, Any], own: Any, where: str, depth: int = 0) -> dict[str, Any]:
    """Keys of a case over those of the case that it is ``like``: interferers of the same kind are changed, too."""
    if not isinstance(own, dict):
        raise ValueError(f"{where} is {shown(own)}; expected a mapping of scene keys")
    if "like" not in own:
        return dict(own)
    name = own["like"]
    if not _is_name(name) or name not in cases or depth > len(cases):
        raise ValueError(
            f"{where}: like is {shown(name)}; give another case of the list, there are {', '.join(cases)}"
        )
    other = _like(cases, cases[name], where, depth + 1)
    out = _merged(
        {k: v for k, v in other.items() if k != "title"}, {k: v for k, v in own.items() if k != "like"}
    )
    was, now = other.get("interference"), own.get("interference")
    if isinstance(was, dict) and isinstance(now, dict):
        out["interference"] = {kind: _merged(was.get(kind, {}), keys) for kind, keys in now.items()}
    return out


def _cases(
    data: dict[str, Any], name: str, own: Any, where: str, frames: int | None, salt: str
) -> list[Case]:
    """A case at each of its overlaps."""
    try:
        shared, mine = data.get("grid", {}), own.pop("grid", None) or {}
        if any(axis in mine for axis in _AXES):  # a case of its own axis
            shared = {key: value for key, value in shared.items() if key not in _AXES}
        grid = build(Grid, shared | mine, "grid")
        grid.levels_db  # noqa: B018 - checks them
        overlaps = convert(tuple[float, ...], own.pop("overlap", data.get("overlap", [1.0])), "overlap")
        limit_m = convert(float | None, own.pop("limit_m", None), "limit_m")
        if not overlaps or not all(0.0 <= overlap <= 1.0 for overlap in overlaps):
            raise ValueError(f"overlap is {shown(list(overlaps))}; give one within 0..1, or a list of them")
        if limit_m is not None and limit_m <= 0.0:
            raise ValueError(f"limit_m is {limit_m:g}; it has to be above 0")
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    title, out = str(own.pop("title", name.replace("_", " "))), []
    for overlap in overlaps:
        seed = seed_of(data.get("seed", 1), name, overlap, *filter(None, (salt,)))
        mapping = _merged(data.get("base", {}), own) | {"name": f"{name}_{overlap:g}", "seed": seed}
        mapping["altitude"] = _altitude(mapping, frames, seed, where)
        scene = parse_scene(mapping, source=where)
        limit = limit_m or max(5.0, scene.waveform.range_resolution_m / 4)
        case = Case(name, title, overlap, scene.at(overlap=overlap), grid, limit)
        try:
            case.at(case.levels_db[0])  # the level that a grid can get wrong
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from None
        out.append(case)
    return out


def _altitude(mapping: dict[str, Any], frames: int | None, seed: int, where: str) -> dict[str, Any]:
    """Altitudes of a case: drawn, or along its landing."""
    altitude = dict(convert(dict, mapping.get("altitude", {}), f"{where}: altitude"))
    if "landing" in mapping:
        altitude.pop("drawn", None)
        return altitude | {"frames": 1} | ({} if frames is None else {"landing_frames": frames})
    drawn = convert(dict, altitude.get("drawn", {}), f"{where}: altitude.drawn") | {"seed": seed}
    return altitude | {"drawn": drawn | ({} if frames is None else {"frames": frames})}


def _is_name(value: Any) -> bool:
    return isinstance(value, str) and bool(value)


def _check_keys(data: Any, allowed: Sequence[str], where: str) -> None:
    if not isinstance(data, dict):
        raise ValueError(f"{where} is {shown(data)}; expected a mapping with the keys {', '.join(allowed)}")
    unknown = [key for key in data if key not in allowed]
    if unknown:
        raise ValueError(f"{where}: unknown key {shown(unknown[0])}; allowed: {', '.join(allowed)}")
    wrong = [key for key in ("base", "grid") if not isinstance(data.get(key, {}), dict)]
    if wrong:
        raise ValueError(f"{where}: {wrong[0]} is {shown(data[wrong[0]])}; expected a mapping of keys")


def _merged(base: Any, own: Any) -> dict[str, Any]:
    """Keys of a case over those of the list, section by section; interference is replaced as a whole."""
    out = {key: plain(value) for key, value in base.items()}
    for key, value in own.items():
        nested = isinstance(value, dict) and isinstance(out.get(key), dict) and key != "interference"
        out[key] = _merged(out[key], value) if nested else value
    return out
