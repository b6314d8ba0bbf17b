"""The first hour on two radios, on the double of gr-uhd and in simulation: every fault has its verdict and cause."""

import csv

import numpy as np
import pytest
import uhd_double

from radalt.core.radio.interlock import InterlockError
from radalt.core.scene import parse_scene
from radalt.evaluation.commands import first_light as command
from radalt.evaluation.radios import hardware
from radalt.evaluation.radios.first_light import STEPS, Bench, Check, perform

RADAR, JAMMER = "R30F4A11", "J30F4A22"
RADIO = uhd_double.RADIO | {"radar_serial": RADAR, "jammer_serial": JAMMER, "jammer_tx_gain_db": 40.0}
SCENE = {"radio": RADIO, "interference": {"qpsk": {"sir_db": -10, "overlap": 1.0, "bandwidth_hz": 2.0025e6}}}


def a_bench(monkeypatch, tmp_path, radio=(), **faults):
    """A bench on the double, with faults of it."""
    air = uhd_double.Air(**{"event": "", **faults})
    uhd_double.install(monkeypatch, air)
    monkeypatch.setattr(hardware, "_START_S", 60.0)  # the double is no radio: a busy machine delays it
    scene = parse_scene({**SCENE, "radio": {**RADIO, **dict(radio)}})
    options = {"transmit": True, "frames": 4, "starts": 2, "minutes": 0.001, "sleep": air.sleep}
    return Bench(scene, tmp_path / "first", log=lambda line: None, **options), air


def verdicts(bench, *names, each=lambda check: None):
    """Checks of these steps that failed, and all, as ``step: what`` -> check; ``each`` sees them as they come."""
    found = {f"{c.step}: {c.what}": c for c in perform(bench, names) if each(c) is None}
    return {name: c for name, c in found.items() if c.verdict == "fail"}, found


FIRST = ("receiver", "radar")


def test_a_healthy_bench_passes_every_step_and_a_silent_transmitter_sends_zeros(monkeypatch, tmp_path):
    bench, air = a_bench(monkeypatch, tmp_path)
    sent = {}
    failed, found = verdicts(bench, *STEPS, each=lambda check: sent.update({check.step: dict(air.sent)}))
    assert sent["radar"]["radar"].any() and sent["jammer"]["jammer"].any()
    assert sent["jammer"]["radar"].size and not sent["jammer"]["radar"].any()
    assert not failed
    assert {(c.step, c.verdict) for c in found.values()} == {(step, "pass") for step in STEPS}
    # the double's air: gain 1/2, drive 0.7, noise of 1e-3 a rail, a latency without fraction
    assert found["receiver: noise"].value == pytest.approx(-57.0, abs=0.1)
    assert found["radar: level"].value == pytest.approx(20 * np.log10(0.7 / 2), abs=0.1)
    assert bench.known["latency"] == pytest.approx(uhd_double.LATENCY, abs=0.05)
    assert found["jammer: SIR off from -10 dB"].value == pytest.approx(0.0, abs=0.3)


@pytest.mark.parametrize(
    ("faults", "failed", "cause"),
    [
        ({"locks": False}, "receiver: run", "lo_locked is false"),
        ({"event": "time_error"}, "radar: transmitter late", "started after the common start"),
        ({"deaf": {"radar"}}, "radar: above the noise", "radios or serials exchanged"),
        ({"gain": 30.0}, "radar: samples clipped", "too much arrives"),
        ({"gain": 0.005}, "radar: level", "more attenuation than stated"),
    ],
    ids="no lock,late start,swapped,clipping,40 dB less".split(","),
)
def test_each_fault_gets_its_verdict(monkeypatch, tmp_path, faults, failed, cause):
    bench, _ = a_bench(monkeypatch, tmp_path, **faults)
    wrong, found = verdicts(bench, *FIRST)
    assert failed in wrong, found
    assert cause in wrong[failed].cause


