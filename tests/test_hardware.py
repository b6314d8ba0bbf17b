"""Two B210s, tested at the boundary of gr-uhd's calls with a recorded double: order, arguments, counters, altitude."""

import argparse
import copy
import functools
import re
import signal
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import ota_eval
import pytest
import uhd_double
import yaml
from gnuradio import blocks, gr, radalt
from hostile import write_scene
from uhd_double import RADIO
from waiting import ROOT

from radalt.core.channel.auxiliary import AuxiliarySettings
from radalt.core.radio import calibration
from radalt.core.radio.calibration import CalibrationKey, load_latency_samples, store_latency_samples
from radalt.core.radio.interlock import InterlockError, require_enclosure
from radalt.core.radio.levels import drive, rx_level_dbm
from radalt.core.radio.transmit_gate import TransmitGate
from radalt.core.scene import SceneError, parse_scene
from radalt.evaluation.flowgraph import FlowgraphError
from radalt.evaluation.flowgraph.generate import Prepared, generate
from radalt.evaluation.flowgraph.rewrite import load_grc
from radalt.evaluation.flowgraph.run import load_class, run_to_end
from radalt.evaluation.radios import setup
from radalt.evaluation.radios.bring_up import bring_up
from radalt.evaluation.radios.hardware import calibrate, run_hardware
from radalt.evaluation.radios.settings import describe

KEY = CalibrationKey("B210", "R", 30e6, 7.5e6)
JAMMER = ("jammer_source", "jammer_gate", "jammer_usrp_sink")


def a_scene(jammer=True, **radio):
    altitude = {"programme_m": [300.0, 60.0], "frames": 6}
    data = {"altitude": altitude, "altimeter": {"max_altitude_m": 1500.0}, "radio": RADIO | radio}
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


def started(air) -> bool:
    return bool({call[1] for call in air.calls} & {"start", "set_start_time"})


def assert_set_up_in_order(recorded):
    """The set-up of two radios on a common reference, each call with its arguments, then one start."""
    sink, source, jammer = "radar Sink", "radar Source", "jammer Sink"
    tune = ("tune", 4.3e9, 6e6)
    # the template of GRC has set rate, frequency and gain before; ours begins with the first clock source
    begin = next(k for k, call in enumerate(recorded) if call[1] == "set_clock_source")
    assert "start" not in {call[1] for call in recorded[:begin]}
    calls = [c for c in recorded[begin:] if not c[1].startswith("get_sensor")]
    sources = [f"set_{of}_source" for of in ("clock", "time")]
    asked = [(name, call, "external", 0) for call in sources for name in (source, jammer)]
    asked += [(name, "set_samp_rate", 7.5e6) for name in (sink, source, jammer)]
    for name, antenna, gain_db in ((sink, "TX/RX", 40.0), (source, "RX2", 20.0), (jammer, "TX/RX", 50.0)):
        own = ("antenna", antenna), ("gain", gain_db), ("center_freq", tune)
        asked += [(name, f"set_{what}", value, 0) for what, value in own]
    assert calls[: calls.index((sink, "get_mboard_sensor", "ref_locked"))] == asked
    after = [c for c in calls if c[1] in ("set_time_next_pps", "set_start_time", "start")]
    start = after[2][2]
    assert after[:2] == [(name, "set_time_next_pps", ("time", 0.0)) for name in (source, jammer)]
    assert after[2:5] == [(name, "set_start_time", start) for name in (sink, source, jammer)]
    assert [c[1] for c in after[5:]] == ["start"] * 3


