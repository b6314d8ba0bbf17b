"""What tests that compute the same frames twice share."""

import numpy as np

ROUNDING = 1e-5  # of the loudest sample: what sums of 7,500 in float32 leave in another order


def assert_same_but_for_rounding(frames: np.ndarray, wanted: np.ndarray) -> None:
    """The same (n, N) frames, cleaned twice by least squares.

    Bits are too much to ask: three full runs had two such results apart by less than 1e-6 of the amplitude, with the
    same input and one BLAS thread. Why is not known; another alignment of the input does not make it.
    """
    np.testing.assert_allclose(frames, wanted, rtol=0, atol=ROUNDING * np.abs(wanted).max())
