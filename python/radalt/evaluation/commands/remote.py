"""Altimeter under interference, controlled by another program over ZMQ, in the simulated channel or on two B210s.

    .venv/bin/python flowgraphs/ota_remote.py --sim --scene paper_qpsk --methods none,tcae
    .venv/bin/python flowgraphs/control_client.py set --altitude 200 --sir-db=-20  # in another terminal, or from MATLAB
    .venv/bin/python flowgraphs/control_client.py stop

Runs in real time without end. Endpoints are on loopback by default; there is no authentication.
"""

from collections.abc import Sequence

from ..engine.options import Parser, command, named, names_of, number

PROGRAM, COMMAND = "ota_remote", "remote"


def _parser() -> Parser:
    parser = Parser(PROGRAM, __doc__)
    parser.add_argument("--sim", action="store_true", help="simulated channel in place of the two B210s")
    parser.add_argument("--scene", default="paper_qpsk", help="YAML file or shipped scene (%(default)s)")
    parser.add_argument("--methods", default="none,tcae", help="methods separated by commas (%(default)s)")
    parser.add_argument("--telemetry", default="tcp://127.0.0.1:5556", help="PUB endpoint (%(default)s)")
    parser.add_argument("--control", default="tcp://127.0.0.1:5557", help="REP endpoint (%(default)s)")
    parser.add_argument("--network", action="store_true", help="allow endpoints that other machines reach")
    parser.add_argument(
        "--keep-alive-s",
        type=number(float, 0, 86400),
        default=0.0,
        help="with radios: stop transmitting after this time without a request; 0 (default): never",
    )
    parser.add_argument("--transmit", action="store_true", help="with radios: allow transmission")
    return parser


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Run until stopped; returns 0, or 2 after one line about what does not fit."""
    parser = _parser()
    args = parser.parse_args(argv)
    from ...core.mitigation import METHODS
    from ...core.scene import load_scene
    from ..radios.remote import drive_remotely

    scene = load_scene(args.scene)
    state = drive_remotely(
        scene,
        names_of(parser, "--methods", args.methods, METHODS),
        telemetry=args.telemetry,
        control=args.control,
        network=args.network,
        keep_alive_s=args.keep_alive_s,
        sim=args.sim,
        transmit=args.transmit,
        log=lambda line: print(f"{named(PROGRAM)}: {line}", flush=True),
    )
    print(f"{named(PROGRAM)}: frames {state['frames']}, dropped {state['segmenter']['dropped_slow']}")
    return 0
