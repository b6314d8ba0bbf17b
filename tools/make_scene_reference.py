#!/usr/bin/env python3
"""Write docs/scene-reference.md: every key of a scene, from its dataclasses.

    .venv/bin/python tools/make_scene_reference.py

Meanings are from the strings below the fields, units from the names, defaults from the fields. Ranges are from the
reader's own messages about values that are far too large, far too small, or unknown words.
"""

from __future__ import annotations

import argparse
import ast
import dataclasses
import inspect
import itertools
import re
import sys
import textwrap
import types
import typing
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "python"))

from radalt.core.interference.effects import Impairments  # noqa: E402 - the path first
from radalt.core.interference.emitters import emitter_class, emitter_names  # noqa: E402 - the path first
from radalt.core.interference.placement import Interferer  # noqa: E402
from radalt.core.mitigation import METHODS, create  # noqa: E402, F401
from radalt.core.scene import Scene, SceneError, parse_scene  # noqa: E402

PAGE = ROOT / "docs" / "scene-reference.md"
UNITS = (
    ("_m_per_s2", "m/s^2"),
    ("_m_per_s", "m/s"), ("_hz_per_s", "Hz/s"), ("_per_s", "1/s"), ("_dbi", "dBi"), ("_dbm", "dBm"), ("_db", "dB"),
    ("_hz", "Hz"), ("_ppm", "ppm"), ("_deg", "degrees"), ("_rad", "rad"), ("_ft", "ft"), ("_us", "us"), ("_m", "m"),
    ("_s", "s"), ("_samples", "samples"), ("_frames", "frames"), ("_cells", "cells"), ("_bits", "bits"),
    ("_w", "W"), ("_outputs", "outputs"), ("seconds", "s"),
)  # fmt: skip
HEAD = """# Scene reference

A scene is one YAML file. Every key has a default, so a file holds only what differs:

```yaml
name: my_case
interference:
  qpsk: {sir_db: -28.0, overlap: 0.5, bandwidth_hz: 2.0e+6}
channel: {snr_db: 10.0}
methods: [none, whitening, tcae]
sweep: {overlap: [0.0, 0.5, 1.0]}
```

    .venv/bin/radalt eval --sim --plan --scene my_case.yaml

prints what a run would build. A key, type or range that does not fit gets one line. YAML reads `1e6` as text, so write
`1.0e+6`. *Range* is what the reader accepts; where it is empty, any number. Some keys limit each other; the
line then names both. Relative names of files are sought next to the scene, then in the working folder. Where a number's
default is *none*, `null` in a file stands for it.

Made by `.venv/bin/python tools/make_scene_reference.py` from the code.
"""


def unit(name: str) -> str:
    """Unit by the suffix of a name."""
    return next((text for end, text in UNITS if name.endswith(end)), "")


def meanings(kind: type) -> dict[str, str]:
    """Field -> the string below it, in a class and its bases."""
    out: dict[str, str] = {}
    for one in reversed(inspect.getmro(kind)[:-1]):
        body = ast.parse(textwrap.dedent(inspect.getsource(one))).body[0].body
        for field, text in itertools.pairwise(body):
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
                out[field.target.id] = " ".join(ast.literal_eval(text.value).split())
    return {name: re.sub(r"``?", "`", text).replace("|", "\\|") for name, text in out.items()}


def wanted(hint: object) -> str:
    """A type in words."""
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        parts = [part for part in typing.get_args(hint) if part is not type(None)]
        return " or ".join(dict.fromkeys(wanted(part) for part in parts))
    if typing.get_origin(hint) in (tuple, list):
        return f"list of {wanted(typing.get_args(hint)[0])}s"
    names = {float: "number", int: "whole number", bool: "true, false", str: "text"}
    return names.get(hint, "mapping")


