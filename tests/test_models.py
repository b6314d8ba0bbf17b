"""The shipped networks: what they claim about themselves and what physics says they must do, from their ONNX files."""

import hashlib
import os
import re
from functools import cache
from math import prod

import numpy as np
import pytest
from frames import returns, right
from google.protobuf.empty_pb2 import Empty
from google.protobuf.unknown_fields import UnknownFieldSet
from waiting import ran_python

from radalt import Altimeter, Waveform
from radalt.core.interference import Interferer, QpskEmitter, ToneEmitter, interference_frames
from radalt.core.mitigation import MitigationError, create

SHIPPED = ("tcae", "any_sweep", "paper", "cnn", "fc")
TRIALS = 120


@pytest.fixture(scope="module")
def models(root):
    return root / "models"


@pytest.fixture(scope="module")
def compact(models):
    return create("tcae", Waveform(), model=models / "tcae.onnx")


@pytest.fixture(scope="module")
def scenes():
    """Altitudes and noisy returns at SNR 10 dB, seeds no training used."""
    altitude_m, frames = returns(np.random.default_rng(271_828), TRIALS)
    return altitude_m, frames.astype(np.complex64)


@cache
def network(models, name):
    """What the network itself puts out, without the check for false returns."""
    return create("tcae", Waveform(), model=models / f"{name}.onnx", shift_check=False)


def _fields(data: bytes) -> list[tuple[int, int | bytes]]:
    """Numbers and values of the fields of one message."""
    message = Empty()
    message.ParseFromString(data)
    return [(field.field_number, field.data) for field in UnknownFieldSet(message)]


def _initialisers(path) -> dict[str, int]:
    """Elements of every initialiser: ModelProto.graph is field 7, GraphProto.initializer 5, TensorProto.name 8."""
    (graph,) = (data for number, data in _fields(path.read_bytes()) if number == 7)
    tensors = [_fields(data) for number, data in _fields(graph) if number == 5]
    return {dict(t)[8].decode(): prod(size for number, size in t if number == 1) for t in tensors}


def _parameters(path, metadata) -> dict[str, int]:
    """Trainable parameters by top-level part of the network."""
    sizes = {re.sub(r"\.(int8|float16)$", "", name): size for name, size in _initialisers(path).items()}
    parts = {}
    for name in metadata["radalt_weights"].split(","):
        part = name.split(".")[0]
        parts[part] = parts.get(part, 0) + sizes[name]
    return parts


def test_paper_model_has_the_papers_parameters(models):
    """4,336 + 15,356,160 + 1,926,472 + 3,314 = 17,290,282, counted in the exported file."""
    path = models / "paper.onnx"
    parts = _parameters(path, create("tcae", Waveform(), model=path).metadata)
    assert parts == {"encoder": 4_336, "compress": 15_356_160, "expand": 1_926_472, "decoder": 3_314}
    assert sum(parts.values()) == 17_290_282


def test_shipped_models_are_small_and_are_those_that_are_tested(models, compact):
    assert sum(_parameters(models / "tcae.onnx", compact.metadata).values()) <= 1_000_000
    assert sum(path.stat().st_size for path in models.glob("*.onnx")) < 30e6
    assert {path.stem for path in models.glob("*.onnx")} == set(SHIPPED)


@pytest.mark.parametrize("name", SHIPPED)
def test_model_states_its_provenance_and_its_card_belongs_to_it(models, name):
    card = (models / f"{name}.md").read_text()
    metadata = create("tcae", Waveform(), model=models / f"{name}.onnx").metadata
    assert hashlib.sha256((models / f"{name}.onnx").read_bytes()).hexdigest() in card
    assert all(f"{int(metadata[f'radalt_{key}']):,}" in card for key in ("training_examples", "parameters"))
    for heading in ("Data", "Recipe", "Results", "Limits", "Licence"):
        assert f"## {heading}" in card
    assert re.fullmatch(r"[0-9a-f]{64}", metadata["radalt_training_data_sha256"])
    assert re.match(r"[0-9a-f]{12}", metadata["radalt_git_revision"])
    assert metadata.get("radalt_placeholder", "0") == "0"


def test_waveform_that_was_not_trained_for_is_refused(models):
    with pytest.raises(MitigationError, match="radalt_rate_hz|radalt_frame_samples"):
        create("tcae", Waveform(rate_hz=15e6, bandwidth_hz=7.5e6), model=models / "tcae.onnx")
    with pytest.raises(MitigationError, match="radalt_centered"):
        create("tcae", Waveform(centered=False), model=models / "tcae.onnx")


@pytest.mark.parametrize("name", SHIPPED)
def test_output_is_finite_for_any_finite_frame(models, name):
    """Silence, one impulse, full scale, tiny and huge amplitudes."""
    method = network(models, name)
    frames = np.zeros((5, 7500), dtype=np.complex64)
    frames[1, 3000] = 1.0
    frames[2] = 1.0 + 1.0j
    frames[3] = 1e-12 * Waveform().reference
    frames[4] = 1e12 * Waveform().reference
    assert np.isfinite(method.process(frames).view(np.float32)).all()


