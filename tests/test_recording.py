"""SigMF capture and replay: to the bit what was live, gaps included; foreign recordings; files that do not fit."""

import codecs
import csv
import hashlib
import json
import os
from pathlib import Path

import numpy as np
import ota_eval
import pytest
import sigmf
import uhd_double
from hostile import assert_refused, ended, refused
from scipy import signal
from waiting import ROOT, patient

from radalt.core.interference.emitters.recording import RecordingEmitter
from radalt.core.mitigation import CUSTOM, METHODS
from radalt.core.radio.calibration import CalibrationKey, store_latency_samples
from radalt.core.radio.recording import RecordingError, Stretch, open_capture, write_metadata
from radalt.core.returns.point import point_return
from radalt.core.scene import parse_scene
from radalt.core.waveform import Waveform
from radalt.evaluation.flowgraph.generate import prepare
from radalt.evaluation.flowgraph.replay import prepare_replay, replay_scene, run_replay, summary
from radalt.evaluation.flowgraph.run import run_point
from radalt.evaluation.radios.hardware import run_hardware
from radalt.evaluation.results.folder import FolderError, read_report

EVERY_METHOD = (*METHODS, CUSTOM)


def a_scene(**changes):
    return parse_scene(
        {
            "name": "flight",
            "altitude": {"programme_m": [300.0, 60.0], "frames": 15},
            "interference": {"qpsk": {"sir_db": -12.0, "overlap": 0.5, "bandwidth_hz": 2.0025e6}},
            "channel": {"snr_db": 10.0, "drops": {"count": 1}},
            "method_options": {CUSTOM: {"file": str(ROOT / "flowgraphs/own_method.py")}},
            "seed": 11,
            **changes,
        }
    )


def recorded(scene, methods, folder, name):
    """Result of a live run, its recording in a folder."""
    prepared = prepare(scene, methods, folder)
    return run_point(prepared, scene, time_limit_s=patient(50), capture=folder / name)


def replayed(prepared, path, scene=None):
    """Result of a replay, its scene, and whether the recording states it."""
    placed, known = replay_scene(open_capture(path), scene)
    return run_replay(prepared, placed, path, known=known, time_limit_s=patient(50)), placed, known


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    """A run with a tagged gap, its recording and its results."""
    folder = tmp_path_factory.mktemp("live")
    scene = a_scene()
    return folder / "flight.sigmf-meta", scene, recorded(scene, EVERY_METHOD, folder, "flight")


@pytest.fixture(scope="module")
def replayer(tmp_path_factory):
    return prepare_replay(("none", "whitening"), tmp_path_factory.mktemp("replay"))


def test_a_replay_is_the_live_run_to_the_bit(live, tmp_path):
    """Every shipped method, and one of the user's own."""
    path, scene, result = live
    again, placed, known = replayed(prepare_replay(EVERY_METHOD, tmp_path), path)
    assert known and placed == scene
    assert result.segmenter["discontinuities"] == 1
    assert again.segmenter == result.segmenter
    for method in EVERY_METHOD:
        assert len(result.results[method]) > 20
        assert again.results[method].tobytes() == result.results[method].tobytes(), method


