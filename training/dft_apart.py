"""Cost of `tcae.onnx` with both DFTs in its graph, as shipped, and with SciPy's in batches between three parts of it.

    PYTHONPATH=python .venv-train/bin/python training/dft_apart.py 1 8 16 64

In FFTs of a frame, by frames per call: medians of five, by turns, least and greatest; FFTs timed in the same run.
"""

import sys
import time
from collections.abc import Callable

import numpy as np
import onnx
import onnxruntime as ort
from onnx import helper
from scipy import fft

from radalt.core.mitigation.tcae import default_model_path

# frame before and after the DFT stage, powers and gains by frequency, the modulus stage's logarithms
BEFORE, AFTER = "/modulus/Mul_12_output_0", "/Reshape_3_output_0"
POWER, GAIN = "/spectrum/Reshape_6_output_0", "/spectrum/Exp_2_output_0"
LOGS, LEVEL = "/modulus/Sub_1_output_0", "/modulus/Slice_2_output_0"
SHAPES = {"iq": (2, 7500), "clean": (2, 7500), BEFORE: (2, 7500), AFTER: (1, 15000)}
SHAPES |= {POWER: (1, 500), GAIN: (1, 500), LOGS: (11, 250), LEVEL: (1, 250)}


def part(arrays: dict[str, np.ndarray], entering: list[str], leaving: list[str]) -> Callable[[], None]:
    """A call that runs the nodes between these tensors on arrays by their names."""
    model, needed, kept = onnx.load(default_model_path()), set(leaving), []
    for node in reversed(model.graph.node):
        if needed.intersection(node.output) - set(entering):
            kept.insert(0, node)
            needed.update(node.input)
    into, out = ([helper.make_tensor_value_info(n, 1, None) for n in ends] for ends in (entering, leaving))
    graph = helper.make_graph(
        kept, "part", into, out, [t for t in model.graph.initializer if t.name in needed]
    )
    model = helper.make_model(graph, opset_imports=model.opset_import, ir_version=model.ir_version)
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    session = ort.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    binding, values = (
        session.io_binding(),
        {n: ort.OrtValue.ortvalue_from_numpy(a) for n, a in arrays.items()},
    )
    for name in entering:
        binding.bind_ortvalue_input(name, values[name])
    for name in leaving:
        binding.bind_ortvalue_output(name, values[name])
    return lambda: session.run_with_iobinding(binding)


def cpu_s(call: Callable[[], object], repeats: int) -> float:
    """CPU time of one call."""
    begin = time.thread_time()
    for _ in range(repeats):
        call()
    return (time.thread_time() - begin) / repeats


for count in map(int, sys.argv[1:]):
    arrays = {name: np.zeros((count, *shape), np.float32) for name, shape in SHAPES.items()}
    arrays["iq"][:] = np.random.default_rng(0).normal(0, 0.5**0.5, arrays["iq"].shape)
    frames, whole = np.empty((count, 7500), np.complex64), arrays | {"clean": np.empty_like(arrays["clean"])}
    calls = part(arrays, ["iq"], [BEFORE, LOGS, LEVEL]), part(arrays, [POWER], [GAIN])
    calls += (part(arrays, [AFTER, LOGS, LEVEL], ["clean"]),)

    def apart(a=arrays, frames=frames, calls=calls) -> None:  # noqa: ANN001
        """The three parts, and SciPy's DFTs between them."""
        calls[0]()
        frames.real, frames.imag = a[BEFORE][:, 0], a[BEFORE][:, 1]
        spectrum = fft.fft(frames, overwrite_x=True)
        groups = spectrum.view(np.float32).reshape(len(frames), 500, 30)
        np.einsum("ngk,ngk->ng", groups, groups, out=a[POWER][:, 0])
        a[POWER][:] /= 15
        calls[1]()
        groups *= a[GAIN][:, 0, :, None]
        back = fft.ifft(spectrum, overwrite_x=True)
        a[AFTER][:, 0, :7500], a[AFTER][:, 0, 7500:] = back.real, back.imag
        calls[2]()

    ways = {
        "graph": part(whole, ["iq"], ["clean"]),
        "DFTs apart": apart,
        "DFTs": part(whole, [BEFORE], [AFTER]),
    }
    found: dict[str, list[float]] = {name: [] for name in [*ways, "FFT's us"]}
    for _ in range(6):  # the first is left out
        for name, call in ways.items():
            unit_s = cpu_s(lambda x=frames[:1]: fft.fft(x), 500)
            found[name].append(cpu_s(call, max(2, 192 // count)) / count / unit_s)
            found["FFT's us"].append(1e6 * unit_s)
    error = np.linalg.norm(arrays["clean"] - whole["clean"]) / np.linalg.norm(whole["clean"])
    shown = [f"{k} {np.median(v[1:]):.1f} ({min(v[1:]):.1f} to {max(v[1:]):.1f})" for k, v in found.items()]
    print(f"{count:3} frames per call: {', '.join(shown)}; relative difference {error:.0e}", flush=True)
