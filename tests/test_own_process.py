"""A method in a process of its own: the same bits, the same refusals, and a death that is noticed."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from frames import W, white

from radalt.core.mitigation import MitigationError, OwnProcess, create


def received(count, seed=1):
    """Frames of a return under a strong tone, in noise."""
    rng = np.random.default_rng(seed)
    tone = 5 * np.exp(2j * np.pi * (0.1 * np.arange(W.samples_per_frame) + rng.random((count, 1))))
    return (W.beat_shifted(250.0) + tone + 0.3 * white(rng, count)).astype(np.complex64)


@pytest.fixture
def apart():
    """Makes methods next to this process; all end with the test."""
    made = []

    def make(name, **parameters):
        made.append(OwnProcess(name, W, **parameters))
        return made[-1]

    yield make
    for method in made:
        method.close()


@pytest.mark.parametrize("name", ["whitening", "tcae", "hybrid"])
def test_results_are_those_of_the_method_bit_for_bit(apart, name):
    frames = received(7)
    frames[3, 100] = np.nan  # one bad frame, and the one after it has to be right again
    here, there = create(name, W), apart(name, batch=1)
    wanted = np.concatenate([here.process(frame[None]) for frame in frames])
    np.testing.assert_array_equal(there.process(frames), wanted)
    assert there.carries_altitude == here.carries_altitude
    assert there.status() == here.status() | {"process_id": there.process_id}
    assert there.outside_cpu_ns > 0


def test_more_frames_than_the_memory_holds_and_ragged_chunks(apart):
    frames = received(150)
    wanted = create("blanking", W).process(frames)
    there = apart("blanking", batch=4)
    np.testing.assert_array_equal(there.process(frames), wanted)
    out = np.empty_like(frames)
    edges = [0, 1, 4, 70, 71, 149, 150]
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        there.process_into(frames[first:last], out[first:last])
    np.testing.assert_array_equal(out, wanted)
    assert there.frames == 300
    there.reset()
    assert there.frames == there.status()["frames"] == 0


def test_a_refusal_is_the_methods_own_line(apart, tmp_path):
    with pytest.raises(MitigationError, match="tcae model .*missing.onnx does not exist"):
        apart("tcae", model=str(tmp_path / "missing.onnx"))
    with pytest.raises(MitigationError, match="unknown mitigation method 'magic'"):
        apart("magic")


def test_what_fails_later_is_one_line_too(apart, tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(
        "def mitigate(frames, waveform):\n"
        "    if abs(frames).max() > 3:\n        raise RuntimeError('too loud')\n    return frames\n"
    )
    there = apart("custom", file=str(file))
    with pytest.raises(MitigationError, match="mine.py, line 3: RuntimeError: too loud"):
        there.process(4 * W.reference[None])


def test_a_killed_process_is_named(apart):
    there = apart("blanking")
    os.kill(there.process_id, signal.SIGKILL)
    with pytest.raises(MitigationError, match=r"blanking: its process ended \(-9\)"):
        there.process(received(1))


def test_the_process_ends_with_the_method():
    there = OwnProcess("blanking", W)
    number = there.process_id
    os.kill(number, signal.SIGINT)  # Ctrl-C reaches it as well, and is not its business
    time.sleep(0.1)
    np.testing.assert_array_equal(there.process(received(1)), create("blanking", W).process(received(1)))
    del there
    with pytest.raises(ProcessLookupError):
        os.kill(number, 0)


def test_the_process_has_no_threads_of_linear_algebra(apart, monkeypatch):
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    there = apart("qpsk_cancel")
    there.process(received(2))
    assert len(list(Path(f"/proc/{there.process_id}/task").iterdir())) == 1


def test_one_core_computes_in_place(monkeypatch):
    monkeypatch.setattr("radalt.core.mitigation.allowed_cores", lambda: [3])
    assert not isinstance(create("blanking", W, own_process=True), OwnProcess)
