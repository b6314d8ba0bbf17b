"""One track of the altitude tracker: its Kalman filter, and its evidence against every rival altitude."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from .summed_block import Measurement

# Latest altitudes whose slope is a track's speed: one second of outputs, over which an aircraft's speed holds.
_FITTED = 25
# Resolution cells from a peak between which the asymmetry of an extended return is measured: from where its main lobe
# has fallen by 6 dB to the middle of the first side lobe.
_FLANKS = 0.625, 1.5
# Weight of one block in the mean of the normalised innovation squared: a memory of ten blocks, as the evidence has.
_NIS_SHARE = 0.1


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a (1, 1) or (2, 2) covariance; LAPACK wakes its threads, for milliseconds next to a busy flowgraph."""
    if len(matrix) == 1:
        return 1.0 / matrix
    (a, b), (c, d) = matrix
    return np.array([[d, -b], [-c, a]]) / (a * d - b * c)


@dataclass
class Kalman:
    """Altitude and vertical speed at the end of a block, with their covariance.

    Constant speed, driven by white acceleration that lasts a block (Y. Bar-Shalom et al., Estimation with Applications
    to Tracking and Navigation, 6.3.2). A measurement belongs to the middle of its frames, ``lead_s`` before the end.
    """

    mean: np.ndarray
    covariance: np.ndarray
    nis: float = 1.0  # normalised innovation squared, mean of about ten blocks
    # state error for a measurement bias of +1 sigma: worst-case correlated errors
    pulled: np.ndarray = field(default_factory=lambda: np.zeros(2))

    def predict(self, seconds: float, acceleration: float) -> None:
        """Predict the state ``seconds`` later."""
        step = np.array([[1.0, seconds], [0.0, 1.0]])
        push = np.array([0.5 * seconds**2, seconds]) * acceleration
        self.mean, self.pulled = step @ self.mean, step @ self.pulled
        self.covariance = step @ self.covariance @ step.T + np.outer(push, push)

    def innovation(self, found: Measurement, lead_s: float) -> tuple[float, float]:
        """Altitude found less altitude expected, and its variance."""
        row = np.array([1.0, -lead_s])
        return float(found.altitude_m - row @ self.mean), float(
            row @ self.covariance @ row + found.altitude_variance_m2 + found.fluctuation_m2
        )

    def speed_innovation(self, found: Measurement) -> tuple[float, float]:
        """Speed found less speed expected, and its variance."""
        variance = float(self.covariance[1, 1]) + found.speed_variance_m2_per_s2
        return found.speed_m_per_s - float(self.mean[1]), variance

    def update(self, found: Measurement, lead_s: float, *, with_speed: bool) -> None:
        """Update by a measurement of altitude, or of altitude and speed at once.

        An error of one half sweep is in both, so a known speed takes it out of the altitude.
        """
        rest, variance = self.innovation(found, lead_s)
        self.nis += _NIS_SHARE * (rest**2 / variance - self.nis)
        n, both = 1 + with_speed, found.altitude_speed_covariance
        rows = np.array([[1.0, -lead_s], [0.0, 1.0]])[:n]
        noise = np.array([[found.altitude_variance_m2, both], [both, found.speed_variance_m2_per_s2]])[:n, :n]
        rest = np.array([rest, found.speed_m_per_s - self.mean[1]])[:n]
        # errors of altitude and Doppler, if the altitude is off by one standard deviation
        pull = noise[:, 0] / np.sqrt(found.altitude_variance_m2)
        noise[0, 0] += found.fluctuation_m2  # new in every frame, so its sign does not last
        gain = self.covariance @ rows.T @ _inverse(rows @ self.covariance @ rows.T + noise)
        self.mean = self.mean + gain @ rest
        self.pulled = self.pulled + gain @ (pull - rows @ self.pulled)
        self.covariance = self.covariance - gain @ rows @ self.covariance
        self.covariance = 0.5 * (self.covariance + self.covariance.T)


