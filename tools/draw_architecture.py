#!/usr/bin/env python3
"""Figure of the rooms of python/radalt and their imports, read from the code.

Arrows that follow from others (transitive reduction) are not drawn.

    .venv/bin/python tools/draw_architecture.py          # docs/figures/architecture.svg
    .venv/bin/python tools/draw_architecture.py --list   # every import between rooms, for a terminal

Needs nothing but Python. tests/test_architecture.py holds the code to `ROOMS`, and the figure to the code.
"""

from __future__ import annotations

import argparse
import ast
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "python" / "radalt"
FIGURE = ROOT / "docs" / "figures" / "architecture.svg"

# In the order of the signal: a room imports only itself and rooms before it. The altimeter stands before the methods,
# since two of them judge their own output by an altimeter, a function of one frame (docs/design.md).
ROOMS = (
    "core",  # modules in core/ outside of its rooms
    "core.radio.device",  # numbers of radios, against which scenes are checked
    "core.returns",
    "core.interference",
    "core.channel",
    "core.altimeter",
    "core.timing",
    "core.tracker",
    "core.deramp",  # a deramping altimeter as data, with its detector
    "core.mitigation",
    "core.scene",
    "core.radio",
    "blocks",
    "evaluation",
    "bench",
    "api",
    "studies",
)


@dataclass(frozen=True)
class Import:
    """One import of a module of the package by another.

    Attributes
    ----------
    source, target : str
        Dotted names below the package; a package stands for its ``__init__.py``, "" for the whole.
    lazy : bool
        Within a function, so carried out when that is called.
    """

    source: str
    target: str
    lazy: bool


def modules(package: Path) -> dict[str, Path]:
    """Dotted name below the package -> file, packages by their ``__init__.py``."""
    found = {}
    for file in sorted(package.rglob("*.py")):
        parts = file.relative_to(package).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


def imports(package: Path = PACKAGE) -> list[Import]:
    """Every import within the package, without those of parents, which Python adds to each."""
    known = modules(package)
    found = []
    for name, file in known.items():
        base = name.split(".") if file.name == "__init__.py" else name.split(".")[:-1]
        for node, lazy in _statements(ast.parse(file.read_text(encoding="utf-8"))):
            targets = dict.fromkeys(_targets(node, [part for part in base if part], known, package.name))
            found += [Import(name, target, lazy) for target in targets if target != name]
    return found


def _statements(node: ast.AST, lazy: bool = False) -> Iterator[tuple[ast.stmt, bool]]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING":
            continue  # for type checkers only
        if isinstance(child, (ast.Import, ast.ImportFrom)):
            yield child, lazy
        yield from _statements(child, lazy or isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef)))


def _targets(node: ast.stmt, base: list[str], known: dict[str, Path], package: str) -> Iterator[str]:
    """Modules of the package named by a statement."""
    if isinstance(node, ast.Import):
        for alias in node.names:
            inside = _below(alias.name, package)
            if inside is not None:
                yield inside
        return
    if node.level:
        parent = base[: len(base) - node.level + 1]
        module = ".".join([*parent, *(node.module.split(".") if node.module else [])])
    else:
        module = _below(node.module or "", package)
    if module is None:
        return
    for alias in node.names:
        longer = f"{module}.{alias.name}".strip(".")
        yield longer if longer in known else module


def _below(name: str, package: str) -> str | None:
    """A module's name below the package, by either name of the package; None if it is outside."""
    for prefix in (f"gnuradio.{package}", package):
        if name == prefix or name.startswith(prefix + "."):
            return name[len(prefix) + 1 :]
    return None


def room_of(module: str) -> str | None:
    """The room of a module; None for the package itself, which only has its version."""
    mine = [room for room in ROOMS if module == room or module.startswith(room + ".")]
    return max(mine, key=len) if mine else None


def between_rooms(found: Sequence[Import]) -> dict[tuple[str, str], list[Import]]:
    """(importing room, imported room) -> imports, without those within a room and of the package itself."""
    arrows: dict[tuple[str, str], list[Import]] = {}
    for entry in found:
        rooms = room_of(entry.source), room_of(entry.target)
        if None not in rooms and rooms[0] != rooms[1]:
            arrows.setdefault(rooms, []).append(entry)
    return arrows


# -- the figure -----------------------------------------------------------------------------------------------------

_COLUMN, _LINE, _GAP, _EDGE = 300, 12, 34, 16
# rooms as wide as one of three columns; others share the width of all three with those of their layer
_NARROW = {
    "core.radio.device": 0,
    "core.interference": 1,
    "core.channel": 1,
    "core.returns": 2,
    "core.altimeter": 1,
    "core.timing": 2,
    "core.tracker": 2,
    "core.mitigation": 0,
    "core.scene": 1,
    "core.deramp": 0,
}
_COLOURS = {
    "core": "#DCEBF7",
    "bloc": "#FDECC8",
    "eval": "#D9F0E6",
    "benc": "#D9F0E6",
    "api": "#D9F0E6",
    "stud": "#E9E2F3",
}


