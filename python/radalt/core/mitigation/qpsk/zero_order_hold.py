"""QPSK switched on the sample grid and not filtered (`QpskEmitter`): every sample is one of four points.

No receiver with a filter hears this. It is here since the paper's emitter is so, and is read in every frame anew.
"""

from __future__ import annotations

import numpy as np

from .carrier_recovery import decide
from .settings import QpskSettings

__all__ = ["cancel_zero_order_hold"]

_STRIDE = 8  # one step from a sample to the next in so many is enough for the test
_LOUD = 0.5  # modulus over that while it sends: between zero and constant modulus
_FAR = 5.0  # times the median distance of a fourth power from their mean
_CHANGES = (
    0.01,
    0.5,
)  # shares of samples that begin another symbol: `min_symbol_rate`, and the highest rate of data


def cancel_zero_order_hold(frame: np.ndarray, s: QpskSettings) -> tuple[np.ndarray, float, float] | None:
    """(n,) complex64, the part of a frame that such QPSK explains, the share in which it is sent, and its EVM squared.

    None where there is none. Between two samples the phase steps by quarter turns and the carrier, so fourth powers of
    the products of neighbours are alike. A filter leaves steps of other sizes where symbols change.
    """
    steps = frame[1::_STRIDE] * frame[:-1:_STRIDE].conj()
    loud = _loud(np.abs(steps), _LOUD**2)
    fourth = steps[loud] / np.maximum(np.abs(steps[loud]), np.float32(1e-30))
    fourth *= fourth
    fourth *= fourth
    mean = complex(fourth.mean())
    coherence = abs(mean)
    if not coherence > s.hold_coherence:
        return None
    distance = np.abs(fourth - np.complex64(mean / coherence))
    far = _FAR * np.median(distance)
    # where noise hides the steps that a filter leaves, the frame is not decided sample by sample
    if not far < 1 or np.count_nonzero(distance > far) > s.hold_outliers * distance.size:
        return None
    active = _loud(np.abs(frame), _LOUD)
    decisions, carrier = decide(frame, active, s.carrier_symbols)
    straight = frame * carrier.conj()
    sent = np.count_nonzero(active)
    amplitude = np.vdot(decisions, straight).real / sent
    error = (straight - decisions * np.float32(amplitude))[active]
    evm_squared = float(np.vdot(error, error).real / (amplitude**2 * sent))
    if not evm_squared < s.max_evm_squared:
        return None
    changes = np.count_nonzero(decisions[1:] != decisions[:-1])
    if not _CHANGES[0] * sent < changes < _CHANGES[1] * sent:
        return None
    source = decisions * carrier
    ramp = np.linspace(-1, 1, frame.size, dtype=np.float32)
    basis = np.stack([source, source * ramp])  # an amplitude that changes evenly over the frame
    gram = basis.conj() @ basis.T
    model = np.linalg.solve(gram, basis.conj() @ frame).astype(np.complex64) @ basis
    return model, sent / frame.size, evm_squared


def _loud(modulus: np.ndarray, threshold: float) -> np.ndarray:
    """(n,) bool: where a (n,) ``modulus`` is above a share of that while it sends."""
    high = int(0.9 * modulus.size)
    return modulus > np.float32(threshold) * np.partition(modulus, high)[high]