def test_set_up_is_in_order_altitudes_are_right_and_events_are_counted(air, monkeypatch):
    lines, held, hold = [], [], radalt.jammer_source.hold_drive
    seen = "hold_drive", lambda self: held.append(hold(self))
    monkeypatch.setattr(radalt.jammer_source, *seen)
    result = fly(air, a_scene(), log=lines.append)
    assert_set_up_in_order(air.calls)
    built = {call[0]: call[2] for call in air.calls if call[1] == "construct"}
    assert built["radar Sink"] == built["radar Source"] == "serial=R,master_clock_rate=30000000"
    assert built["jammer Sink"] == "serial=J,master_clock_rate=30000000"
    assert len(held) == 1  # no live slider can make the jammer clip
    frames = result.results["none"]
    for altitude, first in ((300.0, 8), (60.0, 14)):
        trial = frames[(frames["frame_index"] >= first) & (frames["frame_index"] < first + 6)]
        assert len(trial) == 6
        assert np.all(np.abs(trial["altitude_m"] - altitude) < 2.0)
    assert result.segmenter["tx_underflows"] == 2  # the double publishes one a transmitter
    assert result.segmenter["saturated_frames"] == 0
    assert any("gain dB" in line and "asked" in line for line in lines)


def test_a_live_slider_cannot_make_the_jammer_clip(air):
    """The converters are scaled for the scene's burst; less SIR, or a shorter burst, is held at that power."""
    scene = a_scene()
    jammer = radalt.jammer_source(scene, overlap=1.0, sir_db=-60.0)
    assert jammer.stream.total_sir_db == -60.0  # in the simulated channel nothing clips
    jammer.hold_drive()
    for overlap, sir_db in ((1.0, -60.0), (0.1, scene.sir_db), (0.02, 0.0), (1.0, -3.0)):
        jammer.set_overlap(overlap)
        jammer.set_sir_db(sir_db)
        burst = -jammer.stream.total_sir_db - 10 * np.log10(overlap)
        assert burst == pytest.approx(min(scene.burst_db, -sir_db - 10 * np.log10(overlap)))


def test_saturation_is_counted(air):
    air.gain = 30.0
    assert fly(air, a_scene()).segmenter["saturated_frames"] >= 12


def two_channels(attenuation_db=0, **radio):
    scene = a_scene(auxiliary_attenuation_db=attenuation_db, **radio)
    return replace(scene, auxiliary=AuxiliarySettings())


def test_two_receive_channels_are_one_source_set_up_alike_but_for_their_gains(air):
    result = fly(air, two_channels(50.0, auxiliary_rx_gain_db=30.0))
    source, tune = "radar Source", ("tune", 4.3e9, 6e6)
    begin = next(k for k, call in enumerate(air.calls) if call[1] == "set_clock_source")
    calls = [call[1:] for call in air.calls[begin:] if call[0] == source]
    assert calls.index(("set_subdev_spec", "A:A A:B", 0)) < calls.index(("set_samp_rate", 7.5e6))
    for channel, gain_db in enumerate((20.0, 30.0)):
        own = [call for call in calls if call[-1] == channel and call[0] in ("set_gain", "set_center_freq")]
        assert own == [("set_gain", gain_db, channel), ("set_center_freq", tune, channel)]
        assert {("set_antenna", "RX2", channel), ("set_rx_agc", False, channel)} <= set(calls)
    frames = result.results["none"]
    assert frames["valid"][frames["frame_index"] < 20].sum() >= 18


def test_calibrated_latency_is_stored_by_radio_clock_and_rate_and_subtracted(air, monkeypatch):
    scene = a_scene(jammer=False, clock_source="internal")
    options = {"transmit": True, "log": lambda line: None, "sleep": air.sleep}
    latency, path = calibrate(scene, **options)
    assert latency == pytest.approx(uhd_double.LATENCY, abs=0.05)
    assert load_latency_samples(KEY) == pytest.approx(latency, abs=1e-5)
    for change in ({"device_type": "X310"}, {"serial": "J"}, {"master_clock_hz": 15e6}, {"rate_hz": 3.75e6}):
        assert load_latency_samples(replace(KEY, **change)) is None
    assert path.name == "calibration.yaml"
    # five samples more of path are c / (2 F_s) metres each, on top of every altitude
    other = uhd_double.Air()
    monkeypatch.setattr(uhd_double, "LATENCY", uhd_double.LATENCY + 5)
    uhd_double.install(monkeypatch, other)
    frames = fly(other, scene).results["none"]
    trial = frames[(frames["frame_index"] >= 8) & (frames["frame_index"] < 14)]
    assert np.allclose(trial["altitude_m"], 300.0 + 5 * 299792458 / 2 / 7.5e6, atol=1.0)