def test_a_replay_off_the_air_is_the_live_run_to_the_bit(tmp_path, monkeypatch):
    """Rail and stored latency come from the recording, not from this machine's configuration."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    air = uhd_double.Air(gain=0.9)
    uhd_double.install(monkeypatch, air)
    radio = {"radar_serial": "R", "jammer_serial": "J", "enclosure": "cabled", "attenuation_db": 60.0}
    scene = a_scene(channel={}, radio=radio, altimeter={"max_altitude_m": 1500.0})
    rate_hz = scene.waveform.rate_hz
    key = CalibrationKey("B210", "R", scene.radio.master_clock_hz, rate_hz)
    store_latency_samples(uhd_double.LATENCY - 5, key)
    options = {"transmit": True, "log": lambda line: None, "sleep": air.sleep, "time_limit_s": patient(50)}
    result = run_hardware(scene, ("none", "tcae"), capture=tmp_path / "air", **options)
    store_latency_samples(uhd_double.LATENCY - 11, key)
    again, _, _ = replayed(prepare_replay(("none", "tcae"), tmp_path / "replay"), tmp_path / "air.sigmf-meta")
    for method in ("none", "tcae"):
        live, later = result.results[method], again.results[method]
        # the live run may have dropped frames when a method was slow, and ends where it was stopped
        both, at, where = np.intersect1d(live["frame_index"], later["frame_index"], return_indices=True)
        assert len(both) > 20
        assert live[at].tobytes() == later[where].tobytes()
    trial = result.results["none"][result.results["none"]["frame_index"] >= 8]
    shift_m = 5 * 299792458 / 2 / rate_hz
    assert np.isclose(np.median(trial["altitude_m"][:10]), 300.0 + shift_m, atol=1.0)


def test_annotations_tell_altitude_jammer_and_gap(live):
    path, scene, result = live
    recording = sigmf.sigmffile.fromfile(str(path))
    recording.validate()
    assert recording.get_global_field("core:sample_rate") == 7.5e6
    captures = recording.get_captures()
    assert len(captures) == 2  # the gap splits them, and their counters differ by what was lost
    lost = captures[1]["core:global_index"] - captures[1]["core:sample_start"]
    assert lost == result.segmenter["lost_samples"] > 0
    notes = recording.get_annotations()
    assert [n["radalt:altitude_m"] for n in notes if n["core:label"] == "timing"] == [0.0]
    assert {n["radalt:altitude_m"] for n in notes if n["radalt:jammer"]["on"]} == {300.0, 60.0}
    assert all(n["radalt:jammer"]["sir_db"] == -12.0 for n in notes if n["radalt:jammer"]["on"])
    # an annotation covers the frames it names: eight of the preamble
    assert notes[0]["core:sample_count"] == 8 * scene.waveform.samples_per_frame


def test_annotations_begin_later_by_the_latency_and_are_cut_where_samples_are_missing(tmp_path):
    """Sweep 0 begins 100 samples after the counter's zero; the fifth frame's samples are lost."""
    scene, n = a_scene(), 7500
    np.zeros(20 * n, np.complex64).tofile(tmp_path / "gap.sigmf-data")
    stretches = [Stretch(0, 0, 4 * n), Stretch(4 * n, 5 * n, 16 * n)]
    meta = write_metadata(tmp_path / "gap.sigmf-data", scene, stretches, latency_samples=100.4, recorder="t")
    notes = sigmf.sigmffile.fromfile(str(meta)).get_annotations()
    placed = [(a["core:sample_start"], a["core:sample_count"]) for a in notes]
    assert placed[:2] == [(100, 4 * n - 100), (4 * n, 3 * n + 100)]  # the preamble's eight frames
    assert placed[2][0] == 7 * n + 100


def sweeps(count: int, altitude_m: float = 0.0, rate_hz: float = 7.5e6) -> np.ndarray:
    """(count frames) of the default sweep's return with a little noise."""
    samples = np.tile(point_return(Waveform(rate_hz=rate_hz), altitude_m), count)
    return samples + 0.1 * np.random.default_rng(3).standard_normal(2 * samples.size).view(complex)


def write_foreign(folder, samples, rate_hz, datatype):
    """A recording as another program makes it."""
    data = folder / "foreign.sigmf-data"
    if datatype == "ci16_le":
        scaled = samples / np.abs(samples.view(np.float64)).max() * 20000
        scaled.view(np.float64).round().astype("<i2").tofile(data)
    else:
        samples.astype("<c8").tofile(data)
    info = {"core:datatype": datatype, "core:sample_rate": rate_hz}
    recording = sigmf.SigMFFile(data_file=str(data), global_info=info)
    recording.add_capture(0)
    recording.tofile(str(folder / "foreign.sigmf-meta"), overwrite=True)
    return folder / "foreign.sigmf-meta"


@pytest.mark.parametrize(
    ("rate_hz", "datatype"), [(7.5e6, "cf32_le"), (7.5e6, "ci16_le"), (10e6, "ci16_le"), (15e6, "cf32_le")]
)
def test_foreign_recordings_give_the_altitude(tmp_path, replayer, rate_hz, datatype):
    """Sweeps at 0 m, then at 200 m as a true delay, made at the foreign rate."""
    samples = np.concatenate([sweeps(20, 0.0, rate_hz), sweeps(20, 200.0, rate_hz)])
    samples = samples[round(rate_hz / 7500) :]  # the recording begins anywhere within a sweep
    path = write_foreign(tmp_path, samples, rate_hz, datatype)
    scene = parse_scene({"altimeter": {"max_altitude_m": 1500.0}})
    result, _, known = replayed(replayer, path, scene)
    assert not known
    frames = result.results["none"]
    assert frames.size >= 34
    assert np.allclose(frames["altitude_m"][2:15], 0.0, atol=1.0)
    assert np.allclose(frames["altitude_m"][-12:], 200.0, atol=1.5)
    rows = {row["method"]: row for row in summary(result)}
    assert rows["none"]["found"] >= 30