def test_steps_that_need_what_failed_are_skipped(monkeypatch, tmp_path):
    bench, air = a_bench(monkeypatch, tmp_path, deaf={"radar", "jammer"})
    wrong, found = verdicts(bench, *STEPS)
    assert "a dead port or cable" in wrong["radar: above the noise"].cause
    after = [c for c in found.values() if c.step not in FIRST]
    assert {c.verdict for c in after} == {"skipped"}
    assert all("that an earlier step did not find" in c.cause for c in after)


def test_the_jammers_losses_show_in_the_sir(monkeypatch, tmp_path):
    """Six decibels more in the jammer's path are six decibels of SIR."""
    bench, _ = a_bench(monkeypatch, tmp_path)
    send, gain = uhd_double.Air.send, {"jammer": 0.5, "radar": 1.0}
    monkeypatch.setattr(uhd_double.Air, "send", lambda air, who, samples: send(air, who, samples * gain[who]))
    wrong, _ = verdicts(bench, *FIRST, "jammer")
    assert set(wrong) == {"jammer: SIR off from -10 dB"}
    assert wrong["jammer: SIR off from -10 dB"].value == pytest.approx(6.0, abs=0.3)


def test_nothing_is_opened_without_the_interlock(monkeypatch, tmp_path):
    air = uhd_double.Air()
    uhd_double.install(monkeypatch, air)
    scene = parse_scene(SCENE)
    with pytest.raises(InterlockError, match="--transmit"):
        Bench(scene, tmp_path)
    with pytest.raises(InterlockError, match="enclosure is 'none'"):
        Bench(parse_scene({**SCENE, "radio": {**RADIO, "enclosure": "none"}}), tmp_path, transmit=True)
    assert air.calls == []


def test_the_command_leaves_rows_and_a_report_and_does_not_overwrite_another(tmp_path, capsys):
    out = tmp_path / "first"
    options = ["--sim", "--frames", "4", "--starts", "2", "--steps", "starts", "--out", str(out)]
    assert command.main(options) == 0
    rows = list(csv.DictReader((out / "rows.csv").read_text().splitlines()))
    assert {(r["step"], r["verdict"]) for r in rows} == {(n, "pass") for n in ("receiver", "radar", "starts")}
    assert "altitudes right at 300 m" in (out / "report.md").read_text()
    assert command.main(options) == 2
    assert "holds another hour; name another --out" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        command.main([])
    assert "give the bench's scene with --scene" in capsys.readouterr().err


def test_results_are_below_results(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def stop(path, head):
        raise ValueError(f"stopped at {path}")

    monkeypatch.setattr("radalt.evaluation.radios.first_light.RunFolder", stop)
    assert command.main(["--sim"]) == 2
    assert "stopped at results/first-light-" in capsys.readouterr().err


def test_an_hour_that_is_broken_off_leaves_its_report(tmp_path, monkeypatch):
    def broken_off(bench, names):
        yield Check("noise", -70.0, step="receiver")
        raise KeyboardInterrupt

    monkeypatch.setattr("radalt.evaluation.radios.first_light.perform", broken_off)
    assert command.main(["--sim", "--out", str(tmp_path / "first")]) == 130
    assert "1 passed" in (tmp_path / "first/report.md").read_text()


def test_what_a_step_cannot_use_is_a_failed_check_and_the_next_step_goes_on(tmp_path):
    recording = {"file": str(tmp_path / "none"), "sir_db": -10.0}
    scene = parse_scene(SCENE | {"interference": {"recording": recording}})
    bench = Bench(scene, tmp_path / "first", simulated=True, frames=4, starts=2, minutes=0.001)
    failed, found = verdicts(bench, "receiver", "radar", "jammer", "starts")
    assert set(failed) == {"jammer: run"}
    assert "cannot be read" in failed["jammer: run"].cause
    assert found["starts: latency 150.30, 2 starts"].verdict == "pass"
