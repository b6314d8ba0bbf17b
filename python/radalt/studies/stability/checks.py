"""Stability beyond single frames: step-size limits, long runs, determinism, broken frames in a running flowgraph."""

import itertools
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from ...core.altimeter.altimeter import Altimeter, AltimeterSettings, shared_altimeter
from ...core.interference import Interferer, QpskEmitter, interference_frames
from ...core.interference.evm import TYPICAL
from ...core.mitigation import METHODS, create
from ...core.programme import Programme
from ...core.returns.point import point_return
from ...core.scene import Scene
from ...core.timing.segmenter import FrameSegmenter
from ...core.waveform import Waveform
from ...evaluation.engine.pool import WorkerError, call_apart
from .cases import coloured_noise, noisy

SPREADS = (1.0, 1e2, 1e4, 1e6, 1e8, 1e10)  # spectral spreads of the input, for the step limits

_FAR = 100_000_000_000  # samples: 3.7 hours at 7.5 MS/s
# ONNX Runtime uses other kernels for other batch sizes; other methods are equal bit for bit
_NETWORK_BOUND_M = 0.01


def _bound_m(method: str) -> float:
    return _NETWORK_BOUND_M if METHODS[method].runs_network else 0.0


def step_limit(spread: float) -> dict[str, Any]:
    """Largest stable step of block LMS, measured by bisection, against ``2 / lambda_max(X^H X)``.

    ``lambda_max`` is the largest eigenvalue of the block's mean Gram matrix: ``block`` times that of the covariance (S.
    Haykin, Adaptive Filter Theory, 4th ed., sec. 7.4). ``spread`` as in `coloured_noise`.
    """
    waveform, length, block = Waveform(), 32, 100
    rng = np.random.default_rng(int(np.log10(spread)))
    frame = coloured_noise(spread, 1, waveform.samples_per_frame, rng)
    x = np.lib.stride_tricks.sliding_window_view(frame[0], length)
    values = np.linalg.eigvalsh(x.conj().T @ x / len(x))
    theory = 2.0 / (block * values[-1])

    def diverges(step: float) -> bool:
        method = create("lms", waveform, length=length, block=block, step=step)
        method.process(np.tile(frame, (20, 1)).astype(np.complex64))
        return method.diverged_frames > 0

    low, high = theory / 10, theory * 10
    for _ in range(10):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if diverges(middle) else (middle, high)
    measured = float(np.sqrt(low * high))
    return {
        "spread": spread,
        "condition": float(values[-1] / max(values[0], np.finfo(float).tiny)),
        "theory": theory,
        "measured": measured,
        "ratio": measured / theory,
        # theory takes the mean Gram matrix; that of a single block scatters about it
        "verdict": "pass" if 0.5 <= measured / theory <= 2.0 else "FAIL",
    }


def _check(name: str, value: float, bound: float, unit: str) -> dict[str, Any]:
    verdict = "pass" if value <= bound else "FAIL"
    return {"check": name, "value": value, "bound": bound, "unit": unit, "verdict": verdict}