def test_resampling_in_blocks_is_resampling_at_once(tmp_path, monkeypatch):
    rng = np.random.default_rng(1)
    samples = rng.standard_normal(80_000).view(complex)
    capture = open_capture(write_foreign(tmp_path, samples, 10e6, "cf32_le"))
    monkeypatch.setattr("radalt.core.radio.recording._BLOCK", 1000)
    got = np.concatenate([block for _, block in capture.blocks(7.5e6)])
    want = signal.resample_poly(samples.astype(np.complex64), 3, 4)
    assert got.size == want.size == 30_000
    assert np.abs(got - want).max() < 1e-5


def rewritten(path, change) -> Path:
    """The recording with other metadata."""
    meta = json.loads(path.read_text())
    change(meta)
    path.write_text(json.dumps(meta))
    return path


def test_headers_before_captures_are_no_samples(tmp_path):
    """As receiver, and as an interferer of another file format's recording."""
    samples = sweeps(2)
    path = write_foreign(tmp_path, samples, 7.5e6, "cf32_le")
    data = path.with_suffix(".sigmf-data")
    raw, cut = data.read_bytes(), 8 * 7000
    data.write_bytes(b"h" * 44 + raw[:cut] + b"h" * 12 + raw[cut:])

    def headers(meta):
        del meta["global"]["core:sha512"]
        first = {"core:sample_start": 0, "core:header_bytes": 44}
        meta["captures"] = [first, {"core:sample_start": 7000, "core:header_bytes": 12}]

    capture = open_capture(rewritten(path, headers))
    assert np.array_equal(np.concatenate([b for _, b in capture.blocks(7.5e6)]), samples.astype(np.complex64))
    emitter = RecordingEmitter(file=str(path))
    assert emitter.load(7.5e6).size == 15000


@pytest.mark.parametrize("ending", ["sigmf", "sigmf.gz", "sigmf.xz", "sigmf.zip"])
def test_an_archive_holds_the_same_samples(tmp_path, ending):
    path = write_foreign(tmp_path, sweeps(2), 7.5e6, "ci16_le")
    packed = tmp_path / f"flight.{ending}"
    sigmf.sigmffile.fromfile(str(path)).tofile(str(packed))
    (first,), (second,) = ([b for _, b in open_capture(p).blocks(7.5e6)] for p in (path, packed))
    assert np.array_equal(first, second)
    packed.write_bytes(packed.read_bytes()[:-40_000])
    with pytest.raises(RecordingError, match=f"flight.{ending}: [^\n]+ truncated or another"):
        open_capture(packed)


AS_OTHERS_WRITE = {  # global, annotations
    "a digest in upper case": lambda head, notes: head.update({"core:sha512": head["core:sha512"].upper()}),
    "extensions as an object": lambda head, notes: head.update({"core:extensions": {"antenna": "optional"}}),
    "no author": lambda head, notes: head.update({"core:author": None}),
    "keys of a namespace not declared": lambda head, notes: head.update({"sdrangel:version": "7.2"}),
    "unsorted annotations": lambda head, notes: notes.extend({"core:sample_start": k} for k in (5000, 10)),
    "an annotation past the end": lambda head, notes: notes.append({"core:sample_start": 7501}),
}


@pytest.mark.parametrize("how", AS_OTHERS_WRITE)
def test_what_other_programs_write_is_read(tmp_path, how):
    """With a byte order mark, too."""
    path = write_foreign(tmp_path, sweeps(1), 7.5e6, "cf32_le")
    rewritten(path, lambda meta: AS_OTHERS_WRITE[how](meta["global"], meta["annotations"]))
    path.write_bytes(codecs.BOM_UTF8 + path.read_bytes())
    capture, note = open_capture(path), "annotations go on behind the last sample; are the data whole?"
    assert capture.sample_count == 7500
    assert [note.partition(": ")[2] for note in capture.notes] == [note] * ("past" in how)


