"""Carrier frequency offset: what is left of it turns each symbol within itself."""

import numpy as np

from .arrays import power
from .equaliser import ElementGrid


def residual_cfo(grid: ElementGrid, sent: np.ndarray) -> float:
    """Residual CFO in subcarriers, from the (N,) samples ``sent`` that were rebuilt from decisions.

    Least squares of the angle of ``conj(sent) received`` over the place within the symbol; each symbol has a phase of
    its own, which is taken out first.
    """
    covered, places = grid.cyclic()
    row = places // grid.numerology.useful
    n = np.arange(covered.start, covered.stop)
    place = (n - grid.starts[row]) / grid.numerology.useful - 0.5
    model = sent[covered]
    own = power(model)
    product = model.conj() * grid.samples[covered]
    first = np.flatnonzero(np.diff(np.append(-1, row)))
    angles = np.angle(np.add.reduceat(product, first)).astype(np.float32)
    product *= np.exp(-1j * angles)[row - row[0]]
    total = max(float(own.sum()), 1e-30)
    place = place - float((place * own).sum()) / total
    spread = max(float((own * place * place).sum()), 1e-30)
    return float((product.imag * place).sum() / spread / (2 * np.pi))


def phase_course(phases: np.ndarray, times: np.ndarray, spacing: float) -> tuple[float, float] | None:
    """Straight line (radians at time 0, radians per sample) through symbol phases (L,) known modulo a quarter turn.

    None where the phases have no such line. The rate is searched within an eighth of a turn per ``spacing``, then
    refined by least squares over the symbols that agree.
    """
    fourth = np.exp(4j * phases)
    rates = np.arange(-20, 21) * (np.pi / 4 / 20 / spacing)
    fit = (fourth[:, None] * np.exp(-4j * np.outer(times, rates))).sum(axis=0)
    best = int(np.abs(fit).argmax())
    if np.abs(fit[best]) <= 0.8 * len(fourth):
        return None
    start, rate = float(np.angle(fit[best]) / 4), float(rates[best])
    off = np.angle(fourth * np.exp(-4j * (start + rate * times))) / 4
    near = np.abs(off) < np.pi / 16
    if near.sum() > 2:
        at, off = times[near], off[near]
        middle, step = at.mean(), off.mean()
        slope = float(((at - middle) * off).sum() / ((at - middle) ** 2).sum())
        start, rate = start + float(step) - slope * float(middle), rate + slope
    return start, rate
