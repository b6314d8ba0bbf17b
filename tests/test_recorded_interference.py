"""A recording as interferer: at its frequency, at its power, from SigMF and raw files alike."""

import json
import re
import wave

import numpy as np
import pytest
from hostile import refused
from scipy.io import savemat, wavfile

from radalt.core.interference import Interferer, interference_frame
from radalt.core.interference.effects import ImpairedEmitter, Impairments
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.emitters.qpsk import QpskEmitter
from radalt.core.interference.emitters.recording import RecordingEmitter
from radalt.core.interference.emitters.tones import ToneEmitter
from radalt.core.interference.multipath import FadingChannel
from radalt.core.interference.own_noise import MOST_DB, prefix_snr_db
from radalt.core.interference.stream import JammerStream
from radalt.core.scene import SceneError, load_scene, parse_scene, scene_to_mapping
from radalt.core.waveform import Waveform
from radalt.evaluation.commands import make_recording
from radalt.evaluation.overlap.study import OverlapStudy

RATE_HZ = 7.5e6


def write(folder, samples, rate_hz, **fields):
    """A SigMF recording of complex samples; the path of its metadata."""
    samples.astype(np.complex64).tofile(folder / "air.sigmf-data")
    head = {"core:datatype": "cf32_le", "core:sample_rate": rate_hz, "core:version": "1.0.0", **fields}
    meta = folder / "air.sigmf-meta"
    meta.write_text(json.dumps({"global": head, "captures": [{"core:sample_start": 0}], "annotations": []}))
    return meta


def frequency_hz(samples):
    """Of the strongest line."""
    spectrum = np.abs(np.fft.fft(samples * np.hanning(samples.size), 16 * samples.size))
    return np.fft.fftfreq(spectrum.size, 1 / RATE_HZ)[spectrum.argmax()]


@pytest.mark.parametrize(("rate_hz", "offset_hz"), [(2e6, 0.0), (2e6, 2.5e6), (20e6, -1e6), (7.5e6, 1e6)])
def test_a_tone_is_heard_where_it_is_moved_to(tmp_path, rate_hz, offset_hz):
    tone = 0.3 * np.exp(2j * np.pi * 100e3 / rate_hz * np.arange(round(0.02 * rate_hz)))
    emitter = RecordingEmitter(file=str(write(tmp_path, tone, rate_hz)), offset_hz=offset_hz)
    arrived = emitter.samples(7500, RATE_HZ, np.random.default_rng(1))
    assert frequency_hz(arrived) == pytest.approx(100e3 + offset_hz, abs=60.0)
    assert np.mean(np.abs(arrived) ** 2) == pytest.approx(1.0, rel=0.02)


def test_free_running_it_goes_on_until_the_file_ends_and_then_again(tmp_path):
    tone = np.exp(2j * np.pi * 200e3 / RATE_HZ * np.arange(7500 * 50))
    emitter = RecordingEmitter(file=str(write(tmp_path, tone, RATE_HZ)))
    stream = JammerStream(Waveform(), [Interferer(emitter, 0.0, 1.0)], free_running=True)
    stream.next_frame()  # it begins within this one
    sent = np.concatenate([stream.next_frame() for _ in range(110)])
    turn = sent[1:] * sent[:-1].conj()
    assert np.abs(np.angle(turn) - 2 * np.pi * 200e3 / RATE_HZ).max() < 1e-3


FORMS = {
    "air.ci16": (lambda path, rails: rails.tofile(path), {"rate_hz": 5e6, "datatype": "ci16_le"}),
    "pairs.npy": (np.save, {"rate_hz": 5e6}),
    "complex.npy": (lambda path, rails: np.save(path, rails @ [1, 1j]), {"rate_hz": 5e6}),
    "air.wav": (lambda path, rails: wavfile.write(path, 5_000_000, rails), {}),
    "24 bits.wav": (lambda path, rails: write_wav24(path, 5_000_000, rails), {}),
}


def write_wav24(path, rate_hz, rails):
    with wave.open(str(path), "wb") as file:
        file.setparams((2, 3, rate_hz, len(rails), "NONE", ""))
        file.writeframes((rails.astype("<i4") << 8).view(np.uint8).reshape(-1, 4)[:, :3].tobytes())