def shown(value: object) -> str:
    """A default in YAML."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple):
        return "[" + ", ".join(shown(v) for v in value) + "]"
    return str(value) or "empty"


PROBES = {
    float: (1e30, -1e30, 9e11, -9e11, 1e6, -1e6, 199.0, -199.0, 2.5, -0.5),
    int: (10**18, -(10**18), 10**6, -(10**6), 300, -1),
    str: ("no such word",),
}


ANY_NUMBER = "within -1e+12..1e+12"


def own_part(words: str, key: str) -> str:
    """The part about one key of a line about several, such as "within 1..256, guard_cells 1.5 within 0..256"."""
    tried = re.compile(r"\b([a-z]\w*_\w+) [-+.e\d]+")
    if not tried.search(words):
        return words.strip("()") if words.startswith("(") else words
    parts = re.split(r", and |, | and ", tried.sub(r"\1", words))
    of_key = [part for part in parts if re.search(rf"\b{key}\b", part)]
    of_none = [part for part in parts if not re.search(r"[a-z]_[a-z]", part)]
    own = ", ".join(of_key or of_none or parts).removeprefix(f"{key} ")
    return "" if own == f"above {key}" else own  # said of the other key


def allowed(path: tuple[str, ...], hint: object) -> str:
    """The reader's own words about refused values of this key, those nearest to zero on either side."""
    many = typing.get_origin(hint) is tuple
    inner = [a for a in (typing.get_args(hint) or (hint,)) if a in PROBES]
    said = {}
    for value in PROBES[inner[0]] if inner else ():
        data: object = [value] if many else value
        for key in reversed(path):
            data = {"return" if key == "return_model" else key: data}
        try:
            parse_scene(data)
        except SceneError as error:
            words = re.search(
                r"(?:(?:have|has) to be|expected|allowed:|choose|is outside|is not one of|use(?= [\d-])|; (?=0 for)) "
                r"?(?:one of |a |whole |number )*((?:(?!: did you mean)[^;])+)",
                str(error),
            )
            if words and (path[-1] in str(error) or isinstance(value, str)):
                said[isinstance(value, str) or value > 0] = own_part(words[1].strip(), path[-1])
    own = [text for text in dict.fromkeys(said.values()) if text not in ("", "them", "mapping", ANY_NUMBER)]
    if len(own) > 1:  # one side has its own limit, the other that of all numbers of its unit
        own = [text for text in own if not re.fullmatch(r"within -(\S+)\.\.\1", text)]
    return "; ".join(own).replace("|", "\\|")


def rows(
    kind: type, path: tuple[str, ...], leave: frozenset[str] = frozenset(), within: str = ""
) -> list[str]:
    """Lines of a table; nested settings have lines with dotted keys."""
    hints, texts, out = typing.get_type_hints(kind), meanings(kind), []
    for field in dataclasses.fields(kind):
        if field.name in leave or not field.init:
            continue
        hint = hints[field.name]
        nested = [a for a in (hint, *typing.get_args(hint)) if dataclasses.is_dataclass(a)]
        default = field.default if field.default is not dataclasses.MISSING else (
            field.default_factory() if field.default_factory is not dataclasses.MISSING else "required"
        )  # fmt: skip
        key = f"{within}{field.name}"
        if nested and typing.get_origin(hint) is not tuple:
            said = texts.get(field.name) or first_line(nested[0])
            out.append(f"| `{key}` | {said} | mapping | {'none' if default is None else ''} | |")
            out += rows(nested[0], (*path, field.name), within=f"{key}.")
            continue
        text = texts.get(field.name, "")
        cells = (
            text,
            ", ".join(filter(None, (wanted(hint), unit(field.name)))),
            "one, as below" if nested else shown(default),
            allowed((*path, field.name), hint),
        )
        out.append(f"| `{key}` | " + " | ".join(cells) + " |")
        if nested:
            out += rows(nested[0], (*path, field.name), within=f"{key}[].")
    return out


TOP = "| key | meaning | type, unit | default | range |\n|---|---|---|---|---|"


def first_line(kind: type) -> str:
    """First paragraph of a class' docstring."""
    text = (inspect.getdoc(kind) or "").partition("\n\n")[0].replace("\n", " ")
    return re.sub(r"``?", "`", re.sub(r"(: | \()emitter protocol\)?", "", text))


def page() -> str:
    """The whole page."""
    hints = typing.get_type_hints(Scene)
    parts = {
        name: next((a for a in (h, *typing.get_args(h)) if dataclasses.is_dataclass(a)), None)
        for name, h in hints.items()
        if typing.get_origin(h) is not tuple
    }
    parts = {name: kind for name, kind in parts.items() if kind is not None}
    own = [
        line.replace("`return_model`", "`return`")
        for line in rows(Scene, (), frozenset({*parts, "interference", "total_sir_db"}))
    ]
    out = [HEAD, "## The scene itself", "", TOP, *own]
    for name, kind in parts.items():
        out += ["", f"## {name}", "", first_line(kind), "", TOP, *rows(kind, (name,))]
    out += [
        "",
        "## interference",
        "",
        "A mapping of one emitter, or a list of several. Each also takes these keys:",
        "",
    ]
    out += [TOP, *rows(Interferer, ("interference", "qpsk"), frozenset({"emitter", "channel"}))]
    out += [
        "",
        "And these effects, off where a scene does not name them:",
        "",
        TOP,
        *rows(Impairments, ("interference", "tones")),
        "",
    ]
    for name in emitter_names():
        kind = emitter_class(name)
        table = rows(kind, ("interference", name))
        out += [
            f"### {name}",
            "",
            first_line(kind),
            "",
            *([TOP, *table] if table else ["No keys of its own."]),
            "",
        ]
    return "\n".join(out).rstrip() + "\n"


def main() -> int:
    """Write the page."""
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    PAGE.write_text(page(), encoding="utf-8")
    print(PAGE)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
