"""CFAR: thresholds hold their design false-alarm rate, on correlated cells of an oversampled spectrum too."""

import numpy as np
import pytest

from radalt.core.receiver.altimeter import Altimeter, AltimeterSettings
from radalt.core.receiver.cfar import Cfar, cell_correlation
from radalt.core.waveform import Waveform

W = Waveform()
PFA = 1e-4
FLOOR = 3.0  # ratio that each half sweep has to show in the joint test


def noise_frames(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.standard_normal((count, 2 * W.samples_per_frame), dtype=np.float32).view(np.complex64)


def counted_rates(kind: str, window: str, cells: int) -> tuple[float, float, int]:
    """False alarms of one cell of one half sweep, and of the joint test at equal cells, on white noise."""
    altimeter = Altimeter(W, AltimeterSettings(pfa=PFA, cfar=kind, window=window))
    rng = np.random.default_rng(20 + len(kind + window))
    margin = altimeter.cfar.margin
    single = joint = tested = 0
    while tested < cells:
        spectra = altimeter.spectra(noise_frames(rng, 100))
        ratio = spectra.power[..., margin:-margin] / spectra.noise
        single += np.count_nonzero(ratio > altimeter.cfar_scale)
        both = ratio[:, 0] + ratio[:, 1] > altimeter.joint_scale
        joint += np.count_nonzero(both & (ratio.min(axis=1) >= FLOOR))
        tested += ratio.size
    return single / tested, joint / (tested / 2), tested


@pytest.mark.parametrize(("kind", "window"), [("ca", "boxcar"), ("os", "boxcar"), ("ca", "hann")])
def test_false_alarm_rate_on_noise_is_the_design_value(kind, window):
    """Issue: within a factor 1.5 of 1e-4 on at least 1e6 cells. The joint test sees half as many, of two looks each.

    Expected are 200 single and 100 joint false alarms; neighbouring cells are correlated, so the counts scatter by
    some 10 % and 14 %: 1.5 is beyond three of their deviations.
    """
    single, joint, tested = counted_rates(kind, window, 2_000_000)
    assert tested >= 2_000_000
    assert PFA / 1.5 < single < PFA * 1.5
    assert PFA / 1.5 < joint < PFA * 1.5


def test_altitudes_on_noise_alone_are_as_rare_as_the_cells_make_them():
    """Every cell of the up sweep, with all the partners that Doppler allows, is one test at the design rate."""
    altimeter = Altimeter(W, AltimeterSettings(pfa=1e-3))
    rng = np.random.default_rng(5)
    frames = 1500
    valid = np.concatenate([altimeter.process(noise_frames(rng, 100))["valid"] for _ in range(frames // 100)])
    low, high = altimeter.search_hz
    cells = np.count_nonzero((altimeter.beat_hz >= low) & (altimeter.beat_hz <= high))
    bound = 1 - (1 - 1e-3) ** cells  # neighbouring cells are correlated: fewer independent tests than cells
    assert 0.2 * bound < valid.mean() < 1.2 * bound


def test_independent_cells_give_the_textbook_scale():
    """Cell averaging over n independent cells: Pfa = (1 + a/n)^-n."""
    cfar = Cfar(pfa=1e-4, train=12, guard=2)
    n = 24
    assert cfar.scale() == pytest.approx(n * (1e-4 ** (-1 / n) - 1), rel=1e-6)


@pytest.mark.parametrize("pfa", [1e-2, 1e-3])
def test_order_statistic_scale_holds_by_simulation(pfa):
    """Independent exponential cells, drawn and sorted: no formula shared with the code."""
    cfar = Cfar(pfa=pfa, train=8, guard=1, kind="os", rank=0.75)
    rng = np.random.default_rng(3)
    cells = rng.exponential(size=(400_000, 17))
    level = np.sort(cells[:, 1:], axis=1)[:, 11]  # the twelfth of sixteen
    rate = np.mean(cells[:, 0] > cfar.scale() * level)
    assert rate == pytest.approx(pfa, rel=4 / np.sqrt(400_000 * pfa))


def test_joint_scale_holds_by_simulation():
    """Sum of two independent ratios, each at least the floor."""
    cfar = Cfar(pfa=1e-3, train=10, guard=0)
    rng = np.random.default_rng(4)
    draws = 600_000
    ratio = rng.exponential(size=(draws, 2)) / rng.gamma(20, 1 / 20, size=(draws, 2))
    rate = np.mean((ratio.sum(axis=1) > cfar.joint_scale(2.0)) & (ratio.min(axis=1) >= 2.0))
    assert rate == pytest.approx(1e-3, rel=4 / np.sqrt(draws * 1e-3))


def test_correlation_of_neighbouring_cells_is_that_of_transformed_noise():
    window = np.hanning(64)
    expected = cell_correlation(window, 6, 128)
    rng = np.random.default_rng(8)
    noise = (rng.standard_normal((40_000, 64)) + 1j * rng.standard_normal((40_000, 64))) * window
    cells = np.fft.fft(noise, 128, axis=1)[:, 30:37]
    covariance = (cells.conj().T @ cells / np.mean(np.abs(cells) ** 2)) / len(cells)
    # E[X_k conj X_l] at k - l = lag; the matrix is Toeplitz
    for lag in range(6):
        measured = np.mean([covariance[i, i + lag] for i in range(7 - lag)])
        assert abs(measured - expected[lag]) < 0.02


@pytest.mark.parametrize("kind", ["ca", "os"])
def test_noise_estimate_is_the_statistic_of_the_training_cells(kind):
    """Reference: one cell at a time, by hand."""
    cfar = Cfar(train=5, guard=2, kind=kind, rank=0.75)
    power = np.random.default_rng(1).exponential(size=40)
    noise = cfar.noise(power)
    assert noise.shape == (40 - 14,)
    for at, value in enumerate(noise, start=7):
        training = [power[at + d] for d in range(-7, 8) if abs(d) > 2]
        expected = np.mean(training) if kind == "ca" else sorted(training)[7]  # round(0.75 * 10) = 8th
        assert value == pytest.approx(expected, rel=1e-12)


def test_second_target_among_the_training_cells_masks_less_with_order_statistics():
    power = np.ones(81)
    power[40], power[52] = 60.0, 1e4
    ratios = {
        kind: power[40] / Cfar(train=24, guard=3, kind=kind).noise(power)[40 - 27] for kind in ("ca", "os")
    }
    assert ratios["ca"] < 1 < 12 < ratios["os"]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"pfa": 0.0}, "cfar.pfa is 0.0; it has to be within"),
        ({"train": 1}, "cfar.train 1 has to be at least 2"),
        ({"kind": "go"}, "cfar.kind is 'go'; allowed: ca, os"),
        ({"rank": 1.5}, "cfar.rank is 1.5"),
    ],
)
def test_impossible_settings_are_refused(values, said):
    with pytest.raises(ValueError, match=said):
        Cfar(**values)
