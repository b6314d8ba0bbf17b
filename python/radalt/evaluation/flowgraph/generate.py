"""Generation of Python from a flowgraph by GNU Radio's compiler."""

import contextlib
import copy
import io
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from ...core.parsing import write_yaml
from ...core.paths import share_dir
from ...core.scene import Scene
from . import FlowgraphError
from .rewrite import load_grc, prune, simulate, tracked, with_second_channel


@dataclass(frozen=True)
class Prepared:
    """A generated flowgraph, ready for any point of its scene."""

    module: Path  # generated Python file, named as its class
    methods: tuple[str, ...] = ()  # methods in the flowgraph


def grc_dirs() -> list[str]:
    """Folders with block descriptions: GNU Radio's and this module's (in-tree or installed)."""
    share = share_dir()
    own = share / "grc" if (share / "grc").is_dir() else share.parent / "gnuradio" / "grc" / "blocks"
    return [str(own)]


@lru_cache(maxsize=1)
def _platform(*own: str) -> Any:
    """GNU Radio's compiler with its library of blocks, loaded once from hundreds of files."""
    from gnuradio import gr

    with contextlib.redirect_stdout(io.StringIO()):
        # the compiler stores the stdout of its first import for its messages; its warning of a missing throttle does
        # not apply to a finite source
        from gnuradio.grc.core.platform import Platform

    platform = Platform(
        version=gr.version(),
        version_parts=(gr.major_version(), gr.api_version(), gr.minor_version()),
        prefs=gr.prefs(),
    )
    # docstrings are for the companion's window; collecting them imports all of GNU Radio in a process
    platform._docstring_extractor.start = lambda: None
    platform.build_library([p for p in platform.config.block_paths if p not in own] + list(own))
    return platform


@lru_cache(maxsize=1)
def shipped() -> dict[str, Any]:
    """``ota_b210.grc``, from which all other flowgraphs are derived; read once, and never changed in place."""
    return load_grc(share_dir() / "flowgraphs" / "ota_b210.grc")


def _imported(data: dict[str, Any], path: Path) -> tuple[Any, Any]:
    """GNU Radio's compiler, and the flowgraph in it."""
    platform = _platform(*grc_dirs())
    flow_graph = platform.make_flow_graph()
    flow_graph.import_data(copy.deepcopy(data))
    flow_graph.grc_file_path = str(path)
    flow_graph.rewrite()
    return platform, flow_graph


def save_as_companion(data: dict[str, Any], path: Path) -> None:
    """Write a .grc file in the companion's own form: saving it there changes no line that nobody changed."""
    platform, flow_graph = _imported(data, path)
    platform.save_flow_graph(str(path), flow_graph)


def generate(data: dict[str, Any], folder: Path) -> Path:
    """Write the .grc file and generate Python by GNU Radio's compiler; returns ``<id>.py``, next to ``<id>.grc``.

    Raises FlowgraphError if a block is missing or the flowgraph is not valid; names the first error.
    """
    name = data["options"]["parameters"]["id"]
    path = write_yaml(folder / f"{name}.grc", data, sort_keys=False, width=100)
    platform, flow_graph = _imported(data, path)
    flow_graph.validate()
    dummies = [block.name for block in flow_graph.blocks if block.is_dummy_block]
    if dummies:
        raise FlowgraphError(
            f"flowgraph {name}: no description for block {dummies[0]!r}; is the module installed?"
        )
    if not flow_graph.is_valid():
        element, message = next(iter(flow_graph.iter_error_messages()))
        raise FlowgraphError(
            f"flowgraph {name} is not valid: {getattr(element, 'name', element)}: {message.strip()}"
        )
    platform.Generator(flow_graph, str(folder)).write()
    return folder / f"{name}.py"


@lru_cache(maxsize=1)
def _scratch() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="radalt_")


def generated_here(data: dict[str, Any]) -> Path:
    """`generate` into a folder of its own that is removed at the end of the process."""
    return generate(data, Path(tempfile.mkdtemp(dir=_scratch().name)))


def prepare(
    scene: Scene,
    methods: Sequence[str],
    build_dir: Path | str,
    *,
    track: bool = False,
    jammer: bool | None = None,
) -> Prepared:
    """Rewrite, prune and generate the simulated flowgraph of a scene, once for all of its points.

    There is a jammer chain if the scene has a jammer, unless ``jammer`` says otherwise, and a tracker behind every
    method with ``track``. ``build_dir`` receives ``.grc`` and ``.py``.
    """
    jammer = scene.has_jammer if jammer is None else jammer
    name = f"ota_sim_{'jam' if jammer else 'clear'}{'' if scene.auxiliary is None else '_two'}"
    data = prune(simulate(shipped(), name), methods, jammer)
    if track:
        data = tracked(data, f"{name}_tracked")
    if scene.auxiliary is not None:
        data = with_second_channel(data)
    return Prepared(generate(data, Path(build_dir)), tuple(methods))
