"""A sweep's worth of received samples and when it came in."""

from dataclasses import dataclass

import numpy as np


@dataclass
class Frame:
    """One whole frame at known timing."""

    index: int  # sweep number since the transmitter's start
    start_sample: int  # sample counter at the frame's first sample, lost samples included
    samples: np.ndarray  # (N,) complex64
    offset_s: float
    """Delay of the sweep against the frame's first sample, a fraction of a sample; the altimeter subtracts it."""
    auxiliary: np.ndarray | None = None
    """(N,) complex64 or None: the second channel's samples of the same time, in the block that cuts both."""
