#!/usr/bin/env python3
"""How fast the live path runs: CPU by block in FFTs, real-time factor, latency, drops, memory.

    .venv/bin/python flowgraphs/realtime_benchmark.py                       # 60 s of signal, none and tcae
    .venv/bin/python flowgraphs/realtime_benchmark.py --seconds 10 --methods none,whitening
    .venv/bin/python flowgraphs/realtime_benchmark.py --skip-clean --overlap 0.3
    .venv/bin/python flowgraphs/realtime_benchmark.py --rate-hz 30e6 --methods none,whitening --seconds 10

Two runs of the simulated flowgraph: as fast as it goes (real-time factor, CPU, memory), then held to 7.5 MS/s with the
drop policy of the air (latency, drops). The simulated transmitters and channel run on the same cores and count. Cost is
in FFTs: CPU time per frame over that of one complex64 transform of a frame, timed in the same run. Beside each block's
cost stands that of its function alone in a loop, and how often the block was called per frame.
"""

from __future__ import annotations

import _startup  # isort: skip  # noqa: F401 - first: Ctrl-C, one core, a quiet log, the package on the path

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path

from gnuradio.radalt.evaluation.engine.options import Parser, command, number, path

PROGRAM = "realtime_benchmark"


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    add = parser.add_argument
    add("--scene", default="paper_qpsk", help="YAML file or shipped scene (%(default)s)")
    add("--methods", default="none,tcae", help="with commas (%(default)s)")
    add("--seconds", type=number(float, 0.01, 86_400), default=60.0, help="of signal, each run (%(default)g)")
    add(
        "--rate-hz",
        type=number(float, 1e3, 1e9),
        help="sample rate and swept bandwidth, in place of the scene's (the network takes 7.5e6 alone)",
    )
    add("--overlap", type=number(float, 0, 1), default=1.0, help="of the interference (%(default)g)")
    add(
        "--batch",
        type=number(int, 1, 4096),
        default=8,
        help="frames a run of the network takes at most (%(default)s)",
    )
    add("--one-process", action="store_true", help="network in the flowgraph's own process, on any core")
    add("--skip-clean", action="store_true", help="frames without interference skip the network")
    add("--free-only", action="store_true", help="leave out the run held to real time")
    add("--json", type=path, metavar="FILE", help="write the numbers, too")
    return parser


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print; returns 0 where real time is kept, 1 where not, 2 after one line on what is wrong."""
    args = _parser().parse_args(argv)
    from gnuradio.radalt.core.scene import load_scene
    from gnuradio.radalt.evaluation.realtime.alone import alone_seconds
    from gnuradio.radalt.evaluation.realtime.gateway import gateway_seconds
    from gnuradio.radalt.evaluation.realtime.study import (
        at_rate,
        fft_seconds,
        fly_benchmark,
        long_scene,
        prepare_benchmark,
    )

    methods = tuple(m.strip() for m in args.methods.split(","))
    numbers = {}
    scene = load_scene(args.scene)
    scene = scene.at(overlap=args.overlap) if scene.interference else scene
    scene = scene if args.rate_hz is None else at_rate(scene, args.rate_hz)
    scene = long_scene(scene, args.seconds)
    samples = scene.waveform.samples_per_frame
    with tempfile.TemporaryDirectory(prefix="radalt_") as folder:
        for realtime in (False,) if args.free_only else (False, True):
            options = {"realtime": realtime, "batch": args.batch, "skip_clean": args.skip_clean}
            options["own_process"] = not args.one_process
            prepared = prepare_benchmark(scene, methods, Path(folder), **options)
            limit = 20.0 * args.seconds * max(1.0, scene.waveform.rate_hz / 7.5e6) + 60.0
            unit_s = [fft_seconds(samples)]
            result = fly_benchmark(prepared, scene, realtime=realtime, time_limit_s=limit)
            unit_s.append(fft_seconds(samples))
            numbers["held to real time" if realtime else "as fast as it goes"] = result
            alone = {}
            if not realtime:
                options["own_process"] = False
                single = prepare_benchmark(scene, methods, Path(folder) / "alone", **options)
                alone = alone_seconds(single, scene, batch=args.batch)
                alone |= {"(six blocks that copy)": gateway_seconds(samples)}
                unit_s.append(fft_seconds(samples))
            print(f"one FFT of {samples} points, us: " + ", ".join(f"{1e6 * u:.1f}" for u in unit_s))
            _print(result, realtime, scene.waveform.sweep_s, sorted(unit_s)[len(unit_s) // 2], alone)
    if args.json:
        args.json.write_text(json.dumps({k: _numbers(r) for k, r in numbers.items()}, indent=1))
    return 0 if numbers["as fast as it goes"].real_time_factor >= 1.0 else 1


def _print(result, realtime: bool, sweep_s: float, fft_s: float, alone: dict) -> None:  # noqa: ANN001 - imported late
    title = "held to real time" if realtime else "as fast as it goes"
    print(f"{title}: {result.signal_s:.1f} s of signal in {result.wall_s:.1f} s", flush=True)
    frames = result.signal_s / sweep_s
    per_frame = 1 / (frames * fft_s)
    print(
        f"  CPU               {per_frame * result.process_cpu_s:.1f} FFTs per frame "
        f"({1e3 / result.signal_s * result.process_cpu_s:.0f} ms per second of signal), of which"
    )
    print(f"    {'':24} {'FFTs':>7} {'alone':>7} {'calls per frame':>16}")
    names = dict.fromkeys(sorted(result.cpu_s, key=lambda name: -result.cpu_s[name])) | dict.fromkeys(alone)
    for name in names:
        cost = f"{per_frame * result.cpu_s[name]:.2f}" if name in result.cpu_s else ""
        bare = f"{alone[name] / fft_s:.2f}" if name in alone else ""
        calls = f"{result.calls[name] / frames:.2f}" if name in result.calls else ""
        print(f"    {name:24} {cost:>7} {bare:>7} {calls:>16}")
    if not realtime:
        print(f"  real-time factor  {result.real_time_factor:.2f}")
    for method, latency in result.latency_ms.items():
        if latency.size:
            middle, high = (float(v) for v in _percentiles(latency))
            print(f"  latency {method:12} median {middle:.1f} ms, p99 {high:.1f} ms")
    print(f"  results           {result.frames}, {_share(result, frames)} of the frames sent")
    print(f"  dropped frames    {result.dropped_frames}, lost samples {result.lost_samples}")
    if result.skipped_frames:
        print(f"  network spared    {result.skipped_frames} frames")
    mega = 1 / 1024**2
    print(
        f"  memory            {mega * result.memory_bytes:.0f} MiB, "
        f"grown by {mega * result.memory_growth_bytes:.1f} MiB"
    )


def _share(result, frames: float) -> str:  # noqa: ANN001
    share = min(result.frames.values()) / max(1.0, frames)
    return f"{100 * min(1.0, share):.1f} %"


def _percentiles(values):  # noqa: ANN001, ANN202
    import numpy as np

    return np.percentile(values, [50, 99])


def _numbers(result) -> dict:  # noqa: ANN001
    latency = {
        m: dict(zip(("median", "p99"), map(float, _percentiles(v)), strict=True))
        for m, v in result.latency_ms.items()
        if v.size
    }
    return {
        "signal_s": result.signal_s,
        "wall_s": result.wall_s,
        "real_time_factor": result.real_time_factor,
        "process_cpu_s": result.process_cpu_s,
        "cpu_s": result.cpu_s,
        "calls": result.calls,
        "frames": result.frames,
        "latency_ms": latency,
        "dropped_frames": result.dropped_frames,
        "lost_samples": result.lost_samples,
        "skipped_frames": result.skipped_frames,
        "memory_bytes": result.memory_bytes,
        "memory_growth_bytes": result.memory_growth_bytes,
    }


if __name__ == "__main__":
    raise SystemExit(main())
