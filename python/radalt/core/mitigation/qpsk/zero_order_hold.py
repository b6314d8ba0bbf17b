"""QPSK switched on the sample grid and not filtered (`QpskEmitter`): every sample is one of four points.

No receiver with a filter hears this. It is here since the paper's emitter is so, and is read in every frame anew.
"""

import numpy as np

from .carrier_recovery import decide
from .settings import QpskSettings

_STRIDE = 8  # one step from a sample to the next in so many is enough for the test
_FAR = 5.0  # times the median distance of a fourth power from their mean


def cancel_zero_order_hold(frame: np.ndarray, s: QpskSettings) -> tuple[np.ndarray, np.ndarray, float] | None:
    """(n,) complex64, the part of a frame that such QPSK explains, (n,) bool, where it is sent, and its EVM squared.

    None where there is none. Between two samples the phase steps by quarter turns and the carrier, so fourth powers
    of the products of neighbours are alike. A filter leaves steps of other sizes where symbols change.
    """
    steps = frame[1::_STRIDE] * frame[:-1:_STRIDE].conj()
    steps = steps[_loud(np.abs(steps), s.burst_power)]
    fourth = (steps / np.maximum(np.abs(steps), np.float32(1e-30))) ** 4
    mean = fourth.mean()
    distance = np.abs(fourth - mean / np.maximum(np.abs(mean), np.float32(1e-30)))
    far = _FAR * np.median(distance)
    # where noise hides the steps that a filter leaves, the frame is not decided sample by sample
    if not far < 1 or np.count_nonzero(distance > far) > s.hold_outliers * distance.size:
        return None
    on = _loud(np.square(np.abs(frame)), s.burst_power)
    decisions, carrier = decide(frame, on, s.carrier_symbols)
    straight = frame * carrier.conj()
    sent = np.count_nonzero(on)
    amplitude = np.vdot(decisions, straight).real / sent
    error = (straight - decisions * np.float32(amplitude))[on]
    evm_squared = float(np.vdot(error, error).real / (amplitude**2 * sent))
    changes = np.count_nonzero(decisions[1:] != decisions[:-1])
    if evm_squared > s.max_evm_squared or changes < 0.5 * s.min_symbol_rate * sent:  # a tone does not change
        return None
    source = decisions * carrier
    # an amplitude that changes evenly over the frame
    basis = np.stack([source, source * np.linspace(-1, 1, frame.size, dtype=np.float32)])
    gram = basis.conj() @ basis.T
    return np.linalg.solve(gram, basis.conj() @ frame).astype(np.complex64) @ basis, on, evm_squared


def _loud(power: np.ndarray, threshold: float) -> np.ndarray:
    """(n,) bool: where a (n,) ``power`` is above a share of that while it sends."""
    high = int(0.9 * power.size)
    return power > np.float32(threshold) * np.partition(power, high)[high]