@pytest.mark.parametrize(
    ("changes", "more_db", "message"),
    [
        ({"master_clock_hz": 32e6}, 0.0, "rate S/s"),
        ({"locks": False}, 0.0, "lo_locked is false"),
        ({"mboard_id": "X310"}, 0.0, "the radio is a X310, and radio.device b210 a B210"),
        ({}, 3.0, "gain dB is 43, asked was 40"),
    ],
)
def test_a_radio_that_did_something_else_is_refused(monkeypatch, changes, more_db, message):
    """The level at the receiver was computed from the gains: more of it may damage."""
    air = uhd_double.Air(**changes)
    uhd_double.install(monkeypatch, air)
    get_gain = uhd_double.Sink.get_gain
    monkeypatch.setattr(uhd_double.Sink, "get_gain", lambda *args: get_gain(*args) + more_db)
    with pytest.raises(FlowgraphError, match=message):
        fly(air, a_scene())
    assert not started(air)


def test_a_radio_without_an_lo_sensor_is_used_and_said_to_have_none(air):
    air.sensors, lines = (), []
    result = fly(air, a_scene(jammer=False), log=lines.append)
    assert result.results["none"]["valid"].sum() >= 12
    assert sum("lo_locked" in line and "no such sensor" in line for line in lines) == 2


@pytest.mark.parametrize("name", ["my_bench", "my_box"])
def test_the_pages_scenes_are_complete_and_transmit_a_jammer(root, name):
    page = (root / "docs/hardware.md").read_text(encoding="utf-8")
    scene = parse_scene(yaml.safe_load(re.search(rf"```yaml\n(name: {name}\n.*?)```", page, re.DOTALL)[1]))
    lines, allowed = describe(scene)
    assert allowed and scene.has_jammer
    # also at the highest gain of both, for the cabled one
    most = replace(scene.radio, radar_tx_gain_db=89.75, jammer_tx_gain_db=89.75)
    assert (rx_level_dbm(most, jammer=True) < -15) == (name == "my_bench")


def test_nothing_is_built_without_transmit(air):
    with pytest.raises(InterlockError, match="--transmit"):
        fly(air, a_scene(), transmit=False)
    assert air.calls == []


def beyond_the_radio():
    scene = a_scene()
    return replace(scene, waveform=replace(scene.waveform, carrier_hz=5.9995e9))


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        (a_scene(enclosure="none"), "safety-of-life"),
        (a_scene(attenuation_db=10.0), "at least 30 dB"),
        (a_scene(enclosure="shielded", attenuation_db=0, radar_tx_gain_db=80), "would reach the receiver"),
        (a_scene(attenuation_db=30.0, jammer_tx_gain_db=89.75), "raise attenuation_db by 5.0 dB"),
        (a_scene(jammer_serial=""), "have to name two devices"),
        (a_scene(jammer_serial="R"), "have to name two devices"),
        (a_scene(master_clock_hz=32e6), "not a whole multiple of the rate"),
        (a_scene(lo_offset_hz=20e6), "at most 1.125e\\+07 either way"),
        (beyond_the_radio(), "carrier_hz is 5.9995e.09, and a B210 has 7e.07..6e.09"),
        # of two inputs
        (two_channels(), r"radio\.auxiliary_attenuation_db is 0 with a cabled set-up"),
        (two_channels(30, jammer_tx_gain_db=89.75), "auxiliary_attenuation_db by 5.0 dB"),
        (two_channels(40, master_clock_hz=60e6), "two receive channels .* 3.072e.07"),
    ],
)
def test_interlock_refuses_what_could_harm(scene, message):
    with pytest.raises(InterlockError, match=message):
        require_enclosure(scene, True)


