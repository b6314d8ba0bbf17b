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
    parser.flag("--sim", "simulated channel in place of the two B210s")
    parser.option("--scene", "YAML file or shipped scene", default="paper_qpsk")
    parser.option("--methods", "methods separated by commas", default="none,tcae")
    parser.option("--telemetry", "PUB endpoint", default="tcp://127.0.0.1:5556")
    parser.option("--control", "REP endpoint", default="tcp://127.0.0.1:5557")
    parser.flag("--network", "allow endpoints that other machines reach")
    parser.option(
        "--keep-alive-s",
        "with radios: stop transmitting after this time without a request; 0 (default): never",
        number(float, 0, 86400),
        0.0,
    )
    parser.flag("--transmit", "with radios: allow transmission")
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
