"""Transmit gate: the last block before a radio's sink."""

import sys
from typing import Any

import numpy as np
from gnuradio import gr

from ..core.radio.transmit_gate import TransmitGate
from ..core.scene import Scene
from ._guard import guarded


class transmit_gate(gr.sync_block):
    """Zeros instead of samples, unless transmission is allowed; see `TransmitGate`.

    ``y = x`` while the scene states an enclosure, its numbers are plausible, ``transmit`` is set and control is
    alive, else ``y = 0``. It goes directly before every transmitting sink; the radios' set-up refuses a flowgraph
    without it.

    Category: [RadAlt]/Radio. Ports: ``in: complex > out: complex``.

    Parameters
    ----------
    scene : Scene
        ``radio`` states the enclosure, attenuation and gains.
    transmit : bool
        The command line's or the flowgraph's parameter ``transmit``.
    controlled : bool
        Whether the flowgraph has a remote control, whose heartbeat then has to come at least once per second.
    Example
    -------
    ``gate = radalt.transmit_gate(scene, transmit=True)``
    """

    def __init__(self, scene: Scene, transmit: bool = False, controlled: bool = False) -> None:
        gr.sync_block.__init__(self, "radalt_transmit_gate", [np.complex64], [np.complex64])
        self.gate = TransmitGate(scene, transmit, controlled=controlled)

    def start(self) -> bool:
        """Print once, at the start, why nothing will be transmitted."""
        why = self.gate.why_closed
        if why is not None:
            print(f"{self.alias()}: zeros only: {why}", file=sys.stderr, flush=True)
        return True

    @guarded
    def work(self, input_items, output_items) -> int:  # noqa: ANN001
        """Pass samples, or zeros."""
        self.gate.pass_into(input_items[0], output_items[0])
        return len(output_items[0])


def gates_of(top: Any) -> list[TransmitGate]:
    """Every gate of a flowgraph that attributes refer to: a Python block lives only while something does.

    Searched are the attributes of the flowgraph, of its hierarchical blocks and of plain objects among these, with
    lists, tuples, sets, dictionaries in them. Not searched are other blocks, and what plain objects refer to in turn.
    The set-up of radios refuses transmitters that anything but the flowgraph's own two gates feeds.
    """
    found: dict[int, TransmitGate] = {}
    seen: set[tuple[int, bool]] = set()

    def walk(value: Any, plain: bool) -> None:  # plain: attributes of plain objects, too
        if (id(value), plain) in seen:
            return
        seen.add((id(value), plain))
        if isinstance(value, transmit_gate):
            found[id(value)] = value.gate
        elif isinstance(value, (list, tuple, set, frozenset)):
            for item in list(value):
                walk(item, plain)
        elif isinstance(value, dict):
            for item in list(value.values()):
                walk(item, plain)
        elif value is top or isinstance(value, gr.hier_block2):
            walk(vars(value), True)
        elif plain and hasattr(value, "__dict__") and not hasattr(value, "to_basic_block"):
            walk(vars(value), False)

    walk(top, True)
    return list(found.values())
