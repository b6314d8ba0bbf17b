#!/usr/bin/env python3
"""Flowgraphs made mechanically from the two that are drawn by hand: `make flowgraphs`.

    ota_sim.grc       ota_b210.grc with the simulated channel instead of radios, at an SIR at which methods differ
    ota_live_sim.grc  ota_live.grc likewise, at real time at most

Run it after every change of ota_b210.grc or ota_live.grc; a test compares.
"""

from __future__ import annotations

from _tool import FLOWGRAPHS  # isort: skip - first: Ctrl-C, one core, a quiet log, the package on the path

from collections.abc import Sequence
from typing import Any

from radalt.evaluation.engine.options import Parser, command

PROGRAM = "make_flowgraphs"
SIR_DB = -30  # at the scene's -10 dB all methods of the first run have a Pd of 1


def made() -> dict[str, dict[str, Any]]:
    """File name -> flowgraph."""
    from radalt.evaluation.flowgraph.rewrite import load_grc, simulate

    air, live = load_grc(FLOWGRAPHS / "ota_b210.grc"), load_grc(FLOWGRAPHS / "ota_live.grc")
    simulated, live_simulated = simulate(air), simulate(live, "ota_live_sim", realtime=True)
    _lay_out(air, simulated)
    _lay_out(live, live_simulated)
    parameter = next(block for block in simulated["blocks"] if block["name"] == "sir_db")
    parameter["parameters"]["value"] = f'"{SIR_DB}"'
    return {
        "ota_sim.grc": simulated,
        "ota_live_sim.grc": live_simulated,
    }


def _lay_out(air: dict[str, Any], simulated: dict[str, Any]) -> None:
    """Place the channel where the gates are, and the receiver in line with it unless it has controls next to it."""
    places = {block["name"]: block["states"]["coordinate"] for block in simulated["blocks"]}
    gates = [b["states"]["coordinate"] for b in air["blocks"] if b["name"] in ("radar_gate", "jammer_gate")]
    top = 8 * round(sum(y for _, y in gates) / len(gates) / 8)
    places["simulated_channel"][:] = [gates[0][0] + 16, top]
    if "reacquire" not in places:
        places["frame_segmenter"][1] = top + 8  # aligns its input with the channel's output
        line = places["note_transmit"][1]
        places["note_receive"][:] = [places["frame_segmenter"][0] - 64, line]


def _parser() -> Parser:
    return Parser(PROGRAM, __doc__)


@command(PROGRAM)
def main(argv: Sequence[str] | None = None) -> int:
    """Write the files next to this one."""
    _parser().parse_args(argv)
    from radalt.evaluation.flowgraph.generate import save_as_companion

    for name, data in made().items():
        save_as_companion(data, FLOWGRAPHS / name)
        print(FLOWGRAPHS / name)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
