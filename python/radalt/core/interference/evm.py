"""Error vector magnitude of transmitters: what standards allow, and what is typical."""

from types import MappingProxyType

import numpy as np

# 3GPP TS 38.104 Table 6.5.2.2-1, base stations
EVM_LIMITS = MappingProxyType({"qpsk": 0.175, "16qam": 0.125, "64qam": 0.08, "256qam": 0.035})
TYPICAL = "typical"
EMITTERS = "emitters: half-limit EVM"  # titles of the studies' figures
TYPICAL_EVM = MappingProxyType({name: limit / 2 for name, limit in EVM_LIMITS.items()})


def check_evm(owner: str, evm: float | str) -> None:
    """Raise ValueError, one line, unless ``evm`` is a fraction 0..1 or 'typical'."""
    if evm != TYPICAL and not (isinstance(evm, (int, float)) and 0.0 <= evm <= 1.0):
        raise ValueError(f"{owner}.evm is {evm!r}; it has to be within 0..1 (0.08 is 8 %), or typical")


def evm_fraction(evm: float | str, modulation: str) -> float:
    """RMS error over RMS amplitude: ``evm``, or half the limit of the modulation for 'typical' (QPSK: 0.0875)."""
    return TYPICAL_EVM[modulation] if evm == TYPICAL else float(evm)


def evm_title(evm: float | str) -> str:
    """EVM of the transmitter, for headings."""
    if evm == TYPICAL:
        return "half-limit EVM"
    return f"EVM {100 * evm:.3g} %" if evm else "ideal"


def error_vectors(count: int, fraction: float, rng: np.random.Generator) -> np.ndarray:
    """(count,) complex normal error vectors of symbols of unit mean power; RMS is ``fraction``."""
    return np.sqrt(0.5) * fraction * rng.standard_normal((count, 2)).view(np.complex128)[:, 0]