@dataclass
class Evidence:
    """How much more power a track's cells have shown than cells at other distances, over the last blocks.

    A weighted mean of `Block.differences`, weights falling by ``memory / (memory + 1)`` per block, and its variance.
    """

    memory: float
    mean: np.ndarray | None = None
    variance: np.ndarray | None = None
    weight: float = 0.0

    def add(self, mean: np.ndarray, variance: np.ndarray) -> None:
        """Add one block's differences, (2, 2 reach + 1) each."""
        self.weight = self.weight * self.memory / (self.memory + 1.0) + 1.0
        share = 1.0 / self.weight
        if self.mean is None:
            self.mean, self.variance = mean, variance
            return
        new = np.isnan(self.mean)  # a track that moves brings cells into the beat band that lay beyond it
        self.mean = np.where(new, mean, (1.0 - share) * self.mean + share * mean)
        self.variance = np.where(new, variance, (1.0 - share) ** 2 * self.variance + share**2 * variance)

    def farthest(
        self, sigmas: float, apart: tuple[int, int], lobe: float, span: tuple[float, float]
    ) -> tuple[float, float]:
        """The farthest altitude, and the farthest speed, that are not ruled out: both in cells from the track's.

        - ``sigmas``: standard deviations by which a rival has to fall short
        - ``apart`` (int, int): cells by which a rival's up half may lie above its down half, more than the track's:
          least and most
        - ``lobe``: distance in cells, of both halves, that belongs to the same return
        - ``span`` (float, float): lowest and highest altitude there is, in cells from the track's
        """
        reach = self.mean.shape[1] // 2
        steps = np.arange(-reach, reach + 1)
        altitude = speed = 0.0
        # a weak measurement may leave speeds open that no two cells have
        for d in range(max(apart[0], 1 - steps.size), min(apart[1], steps.size - 1) + 1):
            up = slice(max(0, d), steps.size + min(0, d))
            down = slice(max(0, -d), steps.size + min(0, -d))
            mean = self.mean[0, up] + self.mean[1, down]
            deviation = np.sqrt(self.variance[0, up] + self.variance[1, down])
            middle = 0.5 * (steps[up] + steps[down])
            other = np.maximum(np.abs(steps[up]), np.abs(steps[down])) > lobe
            other &= (middle >= span[0]) & (middle <= span[1])
            open_ = other & ~(mean >= sigmas * deviation)
            if open_.any():
                altitude = max(altitude, float(np.abs(middle)[open_].max()))
                speed = max(speed, float(abs(d)))
        return altitude, speed

    def better_pair(
        self, reach: int, apart: tuple[int, int], lobe: float, span: tuple[float, float]
    ) -> tuple[int, int] | None:
        """The pair of cells next to the track's that has shown the most power; None where its own have.

        Steps of the up half and of the down half from the track's cells, ``reach`` at most; the rest as in `farthest`.
        """
        middle, steps = self.mean.shape[1] // 2, np.arange(-reach, reach + 1)
        near = slice(middle - reach, middle + reach + 1)
        up, down = steps[:, None], steps
        height, speed = 0.5 * (up + down), up - down
        other = np.maximum(np.abs(up), np.abs(down)) > lobe
        other &= (speed >= apart[0]) & (speed <= apart[1]) & (height >= span[0]) & (height <= span[1])
        less = np.where(other, self.mean[0, near, None] + self.mean[1, near], np.inf)
        less[np.isnan(less)] = np.inf  # beyond the beat band
        i, j = divmod(int(less.argmin()), steps.size)
        return (int(steps[i]), int(steps[j])) if less[i, j] < 0.0 else None

    def recentre(self, steps: tuple[int, int]) -> None:
        """Take the cells ``steps`` from the track's, in each half, as the track's from now on."""
        reach = self.mean.shape[1] // 2
        cells = np.arange(-reach, reach + 1)
        for half, step in enumerate(steps):
            at = np.clip(cells + step, -reach, reach) + reach
            here = self.mean[half, step + reach], self.variance[half, step + reach]
            self.mean[half] = self.mean[half, at] - here[0]
            # an upper bound: the errors of both have a part in common
            self.variance[half] = self.variance[half, at] + here[1]

    def asymmetry(self, resolution_cells: float) -> float:
        """Power beyond the track's cells less that before them, as a share of their own.

        About one resolution cell to either side, mean of both halves. A point return has none, nor have the lobes that
        a method leaves of it, since it weights the sweep by real factors. An extended return has more power beyond.
        """
        reach = self.mean.shape[1] // 2
        d = np.arange(round(_FLANKS[0] * resolution_cells), round(_FLANKS[1] * resolution_cells) + 1)
        excess = np.mean(self.mean[:, reach - d] - self.mean[:, reach + d])
        return float(excess / np.nanmedian(self.mean))


@dataclass
class Track:
    """One altitude over time: a candidate until it is confirmed."""

    filter: Kalman
    evidence: Evidence
    hits: int = 1  # consecutive blocks with a measurement
    missed: int = 0  # consecutive blocks without one
    vacant: int = 0  # consecutive blocks that show nothing at its place
    contradicted: int = 0  # consecutive blocks in which its altitudes contradicted its Doppler
    corrected_m: float = 0.0  # correction of the predicted altitude by the latest measurement
    protection_m: float = np.inf  # bound of its altitude's error, computed when the altitude is to be given
    doppler_m_per_s: float = 0.0  # mean of the measured speeds over as many blocks as its evidence
    # deviation of its peak from a point's shape, mean over as many blocks as its evidence
    deviation: float = 0.0
    moment: complex = 0.0  # second moment of its delays, squared resolution cells, mean over as many blocks
    edge_m: float = 0.0  # standard deviation of the nearest point of spread ground
    widened_m: float = 0.0  # by how much a method may have moved that point
    resolved: bool = False  # whether its evidence ruled out every other pair of cells once
    seen: bool = True  # something that is no side lobe stands where the track is expected
    measured_at: float = 0.0  # frame index of the middle of the last measurement
    latest: Measurement | None = field(default=None, repr=False)
    # (frame index, altitude in metres) of the latest measurements
    history: deque = field(default_factory=lambda: deque(maxlen=_FITTED), repr=False)

    def append(self, found: Measurement, middle: float) -> None:
        """Keep a measurement and the frame index of its middle."""
        self.latest, self.measured_at = found, middle
        self.history.append((middle, found.altitude_m))

    def move(self, found: Measurement) -> None:
        """Move a track of a lobe to the return, which has stood at the same distance from the lobe all along."""
        rise = found.altitude_m - self.latest.altitude_m
        self.filter.mean[0] += rise
        self.history = deque(((t, a + rise) for t, a in self.history), maxlen=self.history.maxlen)
        self.latest = found

    def speed_by_altitudes(self, sweep_s: float, least_m2: float) -> tuple[float, float]:
        """Slope of the latest altitudes, without Doppler, and its standard deviation; infinite for less than three.

        Each altitude has a variance of ``least_m2`` at least, which its measurement claims: few residuals may be
        small by chance.
        """
        if len(self.history) < 3:
            return 0.0, np.inf
        time, altitude = np.array(self.history).T
        time = (time - time.mean()) * sweep_s
        slope = float(time @ altitude / (time @ time))
        rest = altitude - altitude.mean() - slope * time
        variance = max(float(rest @ rest) / (time.size - 2), least_m2)
        return slope, float(np.sqrt(variance / (time @ time)))
