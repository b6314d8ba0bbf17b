"""GNU Radio's own transmitters as recordings: each has the marks of its standard, and its scene plays it."""

import numpy as np
import pytest

from radalt.core.scene import load_scene
from radalt.evaluation.transmitters import TRANSMITTERS, transmit

SECONDS = 0.02


@pytest.fixture(scope="module")
def sent():
    return {name: transmit(name, SECONDS, 3) for name in TRANSMITTERS}


def band_hz(samples, rate_hz):
    """Edges of the band that holds 99 % of the power."""
    power = np.fft.fftshift(np.abs(np.fft.fft(samples)) ** 2)
    share = np.cumsum(power) / power.sum()
    return (np.searchsorted(share, [0.005, 0.995]) / samples.size - 0.5) * rate_hz


@pytest.mark.parametrize(
    ("name", "width_hz"),
    [
        ("dvbt", 6.66e6),  # 1705 carriers of 3906.25 Hz, EN 300 744 Table 4 scaled to 7 MHz
        ("dvbt2", 6.66e6),
        ("atsc", 5.4e6),  # half of 10.76 MHz
        ("dvbs2", 5.4e6),  # 5 MBd, and a part of the roll-off of 0.2
        ("ofdm", 8.24e6),  # 53 carriers of 156.25 kHz
    ],
)
def test_bandwidth_is_that_of_the_standard(sent, name, width_hz):
    one, samples = TRANSMITTERS[name], sent[name]
    assert samples.size == round(SECONDS * one.rate_hz)
    assert np.mean(np.abs(samples) ** 2) == pytest.approx(1.0)
    low, high = band_hz(samples, one.rate_hz)
    assert high - low == pytest.approx(width_hz, rel=0.04)


@pytest.mark.parametrize("name, length, prefix", [("dvbt", 2048, 64), ("dvbt2", 2048, 256), ("ofdm", 64, 16)])
def test_ofdm_has_its_cyclic_prefix(sent, name, length, prefix):
    samples, period = sent[name][: 12 * (length + prefix) if length > 64 else None], length + prefix
    product = samples[:-length] * samples[length:].conj()
    product = np.abs(product[: product.size // period * period].reshape(-1, period).mean(axis=0))
    inside = np.convolve(np.concatenate([product, product]), np.ones(prefix) / prefix, "valid")[:period].max()
    assert inside > 0.8 and np.median(product) < 0.45


def test_atsc_has_its_pilot_and_dvbs2_its_symbol_rate(sent):
    spectrum = np.abs(np.fft.fft(sent["atsc"])) ** 2
    # A/53 Part 2: 0.31 MHz above the channel's lower edge
    pilot_hz = -3e6 + (6e6 - 4.5e6 * 684 / 286 / 2) / 2
    peak_hz = np.fft.fftfreq(spectrum.size, 1 / 10e6)[spectrum.argmax()]
    assert peak_hz == pytest.approx(pilot_hz, abs=100.0)
    line = np.abs(np.fft.fft(np.abs(sent["dvbs2"]) ** 2))
    line[0] = 0
    near = np.abs(np.abs(np.fft.fftfreq(line.size, 1 / 10e6)) - 5e6) < 200.0
    assert line[near].max() > 10 * np.median(line)


def test_the_payload_follows_the_seed(sent):
    same, other = transmit("dvbs2", SECONDS, 3), transmit("dvbs2", SECONDS, 4)
    assert np.array_equal(same, sent["dvbs2"])
    assert abs(np.vdot(same, other)) / same.size < 0.9  # headers and pilots are common


def test_every_transmitter_has_a_scene_of_its_name():
    for name in TRANSMITTERS:
        assert load_scene(name).interference[0].emitter.file == f"results/{name}.sigmf-meta"
