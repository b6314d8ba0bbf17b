#!/usr/bin/env python3
"""Figure of docs/two-channels.md, and its numbers that no list of cases has: depth of the null, cost of the canceller.

    .venv/bin/python flowgraphs/bench.py two_channels --out results/two_channels
    .venv/bin/python flowgraphs/bench.py two_channels --methods hybrid --cases nr10_one,noise_one --out results/one
    .venv/bin/python tools/draw_two_channels.py results/two_channels results/one

Writes docs/figures/two_channels.png and docs/data/two_channels.csv.
"""

import argparse
import shutil
import sys
import time
from pathlib import Path

import numpy as np
from scipy import fft

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "python"))

import radalt  # noqa: E402 - the path first
from radalt.bench.rows import read_rows  # noqa: E402
from radalt.core.scene import parse_scene, scene_to_mapping  # noqa: E402
from radalt.evaluation.results.figure import new_figure, save_figure  # noqa: E402

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
    ("nr10_one", "one channel, 5G, best of four", "#888888", "--", "s"),
    ("noise_one", "one channel, noise, best of four", "#888888", ":", "v"),
    ("nr10", "two channels, 5G", "#0072B2", "-", "o"),
    ("noise", "two channels, noise", "#D55E00", "-", "^"),
)


def cancelled(auxiliary: dict, cancel: dict) -> tuple[float, float]:
    """Depth of the null in decibels, and cost per frame in FFTs of it, for one direction at SIR -60 dB."""
    data = scene_to_mapping(radalt.load_scene("two_channels"))
    data["auxiliary"] |= auxiliary
    data["auxiliary_cancel"] |= cancel
    scene = parse_scene(data)
    canceller = radalt.AuxiliaryCancel(scene.waveform, scene.auxiliary_cancel)
    calm, _ = radalt.simulate(scene, overlap=0.0, frames=4, auxiliary=True)
    canceller.process(calm[:, 0], calm[:, 1])
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


def main() -> int:
    """Draw the figure and print the numbers."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("results", type=Path, nargs="+", help="folders of runs of the list two_channels")
    folders = parser.parse_args().results
    rows = [row for folder in folders for row in read_rows(folder / "rows.csv")]
    figure = new_figure(7.0, 6.4)
    top, bottom = figure.subfigures(2, 1, height_ratios=(1.3, 1))
    (left, right), last = top.subplots(1, 2), bottom.subplots()
    for case, label, colour, line, marker in CURVES:
        own = [r for r in rows if r["case"] == case and r["overlap"] == 1.0]
        # the last one of a level is the best
        best = {r["sir_db"]: r for r in sorted(own, key=lambda r: r["pd"])}
        if not case.endswith("_one"):
            best = {r["sir_db"]: r for r in own if r["entry"] == "none"}
        x = sorted(best)
        low, high = ([best[v][key] for v in x] for key in ("pd_low", "pd_high"))
        left.plot(x, [best[v]["pd"] for v in x], line, marker=marker, color=colour, label=label)
        left.fill_between(x, low, high, color=colour, alpha=0.15, lw=0)
    left.set(xlabel="SIR / dB", ylabel="Pd (error < 5 m)", ylim=(-0.02, 1.04))
    left.set_title("One direction: 5G and noise alike", fontsize=10)
    left.invert_xaxis()
    top.legend(fontsize=9, loc="outside lower center", ncols=2, frameon=False)
    for taps, style in ((1, "k:"), (9, "k--"), (17, "k-")):
        reach = {"reach_s": (taps // 2 + 0.1) / 7.5e6}
        depths = [cancelled({"directions": {"delay_s": ns * 1e-9}}, reach)[0] for ns in DELAYS_NS]
        right.semilogx(DELAYS_NS, depths, style, marker="o", ms=4, label=f"{taps} tap{'s'[: taps > 1]}")
        print(f"{taps} taps, dB at {DELAYS_NS} ns:", [f"{depth:.1f}" for depth in depths])
    right.set_xticks(DELAYS_NS, [f"{ns:g}" for ns in DELAYS_NS])
    right.minorticks_off()
    right.set(xlabel="delay between the antennas / ns", ylabel="depth of the null / dB", ylim=(0, 60))
    right.set_title("Taps make up for the delay", fontsize=10)
    right.legend(fontsize=9)
    found = {name: cancelled(*changes) for name, changes in MISMATCHES.items()}
    last.barh(list(found), [depth_db for depth_db, _ in found.values()], color="#0072B2")
    last.invert_yaxis()
    last.set(xlabel="depth of the null / dB", xlim=(0, 60))
    last.set_title("17 taps, 3 ns: mismatch and bits", fontsize=10)
    for axis in (left, right, last):
        axis.grid(alpha=0.3)
    save_figure(figure, folders[0] / "two_channels.png")
    shutil.copy(folders[0] / "two_channels.png", ROOT / "docs/figures/two_channels.png")
    lines = [f"{name},{depth_db:.1f},{ffts:.1f}\n" for name, (depth_db, ffts) in found.items()]
    (ROOT / "docs/data/two_channels.csv").write_text("change,depth_db,ffts\n" + "".join(lines))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