@pytest.mark.parametrize(
    ("second", "stretches", "note"),
    [
        # a frame is lost, to a nanosecond
        ("2026-11-28T07:00:00.002000000Z", [(0, 7500), (15000, 7500)], ""),
        ("2026-11-28T07:00:00.001000000Z", [(0, 7500), (7500, 7500)], ""),
        ("2026-11-28T07:00:00.006Z", [(0, 7500)], "what follows a gap at sample 7500 is left out"),
    ],
)
def test_gaps_come_from_the_time_of_captures(tmp_path, second, stretches, note):
    path = write_foreign(tmp_path, sweeps(2), 7.5e6, "cf32_le")

    def times(meta):
        meta["captures"] = [
            {"core:sample_start": 0, "core:datetime": "2026-11-28T07:00:00.000000000Z"},
            {"core:sample_start": 7500, "core:datetime": second},
        ]

    capture = open_capture(rewritten(path, times))
    assert [(s.global_index, s.count) for s in capture.stretches] == stretches
    assert note in " ".join(capture.notes) and bool(capture.notes) == bool(note)


def test_a_recording_that_begins_airborne_says_so_or_takes_the_altitude(tmp_path, capsys, undrawn):
    """Through the command: 500 m, then 300 m."""
    samples = np.concatenate([sweeps(20, 500.0), sweeps(20, 300.0)])
    path = write_foreign(tmp_path, samples, 7.5e6, "cf32_le")
    (tmp_path / "scene.yaml").write_text("altimeter: {max_altitude_m: 1500.0}\n")
    words = ["--replay", str(path), "--scene", str(tmp_path / "scene.yaml"), "--methods", "none", "--out"]
    assert ota_eval.main([*words, str(tmp_path / "relative")]) == 0
    assert "altitudes are relative to its first sweeps" in capsys.readouterr().err
    assert ota_eval.main([*words, str(tmp_path / "true"), "--reference-m", "500"]) == 0
    assert capsys.readouterr().err == ""
    rows = csv.DictReader((tmp_path / "true/frames.csv").read_text().splitlines())
    altitudes = [float(row["altitude_m"]) for row in rows]
    assert np.allclose(altitudes[2:15], 500.0, atol=1.0) and np.allclose(altitudes[-12:], 300.0, atol=1.0)
    assert (tmp_path / "true" / "altitude.png").is_file()


DAMAGE = {  # of metadata and data
    "core:datatype has 8 bytes a sample, and 5 are left over": lambda meta, data: meta["global"].update(
        {"core:trailing_bytes": 3}
    ),
    "core:author: 5 is not of type 'string'": lambda meta, data: meta["global"].update({"core:author": 5}),
    "0: core:sample_start: -1 is less": lambda meta, data: meta.update(captures=[{"core:sample_start": -1}]),
    "truncated": lambda meta, data: data.write_bytes(data.read_bytes()[:-4000]),
    "other data": lambda meta, data: data.write_bytes(bytes(data.stat().st_size)),
    "no data": lambda meta, data: data.unlink(),
    "capture beyond": lambda meta, data: meta["captures"].append({"core:sample_start": 10**9}),
    "no rate": lambda meta, data: meta["global"].pop("core:sample_rate"),
    "rate not a number": lambda meta, data: meta["global"].update({"core:sample_rate": float("nan")}),
    "real": lambda meta, data: meta["global"].update({"core:datatype": "rf32_le"}),
    "two channels": lambda meta, data: meta["global"].update({"core:num_channels": 2}),
}
NONE_AT_ALL = {"no json": b"{", "no text": b"\xff\xfe", "no object": b"[]"}


@pytest.mark.parametrize("how", [*DAMAGE, *NONE_AT_ALL])
def test_a_recording_that_does_not_fit_gets_one_line(tmp_path, how):
    path = write_foreign(tmp_path, np.ones(8000, complex), 7.5e6, "cf32_le")
    open_capture(path)
    if how in NONE_AT_ALL:
        path.write_bytes(NONE_AT_ALL[how])
    else:
        rewritten(path, lambda meta: DAMAGE[how](meta, path.with_suffix(".sigmf-data")))
    with refused(RecordingError, "foreign.sigmf-meta") as caught:
        open_capture(path)
    assert ("foreign.sigmf-data: cannot be read (No such file" in str(caught.value)) == (how == "no data")
    assert how in str(caught.value) or "core:" not in how


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("core:datatype", "ci16_le", "no sweep of 7.5 MHz in 1 ms"),
        ("core:sample_rate", 5e6, "no sweep of 7.5 MHz in 1 ms"),
        ("core:sample_rate", 7.500912e6, "no ratio of whole numbers"),
    ],
)
def test_a_recording_that_says_the_wrong_thing_of_itself_gets_one_line(tmp_path, key, value, message):
    """Through the command: exit 2, one line, and no rows that look like a result."""
    path = write_foreign(tmp_path, sweeps(12), 7.5e6, "cf32_le")
    rewritten(path, lambda meta: meta["global"].update({key: value}))
    (tmp_path / "scene.yaml").write_text("altimeter: {max_altitude_m: 1500.0}\n")
    words = f"--replay {path} --scene {tmp_path}/scene.yaml --methods none --out {tmp_path}/out"
    for _ in range(2):  # what failed leaves nothing that stops it the second time
        status, error = ended(ota_eval.main, *words.split())
        assert_refused(status, error, message)
        assert "foreign.sigmf-meta" in error
    assert not (tmp_path / "out" / "summary.json").exists()


