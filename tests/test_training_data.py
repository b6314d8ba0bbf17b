"""Training examples and the evaluation of models: reproducible, from the core. Needs no PyTorch."""

import itertools
from dataclasses import replace

import data
import interferers
import numpy as np
import pytest
from frames import W
from hostile import refused

from radalt.core.interference.emitters.recording import RecordingEmitter
from radalt.core.mitigation.any_sweep import layout_of
from radalt.core.returns.point import point_return
from radalt.evaluation.commands import make_recording


def test_an_example_is_a_function_of_seed_and_index():
    config = data.CONFIGS["paper"]
    first, again = (data.example(config, W, 20, 7) for _ in range(2))
    np.testing.assert_array_equal(first[0], again[0])
    assert not np.array_equal(first[0], data.example(config, W, 20, 8)[0])
    assert not np.array_equal(first[0], data.example(config, W, 21, 7)[0])


def test_paper_set_has_the_papers_size_and_a_validation_part_of_its_own():
    config = data.CONFIGS["paper"]
    assert (config.size, config.validation, config.sir_db) == (50_000, 10_000, (-20.0, 0.0))
    _, clean, altitude_m, _ = next(data.validation_batches(config, W, 2))
    received, wanted, altitude = data.example(config, W, config.seed, 50_000)
    np.testing.assert_array_equal(clean[0, 0], wanted.real)
    assert altitude_m[0] == altitude


def test_clean_part_is_the_cores_return():
    """Without echoes the target is the core's delayed sweep, up to its carrier phase."""
    config = replace(data.CONFIGS["paper"], max_vertical_speed_m_per_s=0.0)
    _, clean, altitude_m = data.example(config, W, 1, 3)
    wanted = point_return(W, np.array([altitude_m]))[0]
    coherence = abs(np.vdot(wanted, clean)) / 7500
    assert coherence == pytest.approx(1.0, abs=1e-4)


def test_every_epoch_holds_every_example_once_in_its_own_order(tmp_path):
    config = replace(data.CONFIGS["paper"], size=8, validation=2)
    epochs = [batch[0] for batch in itertools.islice(data.batches(config, W, 8), 2)]
    first, second = (sorted(epoch[:, 0, 0]) for epoch in epochs)
    assert first == second and len(set(first)) == 8
    assert not np.array_equal(epochs[0], epochs[1])
    # resumed after half an epoch, the second half comes
    resumed = next(data.batches(config, W, 4, first=4))[0]
    np.testing.assert_array_equal(resumed, epochs[0][4:])
    # two that take turns make the same
    turns = [next(data.batches(config, W, 4, first=4 * k, share=2))[0] for k in range(2)]
    np.testing.assert_array_equal(np.concatenate(turns), epochs[0])
    # a set kept on disk gives the same, rounded to float16
    stored = data.stored_set(config, W, tmp_path)
    kept, clean, _ = next(data.batches(config, W, 8, stored=stored))
    np.testing.assert_array_equal(kept, epochs[0].astype(np.float16))
    assert clean.dtype == np.float32 and stored.shape == (10, 2, 2, W.samples_per_frame)


def test_a_coarse_converter_leaves_its_levels():
    """Every frame through 1 to 8 bits: at most 256 values on a rail, and no example without a return in it."""
    config = replace(data.CONFIGS["received"], converter=1.0, counts=(1.0,))
    levels = set()
    for index in range(30):
        received, clean, _ = data.example(config, W, 5, index)
        values = np.unique(np.concatenate([received.real, received.imag]))
        levels.add(values.size)
        assert values.size <= 256
        assert abs(np.vdot(clean, received)) > 0.3 * np.linalg.norm(clean) * np.linalg.norm(received)
    assert min(levels) == 2


def test_sweeps_of_training_are_of_all_kinds_and_need_no_resampling():
    config = data.CONFIGS["any_sweep"]
    sweeps = [data.sweep_of(config, number, W) for number in range(60)]
    others = [sweep for sweep in sweeps if sweep != W]
    assert 0.5 < len(others) / len(sweeps) < 0.9
    assert min(s.bandwidth_hz for s in others) < 2e6 < 8e6 < max(s.bandwidth_hz for s in others)
    assert {s.centered for s in others} == {True, False}
    assert all(layout_of(s).samples == s.samples_per_frame for s in others)
    assert data.sweep_of(data.CONFIGS["ground"], 3, W) == W


def test_a_frame_without_a_return_has_its_noise_as_target():
    config = replace(data.CONFIGS["any_sweep"], empty=1.0, converter=0.0, counts=(1.0,))
    received, clean, _ = data.example(config, W, 1, 0)
    np.testing.assert_array_equal(received, clean)
    assert np.mean(np.abs(clean) ** 2) == pytest.approx(1.0, abs=0.1)
    assert np.abs(np.fft.fft(clean * W.reference.conj())).max() ** 2 / 7500 < 30  # no line at any beat


ONE_QPSK = {"kinds": (("qpsk_rectangular", 1.0),), "counts": (0.0, 1.0), "sir_db": (-40.0, -40.0)}
ONE_QPSK |= {"snr_db": (80.0, 80.0)} | dict.fromkeys(("impaired", "empty", "converter", "front_end"), 0.0)