def test_interlock_lets_one_radio_without_a_serial_pass_and_knows_both_inputs():
    require_enclosure(a_scene(jammer=False, radar_serial="", jammer_serial=""), True)
    lines, allowed = describe(two_channels(45.0))
    assert allowed and any("side B, at most -64.3 dBm" in line for line in lines)


def test_receiver_level_is_the_power_sum_less_attenuation():
    radio = replace(a_scene().radio, radar_tx_gain_db=59.75, jammer_tx_gain_db=59.75)
    assert radio.limits.tx_power_dbm(89.75) == pytest.approx(20.0)
    assert rx_level_dbm(radio, jammer=False) == pytest.approx(20 - 30 - 40)
    assert rx_level_dbm(radio, jammer=True) == pytest.approx(20 - 30 - 40 + 10 * np.log10(2))


@pytest.mark.parametrize("gain", [30.0, 40.0, 60.0])
def test_drive_keeps_the_sir_whatever_the_gains(gain):
    levels = drive(a_scene(jammer_tx_gain_db=gain))
    assert levels.radar_dbm - levels.jammer_dbm == pytest.approx(-10.0, abs=0.3)
    assert levels.radar_full_scale >= 1 / 0.7
    assert levels.jammer_full_scale >= np.sqrt(10) / np.sqrt(2) / 0.7


def test_a_radio_without_a_serial_is_not_calibrated(tmp_path):
    nameless = replace(KEY, serial="")
    with pytest.raises(calibration.CalibrationError, match=r"set radio\.radar_serial"):
        store_latency_samples(1.0, nameless, tmp_path / "calibration.yaml")
    assert load_latency_samples(nameless, tmp_path / "calibration.yaml") is None


def test_check_prints_the_plan_and_fails_where_the_interlock_would(tmp_path, capsys):
    scene = tmp_path / "bench.yaml"
    scene.write_text(yaml.safe_dump({"radio": RADIO}))
    assert ota_eval.main(["--check", "--scene", str(scene)]) == 0
    printed = capsys.readouterr().out
    assert "set_time_next_pps" in printed and "not needed" in printed
    scene.write_text(yaml.safe_dump({"radio": RADIO | {"attenuation_db": 3.0}}))
    assert ota_eval.main(["--check", "--scene", str(scene)]) == 2


# -- the companion's Run button: main() of the generated Python -------------------------------------------------------
@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    """Top-block class of ota_b210, by what a person has disabled or bypassed in the companion, and done to it."""
    drawn = load_grc(ROOT / "flowgraphs/ota_b210.grc")

    @functools.cache
    def made(disabled: tuple[str, ...], bypassed: str) -> type:
        data = copy.deepcopy(drawn)
        for block in data["blocks"]:
            if block["name"] in (*disabled, bypassed):
                block["states"]["state"] = "disabled" if block["name"] in disabled else "bypassed"
        return load_class(Prepared(generate(data, tmp_path_factory.mktemp("ota_b210"))))

    def get(disabled=(), bypassed="", change=lambda top: None) -> type:
        class Changed(made(disabled, bypassed)):
            def __init__(self, *arguments, **options):
                super().__init__(*arguments, **options)
                change(self)

        Changed.__module__ = made(disabled, bypassed).__module__
        return Changed

    return get