@pytest.mark.parametrize("name", FORMS)
def test_other_files_are_the_same_samples(tmp_path, name):
    rng = np.random.default_rng(4)
    rails = np.round(3000 * rng.standard_normal((40_000, 2))).astype("<i2")
    save, fields = FORMS[name]
    save(tmp_path / name, rails)
    emitters = [
        RecordingEmitter(file=str(file), **given)
        for file, given in ((write(tmp_path, rails @ [1, 1j], 5e6), {}), (tmp_path / name, fields))
    ]
    a, b = (emitter.samples(5000, RATE_HZ, np.random.default_rng(5)) for emitter in emitters)
    np.testing.assert_allclose(a, b, atol=1e-5)
    assert emitters[1].notes(RATE_HZ) == (f"{name}: no OFDM found, so its noise is not known",)


def numbers(path, kind, mean=0.0, rms=300.0):
    np.random.default_rng(3).normal(mean, rms, (20_000, 2)).astype(kind).tofile(path)


@pytest.mark.parametrize(
    ("make", "datatype", "said"),
    [
        (lambda path: np.savez(path.open("wb"), np.ones(99)), "cf32_le", "zip archive"),
        (lambda path: savemat(path, {"x": np.eye(9)}, appendmat=False), "cf32_le", "MATLAB"),
        (lambda path: path.write_bytes(b"PAR1" + bytes(999)), "cf32_le", "another program's format"),
        (lambda path: numbers(path, "u1", 127.5, 20), "ci8", "not ci8; are they cu8"),
        (lambda path: path.write_bytes(bytes(80_000)), "cf32_le", "not finite, or zeros alone"),
        (lambda path: path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(999)), "cf32_le", "HDF5"),
        (lambda path: wavfile.write(path, 48_000, np.ones(99, "<i2")), "cf32_le", r"int16 of shape \(99,\)"),
        (lambda path: np.save(path.open("wb"), np.ones((99, 2))), "ci8", "states the type; leave"),
        (lambda path: numbers(path, "<f4"), "ci16_le", "not ci16_le; are they cf32_le"),
        (lambda path: numbers(path, "<i2"), "cf32_le", "not cf32_le; are they ci16_le"),
        (lambda path: write(path.parent, np.ones(9), 5e6) and path.touch(), "", "air.sigmf-data; name"),
        (lambda path: numbers(path, "<i2"), "", "datatype is missing.* ci16_le"),
    ],
)
def test_what_is_no_samples_of_that_type_is_refused(tmp_path, make, datatype, said):
    path = tmp_path / "air.bin"
    make(path)
    with refused(ValueError, said) as caught:
        emitter = RecordingEmitter(file=str(path), datatype=datatype, rate_hz=7.5e6 if datatype else None)
        emitter.samples(100, RATE_HZ, np.random.default_rng(6))
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("effects", [{}, {"fading": {"profile": "EVA"}}])
def test_a_run_states_the_samples_of_a_recording_and_not_its_name(tmp_path, effects):
    stated = []
    for name, level in (("a", 1.0), ("same", 1.0), ("other", 1.1)):
        (tmp_path / name).mkdir()
        file = write(tmp_path / name, np.exp(1j * level * np.arange(30_000)), RATE_HZ)
        scene = parse_scene({"interference": {"recording": {"file": str(file), **effects}}})
        stated.append(OverlapStudy(scene).head()["recordings"]["0"])
    assert stated[0] == stated[1] != stated[2]


def test_a_scene_names_it_and_its_origin_is_noted(tmp_path):
    meta = write(tmp_path, np.ones(30_000), 7.5e6, **{"core:license": "CC0", "core:author": "Somebody"})
    scene = parse_scene({"interference": {"recording": {"file": str(meta), "sir_db": -30.0}}})
    emitter = scene.interference[0].emitter
    assert emitter.label == "recording_air"
    notes = emitter.notes(RATE_HZ)
    assert any("CC0" in note for note in notes) and "no OFDM found" in notes[-1]
    assert parse_scene(scene_to_mapping(scene)).interference[0].emitter == emitter
    with pytest.raises(SceneError, match="recording.seconds is 5"):
        parse_scene({"interference": {"recording": {"file": str(meta), "seconds": 5.0}}})


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"file": "nothing.sigmf-meta"}, "nothing.sigmf-meta"),
        ({"start_s": 3.0}, "recording.start_s is 3, and .* lasts 0.004 s; start earlier"),
        ({"offset_hz": 9e6}, "leaves nothing of"),
        ({"rate_hz": 7.5e6}, "SigMF states rate and type; leave out"),
    ],
)
def test_what_does_not_fit_is_one_line(tmp_path, change, said):
    meta = write(tmp_path, np.exp(2j * np.pi * 0.01 * np.arange(30_000)), 7.5e6)
    emitter = RecordingEmitter(**{"file": str(meta), **change})
    with refused(ValueError, said):
        emitter.samples(100, RATE_HZ, np.random.default_rng(6))


