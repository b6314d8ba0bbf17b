"""Flowgraphs with Embedded Python Blocks, for a companion without this module's block descriptions.

Each block of the module becomes a subclass of itself whose arguments all have defaults, as the companion requires;
parameters, connections and everything else are unchanged. The package has to be importable.
"""

from __future__ import annotations

import ast
import copy
import re
from pathlib import Path
from typing import Any

from .generate import grc_dirs
from .rewrite import load_grc

__all__ = ["embed", "source_of"]

_PREFIX = "radalt_"
_TEXT = ("string", "file_open", "file_save")  # parameter types that the companion quotes
_TAKEN = ("method",)  # live parameters whose names are attributes of the blocks: not live when embedded
_SCENE = "paper_qpsk"
_SPREAD = (1.15, 1.8)  # stretch of the layout (across, down): embedded blocks show every parameter
_HEADER = 216  # height of the rows with options, parameters and variables, pixels; they are not moved

# the companion constructs a block without arguments to find its ports, possibly in a Python without onnxruntime
_NETWORK = """\
        if scene is None:  # for the ports only: no network needed
            waveform = load_scene("{scene}").waveform
            _mitigation.MitigationBlock.__init__(self, "radalt_tcae", create("none", waveform))
            return
"""


def description(block_id: str) -> dict[str, Any]:
    """The companion's description of a block of this module."""
    for folder in grc_dirs():
        path = Path(folder) / f"{block_id}.block.yml"
        if path.is_file():
            return load_grc(path)
    raise FileNotFoundError(f"no {block_id}.block.yml in {', '.join(grc_dirs())}")


def _default(parameter: dict[str, Any]) -> str:
    """A parameter's default as Python source."""
    value = str(parameter.get("default", (parameter.get("options") or [""])[0]))
    return repr(value) if parameter["dtype"] in _TEXT else repr(ast.literal_eval(value))


def source_of(block_id: str) -> str:
    """Source of the embedded block for a block of this module; live parameters become properties."""
    block = description(block_id)
    name = block_id.removeprefix(_PREFIX)
    parameters = [p for p in block["parameters"] if p["id"] != "scene"]
    has_scene = len(parameters) < len(block["parameters"])
    signature = (["scene=None"] if has_scene else []) + [f"{p['id']}={_default(p)}" for p in parameters]
    arguments = ([f'scene or load_scene("{_SCENE}")'] if has_scene else []) + [
        f"{p['id']}={p['id']}" for p in parameters
    ]
    lines = ["from gnuradio import radalt"]
    if name == "tcae":
        lines += [
            "from radalt.blocks import _mitigation",
            "from radalt.core.mitigation import create",
        ]
    lines += ["from radalt.core.scene import load_scene"] if has_scene else []
    lines += [
        "",
        "",
        f"class {name}(radalt.{name}):",
        f'    """{block["label"]}, as gnuradio.radalt has it."""',
        "",
    ]
    lines += [f"    def __init__(self, {', '.join(signature)}):"]
    lines += _NETWORK.format(scene=_SCENE).splitlines() if name == "tcae" else []
    live = _callbacks(block)
    lines += [f"        self._live_{parameter} = {parameter}" for _, parameter in live]
    lines += [f"        super().__init__({', '.join(arguments)})"]
    for setter, parameter in live:
        lines += [
            "",
            "    @property",
            f"    def {parameter}(self):",
            f"        return self._live_{parameter}",
        ]
        lines += ["", f"    @{parameter}.setter", f"    def {parameter}(self, value):"]
        lines += [f"        self._live_{parameter} = value", f"        self.{setter}(value)"]
    return "\n".join(lines) + "\n"


def _callbacks(block: dict[str, Any]) -> list[tuple[str, str]]:
    """(setter, parameter) of a block's live parameters."""
    found = re.findall(r"(set_\w+)\(\$\{\s*(\w+)\s*\}\)", "\n".join(block["templates"].get("callbacks", [])))
    return [(setter, parameter) for setter, parameter in found if parameter not in _TAKEN]


def embed(data: dict[str, Any], name: str = "ota_embedded") -> dict[str, Any]:
    """The flowgraph with every block of this module replaced by an Embedded Python Block; nothing else differs.

    Parameters
    ----------
    data : dict
        Flowgraph from `load_grc`.
    name : str
        Identifier of the new flowgraph.
    """
    data = copy.deepcopy(data)
    data["options"]["parameters"]["id"] = name
    names = {block["name"] for block in data["blocks"] if block["id"].startswith(("parameter", "variable"))}
    for block in data["blocks"]:
        if block["id"].startswith(_PREFIX):
            _replace(block, names)
        x, y = block["states"]["coordinate"]
        if y >= _HEADER:
            block["states"]["coordinate"] = [
                _grid(x * _SPREAD[0]),
                _grid(_HEADER + (y - _HEADER) * _SPREAD[1]),
            ]
    return data


def _grid(value: float) -> int:
    return 8 * round(value / 8)


def _replace(block: dict[str, Any], names: set[str]) -> None:
    """Replace a block in place; ``names`` are the flowgraph's parameters and variables."""
    own = {p["id"]: p for p in description(block["id"])["parameters"]}
    values = {"_source_code": source_of(block["id"])}
    for key, parameter in own.items():
        given = block["parameters"].get(key)
        if given is None:
            values[key] = "None" if key == "scene" else _default(parameter)
        else:
            values[key] = _as_source(given, names) if parameter["dtype"] in _TEXT else given
    kept = ("affinity", "alias", "comment", "maxoutbuf", "minoutbuf")
    values |= {key: block["parameters"][key] for key in kept if key in block["parameters"]}
    block["id"], block["parameters"] = "epy_block", values


def _as_source(text: str, names: set[str]) -> str:
    """Source of a text field: the companion quotes a value unless it evaluates to text."""
    try:
        tree = ast.parse(text, mode="eval")
    except SyntaxError:
        return repr(text)
    used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    quoted = isinstance(tree.body, ast.Constant) and isinstance(tree.body.value, str)
    return text if quoted or used and used <= names else repr(text)