@pytest.fixture
def press_run(monkeypatch, tmp_path):
    """Runs main() as the button does; returns the air with what was called on the radios."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def press(cls: type, scene, transmit: int = 1, **air_changes) -> uhd_double.Air:
        air = press.air = uhd_double.Air(ticking=True, **air_changes)
        uhd_double.install(monkeypatch, air)
        monkeypatch.setattr(setup, "bring_up", lambda *given: bring_up(*given[:3], air.sleep))
        path = write_scene(scene, tmp_path / "scene.yaml")
        options = dict.fromkeys(("overlap", "sir_db", "seed"), "scene") | {"scene_file": str(path)}
        options = argparse.Namespace(**options, endpoint="", drop_when_slow=0, transmit=transmit)
        sys.modules[cls.__module__].main(cls, options)
        return air

    yield press
    for number, handler in handlers.items():
        signal.signal(number, handler)


def test_run_button_sets_up_in_order_and_ends_with_the_programme(generated, press_run, capsys):
    air = press_run(generated(), a_scene())
    assert_set_up_in_order(air.calls)
    printed = capsys.readouterr().out
    assert printed.count("master clock Hz") == 3
    for method in ("none", "whitening", "tcae"):
        assert f"1.000  {method}: 12 of 12" in printed


def test_run_button_subtracts_the_stored_calibration(generated, press_run, capsys):
    """Five samples of path more than the calibration cable are 100 m on top of every altitude: none is right."""
    store_latency_samples(uhd_double.LATENCY - 5, KEY)
    press_run(generated(), a_scene())
    assert "0.000  none: 0 of 12" in capsys.readouterr().out


def impostor(top):
    top.radar_gate = blocks.copy(gr.sizeof_gr_complex)


@pytest.mark.parametrize(
    ("drawn", "pressed", "message"),
    [
        ({}, {"transmit": 0}, "transmit is off"),
        ({}, {"scene": a_scene(enclosure="none")}, "safety-of-life"),
        ({}, {"scene": a_scene(attenuation_db=9)}, "at least 30 dB"),
        ({"disabled": ("transmit_interlock",)}, {"transmit": 0}, "transmit is off"),
        ({}, {"scene": a_scene(jammer=False)}, "has no jammer.*disable it"),
        ({"disabled": JAMMER}, {}, "enable it"),
        ({}, {"locks": False}, "lo_locked is false"),
        ({"bypassed": "radar_gate"}, {}, "no Transmit Gate radar_gate before"),
        ({"bypassed": "jammer_gate"}, {}, "no Transmit Gate jammer_gate before"),
        ({"change": impostor}, {}, "no Transmit Gate radar_gate before"),
    ],
)
def test_run_button_refuses_before_a_radio_starts(generated, press_run, drawn, pressed, message):
    """The interlock before one is made; the set-up, where the first snippet is disabled, the jammer is not the scene's,
    nothing locks, a gate is bypassed or another block has its name."""
    with pytest.raises((InterlockError, FlowgraphError), match=message) as refused:
        press_run(generated(**drawn), **{"scene": a_scene()} | pressed)
    assert not started(press_run.air)
    assert (press_run.air.calls == []) == (refused.type is InterlockError and not drawn)


def test_run_button_needs_one_b210_with_the_jammer_disabled(generated, press_run, capsys):
    air = press_run(generated(JAMMER), a_scene(jammer=False))
    assert {call[0] for call in air.calls} == {"radar Sink", "radar Source"}
    assert "12 of 12" in capsys.readouterr().out


# -- the gate: nothing reaches a transmitter past it -------------------------------------------------------------------
@pytest.mark.parametrize(
    ("radio", "transmit"),
    [({}, 0), ({"enclosure": "none"}, 1), ({}, 1)],
    ids=["no --transmit", "no enclosure", "all allowed"],
)
def test_class_without_main_and_without_snippets_sends_zeros(
    generated, air, monkeypatch, tmp_path, radio, transmit, capfd
):
    """As another program would use it: samples of some twenty sweeps reach the sinks, all of them zero."""
    cls = generated(("transmit_interlock", "set_up_radios"))
    top = cls(scene_file=str(write_scene(a_scene(**radio), tmp_path / "bare.yaml")), transmit=transmit)
    for name in ("radar_usrp_sink", "radar_usrp_source", "jammer_usrp_sink"):
        getattr(top, name).state["set_start_time"] = ("time", 1.0)
    run_to_end(top, over=lambda: air.sent["radar"].size >= 150_000)
    allowed = (radio, transmit) == ({}, 1)
    assert air.sent["radar"].size > 0
    assert any(samples.any() for samples in air.sent.values()) is allowed
    assert ("zeros only: transmit" in capfd.readouterr().err) is not allowed


def gate_taken_out_of_the_path(top):
    top.nowhere = blocks.null_sink(gr.sizeof_gr_complex)
    top.disconnect((top.jammer_gate, 0), (top.jammer_usrp_sink, 0))
    top.connect(top.jammer_gate, top.nowhere)
    top.connect(top.jammer_source, top.jammer_usrp_sink)


def third_transmitter_without_a_gate(top):
    top.own = [uhd_double.Sink(top.radar_usrp_sink.air, "", uhd_double.uhd.stream_args("fc32"))]
    top.connect(top.jammer_source, top.own[0])


@pytest.mark.parametrize(
    ("change", "named"),
    [(gate_taken_out_of_the_path, "jammer_usrp_sink"), (third_transmitter_without_a_gate, "double_sink")],
)
def test_a_transmitter_without_its_gate_stops_the_flowgraph_before_the_radios_start(
    generated, press_run, capsys, change, named
):
    press_run(generated(change=change), a_scene())
    printed = capsys.readouterr().out
    assert re.search(rf"stopped: {named}\d* is not fed by its Transmit Gate alone", printed)
    assert "12 of 12" not in printed


def passed(gate, value=1.0) -> bool:
    given, out = np.full(8, value, np.complex64), np.full(8, np.nan, np.complex64)
    gate.pass_into(given, out)
    assert np.array_equal(out, given) or not out.any()
    return bool(out.any())


def test_gate_closes_for_good_when_control_is_silent_for_a_second():
    clock = SimpleNamespace(now=0.0)
    gate, other = (TransmitGate(a_scene(), True, controlled=True, clock=lambda: clock.now) for _ in range(2))
    other.beat()
    assert not passed(gate) and "waits for remote control" in gate.why_closed
    for clock.now in (0.0, 0.9, 1.8):
        gate.beat()
        assert passed(gate)
    clock.now = 2.7
    assert passed(gate)
    clock.now = 2.9
    assert not passed(gate) and "silent for more than 1 s" in gate.why_closed
    gate.beat()
    assert not passed(gate)
    assert gate.zeroed_samples == 24
    other.beat()  # nobody looked meanwhile: the beat itself notices that it is late
    assert not passed(other)


@pytest.mark.parametrize("transmit", [False, None, "True", 1])
def test_gate_opens_for_true_alone_and_for_a_scene_that_the_interlock_allows(transmit):
    assert not passed(TransmitGate(a_scene(), transmit))
    for radio in ({"attenuation_db": 10}, {"jammer_serial": "R"}):
        assert not passed(TransmitGate(a_scene(**radio), True))


@pytest.mark.parametrize(
    ("value", "why"),
    [
        *((value, "not finite") for value in (np.nan, np.inf, -np.inf)),
        (-1.51j, "a sample of 1.51, and the converter's full scale is 1.5"),
    ],
)
def test_gate_closes_at_a_sample_that_is_not_finite_or_beyond_full_scale(value, why):
    gate = TransmitGate(a_scene(), True)
    gate.full_scale = 1.5
    assert passed(gate, 1.5 - 1.5j)
    assert not passed(gate, value)
    assert why in gate.why_closed
    assert not passed(gate)


@pytest.mark.parametrize(
    ("radio", "message"),
    [
        ({"attenuation_db": 180.0}, "attenuation_db is 180; it has to be within 0..150"),
        ({"attenuation_db": 1e308}, "attenuation_db is 1e\\+308; expected a number within"),
        ({"radar_serial": "a,type=x300"}, "radar_serial is 'a,type=x300'; a serial is"),
        ({"master_clock_hz": 0.0}, "master_clock_hz is 0"),
        ({"lo_offset_hz": 40e6}, "within -3.072e\\+07..3.072e\\+07"),
    ],
)
def test_scene_refuses_what_no_radio_can_do(radio, message):
    with pytest.raises(SceneError, match=message):
        a_scene(**radio)
