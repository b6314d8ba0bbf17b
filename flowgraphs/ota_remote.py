#!/usr/bin/env python3
"""Altimeter under interference, driven by another program over ZMQ, in the simulated channel or on two B210s.

    python flowgraphs/ota_remote.py --sim --scene paper_qpsk --methods none,tcae
    python flowgraphs/control_client.py set --altitude 200 --sir-db=-20      # in another terminal, or from MATLAB
    python flowgraphs/control_client.py stop

Runs at real time and without end. Endpoints are on loopback unless you say otherwise; there is no authentication.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import _startup  # noqa: F401 - one core, a quiet log, the package on the path

PROGRAM = "ota_remote"


def main(argv: Sequence[str] | None = None) -> int:
    """Run until stopped; returns 0, or 2 after one line about what does not fit."""
    summary, _, details = __doc__.partition("\n\n")
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        description=summary,
        epilog=details,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--sim", action="store_true", help="simulated channel in place of the two B210s")
    parser.add_argument("--scene", default="paper_qpsk", help="YAML file or shipped scene (%(default)s)")
    parser.add_argument("--methods", default="none,tcae", help="with commas (%(default)s)")
    parser.add_argument("--telemetry", default="tcp://127.0.0.1:5556", help="PUB endpoint (%(default)s)")
    parser.add_argument("--control", default="tcp://127.0.0.1:5557", help="REP endpoint (%(default)s)")
    parser.add_argument("--transmit", action="store_true", help="on the air: allow transmission")
    args = parser.parse_args(argv)
    from gnuradio.radalt.core.scene import load_scene
    from gnuradio.radalt.evaluation.flowgraph import FlowgraphError
    from gnuradio.radalt.evaluation.radios.remote import drive_remotely

    try:
        scene = load_scene(args.scene)
        state = drive_remotely(
            scene,
            tuple(m.strip() for m in args.methods.split(",")),
            telemetry=args.telemetry,
            control=args.control,
            sim=args.sim,
            transmit=args.transmit,
            log=lambda line: print(f"{PROGRAM}: {line}", flush=True),
        )
    except (ValueError, FlowgraphError, OSError) as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return 2
    print(f"{PROGRAM}: frames {state['frames']}, dropped {state['segmenter']['dropped_slow']}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
