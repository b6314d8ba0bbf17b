"""Two B210s, tested at the boundary of gr-uhd's calls with a recorded double: order, arguments, counters, altitude."""

import dataclasses

import numpy as np
import pytest
import uhd_double

from gnuradio.radalt.core.calibration import CalibrationError, load_latency_samples, store_latency_samples
from gnuradio.radalt.core.interlock import InterlockError, require_enclosure
from gnuradio.radalt.core.levels import drive, rx_level_dbm, tx_power_dbm
from gnuradio.radalt.core.scene import parse_scene
from gnuradio.radalt.evaluation.flowgraph import FlowgraphError
from gnuradio.radalt.evaluation.hardware import calibrate, run_hardware
from gnuradio.radalt.evaluation.radios import describe, plan

pytestmark = pytest.mark.timeout(60)

RADIO = {
    "radar_serial": "R",
    "jammer_serial": "J",
    "enclosure": "cabled",
    "attenuation_db": 40.0,
    "radar_tx_gain_db": 40.0,
    "jammer_tx_gain_db": 50.0,
    "radar_rx_gain_db": 20.0,
    "clock_source": "external",
}


def a_scene(jammer=True, **radio):
    data = {
        "altitude": {"programme_m": [300.0, 60.0], "frames": 6},
        "altimeter": {"max_altitude_m": 1500.0},
        "radio": {**RADIO, **radio},
    }
    if jammer:
        data["interference"] = {"qpsk": {"sir_db": -10.0, "overlap": 1.0, "bandwidth_hz": 2.0025e6}}
    return parse_scene(data)


@pytest.fixture
def air(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    air = uhd_double.Air()
    uhd_double.install(monkeypatch, air)
    return air


def fly(air, scene, **options):
    options = {"transmit": True, "log": lambda line: None} | options
    return run_hardware(scene, ("none",), sleep=air.sleep, **options)


def test_order_and_arguments_of_the_set_up(air):
    fly(air, a_scene())
    sink, source, jammer = "radar Sink", "radar Source", "jammer Sink"
    tune = ("tune", 4.3e9, 6e6)
    # the template of GRC has set rate, frequency and gain before; ours begins with the first clock source
    begin = next(k for k, call in enumerate(air.calls) if call[1] == "set_clock_source")
    calls = [c for c in air.calls[begin:] if not c[1].startswith("get_sensor")]
    assert calls[: calls.index((sink, "get_mboard_sensor", "ref_locked"))] == [
        (source, "set_clock_source", "external", 0),
        (jammer, "set_clock_source", "external", 0),
        (source, "set_time_source", "external", 0),
        (jammer, "set_time_source", "external", 0),
        (sink, "set_samp_rate", 7.5e6),
        (source, "set_samp_rate", 7.5e6),
        (jammer, "set_samp_rate", 7.5e6),
        (sink, "set_antenna", "TX/RX", 0),
        (sink, "set_gain", 40.0, 0),
        (sink, "set_center_freq", tune, 0),
        (source, "set_antenna", "RX2", 0),
        (source, "set_gain", 20.0, 0),
        (source, "set_center_freq", tune, 0),
        (jammer, "set_antenna", "TX/RX", 0),
        (jammer, "set_gain", 50.0, 0),
        (jammer, "set_center_freq", tune, 0),
    ]
    after = [c for c in calls if c[1] in ("set_time_next_pps", "set_start_time", "start")]
    start = after[2][2]
    assert after[:2] == [
        (source, "set_time_next_pps", ("time", 0.0)),
        (jammer, "set_time_next_pps", ("time", 0.0)),
    ]
    assert after[2:5] == [(name, "set_start_time", start) for name in (sink, source, jammer)]
    assert {c[1] for c in after[5:]} == {"start"}


def test_devices_are_named_by_serial_and_master_clock(air):
    fly(air, a_scene())
    built = {call[0]: call[2] for call in air.calls if call[1] == "construct"}
    assert built["radar Sink"] == built["radar Source"] == "serial=R,master_clock_rate=30000000"
    assert built["jammer Sink"] == "serial=J,master_clock_rate=30000000"


def test_altitudes_are_right_and_events_are_counted(air):
    lines = []
    result = fly(air, a_scene(), log=lines.append)
    frames = result.results["none"]
    for altitude, first in ((300.0, 8), (60.0, 14)):
        trial = frames[(frames["frame_index"] >= first) & (frames["frame_index"] < first + 6)]
        assert len(trial) == 6
        assert np.all(np.abs(trial["altitude_m"] - altitude) < 2.0)
    assert result.segmenter["tx_underflows"] == 2  # the double publishes one a transmitter
    assert result.segmenter["saturated_frames"] == 0
    assert any("gain dB" in line and "asked" in line for line in lines)


def test_saturation_is_counted(air):
    air.gain = 30.0
    result = fly(air, a_scene())
    assert result.segmenter["saturated_frames"] >= 12


def test_one_b210_without_jammer(air):
    fly(air, a_scene(jammer=False, clock_source="internal"))
    assert {call[0] for call in air.calls} == {"radar Sink", "radar Source"}
    assert [c for c in air.calls if c[1] == "set_time_now"] == [
        ("radar Source", "set_time_now", ("time", 0.0))
    ]


def test_calibrated_latency_is_stored_by_clock_and_rate_and_subtracted(air, monkeypatch):
    scene = a_scene(jammer=False, clock_source="internal")
    options = {"transmit": True, "log": lambda line: None, "sleep": air.sleep}
    latency, path = calibrate(scene, **options)
    assert latency == pytest.approx(uhd_double.LATENCY, abs=0.05)
    assert load_latency_samples(30e6, 7.5e6) == pytest.approx(latency, abs=1e-5)
    assert load_latency_samples(30e6, 3.75e6) is None
    assert path.name == "calibration.yaml"
    # five samples more of path are c / (2 F_s) metres each, on top of every altitude
    other = uhd_double.Air()
    monkeypatch.setattr(uhd_double, "LATENCY", uhd_double.LATENCY + 5)
    uhd_double.install(monkeypatch, other)
    frames = fly(other, scene).results["none"]
    trial = frames[(frames["frame_index"] >= 8) & (frames["frame_index"] < 14)]
    assert np.allclose(trial["altitude_m"], 300.0 + 5 * 299792458 / 2 / 7.5e6, atol=1.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"master_clock_hz": 32e6}, "rate S/s"), ({"locks": False}, "lo_locked is false")],
)
def test_a_radio_that_did_something_else_is_refused(monkeypatch, changes, message):
    air = uhd_double.Air(**changes)
    uhd_double.install(monkeypatch, air)
    with pytest.raises(FlowgraphError, match=message):
        fly(air, a_scene())
    assert not [c for c in air.calls if c[1] == "start"]


