"""Export a trained network to ONNX with the module's contract, check it against PyTorch, and make smaller variants.

    PYTHONPATH=python .venv-train/bin/python training/export.py compact --out models/tcae.onnx
    PYTHONPATH=python .venv-train/bin/python training/export.py any_sweep --any-sweep --out models/any_sweep.onnx

The second writes a network that serves every sweep. ``--weights`` takes weights and provenance from an exported model.

Variants store the weights in fewer bits than ``float32`` and widen them when the model is loaded: the arithmetic stays
float32.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from configs import CONFIGS
from data import content_hash, description, make_batch
from networks import build
from networks.any_sweep import AnySweep
from networks.layers import Tables
from onnx import TensorProto, helper, numpy_helper
from recipes import RECIPES
from train import RUNS, exported_weights, normalise

from radalt.core.mitigation.any_sweep import layout_of, resampled, tables_of
from radalt.core.mitigation.tcae import ANY
from radalt.core.waveform import Waveform

ROOT = Path(__file__).resolve().parent.parent
TOLERANCE = 1e-4  # relative error of the exported graph against PyTorch
PRECISIONS = ("float32", "float16", "int8")
# sweeps on which a network for any sweep is checked
SWEEPS = (
    Waveform(5e6, 0.3e-3, 7.5e6),
    Waveform(),
    Waveform(15e6, 1e-3, 15e6, centered=False),
    Waveform(1e6, 10e-3, 2e6),
)
_SMALL = 1024  # elements below which a tensor stays float32: its bytes do not matter


def git_revision() -> str:
    """Last commit of a model's sources, with ``-dirty`` if they differ from it; ``unknown`` outside git."""
    sources = ["training/*.py", "training/networks", "python/radalt/core"]

    def git(*command: str) -> str:
        run = subprocess.run(["git", "-C", str(ROOT), *command], capture_output=True, text=True, check=True)
        return run.stdout.strip()

    try:
        revision = git("log", "-1", "--format=%H", "--", *sources)[:12]
        return revision + ("-dirty" if git("status", "--porcelain", "--", *sources) else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def exported_metadata(model: Path) -> dict[str, str]:
    """Metadata of an exported model."""
    return {entry.key: entry.value for entry in onnx.load(str(model)).metadata_props}


def data_hash(name: str) -> str:
    """Content hash of the first 1024 examples (`data.py` prints the hash of a whole finite set)."""
    return content_hash(CONFIGS[name], Waveform(), 1024)


def metadata(recipe_name: str, state: dict | None, network: torch.nn.Module) -> dict[str, str]:
    """Contract and provenance of a model."""
    recipe, waveform = RECIPES[recipe_name], Waveform()
    step = state["step"] if state else 0
    entries = {
        "radalt_frame_samples": str(waveform.samples_per_frame),
        "radalt_layout": "iq_channels_first",
        "radalt_normalisation": network.normalisation,
        "radalt_rate_hz": f"{waveform.rate_hz:g}",
        "radalt_centered": "1" if waveform.centered else "0",
        "radalt_network": recipe.network,
        "radalt_recipe": recipe_name,
        "radalt_weights": ",".join(name for name, _ in network.named_parameters()),
        "radalt_parameters": str(sum(p.numel() for p in network.parameters())),
        "radalt_training_steps": str(step),
        "radalt_training_examples": str(step * recipe.batch),
        "radalt_training_data": description(CONFIGS[recipe.data]),
        "radalt_training_data_sha256": data_hash(recipe.data),
        "radalt_git_revision": git_revision(),
        "radalt_licence": "GPL-3.0-or-later",
    }
    if state is None:
        entries["radalt_placeholder"] = "1"
    return entries


def export(network: torch.nn.Module, entries: dict[str, str], path: Path) -> None:
    """Write the float32 graph with its metadata."""
    example = torch.zeros(1, 2, Waveform().samples_per_frame)
    _write(network, (example,), {"iq": {0: "batch"}, "clean": {0: "batch"}}, entries, path)


def export_any_sweep(network: torch.nn.Module, entries: dict[str, str], path: Path) -> None:
    """Write the float32 graph that takes the tables of a sweep as inputs."""
    waveform = SWEEPS[0]  # a sweep whose sizes all differ from those of the training sweep
    layout = layout_of(waveform)
    tables = Tables(waveform, layout).state()
    frames = {0: "batch", 2: "samples"}
    # sizes that stay fixed: a convolution needs all but the first size of its weights
    fixed = {"ramp": (1, 2), "local": (1, 2), "halves": (0,), "stretch": (0,), "place": (0,)}
    axes = {"iq": frames, "clean": frames} | {
        name: {k: f"{name}_{k}" for k in range(t.ndim) if k not in fixed.get(name, ())}
        for name, t in tables.items()
    }
    contract = dict.fromkeys(("radalt_frame_samples", "radalt_rate_hz", "radalt_centered"), ANY)
    weights = ",".join(f"network.{name}" for name in entries["radalt_weights"].split(","))
    inputs = (torch.zeros(2, 2, layout.samples), *tables.values())
    _write(AnySweep(network), inputs, axes, entries | contract | {"radalt_weights": weights}, path)


def _write(
    network: torch.nn.Module,
    inputs: tuple[torch.Tensor, ...],
    axes: dict[str, dict[int, str]],
    entries: dict[str, str],
    path: Path,
) -> None:
    network.eval()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            inputs,
            str(path),
            dynamo=False,
            opset_version=17,
            do_constant_folding=False,  # so that weights keep their names; ONNX Runtime folds when it loads
            input_names=[name for name in axes if name != "clean"],
            output_names=["clean"],
            dynamic_axes=axes,
            custom_opsets={"com.microsoft": 1},
        )
    model = onnx.load(str(path))
    helper.set_model_props(model, entries)
    onnx.checker.check_model(model)
    onnx.save(model, str(path))


