"""Scenes: wrong ones get one line with file, key, value and what is allowed; right ones survive a round trip."""

import re
from pathlib import Path

import pytest
import yaml
from hostile import refused
from waiting import ROOT

from radalt.core.interference import QpskEmitter, ToneEmitter
from radalt.core.scene import SceneError, load_scene, parse_scene, scene_from_parameters, scene_to_mapping
from radalt.evaluation.engine.options import number
from radalt.evaluation.overlap.points import parse_axis

SHIPPED = sorted((ROOT / "flowgraphs/scenes").glob("*.yaml"))

FULL = """
name: everything
description: every section, nothing at its default
waveform: {bandwidth_hz: 6.0e+6, sweep_s: 2.0e-3, rate_hz: 7.5e6, carrier_hz: 4.25e9, centered: false}
altitude: {programme_m: [800, 20.5], frames: 4, mode: true_delay, vertical_speed_m_per_s: -3, preamble_frames: 9,
           sync_every_frames: 6, sync_frames: 8}
interference:
  - qpsk: {sir_db: -12.5, overlap: 0.3, start: 0.1, bandwidth_hz: 1e6, carrier_hz: -2e5, pulse: rrc, rolloff: 0.4}
  - tones: {sir_db: -3, frequencies_hz: [1e5, -2e6], free_running: true}
total_sir_db: -11
channel: {snr_db: null, start_offset_samples: 90.5, gain_db: 1, jammer_delay_samples: 3, jammer_clock_ppm: -1,
          jammer_lo_offset_hz: 100, dc_offset: 0.1, iq_gain_db: 0.2, iq_phase_deg: 1, adc_bits: 12, full_scale: 5,
          leakage_db: -20, drops: {count: 2, min_samples: 5, max_samples: 9, tagged: false}}
segmenter: {acquisition_frames: 3, lock_threshold: 30, confirm_frames: 3, monitor: false}
altimeter: {max_altitude_m: 900, min_altitude_m: 1, max_vertical_speed_m_per_s: 40, window: hann, pfa_per_frame: 1e-3,
            train_cells: 12, guard_cells: 2, strategy: centroid}
methods: [none, blanking]
method_options: {blanking: {threshold_db: 10}}
sweep: {overlap: [0, 1], sir_db: [-10], snr_db: [0, 10]}
radio: {radar_serial: "30AD123", enclosure: cabled, attenuation_db: 40, clock_source: external}
seed: 99
"""


def full() -> dict:
    return yaml.safe_load(FULL)


def test_empty_scene_is_the_paper_waveform_in_noise():
    scene = parse_scene({})
    assert scene.waveform.samples_per_frame == 7500 and not scene.has_jammer
    assert scene.channel.snr_db == 10.0 and scene.channel.adc_bits == 0
    names = [parse_scene(data).interference_name for data in ({}, {"interference": {"qpsk": {}}})]
    assert names == ["none", "qpsk_rectangular"]


def test_every_section_arrives_where_it_belongs_and_survives_the_round_trip():
    scene = parse_scene(full())
    # YAML 1.1 reads these as text
    assert scene.waveform.rate_hz == 7.5e6 and scene.waveform.carrier_hz == 4.25e9
    assert scene.altitude.programme_m == (800.0, 20.5)
    assert scene.altitude.programme.total_frames == 9 + 6 + 8 + 2
    qpsk, tones = scene.interference
    assert qpsk.emitter == QpskEmitter(1e6, -2e5, "rrc", 0.4)
    assert (qpsk.sir_db, qpsk.overlap, qpsk.start, qpsk.free_running) == (-12.5, 0.3, 0.1, False)
    assert tones.emitter == ToneEmitter(frequencies_hz=(1e5, -2e6)) and tones.free_running
    assert scene.channel.snr_db is None and scene.channel.drops.tagged is False
    assert scene.altimeter.train_cells == 12 and scene.segmenter.monitor is False
    assert scene.radio.radar_serial == "30AD123" and scene.seed == 99
    assert parse_scene(yaml.safe_load(yaml.safe_dump(scene_to_mapping(scene)))) == scene


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_shipped_scene_survives_the_round_trip_through_yaml(path):
    scene = load_scene(path)
    assert load_scene(path.stem) == scene
    again = yaml.safe_load(yaml.safe_dump(scene_to_mapping(scene)))
    assert parse_scene(again) == scene


