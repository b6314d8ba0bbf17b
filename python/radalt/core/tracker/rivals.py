"""What else stands in a block next to a return, or may explain it: side lobes, lines beyond the span, others."""

import numpy as np
from scipy import ndimage, signal

from .summed_block import CONTRADICTION_SIGMAS, EACH_HALF, Block, Measurement

# Resolution cells from a return, beyond which another return counts: both main lobes overlap there.
_NEAR_BY = 0.9
# Power ratio (6 dB) by which a side lobe may exceed 1 / (pi distance)^2: a method weights the sweep.
_SIDE_LOBE_SPARE = 4.0
# Standard deviations by which a second return has to exceed its mirror image: one of the 60 cells examined does so by
# noise in one of 60,000 blocks.
_SECOND_SIGMAS = 5.0
# Resolution cells around a return that are its own peak: the power there says nothing of another return.
OWN_CELLS = 0.35
# One-sided power, as a share of the return's, that is another return's: -25 dB. A point's lobes are equal to -30 dB
# after interpolation between cells.
_ONE_SIDED_SHARE = 0.003
# Fluctuation of one-sided power from frame to frame that is another return's: standard deviations of what noise gives.
_FLUCTUATION_SIGMAS = 3.0


def _at(rows: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """(n, k) values of rows (n, J) at fractional cells (k,), by the cubic through the four nearest."""
    whole = np.clip(np.floor(cells).astype(int), 1, rows.shape[-1] - 3)
    x = np.clip(cells - whole, 0.0, 1.0)
    weights = (
        -x * (x - 1) * (x - 2) / 6,
        (x + 1) * (x - 1) * (x - 2) / 2,
        -(x + 1) * x * (x - 2) / 2,
        (x + 1) * x * (x - 1) / 6,
    )
    return sum(weight * rows[:, whole + k - 1] for k, weight in enumerate(weights))


def is_side_lobe(block: Block, found: Measurement, *, mixed: bool = False) -> bool:
    """Whether a stronger return explains this one: side lobes of an unweighted sweep, with 6 dB to spare.

    With ``mixed`` also a pair of one half sweep of the stronger return with another cell of the other half, if
    the stronger has more power too: a grating lobe may win by strength alone.
    """
    other = block.strongest(block.away_from(found))
    if other is None or other.strength <= found.strength:
        return False
    near, far = np.sort(np.abs(np.array(other.cells) - found.cells)) / block.tables.resolution_cells
    if near < 1.0 <= far:  # one half of the stronger return with the other half's side lobe
        return mixed and other.power > found.power
    return bool(near >= 1.0 and found.power < other.power * _SIDE_LOBE_SPARE / (np.pi * near) ** 2)


def lobe_from_beyond(block: Block, found: Measurement) -> bool:
    """Whether a return is no more than a side lobe of a line beyond the span, in either half sweep, 6 dB to spare.

    Such a line may be a radar of the same sweep that moves in, or ground too far away; with the default sweep the
    beat band shows it up to 390 m beyond the span. Its speed is its own: frames stay unmoved.
    """
    t = block.tables
    moved, _, _ = block.sums(int(t.rows[found.row, 0]))
    line, cells = block.ratio.sum(axis=0), np.arange(moved.shape[1])
    line[:, t.first : t.last] = 0.0
    for half, at in enumerate(found.cells):
        apart = np.maximum(np.abs(cells - at) / t.resolution_cells, 1.0)
        if np.max(line[half] * _SIDE_LOBE_SPARE / (np.pi * apart) ** 2) >= np.interp(at, cells, moved[half]):
            return True
    return False


def second_return(block: Block, found: Measurement, reach: int, above: float, below: float) -> bool:
    """Whether another return, not a side lobe, stands within ``reach`` cells of one.

    A method weights the sweep by real factors, so its lobes lie on both sides alike; a return stands on one side
    only. It counts from 0.9 resolution cells on, if it exceeds a share of the return's power (``above`` it in
    altitude, ``below`` it) and twice its mirror image by five standard deviations.
    """
    t = block.tables
    power, floor, _ = block.sums(int(t.rows[found.row, 0]))
    steps = np.arange(-reach, reach + 1)
    cells = np.arange(power.shape[1])
    here = [np.interp(found.cells[h] + steps, cells, power[h]) / floor[h] - 1.0 for h in range(2)]
    over = 0.5 * (here[0] + here[1])
    share = np.where(steps > 0, above, below)
    noise = np.sqrt(((1.0 + over) ** 2 + 4.0 * (1.0 + over[::-1]) ** 2) / (2.0 * block.count))
    apart = np.abs(steps) >= _NEAR_BY * t.resolution_cells
    both = np.minimum(*here) > EACH_HALF * over  # the two halves show it

    def counts(over: np.ndarray) -> np.ndarray:
        return (over >= share * found.power) & (over - 2.0 * over[::-1] > _SECOND_SIGMAS * noise)

    stands = apart & both & counts(over)
    if not stands.any():
        return False
    # what a network leaves falls off beyond the span it was trained for: that is no return
    around = [ndimage.median_filter(power[h], size=t.background_cells, mode="nearest") for h in range(2)]
    level = [np.interp(found.cells[h] + steps, cells, around[h]) / floor[h] - 1.0 for h in range(2)]
    return bool(np.any(stands & counts(over - np.maximum(0.5 * (level[0] + level[1]), 0.0))))


def stands_apart(block: Block, found: Measurement, apart: float, window: float) -> bool:
    """Whether something stands ``apart`` cells from a return, ``window`` to either side, beyond its own lobes.

    A point has the same power on both sides, and so have its lobes behind a method, which weights the sweep by
    real factors. Another return shows by power on one side. Nearer by, it shows by how that power fluctuates from
    frame to frame: the phases of two returns rotate against each other. What changes in proportion to time is
    left out, since a point that moves does so. Interference that fluctuates as much counts as a return: nothing
    is known then.
    """
    t = block.tables
    k = int(t.rows[found.row, 0])
    steps = np.arange(apart - window, apart + window + 0.5)
    steps = steps[(np.abs(steps) >= OWN_CELLS * t.resolution_cells) & (np.sign(steps) == np.sign(apart))]
    if not steps.size:
        return False
    frames = block.aligned(k)
    here = 0.5 * sum(_at(frames[:, h], found.cells[h] + steps) for h in range(2))
    mirrored = 0.5 * sum(_at(frames[:, h], found.cells[h] - steps) for h in range(2))
    excess = here - mirrored
    level = 0.5 * float(block.sums(k)[1].sum()) / block.count
    fluctuation = signal.detrend(excess, axis=0).std(axis=0, ddof=2)
    over = np.maximum(here, mirrored).mean(axis=0)
    # standard deviation of one frame's excess for a constant line in noise
    noise = np.sqrt(np.maximum(over, 0.0) * level + 0.5 * level**2)  # interpolation may fall below zero
    most = _ONE_SIDED_SHARE * found.power * level + CONTRADICTION_SIGMAS * fluctuation / np.sqrt(block.count)
    return bool(np.any((fluctuation > _FLUCTUATION_SIGMAS * noise) | (excess.mean(axis=0) > most)))
