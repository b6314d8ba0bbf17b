"""Runs gnuradio-companion itself, has it draw flowgraphs, and prints as JSON what it shows; no test, used by them.

`xvfb-run -a /usr/bin/python3 tests/companion_probe.py [--run COUNT] [--picture FILE] FLOWGRAPH.grc ...`: --run executes
the first ones as the button does and adds what the console says, --picture saves the first as Screen Capture does."""

import argparse
import json
import os
import runpy
import shutil
import subprocess
import sys


def pictured(block, ports: bool) -> list[float]:
    """Left, top, right, bottom of a block on the canvas, with its ports or without."""
    (x, y), sides = block.coordinate, (block.active_sinks, block.active_sources)
    left, right = (ports * max((port.width for port in side), default=0) for side in sides)
    return [x - left, y, x + block.width + right, y + block.height]


def labels(block) -> list[list]:
    """[name, left, top, right, bottom] of each port's label on the canvas."""
    found = []
    for port in (*block.active_sinks, *block.active_sources):
        x, y = (sum(pair) for pair in zip(block.coordinate, port.coordinate, strict=True))
        found.append([f"{block.name}.{port.key}", x, y, x + port.width, y + port.height])
    return found


def wire(connection) -> list:
    """Names of both ports, and points of the line between them as the companion draws it (a Bezier curve)."""
    ends = [connection.source_port, connection.sink_port]
    (x0, y0), (x1, y1) = (port.connector_coordinate_absolute for port in ends)
    corners = [(x0 + 15, y0), (x0 + 50, y0), (x1 - 50, y1), (x1 - 15, y1)]
    points = [(x0, y0)]
    for step in range(41):
        t = step / 40
        weights = ((1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3)
        points.append([sum(w * c[axis] for w, c in zip(weights, corners, strict=True)) for axis in (0, 1)])
    return [[f"{port.parent_block.name}.{port.key}" for port in ends], [*points, (x1, y1)]]


def described(page) -> dict:
    """One page of the companion: blocks, where they stand, and whatever it complains about."""
    graph = page.flow_graph
    graph.update()
    graph.create_labels()
    graph.create_shapes()
    blocks = [
        {
            "name": block.name,
            "key": block.key,
            "dummy": block.is_dummy_block,
            "enabled": block.state == "enabled",
            "box": pictured(block, True),
            "inner": pictured(block, False),
        }
        for block in graph.blocks
    ]
    errors = [f"{getattr(e, 'name', e)}: {message}" for e, message in graph.iter_error_messages()]
    return {
        "file": page.file_path,
        "blocks": blocks,
        "connections": len(graph.connections),
        "labels": [label for block in graph.blocks for label in labels(block)],
        "wires": [wire(connection) for connection in graph.connections],
        "errors": errors,
    }


def windows(name: str) -> int:
    """Number of visible windows of the X server with this in their title."""
    command = ["xdotool", "search", "--onlyvisible", "--name", name]
    found = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    return len(found.stdout.split())


def finish(report: dict) -> None:
    print("PROBE " + json.dumps(report), flush=True)
    os._exit(0)  # the companion would ask what to do with open pages


def executions(pages: list, window, report: dict):
    """Runs each page's flowgraph, and keeps what the console says of it; the main loop asks for the next step."""
    from gnuradio.grc.gui import Actions

    text, before = window.console.text_display.get_buffer(), 0
    for page in pages:
        window.current_page = page
        Actions.FLOW_GRAPH_EXEC()
        yield
        while page.process is not None:
            yield
        said = text.get_text(*text.get_bounds(), False)
        report["consoles"].append(said[before:])
        before = len(said)
    finish(report)


def probe(run: int, picture: str) -> bool:
    """Called by the companion's own main loop until its window is on the screen: print, then quit."""
    from gi.repository import GLib, Gtk
    from gnuradio.grc.gui import Utils

    window = Gtk.Application.get_default().main_window
    title = window.get_title()
    if not windows(title.split(" ")[0]):
        return True  # not mapped yet: called again
    report = {"pages": [], "consoles": []}
    for page in window.get_pages():
        window.current_page = page
        report["pages"].append(described(page))
    if picture:
        Utils.make_screenshot(window.get_pages()[0].flow_graph, picture)
    steps = executions(window.get_pages()[:run], window, report)
    GLib.timeout_add(200, lambda: next(steps) is None)
    return False


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--run", type=int, default=0)
    parser.add_argument("--picture", default="")
    parser.add_argument("flowgraphs", nargs="+")
    arguments = parser.parse_args()
    import gi

    gi.require_version("Gtk", "3.0")
    from gi.repository import GLib

    GLib.timeout_add(300, probe, arguments.run, arguments.picture)
    companion = shutil.which("gnuradio-companion")
    sys.argv = [companion, *arguments.flowgraphs]
    runpy.run_path(companion, run_name="__main__")


if __name__ == "__main__":
    main()