def narrow(source: Path, target: Path, precision: str) -> None:
    """Write a variant of a float32 model."""
    model = onnx.load(str(source))
    entries = {p.key: p.value for p in model.metadata_props}
    _store(model, precision)
    helper.set_model_props(model, entries | {"radalt_precision": precision})
    onnx.save(model, str(target))


def _store(model: onnx.ModelProto, precision: str) -> None:
    """Replace large float32 initialisers by narrow ones with constant nodes that widen them."""
    graph = model.graph
    nodes, kept = [], []
    for tensor in list(graph.initializer):
        large = tensor.data_type == TensorProto.FLOAT and np.prod(tensor.dims) >= _SMALL
        if not large:
            kept.append(tensor)
            continue
        values, name = numpy_helper.to_array(tensor), tensor.name
        if precision == "float16":
            kept.append(numpy_helper.from_array(values.astype(np.float16), name + ".float16"))
            nodes.append(helper.make_node("Cast", [name + ".float16"], [name], to=TensorProto.FLOAT))
            continue
        axes = tuple(range(1, values.ndim))  # one scale per row
        scale = np.maximum(np.abs(values).max(axis=axes, keepdims=True), 1e-30).astype(np.float32) / 127
        codes = np.rint(values / scale).astype(np.int8)
        kept += [
            numpy_helper.from_array(codes, name + ".int8"),
            numpy_helper.from_array(scale, name + ".scale"),
        ]
        nodes.append(helper.make_node("Cast", [name + ".int8"], [name + ".wide"], to=TensorProto.FLOAT))
        nodes.append(helper.make_node("Mul", [name + ".wide", name + ".scale"], [name]))
    del graph.initializer[:]
    graph.initializer.extend(kept)
    old = list(graph.node)
    del graph.node[:]
    graph.node.extend(nodes + old)