def test_nothing_is_built_without_transmit(air):
    with pytest.raises(InterlockError, match="--transmit"):
        fly(air, a_scene(), transmit=False)
    assert air.calls == []


@pytest.mark.parametrize(
    ("radio", "message"),
    [
        ({"enclosure": "none"}, "safety-of-life"),
        ({"attenuation_db": 10.0}, "at least 30 dB"),
        (
            {"enclosure": "shielded", "attenuation_db": 0.0, "radar_tx_gain_db": 80.0},
            "would reach the receiver",
        ),
        ({"attenuation_db": 30.0, "jammer_tx_gain_db": 89.75}, "raise attenuation_db by 5.0 dB"),
    ],
)
def test_interlock_refuses_what_could_harm(radio, message):
    with pytest.raises(InterlockError, match=message):
        require_enclosure(a_scene(**radio), True)


def test_receiver_level_is_the_power_sum_less_attenuation():
    radio = dataclasses.replace(a_scene().radio, radar_tx_gain_db=59.75, jammer_tx_gain_db=59.75)
    assert tx_power_dbm(89.75) == pytest.approx(20.0)
    assert rx_level_dbm(radio, jammer=False) == pytest.approx(20 - 30 - 40)
    assert rx_level_dbm(radio, jammer=True) == pytest.approx(20 - 30 - 40 + 10 * np.log10(2))


@pytest.mark.parametrize("gain", [30.0, 40.0, 60.0])
def test_drive_keeps_the_sir_whatever_the_gains(gain):
    levels = drive(a_scene(jammer_tx_gain_db=gain))
    assert levels.radar_dbm - levels.jammer_dbm == pytest.approx(-10.0, abs=0.3)
    assert levels.radar_full_scale >= 1 / 0.7
    assert levels.jammer_full_scale >= np.sqrt(10) / np.sqrt(2) / 0.7


def test_the_plan_needs_no_radio_and_says_what_the_interlock_says():
    lines, allowed = describe(a_scene())
    assert allowed
    assert sum("set_center_freq((4300000000.0, 6000000.0), 0)" in line for line in lines) == 3
    lines, allowed = describe(a_scene(enclosure="none"))
    assert not allowed
    assert "transmit refused" in lines[-1]
    assert "jammer_usrp_sink" not in {step.block for step in plan(a_scene(jammer=False))}


def test_a_calibration_file_that_is_none_is_named(tmp_path):
    path = tmp_path / "calibration.yaml"
    path.write_text("latency_samples: [1, 2]\n")
    with pytest.raises(CalibrationError, match=r"calibration\.yaml.*calibrate anew"):
        store_latency_samples(1.0, 30e6, 7.5e6, path)


def test_check_prints_the_plan_and_fails_where_the_interlock_would(tmp_path, capsys):
    import ota_eval
    import yaml

    scene = tmp_path / "bench.yaml"
    scene.write_text(yaml.safe_dump({"radio": RADIO}))
    assert ota_eval.main(["--check", "--scene", str(scene)]) == 0
    printed = capsys.readouterr().out
    assert "set_time_next_pps" in printed
    assert "not needed" in printed
    scene.write_text(yaml.safe_dump({"radio": RADIO | {"attenuation_db": 3.0}}))
    assert ota_eval.main(["--check", "--scene", str(scene)]) == 2