@pytest.mark.parametrize("name", ["tcae", "any_sweep"])
def test_gain_before_is_gain_after(models, name, scenes):
    """Frames are normalised outside the network, so a receiver's gain passes through."""
    method = network(models, name)
    frames = scenes[1][:4]
    np.testing.assert_allclose(method.process(64 * frames), 64 * method.process(frames), rtol=0, atol=1e-2)


def test_what_a_call_gave_stays_when_the_next_one_runs(compact, scenes):
    """Work arrays are kept between calls of any size; results are not among them."""
    first = compact.process(scenes[1][:2])
    before = first.copy()
    compact.process(scenes[1][2:7])
    compact.process(scenes[1][7:8])
    np.testing.assert_array_equal(first, before)
    np.testing.assert_array_equal(compact.process(scenes[1][:2]), before)


def _forced_rmse_m(method, frames, altitude_m):
    result = Altimeter(Waveform()).process(method.process(frames))
    return float(np.sqrt(np.mean((result["forced_altitude_m"] - altitude_m) ** 2)))


def _interfered(scenes, emitter, sir_db, overlap):
    rng = np.random.default_rng(161_803)
    extra = interference_frames([Interferer(emitter, sir_db, overlap)], TRIALS, 7500, 7.5e6, rng)
    return (scenes[1] + extra).astype(np.complex64)


def test_clean_scene_is_left_alone(compact, scenes):
    """Target (e): RMSE at most 1.2 times that without mitigation."""
    altitude_m, frames = scenes
    none = create("none", Waveform())
    assert right(compact.process(frames), altitude_m) == 1.0
    assert _forced_rmse_m(compact, frames, altitude_m) <= 1.2 * _forced_rmse_m(none, frames, altitude_m)


@pytest.mark.parametrize(
    ("emitter", "sir_db", "overlap"),
    [
        (QpskEmitter(), -40.0, 1.0),
        (QpskEmitter(), -40.0, 0.3),
        (QpskEmitter(pulse="rrc"), -38.0, 1.0),
        (QpskEmitter(pulse="rrc"), -38.0, 0.3),
        (ToneEmitter(5), -40.0, 1.0),
    ],
)
def test_compact_measures_where_nothing_else_is_left(compact, scenes, emitter, sir_db, overlap):
    """Twelve and more decibels beyond where no mitigation breaks (about -25 dB)."""
    frames = _interfered(scenes, emitter, sir_db, overlap)
    assert right(frames, scenes[0]) < 0.5 < 0.9 <= right(compact.process(frames), scenes[0])


def test_compact_holds_at_minus_ten_decibels_at_every_overlap(compact, scenes):
    """Target (b) in the simulated baseband: Pd at least 0.95."""
    for overlap in (0.1, 0.4, 0.7, 1.0):
        frames = _interfered(scenes, QpskEmitter(), -10.0, overlap)
        assert right(compact.process(frames), scenes[0]) >= 0.95


def test_paper_model_meets_its_target(models, scenes):
    """Target (a): forced RMSE below 50 m under full overlap at SINR -15 dB."""
    paper = network(models, "paper")
    frames = _interfered(scenes, QpskEmitter(), -14.99, 1.0)
    assert _forced_rmse_m(paper, frames, scenes[0]) < 50.0


def test_a_frame_of_constant_modulus_passes_as_it_is(compact):
    """A 1-bit converter leaves no modulus to read interference from; the networks' first stage would take it all."""
    sweep = Waveform().beat_shifted(300.0)
    one_bit = (np.sign(sweep.real) + 1j * np.sign(sweep.imag)).astype(np.complex64)[None]
    before = compact.flat_frames
    np.testing.assert_array_equal(compact.process(one_bit), one_bit)
    assert compact.flat_frames == before + 1
    assert compact.status()["threads"] == 1


def test_a_modulus_that_is_constant_in_few_samples_is_not_constant(compact):
    """Few samples are asked first; a burst between them is interference all the same, and goes to the network."""
    frame = Waveform().beat_shifted(300.0)[None]
    frame[0, 1:400] *= 3.0
    before, out = compact.flat_frames, np.empty_like(frame)
    compact.process_into(frame, out)
    assert compact.flat_frames == before and not np.array_equal(out, frame)


def test_a_run_tells_nobody_and_leaves_nothing(root, tmp_path):
    """ONNX Runtime's telemetry keeps an identifier in the home or temporary folder; off, it keeps nothing."""
    code = (
        "import numpy; from radalt.core.mitigation import create; from radalt.core.waveform import "
        "Waveform; create('tcae', Waveform()).process(numpy.ones((1, 7500), numpy.complex64))"
    )
    telling = {"ORT_DISABLE_TELEMETRY", "CI", "XDG_CACHE_HOME"}
    environ = {name: value for name, value in os.environ.items() if name not in telling}
    environ |= {"TMPDIR": str(tmp_path), "HOME": str(tmp_path), "PYTHONPATH": str(root / "python")}
    ran_python("-c", code, env=environ, check=True)
    assert list(tmp_path.rglob("*")) == []