def session(path: Path, threads: int = 1) -> onnxruntime.InferenceSession:
    """Session with the module's options."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def relative_error(path: Path, network: torch.nn.Module, recipe_name: str) -> float:
    """Largest over frames of ``|onnx - torch| / |torch|`` (2-norms) on fresh training-like examples."""
    received, _, _ = make_batch(CONFIGS[RECIPES[recipe_name].data], Waveform(), 987_654, 0, 16)
    x = normalise(torch.from_numpy(received), network.normalisation)
    with torch.no_grad():
        wanted = network(x).numpy()
    have = session(path).run(None, {"iq": x.numpy()})[0]
    return float(np.max(np.linalg.norm(have - wanted, axis=(1, 2)) / np.linalg.norm(wanted, axis=(1, 2))))


def sweep_error(path: Path, network: torch.nn.Module) -> float:
    """`relative_error` of a network for any sweep, the largest over `SWEEPS`, on noise with a return."""
    run, largest = session(path), 0.0
    for waveform in SWEEPS:
        layout = layout_of(waveform)
        clean = resampled(waveform.beat_shifted(300.0), layout.samples)
        noise = np.random.default_rng(0).standard_normal((2, layout.samples))
        x = (np.stack([clean.real, clean.imag]) + noise)[None].astype(np.float32)
        with torch.no_grad():
            wanted = network(torch.from_numpy(x), Tables(waveform, layout)).numpy()
        have = run.run(None, {"iq": x} | tables_of(waveform, layout))[0]
        largest = max(largest, float(np.linalg.norm(have - wanted) / np.linalg.norm(wanted)))
    return largest


def milliseconds(path: Path, repeats: int = 200) -> float:
    """Median time of one frame on one thread."""
    run = session(path)
    frame = np.random.default_rng(0).standard_normal((1, 2, Waveform().samples_per_frame)).astype(np.float32)
    times = []
    for _ in range(repeats + 10):
        start = time.perf_counter()
        run.run(None, {"iq": frame})
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times[10:]))


def main() -> int:
    """Export; returns 1 if the graph does not agree with PyTorch."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recipe", choices=sorted(RECIPES))
    parser.add_argument("--name", help="run below training/runs (default: the recipe's name)")
    parser.add_argument("--runs", type=Path, default=RUNS, help="folder of all runs (default: training/runs)")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--precision", choices=PRECISIONS, default="float32")
    parser.add_argument("--weights", type=Path, help="exported float32 model to take the weights from")
    parser.add_argument("--any-sweep", action="store_true", help="compact for every sweep, tables as inputs")
    parser.add_argument("--untrained", action="store_true", help="placeholder that starts as built")
    parser.add_argument(
        "--variants", action="store_true", help="also measure every precision, in a scratch folder"
    )
    args = parser.parse_args()
    torch.manual_seed(0)
    network = build(RECIPES[args.recipe].network, Waveform()).eval()
    state = None
    if args.weights:
        network.load_state_dict(exported_weights(args.weights))
    elif not args.untrained:
        path = args.runs / (args.name or args.recipe) / "checkpoint.pt"
        state = torch.load(path, map_location="cpu", weights_only=True)
        network.load_state_dict(state["network"])
    entries = exported_metadata(args.weights) if args.weights else metadata(args.recipe, state, network)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        plain = Path(scratch) / "float32.onnx"
        if args.any_sweep:
            export_any_sweep(network, entries, plain)
            error = sweep_error(plain, network)
        else:
            export(network, entries, plain)
            error = relative_error(plain, network, args.recipe)
        limit = getattr(network, "export_tolerance", TOLERANCE)
        print(f"float32 against PyTorch: relative error {error:.2e} (limit {limit:g})")
        if not error < limit:
            return 1
        if args.any_sweep:
            args.out.write_bytes(plain.read_bytes())
            return 0
        if args.precision == "float32":
            args.out.write_bytes(plain.read_bytes())
        else:
            narrow(plain, args.out, args.precision)
        _describe(args.out, network, args.recipe)
        for precision in PRECISIONS[1:] if args.variants else ():
            variant = Path(scratch) / f"{precision}.onnx"
            narrow(plain, variant, precision)
            _describe(variant, network, args.recipe)
    return 0


def _describe(path: Path, network: torch.nn.Module, recipe_name: str) -> None:
    content = path.read_bytes()
    error = relative_error(path, network, recipe_name)
    print(
        f"{path.name}: {len(content)} bytes, {milliseconds(path):.2f} ms per frame on one thread, "
        f"relative error {error:.2e}, sha256 {hashlib.sha256(content).hexdigest()}"
    )


if __name__ == "__main__":
    sys.exit(main())