@pytest.mark.parametrize("text", ["7.5e6", "7.5e+6", "7500000", 7_500_000])
def test_numbers_may_be_written_as_people_write_them(text):
    assert parse_scene({"waveform": {"rate_hz": text}}).waveform.rate_hz == 7.5e6


def test_the_minus_sign_of_a_text_is_a_minus():
    read = parse_scene({"interference": {"qpsk": {"sir_db": "\u221228"}}, "sweep": {"sir_db": ["\u22125.5"]}})
    assert (read.sir_db, read.sweep.sir_db) == (-28.0, (-5.5,))
    assert parse_axis("\u221230:\u221210:10,\u22125", "--sir-db") == (-30.0, -20.0, -10.0, -5.0)
    assert number(int, -9, 9)("\u22122") == -2


# (YAML, key, value, what is allowed): all three have to be in the one line
WRONG = [
    ("wavefrom: {}", "'wavefrom'", "did you mean 'waveform'", "allowed: waveform, "),
    ("methods: [whitenning]", "'whitenning'", "did you mean 'whitening'", "allowed: whitening, "),
    ("waveform: {rate_hz: -7500000.0}", "waveform.rate_hz", "-7.5e+06", "within 10000"),
    ("waveform: {rate_hz: 7.5 MHz}", "waveform.rate_hz", "'7.5 MHz'", "expected a number, in the unit"),
    ("waveform: {rate_hz: .nan}", "waveform.rate_hz", "nan", "finite"),
    ("waveform: {centered: maybe}", "waveform.centered", "'maybe'", "true or false"),
    ("waveform: {bandwidth_hz: 9.0e+6}", "waveform.bandwidth_hz", "9e+06", "the bandwidth or raise rate_hz"),
    ("altitude: {mode: real}", "altitude.mode", "'real'", "allowed: synthetic, true_delay"),
    ("altitude: {programme_m: [100, high]}", "altitude.programme_m[1]", "'high'", "expected a number"),
    ("{altimeter: {max_altitude_m: 1500}, altitude: {programme_m: [2000]}}", "programme_m", "2000", "raise"),
    ("altitude: {vertical_speed_m_per_s: 5}", "altitude.vertical_speed_m_per_s", "5", "mode: true_delay"),
    ("interference: {qpsk: {sir_bd: 3}}", "'interference.qpsk.sir_bd'", "'sir_db'? allowed: ", "overlap"),
    ("interference: {laser: {}}", "'interference.laser'", "laser", "recording, "),
    ("interference: [{qpsk: {}, tones: {}}]", "interference", "'qpsk'", "expected one 'kind: {...}'"),
    ("methods: [none, magic]", "methods", "'magic'", "whitening"),
    ("method_options: {magic: {}}", "method_options", "'magic'", "whitening"),
    ("interference: {qpsk: {sir_db: 28}}", "qpsk.sir_db", "28", "at most 20: did you mean -28?"),
    ("sweep: {overlap: [0, 1.5]}", "sweep.overlap", "1.5", "0..1"),
    ("radio: {enclosure: open}", "radio.enclosure", "'open'", "allowed: none, cabled, shielded"),
    ("radio: {radar_serial: 1234567}", "radio.radar_serial", "1234567", "expected text: quote it"),
    ("radio: {radar_serial: 0123456}", "line 1", "'0123456' begins with 0", "quote it"),
    ("interference: {qpsk: {carrier_hz: 2}}", "qpsk.carrier_hz", "is 2; it has to be 0, or at", "mean 2e+06"),
    ("[a, b]", "scene", "['a', 'b']", "expected a mapping"),
]


