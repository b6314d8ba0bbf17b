"""Cost of the arithmetic inside each stage: a lower bound for any way of calling NumPy."""

import numpy as np
from scipy import fft, ndimage
from scipy.linalg import blas

from ...core.channel.delay_line import DelayLine
from ...core.receiver.altimeter import shared_altimeter
from ...core.scene import Scene
from .study import median_seconds

_AT_ONCE = 8  # frames per call of methods and altimeters, the largest batch of the flowgraph
_SYMBOLS = 0.267  # QPSK symbols per sample: the paper's bandwidth over the sample rate


def kernel_seconds(scene: Scene, repeats: int = 60) -> dict[str, float]:
    """Median CPU seconds per frame by block, on arrays that are allocated once and stay in the caches.

    - ``chirp_source``: a copy.
    - ``jammer_source``: QPSK symbols drawn and held.
    - ``simulated_channel``: a delay by a fraction of a sample (short transforms there and back), 64 random bits per
      sample, their logarithm, root, sine and cosine.
    - ``frame_segmenter``: six scalar products, two copies.
    - ``mitigation_whitening``: two transforms, running mean, logarithm, exponential.
    - ``altimeter``: mixing, products with the decimator's matrix, transforms.

    Parameters
    ----------
    scene : Scene
    repeats : int
        Calls of each kernel.
    """
    n = scene.waveform.samples_per_frame
    rng = np.random.default_rng(1)
    frames = rng.standard_normal((_AT_ONCE, 2 * n), dtype=np.float32).view(np.complex64)
    one, other, copy = frames[0], frames[1], np.empty(n, dtype=np.complex64)
    rail, real = rng.random(n, dtype=np.float32) + np.float32(0.1), np.empty(n, dtype=np.float32)
    bits = np.random.SFC64(1)
    line = DelayLine(n, 2 * n)
    pieces = np.ones((line._parts, line._size), dtype=np.complex64)
    altimeter = shared_altimeter(scene.waveform, scene.altimeter_settings)
    table = np.ones((2, n // 2), dtype=np.complex64)
    symbols, held = np.ones(n, dtype=np.complex64), (_SYMBOLS * np.arange(n)).astype(np.intp)

    def copied() -> None:
        copy[:] = one

    def drawn() -> None:
        rng.integers(0, 4, round(_SYMBOLS * n))
        np.take(symbols, held, out=copy, mode="clip")

    def heard() -> None:
        fft.ifft(fft.fft(pieces, axis=1), axis=1, overwrite_x=True)
        bits.random_raw(n)
        for function in (np.log, np.sqrt, np.cos, np.sin):
            function(rail, out=real)

    def checked() -> None:
        for _ in range(6):
            blas.cdotc(one, other)
        copied()
        copied()

    def whitened() -> None:
        spectrum = fft.fft(frames, axis=1)
        for _ in frames:
            ndimage.uniform_filter1d(rail, 25, mode="wrap", output=real)
            np.exp(rail, out=real)
            np.log(rail, out=real)
        fft.ifft(spectrum, axis=1, overwrite_x=True)

    def measured() -> None:
        low = altimeter.decimator.mix(frames.reshape(_AT_ONCE, 2, -1), table)
        fft.fft(low, altimeter.fft_size, axis=-1)

    kernels = {
        "chirp_source": (copied, 1),
        "jammer_source": (drawn, 1),
        "simulated_channel": (heard, 1),
        "frame_segmenter": (checked, 1),
        "mitigation_whitening": (whitened, _AT_ONCE),
        "altimeter": (measured, _AT_ONCE),
    }
    return {name: median_seconds(kernel, repeats) / count for name, (kernel, count) in kernels.items()}
