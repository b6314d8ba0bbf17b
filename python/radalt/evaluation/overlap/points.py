"""Points of a sweep: each is a function of (scene, point, seed), in any order and process."""

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core.parsing import MINUS, quantity, shown
from ...core.scene import Scene, SceneError
from ..engine.study import Point

_MAX_VALUES = 1001  # most values of one axis; more are a mistake in start:stop:step


@dataclass(frozen=True)
class OverlapPoint(Point):
    """One point of the sweep."""

    overlap: float = 0.0  # active fraction of the frame, 0..1
    # SIR of all interferers together over the frame; None in a scene without interference
    sir_db: float | None = None
    snr_db: float | None = None  # SNR of the return; None for no noise

    @classmethod
    def at(
        cls, overlap: float, sir_db: float | None, snr_db: float | None, frames: int = 0, table: str = "rows"
    ) -> "OverlapPoint":
        """A point with a name made of its values."""
        parts = ["ceiling"] if table == "ceiling" else [f"overlap {overlap:g}"]
        parts = ["tracked", *parts] if table == "tracked" else parts
        parts += [] if sir_db is None else [f"SIR {sir_db:g} dB"]
        parts += ["no noise"] if snr_db is None else [f"SNR {snr_db:g} dB"]
        return cls(", ".join(parts), frames, table, overlap, sir_db, snr_db)


def parse_axis(text: str, what: str) -> tuple[float, ...]:
    """Values of one axis: parts separated by commas, each a number or an inclusive ``start:stop:step``.

    Raises ValueError, one line that names the option (``what``), the part and what is expected.

    Examples
    --------
    >>> parse_axis("0:0.3:0.1,1", "--overlap")
    (0.0, 0.1, 0.2, 0.3, 1.0)
    """
    values: list[float] = []
    if text.count(",") > _MAX_VALUES:
        raise ValueError(f"{what} holds {text.count(',') + 1} parts; at most {_MAX_VALUES}")
    for part in text.split(","):
        try:
            numbers = [float(n) for n in part.replace(MINUS, "-").split(":")]
        except ValueError:
            numbers = []
        if len(numbers) not in (1, 3) or not np.all(np.isfinite(numbers)):
            raise ValueError(
                f"{what} holds {shown(part.strip())}; expected numbers like 0,0.3,1 or start:stop:step"
            )
        for number in numbers:
            quantity(number, f"{what} {shown(part.strip())}: {what.lstrip('-').replace('-', '_')}")
        values += numbers if len(numbers) == 1 else _span(*numbers, f"{what} {part.strip()}")
    return tuple(dict.fromkeys(values))


def changed(
    scene: Scene,
    *,
    overlap: Sequence[float] | None = None,
    sir_db: Sequence[float] | None = None,
    snr_db: Sequence[float] | None = None,
    altitudes_m: Sequence[float] | None = None,
    frames: int | None = None,
    seed: int | None = None,
    methods: Sequence[str] | None = None,
    own: Mapping[str, dict[str, Any]] | None = None,
) -> Scene:
    """The scene with other axes, altitudes, frames per altitude, seed or methods; None keeps the scene's.

    ``own`` has further method options by the method's name; methods that the scene lacks are added.

    Raises SceneError for a wrong value; one line.
    """

    def given(**values: Any) -> dict[str, Any]:
        return {k: tuple(v) if isinstance(v, Sequence) else v for k, v in values.items() if v is not None}

    options = {name: {**(scene.method_options.get(name) or {}), **more} for name, more in (own or {}).items()}
    chosen = scene.methods if methods is None else tuple(methods)
    try:
        return dataclasses.replace(
            scene,
            sweep=dataclasses.replace(scene.sweep, **given(overlap=overlap, sir_db=sir_db, snr_db=snr_db)),
            altitude=dataclasses.replace(scene.altitude, **given(programme_m=altitudes_m, frames=frames)),
            methods=chosen + tuple(name for name in options if name not in chosen),
            method_options={**scene.method_options, **options},
            **given(seed=seed),
        )
    except ValueError as error:
        raise SceneError(str(error)) from None


def _span(start: float, stop: float, step: float, what: str) -> list[float]:
    if step == 0 or (stop - start) / step < 0:
        raise ValueError(f"{what}: a step of {step:g} never gets from {start:g} to {stop:g}")
    # tolerance of half a millionth of a step, so that 0:1:0.1 ends at 1 in spite of rounding
    count = np.floor((stop - start) / step + 5e-7) + 1
    if count > _MAX_VALUES:
        raise ValueError(f"{what}: {count:.4g} values; at most {_MAX_VALUES}: take a larger step")
    return [round(start + k * step, 9) for k in range(int(count))]


def sweep_points(scene: Scene) -> tuple[OverlapPoint, ...]:
    """Every overlap at every SIR at every SNR, in canonical order; an empty axis has the scene's value.

    Raises ValueError if overlaps or SIRs are swept in a scene without interference.
    """
    sweep, frames = scene.sweep, scene.altitude.programme.trial_frames
    snrs = sweep.snr_db or (scene.channel.snr_db,)
    if not scene.interference:
        named = next((n for n in ("overlap", "sir_db") if any(getattr(sweep, n))), None)
        if named:
            raise ValueError(
                f"sweep.{named} {getattr(sweep, named)} needs interference, and the scene has none"
            )
        return tuple(OverlapPoint.at(0.0, None, snr, frames) for snr in snrs)
    sirs = sweep.sir_db or (scene.sir_db if scene.total_sir_db is not None else round(scene.sir_db, 9),)
    overlaps = sweep.overlap or (max(i.overlap for i in scene.interference),)
    points = (
        OverlapPoint.at(overlap, sir, snr, frames) for snr in snrs for sir in sirs for overlap in overlaps
    )
    return tuple(dict.fromkeys(points))


def point_seed(seed: int, point: OverlapPoint) -> int:
    """Seed of a point, 31 bits, from the run's seed and the point's values.

    Without interference the seed does not depend on the SIR: points at overlap 0 of all panels, and those of a scene
    without interference, are equal.
    """
    sir = None if point.overlap == 0 else point.sir_db
    text = "/".join("none" if v is None else f"{v:.9g}" for v in (point.overlap, sir, point.snr_db))
    digest = hashlib.sha256(f"radalt {seed} {text}".encode()).digest()
    return int.from_bytes(digest[:4], "big") >> 1


def scene_at(scene: Scene, point: OverlapPoint) -> Scene:
    """The scene of one point, with the point's seed and without a sweep."""
    placed = scene.at(
        overlap=point.overlap if scene.sweep.overlap else None,
        sir_db=point.sir_db if scene.interference else None,
        snr_db=point.snr_db,
        seed=point_seed(scene.seed, point),
    )
    return dataclasses.replace(placed, sweep=type(scene.sweep)())