def contents(room: str, package: Path = PACKAGE) -> str:
    """Names of a room's files and folders."""
    folder = package.joinpath(*room.split("."))
    if not folder.is_dir():
        return {"api": "simulate, method, evaluate, Report"}.get(room, "numbers of each type of radio")
    other = {r.rpartition(".")[2] for r in ROOMS if r.rpartition(".")[0] == room}
    files = [] if room in ("evaluation", "studies") else [f.stem for f in sorted(folder.glob("[!_]*.py"))]
    folders = [f.name + "/" for f in sorted(folder.iterdir()) if (f / "__init__.py").is_file()]
    return ", ".join(name for name in folders + files if name.rstrip("/") not in other)


def needed_arrows(arrows: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """Arrows that do not follow from others (transitive reduction)."""
    into: dict[str, set[str]] = {room: set() for room in ROOMS}
    for source, target in arrows:
        into[source].add(target)

    def reach(room: str) -> set[str]:
        return into[room].union(*(reach(other) for other in into[room]))

    return [
        (source, target)
        for source in ROOMS
        for target in ROOMS
        if target in into[source] and not any(target in reach(other) for other in into[source] - {target})
    ]


def draw(package: Path = PACKAGE) -> str:
    """The figure as SVG, importing rooms above imported ones, so that every arrow points down.

    Raises
    ------
    ValueError
        If an import would point up.
    """
    found = between_rooms(imports(package))
    up = [arrow for arrow in found if ROOMS.index(arrow[0]) < ROOMS.index(arrow[1])]
    if up:
        raise ValueError(f"{up[0][0]} imports {up[0][1]}, which stands after it: {found[up[0]][0]}")
    arrows = needed_arrows(found)
    layer: dict[str, int] = {}
    for room in ROOMS:
        layer[room] = 1 + max((layer[target] for source, target in arrows if source == room), default=-1)
    boxes, height = _places(layer, package)
    width = 2 * _EDGE + 3 * _COLUMN
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="DejaVu Sans, sans-serif">',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        '<path d="M0 0 L8 4 L0 8 z" fill="#444"/></marker></defs>',
        f'<rect width="{width}" height="{height}" fill="white"/>',
    ]
    # below the boxes, whose text stays readable where an arrow passes several layers
    parts += [
        _arrow(boxes[source], boxes[target], layer[source] - layer[target]) for source, target in arrows
    ]
    for room, (x, y, wide, high, lines) in boxes.items():
        parts += _box(room, x, y, wide, high, lines)
    return "\n".join([*parts, "</svg>"]) + "\n"


def _places(layer: dict[str, int], package: Path) -> tuple[dict[str, tuple], int]:
    """Room -> (x, y, width, height, lines of text), the highest layer first; and the figure's height."""
    boxes: dict[str, tuple] = {}
    y = _EDGE
    for level in range(max(layer.values()), -1, -1):
        here = [room for room in ROOMS if layer[room] == level]
        shared = [room for room in reversed(here) if room not in _NARROW]
        # room -> width, and how many of it to the left
        place = {room: (_COLUMN, _NARROW[room]) for room in here if room in _NARROW}
        place |= {room: (3 * _COLUMN // len(shared), k) for k, room in enumerate(shared)}
        text = {room: textwrap.wrap(contents(room, package), 44 * place[room][0] // _COLUMN) for room in here}
        high = 26 + _LINE * max(map(len, text.values()))
        for room, (wide, left) in place.items():
            boxes[room] = (_EDGE + 10 + wide * left, y, wide - 20, high, text[room])
        y += high + _GAP
    return boxes, y - _GAP + _EDGE


def _box(room: str, x: int, y: int, wide: int, high: int, lines: Sequence[str]) -> list[str]:
    shape = f'<rect x="{x}" y="{y}" width="{wide}" height="{high}" rx="5" '
    name = room.replace(".", "/") + ("" if room.endswith(("device", "api")) else "/")
    return [
        shape + f'fill="{_COLOURS[room[:4]]}" stroke="#666"/>',
        f'<text x="{x + 8}" y="{y + 16}" font-size="13" font-weight="bold">{escape(name)}</text>',
        *(
            f'<text x="{x + 8}" y="{y + 30 + _LINE * k}" font-size="10" fill="#333">{escape(line)}</text>'
            for k, line in enumerate(lines)
        ),
    ]


def _arrow(source: tuple, target: tuple, layers: int) -> str:
    """From the lower edge of one box to the upper edge of another, vertical if possible; longer ones farther left."""
    left, right = max(source[0], target[0]), min(source[0] + source[2], target[0] + target[2])
    if right > left:
        x0 = x1 = left + (right - left) * (0.5 - 0.08 * (layers - 1))
    else:
        x0, x1 = (b[0] + b[2] * share for b, share in ((source, 0.8), (target, 0.2)))
    return (
        f'<line x1="{x0:g}" y1="{source[1] + source[3]}" x2="{x1:g}" y2="{target[1] - 1}" stroke="#444" '
        'stroke-width="1.3" marker-end="url(#tip)"/>'
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Write the figure, or list the imports between rooms."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, default=FIGURE, help="file (default: docs/figures/architecture.svg)"
    )
    parser.add_argument("--list", action="store_true", help="print every import between rooms instead")
    args = parser.parse_args(argv)
    if args.list:
        for (source, target), found in sorted(between_rooms(imports()).items()):
            print(f"{source} -> {target}")
            for entry in found:
                print(f"    {entry.source} -> {entry.target}{' (lazy)' if entry.lazy else ''}")
        return 0
    args.out.write_text(draw(), encoding="utf-8")
    print(args.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