def test_a_foreign_recording_needs_a_scene(tmp_path):
    path = write_foreign(tmp_path, np.ones(8000, complex), 7.5e6, "cf32_le")
    with pytest.raises(RecordingError, match="--scene"):
        replay_scene(open_capture(path))
    with pytest.raises(RecordingError, match="no SigMF recording"):
        open_capture(tmp_path / "absent.sigmf-meta")


def test_replay_from_the_command_line_gives_the_live_rows(live, tmp_path, capsys, undrawn):
    path, _, _ = live
    out = tmp_path / "out"
    assert ota_eval.main(["--replay", str(path), "--methods", "none,whitening", "--out", str(out)]) == 0
    assert "whitening" in capsys.readouterr().out
    assert len((out / "rows.csv").read_text().splitlines()) == 3
    with pytest.raises(FolderError, match=r"or a replay and has none$"):
        read_report(out)
    assert ota_eval.main(["--replay", str(path), "--out", str(out)]) == 2
    assert "holds a run already; name another --out" in capsys.readouterr().err
    assert ota_eval.main(["--replay", str(tmp_path / "absent"), "--out", str(out)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """A short recording of ours."""
    folder = tmp_path_factory.mktemp("short")
    scene = a_scene(altitude={"programme_m": [60.0], "frames": 6}, channel={"snr_db": 10.0})
    recorded(scene, ("none",), folder, "short")
    return folder


def copied(folder: Path, target: Path, changes: dict, samples=None) -> tuple[int, str]:
    """Status and error of the command on a copy of the short recording with other metadata or samples."""
    meta = json.loads((folder / "short.sigmf-meta").read_text())
    meta["global"] |= changes
    data = np.fromfile(folder / "short.sigmf-data", "<c8")
    if samples is not None:
        data[:] = samples
    meta["global"]["core:sha512"] = hashlib.sha512(data.tobytes()).hexdigest()
    data.tofile(target / "copy.sigmf-data")
    (target / "copy.sigmf-meta").write_text(json.dumps(meta))
    words = f"--replay {target}/copy.sigmf-meta --methods none --out {target}/out"
    return ended(ota_eval.main, *words.split())


@pytest.mark.parametrize(
    ("changes", "samples", "message"),
    [
        *(({"core:datatype": kind}, None, f"datatype is '{kind}'") for kind in ("cf32_be", "ci16_le")),
        *(({"core:sample_rate": rate}, None, "was recorded at 7.5e+06") for rate in (30e6, 1831.0)),
        ({}, None, ""),  # the copy as it is replays
        ({}, np.nan, "no sample in it is a finite number"),
        ({}, 0.0, "nothing but zeros is in it"),
        ({"radalt:full_scale": 0}, None, "radalt:full_scale is 0"),
        ({"radalt:scene": {"seed": 10**30}}, None, "seed is 1000"),
    ],
)
def test_a_changed_recording_of_ours_gets_one_line(short, tmp_path, undrawn, changes, samples, message):
    ends = copied(short, tmp_path, changes, samples)
    if not message:
        assert ends == (0, "")
        return
    assert_refused(*ends, message)
    assert not (tmp_path / "out" / "rows.csv").exists()


@pytest.mark.parametrize("name", ["pipe", "../pipe", "/dev/zero", "a\0b"])
def test_data_that_the_metadata_name_are_a_file_next_to_them(tmp_path, name):
    path = write_foreign(tmp_path, np.ones(8000, complex), 7.5e6, "cf32_le")
    path.with_suffix(".sigmf-data").unlink()
    os.mkfifo(tmp_path / "pipe")
    rewritten(path, lambda meta: meta["global"].update({"core:dataset": name}))
    with pytest.raises(RecordingError, match="a pipe or device|name a file next to it|embedded null"):
        open_capture(path)
