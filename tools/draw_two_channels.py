#!/usr/bin/env python3
"""Figure of docs/two-channels.md, and its numbers that no list of cases has: depth of the null, cost of the canceller.

    .venv/bin/python flowgraphs/bench.py two_channels --methods hybrid --cases nr10_one,noise_one --out results/one
    .venv/bin/python tools/draw_two_channels.py results/one

Pd is of the stored rows and of the folders named; depth and cost (docs/data) are measured: a minute of CPU.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from scipy import fft

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "python"))

import radalt  # noqa: E402 - the path first
from radalt.bench.board import stored_rows  # noqa: E402
from radalt.bench.rows import read_rows  # noqa: E402
from radalt.core.scene import parse_scene, scene_to_mapping  # noqa: E402
from radalt.evaluation.results.figure import new_figure  # noqa: E402
from radalt.evaluation.results.labels import name_curves  # noqa: E402

# What keeps the null from being deep: keys of ``auxiliary`` and of ``auxiliary_cancel``
MISMATCHES = {
    "as shipped": ({}, {}),
    "ripple 1 dB": ({"ripple_db": 1.0}, {}),
    "8 bits": ({"adc_bits": 8}, {}),
    "image -35 dB": ({"image_db": -35.0}, {}),
    "image -35 dB conjugate": ({"image_db": -35.0}, {"conjugate": True}),
    "100 Hz of Doppler": ({"directions": {"doppler_hz": 100.0}}, {}),
    "100 Hz of Doppler order 1": ({"directions": {"doppler_hz": 100.0}}, {"order": 1}),
    "echo of 0 dB after 500 ns": ({"directions": {"echo_db": 0.0}}, {}),
}
DELAYS_NS = (0.3, 1.0, 3.0, 10.0, 30.0)
CURVES = (
    ("nr10_one", "5G, 1 channel", "#888888", "--", "s"),
    ("noise_one", "noise, 1 channel", "#888888", ":", "v"),
    ("nr10", "5G, 2 channels", "#0072B2", "-", "o"),
    ("noise", "noise, 2 channels", "#D55E00", "-", "^"),
)


def cancelled(auxiliary: dict, cancel: dict) -> tuple[float, float]:
    """Depth of the null in decibels, and cost per frame in FFTs of it, for one direction at SIR -60 dB."""
    data = scene_to_mapping(radalt.load_scene("two_channels"))
    data["auxiliary"] |= auxiliary
    data["auxiliary_cancel"] |= cancel
    scene = parse_scene(data)
    canceller = radalt.AuxiliaryCancel(scene.waveform, scene.auxiliary_cancel)
    canceller.process(*radalt.simulate(scene, overlap=0.0, frames=4, auxiliary=True)[0].swapaxes(0, 1))
    both, _ = radalt.simulate(scene, sir_db=-60.0, frames=20, auxiliary=True)
    first, second = np.ascontiguousarray(both.swapaxes(0, 1))
    spent, unit, left = [], [], []
    for k in range(len(first)):
        begin = time.thread_time_ns()
        left.append(canceller.process(first[k : k + 1], second[k : k + 1])[0])
        spent.append(time.thread_time_ns() - begin)
        begin = time.thread_time_ns()
        fft.fft(first[k])
        unit.append(time.thread_time_ns() - begin)
    depth_db = 10 * np.log10(np.mean(np.abs(first) ** 2) / np.mean(np.abs(np.stack(left)) ** 2))
    return float(depth_db), float(np.median(spent) / np.median(unit))


def main() -> None:
    """Draw the figure, print its depths and write those of mismatches with their cost."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("results", type=Path, nargs="*", help="folders of further rows of the list")
    paths = stored_rows("two_channels"), *(folder / "rows.csv" for folder in parser.parse_args().results)
    rows, held = [row for path in paths for row in read_rows(path)], {}
    figure = new_figure(7.0, 6.4)
    top, bottom = figure.subfigures(2, 1, height_ratios=(1.4, 1))
    (left, right), last = top.subplots(1, 2), bottom.subplots()
    for case, label, colour, line, marker in CURVES:
        own = [r for r in rows if r["case"] == case and r["overlap"] == 1.0]
        own = [r for r in own if case.endswith("_one") or r["entry"] == "none"]
        best = {r["sir_db"]: r for r in sorted(own, key=lambda r: r["pd"])}  # the last of a level stays
        x = sorted(best)
        pd, low, high = (np.array([best[v][key] for v in x]) for key in ("pd", "pd_low", "pd_high"))
        left.plot(x, pd, line, marker=marker, ms=5, color=colour, label=label)
        left.fill_between(x, low, high, color=colour, alpha=0.15, lw=0)
        held[case] = min((level for k, level in enumerate(x) if all(pd[k:] >= 0.9)), default=np.nan)
    of = ", ".join(dict.fromkeys(r["entry"] for r in rows if r["case"] == "nr10_one"))
    top.suptitle(
        f"Two channels hold Pd 0.9 to {held['noise']:.0f} dB under noise and {held['nr10']:.0f} dB under 5G;\n"
        f"one channel (best of {of}) to {held['noise_one']:.0f} and {held['nr10_one']:.0f} dB",
        fontsize=11,
    )
    left.set(xlabel="SIR / dB, one direction", ylabel="Pd (error < 5 m)", ylim=(-0.02, 1.04))
    left.invert_xaxis()
    for taps, style in ((1, "k:"), (9, "k--"), (17, "k-")):
        reach = {"reach_s": (taps // 2 + 0.1) / 7.5e6}
        depths = [cancelled({"directions": {"delay_s": ns * 1e-9}}, reach)[0] for ns in DELAYS_NS]
        right.semilogx(DELAYS_NS, depths, style, marker="o", ms=4, label=f"{taps} tap{'s'[: taps > 1]}")
        print(f"{taps} taps, dB at {DELAYS_NS} ns:", [f"{depth:.1f}" for depth in depths])
    right.set_xticks(DELAYS_NS, [f"{ns:g}" for ns in DELAYS_NS])
    right.minorticks_off()
    right.set(xlabel="delay between the antennas / ns", ylabel="depth of the null / dB", ylim=(0, 60))
    right.set_title(f"{taps} taps null by {depths[-1]:.0f} dB at {DELAYS_NS[-1]:g} ns", fontsize=10)
    found = {name: cancelled(*changes) for name, changes in MISMATCHES.items()}
    last.barh(list(found), [depth_db for depth_db, _ in found.values()], color="#0072B2")
    last.set(xlabel="depth of the null / dB, 17 taps, 3 ns", xlim=(0, 60), ylim=(len(found) - 0.4, -0.6))
    (worst, (least_db, _)), (as_is_db, _) = min(found.items(), key=lambda of: of[1]), found["as shipped"]
    last.set_title(f"Of {as_is_db:.0f} dB, {worst} leaves {least_db:.0f}", fontsize=10)
    for axis in (left, right, last):
        axis.grid(alpha=0.3)
    for axis in (left, right):
        name_curves(figure, [axis])
    figure.savefig(ROOT / "docs/figures/two_channels.png", metadata={"Title": "Two channels"})
    lines = [f"{name},{depth_db:.1f},{ffts:.1f}\n" for name, (depth_db, ffts) in found.items()]
    (ROOT / "docs/data/two_channels.csv").write_text("change,depth_db,ffts\n" + "".join(lines))


if __name__ == "__main__":
    main()
