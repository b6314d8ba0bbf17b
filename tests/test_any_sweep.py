"""One set of weights for every sweep: sizes, tables, and what the network does at sweeps that no training drew."""

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from frames import returns, white
from hostile import refused
from scipy.stats import binom

from radalt import Altimeter, Waveform
from radalt.core.interference import Interferer, QpskEmitter, interference_frames
from radalt.core.mitigation import MitigationError, create
from radalt.core.mitigation.any_sweep import SERVED, layout_of

OWN = Waveform()
SHORT = Waveform(2e6, 0.5e-3, 2e6)  # resampled, a quarter of the columns
OVERSAMPLED = Waveform(5e6, 0.3e-3, 7.5e6)
WRAPPED = Waveform(10e6, 1e-3, 10e6, centered=False)
LONG = Waveform(1e6, 10e-3, 2e6)
WIDE = Waveform(15e6, 1e-3, 15e6)
OTHERS = (SHORT, OVERSAMPLED, WRAPPED, LONG, WIDE)


def scene(waveform, trials, seed):
    """Altitudes and returns at SNR 10 dB."""
    rng = np.random.default_rng(seed)
    altitude_m, frames = returns(rng, trials, waveform=waveform, span_m=(10.0, 1500.0))
    return altitude_m, frames.astype(np.complex64)


def correct(waveform, frames, altitude_m):
    """Share of altitudes within 5 m, or a quarter of a resolution cell where that is more."""
    result = Altimeter(waveform).process(frames)
    limit_m = max(5.0, 0.25 * waveform.range_resolution_m)
    return np.mean(result["valid"] & (np.abs(result["altitude_m"] - altitude_m) < limit_m))


@pytest.mark.parametrize("rate_hz", [2e6, 3.3e6, 7.5e6, 56e6])
def test_every_sweep_that_is_served_has_a_layout(rate_hz):
    bandwidths, periods = (1e6, 2e6, 7.1e6, 30e6, 56e6), (0.2e-3, 0.37e-3, 1e-3, 10e-3)
    for bandwidth_hz, sweep_s in product(bandwidths, periods):
        if bandwidth_hz > rate_hz:
            continue
        waveform = Waveform(bandwidth_hz, 2 * round(rate_hz * sweep_s / 2) / rate_hz, rate_hz)
        layout = layout_of(waveform)
        assert waveform.samples_per_frame <= layout.samples <= 1.15 * waveform.samples_per_frame
        assert layout.hop % 2 == layout.columns % 2 == layout.factors[0] % layout.group == 0
        assert np.prod(layout.factors) == layout.samples


@pytest.mark.parametrize(
    "key, sweep, end", [("bandwidth_hz", LONG, 0), ("sweep_s", OWN, 1), ("rate_hz", OWN, 1)]
)
def test_a_sweep_out_of_range_is_refused_in_one_line(key, sweep, end):
    low, high = SERVED[key]
    with refused(MitigationError, re.escape(f"network serves {low:g} to {high:g}: ")):
        create("tcae", replace(sweep, **{key: (0.5 * low, 2 * high)[end]}))


UNCHECKED = {"shift_check": False, "skip_white": False}


@pytest.mark.parametrize("sir_db", [-30.0, -45.0])
def test_at_the_default_sweep_it_is_as_good_as_the_network_of_that_alone(root, sir_db):
    altitude_m, frames = scene(OWN, 40, 3)
    qpsk, rng = [Interferer(QpskEmitter(pulse="rrc"), sir_db, 0.5)], np.random.default_rng(6)
    frames = frames + interference_frames(qpsk, *frames.shape, OWN.rate_hz, rng)
    other = create("tcae", OWN, model=root / "models/any_sweep.onnx", **UNCHECKED).process(frames)
    own = create("tcae", OWN).process(frames)
    assert correct(OWN, other, altitude_m) >= correct(OWN, own, altitude_m) - 0.05


@pytest.mark.parametrize("waveform", OTHERS)
def test_of_noise_it_makes_no_altitudes(waveform):
    """Frames without a return were in its training: unchecked it declares no more than the altimeter alone may."""
    noise, altimeter = white(np.random.default_rng(12), 100, waveform.samples_per_frame), Altimeter(waveform)
    cleaned = create("tcae", waveform, **UNCHECKED).process(noise.astype(np.complex64))
    most = binom.ppf(0.999, 100, altimeter.false_alarms_per_frame)
    assert np.count_nonzero(altimeter.process(cleaned)["valid"]) <= most


def test_which_file_serves_a_sweep():
    files = [create("tcae", w).model.name for w in (OWN, replace(OWN, carrier_hz=4.25e9), WRAPPED)]
    assert files == ["tcae.onnx", "tcae.onnx", "any_sweep.onnx"]


@pytest.mark.parametrize("waveform", OTHERS)
def test_without_interference_every_altitude_stays(waveform):
    altitude_m, frames = scene(waveform, 12, 3)
    assert correct(waveform, create("tcae", waveform).process(frames), altitude_m) == 1.0


@pytest.mark.parametrize(
    "waveform, sir_db", [(SHORT, -30.0), (OVERSAMPLED, -35.0), (WRAPPED, -45.0), (LONG, -45.0), (WIDE, -45.0)]
)
def test_shaped_qpsk_is_removed_where_none_is_blind(waveform, sir_db):
    altitude_m, frames = scene(waveform, 20, 4)
    emitter = QpskEmitter(bandwidth_hz=0.267 * waveform.bandwidth_hz, pulse="rrc")
    jammer, rng = [Interferer(emitter, sir_db, 0.3)], np.random.default_rng(5)
    frames = frames + interference_frames(jammer, *frames.shape, waveform.rate_hz, rng)
    cleaned = create("tcae", waveform, shift_check=False).process(frames)
    # 20 frames; what is below the limit is withheld, not wrong: the altimeter declares by likelihood.
    assert correct(waveform, frames, altitude_m) < 0.5 < 0.8 <= correct(waveform, cleaned, altitude_m)


@pytest.mark.parametrize("waveform", [SHORT, OVERSAMPLED, LONG])
def test_noise_alone_passes_bit_for_bit(waveform):
    """Of what the network does not touch it makes no false return."""
    noise = white(np.random.default_rng(11), 40, waveform.samples_per_frame).astype(np.complex64)
    method = create("tcae", waveform)
    np.testing.assert_array_equal(method.process(noise), noise)
    assert method.status()["skipped_frames"] == 40
