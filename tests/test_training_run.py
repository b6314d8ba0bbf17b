"""A tiny training run through the same programs: loss falls, export loads, contract holds.

Skipped without the training environment, which `make train ARGS="--help"` makes."""

import csv
import os
import re

import numpy as np
import pytest
from frames import white
from waiting import ran

from radalt.core.mitigation import create
from radalt.core.waveform import Waveform

SWEEP = Waveform(5e6, 0.3e-3, 7.5e6)


@pytest.fixture(scope="module")
def training(root):
    """A program of `training/` in the training environment."""
    python = root / ".venv-train/bin/python"
    # 1.3 GB of PyTorch are no part of the set-up of `make test`
    if not (root / ".venv-train/.training").is_file():
        pytest.skip("no training environment; make train ARGS=--help makes it")

    def run(program, *arguments):
        environment = {**os.environ, "PYTHONPATH": str(root / "python"), "OMP_NUM_THREADS": "1"}
        words = (program if program == "-c" else root / "training" / program, *arguments)
        done = ran(python, *words, cwd=root, env=environment, limit_s=150)
        return done.returncode, done.stdout, done.stderr

    return run


@pytest.fixture(scope="module")
def runs(training, tmp_path_factory):
    """Folder of a run from nothing: 25 steps, validated every 5."""
    folder = tmp_path_factory.mktemp("runs")
    small = ("--runs", folder, "--batch", "4", "--validation", "8", "--threads", "1", "--interval", "5")
    status, said, errors = training("train.py", "compact_first", "--steps", "25", *small)
    assert status == 0, errors
    start, progress = said.splitlines()[:2]
    assert "compact_first: 25 steps of 4 examples on " in start and "first 8 examples to validate" in start
    assert re.fullmatch(r"\[1/25\] \S+ s a step, about \d+ min left", progress)
    return folder, small


def test_loss_falls(runs):
    with (runs[0] / "compact_first/log.csv").open() as file:
        losses = [float(row["validation_loss"]) for row in csv.DictReader(file)]
    assert len(losses) == 5
    assert losses[-1] < losses[0]


def test_a_stopped_run_goes_on_where_it_was(training, runs):
    """Killed while it wrote: half a new checkpoint, a row ahead of the old one and half a row are forgotten."""
    folder, small = runs
    (folder / "compact_first/checkpoint.new").write_bytes(b"PK half")
    with (folder / "compact_first/log.csv").open("a") as log:
        log.write("28,112,,9.9,0.001,1.0,1.0\n29,11")
    status, said, errors = training("train.py", "compact_first", "--steps", "30", *small)
    assert status == 0, errors
    assert "resumes from its own checkpoint at step 25" in said
    steps = [row.split(",")[0] for row in (folder / "compact_first/log.csv").read_text().splitlines()[1:]]
    assert steps == ["5", "10", "15", "20", "25", "30"]


def test_export_for_every_sweep_loads_and_is_the_same_network_at_its_own(training, root, tmp_path):
    """The weights of `tcae.onnx` in a graph that takes a sweep's tables: the same result but for rounding."""
    model = tmp_path / "any.onnx"
    chosen = ("compact", "--weights", root / "models/tcae.onnx", "--any-sweep", "--out", model)
    status, said, errors = training("export.py", *chosen)
    assert status == 0, errors
    assert "against PyTorch: relative error" in said
    rng = np.random.default_rng(2)
    frames = (Waveform().reference + 1.4 * white(rng, 2)).astype(np.complex64)
    unchecked = {"shift_check": False, "skip_white": False}
    mine = create("tcae", Waveform(), model=model, **unchecked).process(frames)
    own = create("tcae", Waveform()).process(frames)
    assert np.linalg.norm(mine - own) < 1e-4 * np.linalg.norm(own)
    frame = SWEEP.reference[None].copy()
    assert np.isfinite(create("tcae", SWEEP, model=model).process(frame).view(np.float32)).all()


def test_the_shipped_network_is_what_its_weights_export_to(training, root, tmp_path):
    """To the byte, so that what runs is what the code in `training/networks` says."""
    model = tmp_path / "again.onnx"
    weights = "--weights", root / "models/tcae.onnx"
    status, _, errors = training("export.py", "compact", *weights, "--out", model)
    assert status == 0, errors
    assert model.read_bytes() == (root / "models/tcae.onnx").read_bytes()


# the authors' layers by PyTorch's own: 2-D mixers, pooling with indices, unpooling, transposed convolutions
AUTHORS_CNN = """
import sys

sys.path[:0] = ["training", "python"]
import torch
from networks import build
from networks.cnn import _OverlapSave, _Pool
from torch import nn
from torch.nn import functional as f

from radalt.core.waveform import Waveform

torch.manual_seed(0)
net = build("cnn", Waveform()).eval()
x = torch.randn(2, 2, 7500)
with torch.no_grad():
    made = net(x)
    mixer = nn.Conv2d(1, 1, 2, padding=(0, 1))
    mixer.weight.copy_(net.mixer.weight[None])
    mixer.bias.copy_(net.mixer.bias)
    h, places = f.pad(mixer(x[:, None])[:, :, 0, :7500], (0, 4)), []
    for k, layer in enumerate(net.encoder):
        h = f.conv1d(f.pad(h, (99, 100)), layer.weight, layer.bias)
        h, at = f.max_pool1d(torch.relu(h) if k < 2 else h, 2, return_indices=True)
        places.append(at)
    for k, layer in enumerate(net.decoder):
        # the taps in reverse, and entering and leaving channels change places
        h = f.conv_transpose1d(f.max_unpool1d(h, places.pop(), 2), layer.weight.flip(2).transpose(0, 1), layer.bias)
        h = h[..., 100:-99]
        h = torch.relu(h) if k < 2 else h
    unmixer = nn.ConvTranspose2d(1, 1, 2)
    unmixer.weight.copy_(net.unmixer.weight[None])
    # one bias a rail, where the transposed 2-D convolution has one for both
    wanted = (unmixer(h[:, :, None, :7500]) - unmixer.bias)[:, 0, :, :7500] + net.unmixer.bias[:, None]
print(float((made - wanted).norm() / wanted.norm()), sum(p.numel() for p in net.parameters()))
x, taps = (torch.randn(s, dtype=torch.float64, requires_grad=True) for s in ((3, 2, 40), (2, 2, 5)))
torch.autograd.gradcheck(_OverlapSave.apply, (x, taps))
torch.autograd.gradcheck(lambda x: _Pool.apply(x)[0], (x,))
"""


def test_the_authors_cnn_is_what_pytorchs_own_layers_give(training):
    """IQ mixer, convolutions of 200 x 64 with pooling, the same mirrored; and the gradients of finite differences."""
    status, said, errors = training("-c", AUTHORS_CNN)
    assert status == 0, errors
    error, parameters = said.split()
    assert float(error) < 1e-5
    # encoder and decoder, their biases, mixer and unmixer
    assert int(parameters) == 2 * (200 * 64 + 200 * 64 * 64 + 200 * 64) + (64 + 64 + 1) * 2 + 5 + 6


def test_weights_stored_in_few_bits_start_a_run(training, runs, root):
    """`fc.onnx` stores int8; its training goes on from there."""
    folder, small = runs
    start = ("--start", root / "models/fc.onnx", "--name", "on")
    status, said, errors = training("train.py", "fc", "--steps", "1", *start, *small)
    assert status == 0, errors
    assert "starts from the weights of" in said
