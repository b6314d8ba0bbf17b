"""How fast the live path runs: CPU by block in FFTs, real-time factor, latency, drops, memory.

    .venv/bin/python flowgraphs/realtime_benchmark.py                       # 60 s of signal, none and tcae
    .venv/bin/python flowgraphs/realtime_benchmark.py --seconds 10 --methods none,whitening
    .venv/bin/python flowgraphs/realtime_benchmark.py --skip-clean --overlap 0.3
    .venv/bin/python flowgraphs/realtime_benchmark.py --rate-hz 30e6 --methods none,whitening --seconds 10
    .venv/bin/python flowgraphs/realtime_benchmark.py --seconds 20 --out results/realtime  # and a report

Two runs of the simulated flowgraph: as fast as it goes (real-time factor, CPU, memory), then held to 7.5 MS/s with the
drop policy of the air (latency, drops). The simulated transmitters and channel run on the same cores and count. Cost is
in FFTs: CPU time per frame over that of one complex64 FFT of a frame, timed in the same run. Each block's function
alone in a loop, and its calls per frame, are given as well.
"""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ...evaluation.engine.options import Parser, command, command_of, names_of, number, path

PROGRAM, COMMAND = "realtime_benchmark", "benchmark"
FREE, HELD = "as fast as it goes", "held to real time"


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    parser.option("--scene", "YAML file or shipped scene", default="paper_qpsk")
    parser.option("--methods", "with commas", default="none,tcae")
    parser.option("--seconds", "of signal, each run", number(float, 0.01, 86_400), 60.0)
    parser.option(
        "--rate-hz",
        "sample rate and swept bandwidth, in place of the scene's (the network takes 7.5e6 alone)",
        number(float, 1e3, 1e9),
    )
    parser.option("--overlap", "of the interference", number(float, 0, 1), 1.0)
    parser.option("--batch", "frames a run of the network takes at most", number(int, 1, 4096), 8)
    parser.flag("--one-process", "network in the flowgraph's own process, on any core")
    parser.flag("--skip-clean", "frames without interference skip the network")
    parser.flag("--tracked", "an altitude tracker instead of every altimeter")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--free-only", action="store_true", help="leave out the run held to real time")
    which.add_argument(
        "--held-only", action="store_true", help="only the run held to real time, and no functions alone"
    )
    parser.option("--out", "result folder for report.md, report.html and report.json (default: none)", path)
    return parser


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print; returns 0 if real time is kept (--held-only: without a drop), else 1, or 2 after one line."""
    parser = _parser()
    args = parser.parse_args(argv)
    if args.held_only and args.out:
        parser.error("--out reports a run that goes as fast as it can; leave out --held-only")
    from ...core.mitigation import METHODS
    from ...core.scene import load_scene, scene_to_mapping
    from ...evaluation.engine.study import Run, peak_memory_bytes
    from ...evaluation.results.folder import RunFolder, versions
    from .alone import alone_seconds, gateway_seconds
    from .report import Benchmark, tables_of, write_report
    from .study import at_rate, fft_seconds, fly_benchmark, long_scene, prepare_benchmark

    begin = time.monotonic()
    methods = names_of(parser, "--methods", args.methods, METHODS)
    found = {}
    scene = load_scene(args.scene)
    scene = scene.at(overlap=args.overlap) if scene.interference else scene
    scene = long_scene(at_rate(scene, args.rate_hz) if args.rate_hz else scene, args.seconds)
    samples = scene.waveform.samples_per_frame
    options = {
        "batch": args.batch,
        "skip_clean": args.skip_clean,
        "own_process": not args.one_process,
        "track": args.tracked,
    }
    if args.out:  # before the runs, so that an unsuitable folder is refused at once
        head = {"study": "realtime", "command": command_of(args, parser), "scene": scene_to_mapping(scene)}
        head |= {"methods": list(methods), **options, "versions": versions("tcae" in methods)}
        folder = RunFolder(args.out, head, replace=True)
    with tempfile.TemporaryDirectory(prefix="radalt_") as build:
        for realtime in [False] * (not args.held_only) + [True] * (not args.free_only):
            prepared = prepare_benchmark(scene, methods, Path(build), realtime=realtime, **options)
            limit = 20.0 * args.seconds * max(1.0, scene.waveform.rate_hz / 7.5e6) + 60.0
            unit_s = fft_seconds(samples)
            result = fly_benchmark(prepared, scene, realtime=realtime, time_limit_s=limit)
            title = HELD if realtime else FREE
            found[title] = Benchmark(result, 0.5 * (unit_s + fft_seconds(samples)))
            print(f"{title}: {result.signal_s:.1f} s of signal in {result.wall_s:.1f} s", flush=True)
        if not args.held_only:
            # last, since it loads the network into this process, whose memory is measured before
            alone, apart = Path(build) / "alone", options | {"own_process": False}
            in_turn = prepare_benchmark(scene, methods, alone, realtime=False, **apart)
            unit_s = fft_seconds(samples)
            alone_s = alone_seconds(in_turn, scene, batch=args.batch)
            alone_s["(six blocks that copy)"] = gateway_seconds(samples)
            # the FFT's time changes with the machine's load: timed again, and scaled to that of the run
            share = found[FREE].fft_s / (0.5 * (unit_s + fft_seconds(samples)))
            found[FREE] = replace(found[FREE], alone_s={name: share * s for name, s in alone_s.items()})
    sweep_s = scene.waveform.sweep_s
    shown = tables_of({title: benchmark.numbers(sweep_s) for title, benchmark in found.items()})
    print("", *filter(None, shown.values()), sep="\n\n")
    if args.held_only:
        return 0 if found[HELD].measured.dropped_frames == 0 else 1
    if args.out:
        wall_s = round(time.monotonic() - begin, 3)
        run = Run(1, len(found), 0, wall_s, peak_memory_bytes(), folder.head["command"])
        print(write_report(folder, found, sweep_s, run))
        folder.close()
    return 0 if found[FREE].measured.real_time_factor >= 1.0 else 1
