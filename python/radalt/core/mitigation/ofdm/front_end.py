"""What the receiver itself adds to a frame: a faint image of all it hears, and a constant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["FrontEnd", "front_end"]

_CLEARLY = 20.0  # times the power that chance would give


@dataclass(frozen=True)
class FrontEnd:
    """IQ imbalance and DC offset of a direct-conversion receiver: it gives ``x + image conj(x) + constant`` for x.

    M. Valkama, M. Renfors, V. Koivunen, IEEE Trans. Signal Process. 49(10), 2001.
    """

    image: np.complex64
    constant: np.complex64

    def without(self, frame: np.ndarray) -> np.ndarray:
        """(N,) complex64 frame without both, to the first order of the image."""
        out = frame - self.constant
        out -= self.image * out.conj()
        return out


def front_end(model: np.ndarray, rest: np.ndarray) -> FrontEnd | None:
    """What of a frame's (N,) complex64 ``rest`` is an image of its ``model`` or a constant; None if hardly any is.

    Samples that are 0 in ``rest`` do not count. The image is known far better than it is large: all samples of a frame
    tell one number.
    """
    told = rest != 0
    mirrored = model.conj() * told
    gram = np.array([[np.vdot(mirrored, mirrored), mirrored.conj().sum()], [mirrored.sum(), told.sum()]])
    image, constant = np.linalg.solve(gram + 1e-30 * np.eye(2), [np.vdot(mirrored, rest), rest.sum()])
    chance = _CLEARLY * np.vdot(rest, rest).real / max(np.count_nonzero(told), 1)
    image *= abs(image) ** 2 * gram[0, 0].real > chance
    constant *= abs(constant) ** 2 * gram[1, 1].real > chance
    return FrontEnd(np.complex64(image), np.complex64(constant)) if image or constant else None
