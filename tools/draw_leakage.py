#!/usr/bin/env python3
"""Figure of docs/leakage.md: share of right altitudes over the level of the leakage, by what the receiver knows of it.

.venv/bin/python tools/draw_leakage.py --out docs/figures/leakage.png

Flies the scene `leakage` (3 m to 1000 m) at each level, with the landing gear's echo 20 dB below it: with a calibration
measured at that level, as a receiver that knows that it leaks (nothing below 100 m), and as one that does not.
"""

from __future__ import annotations

import _tool  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from radalt.core.scene import Scene, load_scene, parse_scene, scene_to_mapping
from radalt.core.timing.leakage_file import store_leakage
from radalt.evaluation.engine.options import Parser, command, path
from radalt.evaluation.radios.leakage_calibration import calibrate_leakage
from radalt.evaluation.results.figure import new_figure
from radalt.evaluation.results.proportion import wilson_interval
from radalt.evaluation.results.score import score_frames
from radalt.evaluation.simulation import run_chain

ROOT = Path(__file__).resolve().parent.parent
GEAR_BELOW_DB = 20.0  # level of the landing gear's echo below the leakage
LEVELS_DB = (-30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0, 40.0)
# by receiver: keys of the scene besides the level, colour (Okabe and Ito) and marker
RECEIVERS = {
    "calibrated": ({}, "#0072B2", "o"),
    "known to leak: above 100 m": (
        {"segmenter": {"leakage_calibration": "uncalibrated"}, "altimeter": {"min_altitude_m": 100.0}},
        "#009E73",
        "s",
    ),
    "neither": ({"segmenter": {"leakage_calibration": ""}}, "#D55E00", "^"),
}


def share_right(scene: Scene) -> tuple[float, float, float]:
    """Share of right altitudes above the scene's least altitude, and its 95 % interval."""
    results = run_chain(scene, ["none"]).results["none"]
    programme, least_m = scene.altitude.programme, scene.altimeter.min_altitude_m

    def counts(index: np.ndarray) -> np.ndarray:
        return programme.is_trial(index) & (programme.altitude_m(index) >= least_m)

    trials = int(counts(np.arange(programme.total_frames)).sum())  # frames of a lost lock among them
    mine = results[counts(results["frame_index"])]
    correct = score_frames(mine, programme.altitude_m(mine["frame_index"])).correct
    return correct / trials, *wilson_interval(correct, trials)


def scenes(level_db: float, folder: Path) -> dict[str, Scene]:
    """The scene at a level of leakage, by receiver."""
    base = scene_to_mapping(load_scene("leakage"))
    base["channel"] |= {"leakage_db": level_db, "gear_db": level_db - GEAR_BELOW_DB}
    file = folder / f"{level_db:g}.yaml"
    store_leakage(calibrate_leakage(parse_scene(base)), file)
    base["segmenter"]["leakage_calibration"] = str(file)
    return {
        name: parse_scene(base | {key: base[key] | values for key, values in keys.items()})
        for name, (keys, _, _) in RECEIVERS.items()
    }


def draw(out: Path) -> None:
    """A curve per receiver, with 95 % intervals."""
    with tempfile.TemporaryDirectory() as folder:
        found = [{n: share_right(s) for n, s in scenes(level, Path(folder)).items()} for level in LEVELS_DB]
    figure = new_figure(4.6, 3.4)
    axis = figure.subplots()
    for name, (_, colour, marker) in RECEIVERS.items():
        share, low, high = zip(*(point[name] for point in found), strict=True)
        axis.plot(LEVELS_DB, share, color=colour, marker=marker, label=name)
        axis.fill_between(LEVELS_DB, low, high, color=colour, alpha=0.15, lw=0)
        print(name, [round(value, 3) for value in share], round(min(low), 3))
    axis.set(
        xlabel="leakage over the ground's return / dB", ylabel="share of right altitudes", ylim=(-0.03, 1.03)
    )
    axis.grid(alpha=0.3)
    figure.legend(loc="outside upper center", ncols=2, fontsize=9, frameon=False)
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, metadata={"Title": "Leakage"})


@command("draw_leakage")
def main(argv: Sequence[str] | None = None) -> int:
    """Draw; returns 0, or 2 after one line about an error."""
    parser = Parser("draw_leakage", __doc__)
    parser.add_argument(
        "--out", type=path, default=ROOT / "docs" / "figures" / "leakage.png", help="PNG file"
    )
    draw(parser.parse_args(argv).out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
