#!/usr/bin/env python3
"""How fast the live path runs: real-time factor, CPU by block, latency, drops, memory.

    .venv/bin/python flowgraphs/realtime_benchmark.py                       # 60 s of signal, none and tcae
    .venv/bin/python flowgraphs/realtime_benchmark.py --seconds 10 --methods none,whitening
    .venv/bin/python flowgraphs/realtime_benchmark.py --skip-clean --overlap 0.3

Two runs of the simulated flowgraph: as fast as it goes (real-time factor, CPU, memory), then held to 7.5 MS/s with the
drop policy of the air (latency, drops). The simulated transmitters and channel run on the same cores and count.
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
    add("--overlap", type=number(float, 0, 1), default=1.0, help="of the interference (%(default)g)")
    add(
        "--batch",
        type=number(int, 1, 4096),
        default=8,
        help="frames a run of the network takes at most (%(default)s)",
    )
    add("--one-process", action="store_true", help="network in the flowgraph's own process, on any core")
    add("--skip-clean", action="store_true", help="frames without interference skip the network")
    add("--tracked", action="store_true", help="an altitude tracker in the place of every altimeter")
    add("--free-only", action="store_true", help="leave out the run held to real time")
    add("--json", type=path, metavar="FILE", help="write the numbers, too")
    return parser


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print; returns 0 where real time is kept, 1 where not, 2 after one line on what is wrong."""
    args = _parser().parse_args(argv)
    from gnuradio.radalt.core.scene import load_scene
    from gnuradio.radalt.evaluation.realtime.study import (
        fft_seconds,
        fly_benchmark,
        long_scene,
        prepare_benchmark,
    )

    methods = tuple(m.strip() for m in args.methods.split(","))
    numbers = {}
    scene = load_scene(args.scene)
    scene = scene.at(overlap=args.overlap) if scene.interference else scene
    scene = long_scene(scene, args.seconds)
    with tempfile.TemporaryDirectory(prefix="radalt_") as folder:
        for realtime in (False,) if args.free_only else (False, True):
            options = {"realtime": realtime, "batch": args.batch, "skip_clean": args.skip_clean}
            options |= {"own_process": not args.one_process, "track": args.tracked}
            prepared = prepare_benchmark(scene, methods, Path(folder), **options)
            limit = 20.0 * args.seconds + 60.0
            unit_s = [fft_seconds(scene.waveform.samples_per_frame)]
            result = fly_benchmark(prepared, scene, realtime=realtime, time_limit_s=limit)
            unit_s.append(fft_seconds(scene.waveform.samples_per_frame))
            numbers["held to real time" if realtime else "as fast as it goes"] = result
            before, after = (1e6 * u for u in unit_s)
            print(f"one FFT of a frame: {before:.1f} us before the run, {after:.1f} after")
            _print(result, realtime, scene.waveform.sweep_s, sum(unit_s) / 2)
    if args.json:
        args.json.write_text(json.dumps({k: _numbers(r) for k, r in numbers.items()}, indent=1))
    return 0 if numbers["as fast as it goes"].real_time_factor >= 1.0 else 1


def _print(result, realtime: bool, sweep_s: float, fft_s: float) -> None:  # noqa: ANN001 - imported late
    title = "held to real time" if realtime else "as fast as it goes"
    print(f"{title}: {result.signal_s:.1f} s of signal in {result.wall_s:.1f} s", flush=True)
    if not realtime:
        print(f"  real-time factor  {result.real_time_factor:.2f}")
    per_s, per_frame = 1e3 / result.signal_s, sweep_s / result.signal_s / fft_s
    print(
        f"  CPU               {per_frame * result.process_cpu_s:.1f} FFTs per frame "
        f"({per_s * result.process_cpu_s:.0f} ms per second of signal), of which"
    )
    for name, seconds in sorted(result.cpu_s.items(), key=lambda item: -item[1]):
        print(f"    {name:24} {per_frame * seconds:7.2f} {per_s * seconds:9.1f}")
    for method, latency in result.latency_ms.items():
        if latency.size:
            middle, high = (float(v) for v in _percentiles(latency))
            print(f"  latency {method:12} median {middle:.1f} ms, p99 {high:.1f} ms")
    print(f"  results           {result.frames}")
    print(f"  dropped frames    {result.dropped_frames}, lost samples {result.lost_samples}")
    if result.skipped_frames:
        print(f"  network spared    {result.skipped_frames} frames")
    mega = 1 / 1024**2
    print(
        f"  memory            {mega * result.memory_bytes:.0f} MiB, "
        f"grown by {mega * result.memory_growth_bytes:.1f} MiB"
    )


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