def long_run_rows() -> Iterator[dict[str, Any]]:
    """Phase and timing after 1e11 samples, reached by setting the counter; a float32 accumulator next to them."""
    w = Waveform(bandwidth_hz=7.100123e6, centered=False)
    n = w.samples_per_frame
    for frames in (_FAR // n, 10**9):
        exact = (Fraction(w.bandwidth_hz) * Fraction(w.half_sweep_s) * frames) % 1
        have = float(np.angle(w.frame_rotation(frames)) / (2 * np.pi)) % 1.0
        error = abs((have - float(exact) + 0.5) % 1.0 - 0.5)
        yield _check(f"source phase at sweep {frames:.3g} against exact fractions", error, 1e-4, "cycles")
    for far in (0, _FAR, _FAR + 12_345):
        name = f"segmenter from sample {far:.4g}: largest altitude error"
        yield _check(name, _segmented_error(far), 0.1, "m")
    name = "float64 phase of 1e9 samples at 1 Hz of 7.5 MS/s, reduced"
    yield _check(name, _float_drift(np.float64), 1e-6, "cycles")
    drift = _float_drift(np.float32)
    name = "the same in float32, which is why nothing here is"
    yield {"check": name, "value": drift, "bound": None, "unit": "cycles", "verdict": "shown"}


def _float_drift(dtype: type) -> float:
    """Phase error in cycles of ``index * f / rate`` at sample 1e9 + 1, computed in ``dtype``."""
    index = 10**9 + 1
    exact = Fraction(index) / Fraction(7_500_000) % 1
    value = dtype(index) * (dtype(1.0) / dtype(7.5e6))
    return abs((float(value % dtype(1.0)) - float(exact) + 0.5) % 1.0 - 0.5)


def _segmented_error(first_sample: int) -> float:
    """Largest altitude error of frames from a segmenter whose counter starts there; infinite if it lost any."""
    w, latency = Waveform(), 321
    programme = Programme(altitudes_m=(200.0, 900.0), frames_per_step=4)
    sweeps = [w.beat_shifted(float(programme.altitude_m(i))) for i in range(programme.total_frames + 3)]
    stream = np.concatenate([np.zeros(latency), *sweeps])[None]
    stream = noisy(stream, 20.0, np.random.default_rng(3))[0]
    segmenter = FrameSegmenter(w)  # without the programme, which ended long before that sample
    segmenter.reset(first_sample)
    frames = [f for part in np.array_split(stream, 7) for f in segmenter.push(part)] + segmenter.drain()
    altimeter = Altimeter(w)
    errors = []
    for f in frames:
        index = f.index - (first_sample + latency + 1) // w.samples_per_frame
        result = altimeter.process(f.samples[None], timing_offset_s=f.offset_s)[0]
        if programme.is_trial(index):
            errors.append(abs(result["forced_altitude_m"] - programme.altitude_m(index)))
    return float(max(errors)) if len(errors) == programme.trial_frames else float("inf")


def _frames(count: int = 12) -> np.ndarray:
    rng, w = np.random.default_rng(11), Waveform()
    frames = noisy(point_return(w, rng.uniform(20.0, 1400.0, count)), 10.0, rng)
    jammer = Interferer(QpskEmitter(evm=TYPICAL), -20.0, 0.4)
    jam = interference_frames([jammer], count, w.samples_per_frame, w.rate_hz, rng)
    return (frames + jam).astype(np.complex64)


def altitudes_of(method: str, batches: Sequence[int] = (12,)) -> list[float]:
    """Forced altitudes of fixed frames behind a method, in batches of the given sizes in turn."""
    w, frames = Waveform(), _frames()
    altimeter, subject = shared_altimeter(w, AltimeterSettings()), create(method, w)
    found: list[float] = []
    for size in itertools.cycle(batches):
        part = frames[len(found) : len(found) + size]
        if not len(part):
            return found
        found += altimeter.process(subject.process(part))["forced_altitude_m"].tolist()
    return found


def determinism_rows(method: str) -> Iterator[dict[str, Any]]:
    """Whether altitudes are the same in batches of any size and with any number of threads."""
    bound, whole = _bound_m(method), altitudes_of(method)
    for batches in ((1,), (5, 1, 3)):
        name = f"{method}: batches of {', '.join(map(str, batches))} against one of 12"
        yield _check(name, _difference(altitudes_of(method, batches), whole), bound, "m")
    for threads in (1, 2):
        try:
            other, said = call_apart(__name__, "altitudes_of", method, threads=threads), ""
        except WorkerError as error:
            other, said = [], f"FAIL {error}"
        name = f"{method}: a process of {threads} {'thread' if threads == 1 else 'threads'}"
        row = _check(name, _difference(other, whole), bound, "m")
        yield row | ({"verdict": said} if said else {})


def _difference(one: Sequence[float], other: Sequence[float]) -> float:
    """Largest difference; infinite unless the same frames, those that a method silenced, are without a decision."""
    one, other = np.asarray(one), np.asarray(other)
    if one.shape != other.shape or not np.array_equal(np.isnan(one), np.isnan(other)):
        return float("inf")
    return float(np.nanmax(np.abs(one - other), initial=0.0))


def flowgraph_row(method: str, time_limit_s: float = 60.0) -> dict[str, Any]:
    """Broken frames through GNU Radio's blocks: no exception, and each frame as the core measures it."""
    w, scene = Waveform(), Scene(methods=(method,))
    bad = _frames(8)
    bad[1] = 0
    bad[2, 77] = np.nan
    bad[4, 78] = np.inf
    bad[6] *= np.float32(1e30)
    wanted = Altimeter(w, scene.altimeter_settings).process(create(method, w).process(bad))
    have, error = _through_blocks(scene, method, bad, time_limit_s)
    # blocks process one frame per call, the core all frames in one
    same = error is None and np.array_equal(have["valid"], wanted["valid"])
    same = same and _difference(have["altitude_m"], wanted["altitude_m"]) <= _bound_m(method)
    return {
        "check": f"{method}: zeros, NaN, infinity and 1e30 among {len(bad)} frames",
        "value": None if error else int(have["valid"].sum()),
        "bound": int(wanted["valid"].sum()),
        "unit": "frames valid",
        "verdict": "pass" if same else f"FAIL {error or ''}".strip(),
    }


def _through_blocks(
    scene: Scene, method: str, frames: np.ndarray, limit_s: float
) -> tuple[np.ndarray, Exception | None]:
    from gnuradio import blocks, gr

    import gnuradio.radalt as radalt

    from ...evaluation.flowgraph.run import run_to_end

    top = gr.top_block()
    source = blocks.vector_source_c(frames.ravel().tolist(), False, frames.shape[1])
    top.method = radalt.tcae(scene) if method == "tcae" else radalt.mitigation(scene, method)
    top.sink = radalt.altimeter_sink(scene, method=method, messages=False)
    top.connect(source, top.method, top.sink)
    try:
        run_to_end(top, time_limit_s=limit_s)
    except Exception as error:  # any error of a block is a finding
        return top.sink.results(), error
    return top.sink.results(), None