def test_interference_as_received_has_paths_and_no_power_at_the_bands_edge():
    """A rectangular burst reaches over the band; behind paths and filter it has echoes, and its spectrum ends."""
    for received in (0.0, 1.0):
        lasting = {"full_overlap": 1.0, "persistent": 1}
        config = replace(data.CONFIGS["any_sweep"], **ONE_QPSK, received=received, **lasting)
        spectra = []
        for index in range(20):
            frame, clean, _ = data.example(config, W, 1, index)
            spectra.append(np.abs(np.fft.fft((frame - clean).astype(complex) * np.hanning(7500))) ** 2)
            assert -10 * np.log10(np.mean(np.abs(frame - clean) ** 2)) == pytest.approx(-40.0, abs=0.05)
        power = np.mean(spectra, axis=0)
        edge_db = 10 * np.log10(power[3740:3760].mean() / power.mean())  # half the rate is in the middle
        assert (edge_db < -40.0) == bool(received)


def test_an_interferers_own_noise_is_as_far_below_it_as_said(monkeypatch):
    """Tones leave the band empty, so the noise there tells its power; the SIR holds both."""
    monkeypatch.setattr(interferers, "_OWN_NOISE_DB", (-10.0, -10.0))
    levels_db = []
    for own_noise in (0.0, 1.0):
        kinds = {"kinds": (("tones", 1.0),)}
        config = replace(
            data.CONFIGS["any_sweep"], **ONE_QPSK | kinds, received=0.0, own_noise=own_noise, full_overlap=1.0,
            persistent=1,
        )  # fmt: skip
        share = []
        for index in range(10):
            frame, clean, _ = data.example(config, W, 1, index)
            power = np.abs(np.fft.fft((frame - clean).astype(complex) * np.hanning(7500))) ** 2
            assert -10 * np.log10(np.mean(np.abs(frame - clean) ** 2)) == pytest.approx(-40.0, abs=0.05)
            share.append(7500 * np.median(power) / power.sum())
        levels_db.append(10 * np.log10(np.mean(share)))
    assert levels_db[0] < -40.0
    # half of exponentially distributed powers are below log 2 of their mean
    assert levels_db[1] == pytest.approx(10 * np.log10(np.log(2.0) * 0.1 / 1.1), abs=0.2)


def test_interference_that_lasts_goes_on_in_the_next_example():
    """Two examples share one burst, which need not end where the first does; a return is each example's own."""
    config = replace(data.CONFIGS["any_sweep"], **ONE_QPSK, received=0.0, full_overlap=0.0, persistent=2)
    over_the_edge = 0
    for group in range(12):
        pair = [data.example(config, W, 1, 2 * group + k) for k in (0, 1)]
        on = np.concatenate([np.abs(frame - clean) > 1.0 for frame, clean, _ in pair])
        assert np.count_nonzero(np.diff(on.astype(int)) == 1) <= 1  # one beginning at most
        over_the_edge += on[7499] and on[7500]
        assert pair[0][2] != pair[1][2]
    assert over_the_edge >= 3


def recording(folder, name, seed):
    """A short SigMF recording of noise."""
    noise = np.random.default_rng(seed).standard_normal((40_000, 2)).view(complex)[:, 0]
    make_recording.write(folder / f"{name}.sigmf-meta", noise, 1e6, "noise")
    return str(folder / f"{name}.sigmf-meta")


@pytest.mark.parametrize("count", [1, 2, 3, 9])
def test_no_recording_is_in_both_training_and_validation(tmp_path, count):
    """Told apart by their samples, so a copy under another name does not help."""
    files = [recording(tmp_path, f"r{k}", k) for k in range(count)]
    copies = [recording(tmp_path, f"copy{k}", k) for k in range(count)]
    train, validation = data.split_recordings(files + copies)
    digests = [{data._digest(name) for name in part} for part in (train, validation)]
    assert not digests[0] & digests[1]
    assert len(digests[0]) + len(digests[1]) == len(train) + len(validation) == count
    assert (len(validation) > 0) == (count > 1)


def test_training_hears_the_recordings_of_its_part_only(tmp_path, monkeypatch):
    used = []

    class Listed(RecordingEmitter):
        def samples(self, count, rate_hz, rng):
            used.append(self.file)
            return np.ones(count, dtype=complex)

    monkeypatch.setattr("interferers.RecordingEmitter", Listed)
    files = tuple(recording(tmp_path, f"r{k}", k) for k in range(5))
    train, validation = data.split_recordings(files)
    config = replace(data.CONFIGS["paper"], recordings=files, counts=(0.0, 1.0), size=0)
    next(data.batches(config, W, 40))
    assert set(used) <= set(train) and len(used) > 5
    used.clear()
    list(data.validation_batches(config, W, 40, 20))
    assert set(used) <= set(validation) and used


def test_a_recording_that_is_not_there_is_one_line(tmp_path):
    said = r"recording .*none.sigmf-data: No such file.*; name a .sigmf-meta"
    with refused(ValueError, said):
        data.split_recordings([str(tmp_path / "none.sigmf-meta")])