@pytest.mark.parametrize(("text", "key", "value", "allowed"), WRONG, ids=[f"{w[1]}-{w[2]}" for w in WRONG])
def test_wrong_scene_is_one_line_with_file_key_value_and_what_is_allowed(text, key, value, allowed, tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    with refused(SceneError, path.name) as raised:
        load_scene(path)
    assert [part for part in (key, value, allowed) if part not in str(raised.value)] == []


NAMES_FILE = {  # a key of a scene, and a value of it that names a file
    "interference": [{"recording": {"file": "NAME"}}],
    "method_options": {"tcae": {"model": "NAME+NAME"}, "custom": {"file": "NAME"}},
    "segmenter": {"leakage_calibration": "NAME"},
    "landing": {"folder": "NAME"},
}


@pytest.mark.parametrize("key", NAMES_FILE)
def test_files_are_sought_next_to_the_scene_then_in_the_working_folder(key, tmp_path, monkeypatch):
    sibling, here = tmp_path / "scenes", tmp_path / "here"
    sibling.mkdir(), here.mkdir()
    monkeypatch.chdir(here)
    scene = Path("../scenes/mine.yaml")
    scene.write_text(
        yaml.safe_dump({key: NAMES_FILE[key]}).replace("NAME", "a.b")
        + "altitude: {mode: true_delay, programme_m: [9]}"
    )
    if key == "segmenter":  # it may be about to be made
        assert str(load_scene(scene)).count("'a.b'") == 1
    else:
        with pytest.raises(
            SceneError, match=rf"mine.yaml: .*is 'a.b'; it is neither in {sibling}, .* nor in {here}"
        ):
            load_scene(scene)
    for folder, path in ((here, "a.b"), (sibling, "../scenes/a.b")):
        (folder / "a.b").touch()
        assert path in re.split(r"['+]", str(load_scene(scene)))


def test_broken_and_missing_files_are_named(tmp_path):
    (tmp_path / "broken.yaml").write_text("name: x\nwaveform: {rate_hz: 1\naltitude: 3\n")
    with pytest.raises(SceneError, match=r"broken.yaml: not valid YAML at line [23]: "):
        load_scene(tmp_path / "broken.yaml")
    with pytest.raises(SceneError, match="did you mean 'paper_qpsk'"):
        load_scene("paper_qsk")
    with pytest.raises(SceneError, match="no_such_scene.yaml: cannot be read"):
        load_scene("no_such_scene")


def test_point_of_a_sweep_changes_what_it_names_and_nothing_else():
    scene = parse_scene(full())
    point = scene.at(overlap=0.5, sir_db=-20.0, snr_db=3.0, seed=4)
    assert [i.overlap for i in point.interference] == [0.5, 0.5]
    assert [i.sir_db for i in point.interference] == [-20.0, -10.5]  # relative levels are kept
    assert (point.total_sir_db, point.channel.snr_db, point.seed) == (-20.0, 3.0, 4)
    assert point.altitude == scene.altitude and point.waveform == scene.waveform
    assert scene.at() == scene


def test_flowgraph_parameters_override_only_what_is_set():
    scene = load_scene("paper_qpsk")
    assert scene_from_parameters("paper_qpsk") == scene
    assert scene_from_parameters("paper_qpsk", 0.3, -5.0, 8) == scene.at(overlap=0.3, sir_db=-5.0, seed=8)
    assert scene_from_parameters("paper_qpsk", "0.3", "-5", "8") == scene.at(overlap=0.3, sir_db=-5.0, seed=8)
    assert scene_from_parameters("paper_qpsk", "scene", "-5", "scene") == scene.at(sir_db=-5.0)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("low", "is 'low'; give a number"),
        (28, "is 28; it has to be within -200..20, or scene.*: did you mean -28"),
        ("nan", "is nan"),
    ],
)
def test_flowgraph_parameter_that_is_no_number_or_out_of_range_is_one_line(value, said):
    with pytest.raises(SceneError, match=f"sir_db {said}"):
        scene_from_parameters("paper_qpsk", sir_db=value)