def noisy(samples, snr_db, rng):
    """Mean power 1, and white noise over the whole rate."""
    noise = rng.standard_normal((samples.size, 2)).view(np.complex128)[:, 0]
    return samples / np.sqrt(np.mean(np.abs(samples) ** 2)) + np.sqrt(0.5 * 10 ** (-snr_db / 10)) * noise


@pytest.mark.parametrize("snr_db", [0.0, 8.0, 15.0])
@pytest.mark.parametrize("load", [0.2, 1.0])
@pytest.mark.parametrize("profile", [None, "EVA"])
def test_the_prefix_tells_a_recordings_own_noise(snr_db, load, profile):
    rng = np.random.default_rng(11)
    emitter = NrEmitter(channel_bandwidth_hz=10e6, load=load, cell_id=7, frame_count=4)
    if profile:
        emitter = ImpairedEmitter(emitter=emitter, effects=Impairments(fading=FadingChannel(profile=profile)))
    arrived = noisy(emitter.samples(300_000, RATE_HZ, rng), snr_db, rng)
    assert prefix_snr_db(arrived, RATE_HZ) == pytest.approx(snr_db, abs=1.5)


def test_the_prefix_is_found_at_any_rate_and_two_antennas_are_one_signal():
    rng = np.random.default_rng(12)
    arrived = noisy(NrEmitter().samples(200_000, 5.5e6, rng), 8.0, rng)
    assert prefix_snr_db(arrived, 5.5e6) == pytest.approx(8.0, abs=1.0)
    # 8 dB over 15.36 MHz; the carrier has 9.36 MHz of it
    pair = make_recording.received(2, 0.5, 8.0, seed=3)
    assert prefix_snr_db(pair, make_recording.RATE_HZ) == pytest.approx(8.0, abs=1.0)
    assert prefix_snr_db(noisy(pair, 60.0, rng)[:600_000], make_recording.RATE_HZ) < MOST_DB


@pytest.mark.parametrize("emitter", [QpskEmitter(), QpskEmitter(pulse="rrc"), ToneEmitter(3)])
def test_what_has_no_prefix_has_no_estimate(emitter):
    rng = np.random.default_rng(13)
    assert prefix_snr_db(noisy(emitter.samples(300_000, RATE_HZ, rng), 10.0, rng), RATE_HZ) is None
    assert prefix_snr_db(noisy(np.ones(300_000), -90.0, rng), RATE_HZ) is None


def test_the_command_makes_what_the_scene_names(tmp_path, monkeypatch, root, capsys):
    monkeypatch.chdir(tmp_path)
    scene = load_scene("recorded")
    with pytest.raises(ValueError, match="make-recording"):
        scene.interference[0].emitter.samples(7500, RATE_HZ, np.random.default_rng(14))
    assert make_recording.main([]) == 0
    assert capsys.readouterr().out.strip() == scene.interference[0].emitter.file
    frame = interference_frame(scene.interference[0], 7500, RATE_HZ, np.random.default_rng(14))
    assert np.mean(np.abs(frame) ** 2) == pytest.approx(100.0)
    notes = scene.interference[0].emitter.notes(RATE_HZ)
    # 8 dB over 15.36 MHz are 10.1 over the carrier's 9.36 MHz; the paths' gain in the radar's 7.5 MHz differs
    bound = re.search(r"OFDM ([\d.]+) dB above .* at most ([\d.]+) dB", notes[-1])
    assert float(bound[1]) == pytest.approx(10.1, abs=1.5) and 0 < float(bound[2]) - float(bound[1]) < 1
    assert any("SYNTHETIC" in note for note in notes)
