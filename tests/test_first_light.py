"""The first hour on two radios, on the double of gr-uhd and in simulation: every fault has its verdict and cause."""

import csv
import io
import signal
import zipfile

import numpy as np
import pytest
import uhd_double
import yaml

from radalt.core.radio.interlock import InterlockError
from radalt.core.scene import parse_scene
from radalt.evaluation.commands import first_light as command
from radalt.evaluation.flowgraph.replay import score_recording
from radalt.evaluation.radios import first_light_bundle as bundles
from radalt.evaluation.radios import hardware
from radalt.evaluation.radios.first_light import Bench, perform
from radalt.evaluation.radios.first_light_steps import MEASURES

pytestmark = pytest.mark.timeout(150)

RADAR, JAMMER = "R30F4A11", "J30F4A22"
RADIO = uhd_double.RADIO | {"radar_serial": RADAR, "jammer_serial": JAMMER, "jammer_tx_gain_db": 40.0}
SCENE = {
    "radio": RADIO,
    "interference": {"qpsk": {"sir_db": -10.0, "overlap": 1.0, "bandwidth_hz": 2.0025e6}},
}


def a_bench(monkeypatch, tmp_path, radio=(), **faults):
    """A bench on the double, with faults of it."""
    air = uhd_double.Air(**{"event": "", "serials": (RADAR, JAMMER), **faults})
    uhd_double.install(monkeypatch, air)
    monkeypatch.setattr(hardware, "_START_S", 60.0)  # the double is no radio: a busy machine delays it
    monkeypatch.setattr(hardware, "link_bytes_per_s", lambda serial: 5e8)
    scene = parse_scene({**SCENE, "radio": {**RADIO, **dict(radio)}})
    options = {"transmit": True, "frames": 4, "starts": 2, "minutes": 0.001, "sleep": air.sleep}
    return Bench(scene, tmp_path / "first", log=lambda line: None, **options), air


def verdicts(bench, *names):
    """Checks of these steps that failed, and all of them, as ``step: what`` -> check."""
    checks = perform(bench, {name: MEASURES[name] for name in names})
    found = {f"{c.step}: {c.what}": c for c in checks}
    return {name: c for name, c in found.items() if c.verdict == "fail"}, found


FIRST = ("devices", "receiver", "radar")


@pytest.mark.timeout(300)
def test_a_healthy_bench_passes_every_step(monkeypatch, tmp_path):
    bench, air = a_bench(monkeypatch, tmp_path)
    failed, found = verdicts(bench, *MEASURES)
    assert not failed
    assert {c.verdict for c in found.values()} == {"pass"}
    assert {c.step for c in found.values()} == set(MEASURES)
    # the double's air: gain 1/2, drive 0.7, noise of 1e-3 a rail, a latency without fraction
    assert found["receiver: noise"].value == pytest.approx(-57.0, abs=0.1)
    assert found["radar: level"].value == pytest.approx(20 * np.log10(0.7 / 2), abs=0.1)
    assert bench.known["latency"] == pytest.approx(uhd_double.LATENCY, abs=0.05)
    assert found["jammer: SIR off from -10 dB"].value == pytest.approx(0.0, abs=0.3)
    assert found["both: radar's level against its fullscale"].value == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize(
    ("faults", "failed", "cause"),
    [
        ({"master_clock_hz": 32e6}, "receiver: run", "rate S/s is"),
        ({"locks": False}, "receiver: run", "lo_locked is false"),
        ({"event": "time_error"}, "radar: transmitter late", "started after the common start"),
        ({"deaf": {"radar"}}, "radar: above the noise", "cables swapped between the radios"),
        ({"gain": 30.0}, "radar: samples clipped", "too much arrives"),
        ({"gain": 0.005}, "radar: level", "more attenuation than stated"),
        ({"serials": (RADAR,)}, "devices: radios found", f"no radio {JAMMER}: UHD found {RADAR};"),
    ],
    ids="wrong rate,no lock,late start,swapped,clipping,40 dB less,one missing".split(","),
)
def test_each_fault_gets_its_verdict(monkeypatch, tmp_path, faults, failed, cause):
    bench, _ = a_bench(monkeypatch, tmp_path, **faults)
    wrong, found = verdicts(bench, *FIRST)
    assert failed in wrong, found
    assert cause in wrong[failed].cause


def test_usb_2_is_too_slow_for_the_radar(monkeypatch, tmp_path):
    bench, _ = a_bench(monkeypatch, tmp_path)
    monkeypatch.setattr(hardware, "link_bytes_per_s", lambda serial: 53.2e6)
    wrong, found = verdicts(bench, "devices")
    assert set(wrong) == {"devices: link of the radar"}  # 60 MB/s both ways; the jammer's 30 fit
    assert "USB 2" in wrong["devices: link of the radar"].cause


def test_steps_that_need_what_failed_are_skipped(monkeypatch, tmp_path):
    bench, air = a_bench(monkeypatch, tmp_path, deaf={"radar", "jammer"})
    wrong, found = verdicts(bench, *MEASURES)
    assert "dead antenna port or cable" in wrong["radar: above the noise"].cause
    after = [c for c in found.values() if c.step not in FIRST]
    assert {c.verdict for c in after} == {"skipped"}
    assert all("that an earlier step did not find" in c.cause for c in after)


def test_the_jammers_losses_show_in_the_sir(monkeypatch, tmp_path):
    """Six decibels more in the jammer's path are six decibels of SIR."""
    bench, _ = a_bench(monkeypatch, tmp_path)
    send = uhd_double.Air.send
    monkeypatch.setattr(
        uhd_double.Air,
        "send",
        lambda air, who, samples: send(air, who, samples * (0.5 if who == "jammer" else 1)),
    )
    wrong, _ = verdicts(bench, *FIRST, "jammer")
    assert set(wrong) == {"jammer: SIR off from -10 dB"}
    assert wrong["jammer: SIR off from -10 dB"].value == pytest.approx(6.0, abs=0.3)


def test_an_image_and_a_slope_of_the_path_are_measured(monkeypatch, tmp_path):
    """y + 0.1 y* has an image of -20 dBc; it leaves power over the band as it was."""
    bench, _ = a_bench(monkeypatch, tmp_path)
    send = uhd_double.Air.send
    monkeypatch.setattr(
        uhd_double.Air,
        "send",
        lambda air, who, x: send(air, who, (0.8 * (x + 0.1 * x.conj())).astype(np.complex64)),
    )
    wrong, found = verdicts(bench, *FIRST)
    assert set(wrong) == {"radar: IQ image, LO in the middle of the band"}
    assert found["radar: IQ image, LO in the middle of the band"].value == pytest.approx(-20.0, abs=0.1)


def test_nothing_is_opened_without_the_interlock(monkeypatch, tmp_path):
    air = uhd_double.Air()
    uhd_double.install(monkeypatch, air)
    scene = parse_scene(SCENE)
    with pytest.raises(InterlockError, match="--transmit"):
        Bench(scene, tmp_path)
    with pytest.raises(InterlockError, match="enclosure is 'none'"):
        Bench(parse_scene({**SCENE, "radio": {**RADIO, "enclosure": "none"}}), tmp_path, transmit=True)
    assert air.calls == []


def test_a_silent_transmitter_sends_zeros(monkeypatch, tmp_path):
    bench, air = a_bench(monkeypatch, tmp_path)
    verdicts(bench, *FIRST)
    assert air.sent["radar"].any()
    _, found = verdicts(bench, "muted")
    assert air.sent["radar"].size and not air.sent["radar"].any()
    assert found["muted: above the noise, transmitter muted"].value == pytest.approx(0.0, abs=0.1)


# -- the command and its bundle ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    """A bundle of a simulated bench, its serials left out."""
    folder = tmp_path_factory.mktemp("bundle")
    scene = folder / "bench.yaml"
    scene.write_text(yaml.safe_dump(SCENE))
    options = ["--sim", "--frames", "4", "--starts", "2", "--minutes", "0.001", "--no-serials"]
    assert command.main([*options, "--scene", str(scene), "--out", str(folder / "out")]) == 0
    return folder / "out.zip"


def test_a_bundle_holds_all_that_comes_back_and_no_serial(bundle):
    assert bundle.stat().st_size < bundles.MOST_BYTES
    with zipfile.ZipFile(bundle) as archive:
        names = set(archive.namelist())
        content = b"".join(archive.read(n) for n in names if not n.endswith("data"))
        rows = list(csv.DictReader(io.StringIO(archive.read("rows.csv").decode())))
    assert {"report.html", "report.md", "rows.csv", "run.json", "captures/radar.sigmf-meta"} <= names
    assert RADAR.encode() not in content and JAMMER.encode() not in content
    assert b"SERIAL1" in content
    assert {row["step"] for row in rows} == set(MEASURES)
    assert {row["verdict"] for row in rows} == {"pass", "skipped"}
    assert b"<svg" in content and b"gnuradio" in content


def test_a_bundle_is_shown_and_its_captures_replay(bundle, tmp_path, capsys):
    assert command.main(["--read", str(bundle), "--out", str(tmp_path / "read")]) == 0
    printed = capsys.readouterr().out
    assert "altitudes right at 300 m" in printed and "0 failed" in printed
    rows = score_recording(
        tmp_path / "read/captures/altitudes.sigmf-meta", tmp_path / "score", methods=["none"]
    )
    assert rows[0]["pd"] == 1.0 and rows[0]["trials"] == 24


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("../evil.md", "it holds '../evil.md', which no bundle does"),
        ("/etc/evil.md", "it holds '/etc/evil.md'"),
        ("captures/../../evil.md", "which no bundle does"),
        ("evil.sh", "which no bundle does"),
        ("report.md", "which no bundle does"),  # twice
    ],
)
@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_strangers_zip_unpacks_nowhere_else(tmp_path, name, message, capsys):
    path = tmp_path / "in/bundle.zip"
    path.parent.mkdir()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("report.md", "# First light\x1b[31m")
        archive.writestr(name, "x")
    assert command.main(["--read", str(path), "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
    assert {p.name for p in tmp_path.rglob("*") if p.is_file()} == {"bundle.zip"}


def test_a_bomb_and_a_lie_are_refused(tmp_path, capsys):
    bomb, lie, none, broken = (tmp_path / n for n in ("bomb.zip", "lie.zip", "none.zip", "broken.zip"))
    with zipfile.ZipFile(broken, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("report.md", "x" * 999)
    data = bytearray(broken.read_bytes())
    data[48:52] = b"\xff" * 4  # the first of what is compressed
    broken.write_bytes(data)
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("report.md", "x" * (101 << 20))
    with zipfile.ZipFile(lie, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("report.md", "x" * 100_000)
    data = bytearray(lie.read_bytes())
    size = (100_000).to_bytes(4, "little")
    assert data.count(size) == 2
    lie.write_bytes(bytes(data).replace(size, (10).to_bytes(4, "little")))
    none.write_bytes(b"no zip at all")
    for path in (bomb, lie, none, broken, tmp_path / "absent.zip"):
        assert command.main(["--read", str(path)]) == 2
        assert capsys.readouterr().err.startswith("first_light: ")


def test_what_a_stranger_wrote_moves_no_cursor(tmp_path, capsys):
    path = tmp_path / "bundle.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("report.md", "# First light\x1b[31m\x07\r\n")
    assert command.main(["--read", str(path)]) == 0
    assert capsys.readouterr().out.startswith("# First light [31m")


@pytest.mark.parametrize(
    ("options", "message"), [(["--yes"], "give the bench's scene with --scene"), ([], "add --yes")]
)
def test_what_is_missing_gets_one_line(options, message, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO())
    with pytest.raises(SystemExit):
        command.main(options)
    assert message in capsys.readouterr().err


def test_an_hour_does_not_overwrite_another(tmp_path, capsys):
    """Neither a folder nor a zip; and it is said before anything is measured."""
    (tmp_path / "first.zip").write_text("mine")
    with pytest.raises(SystemExit) as ended:
        raise SystemExit(command.main(["--sim", "--steps", "receiver", "--out", str(tmp_path / "first")]))
    assert ended.value.code == 2
    assert (tmp_path / "first.zip").read_text() == "mine"
    assert "name another --out" in capsys.readouterr().err


def test_a_recording_too_large_for_the_bundle_is_named_in_the_report(tmp_path, monkeypatch):
    monkeypatch.setattr(bundles, "_CAPTURE_BYTES", 10)
    bench = Bench(parse_scene(SCENE), tmp_path / "first", simulated=True)
    folder = bundles.open_folder(bench)
    for name, count in (("altitudes", 9), ("radar", 8)):
        bench._save(name, bench.scene, np.zeros(count, np.complex64), 0.0)
    bundle = bundles.write_bundle(folder, [], "title")
    assert "in the folder alone: altitudes, radar." in bundles.read_bundle(bundle)


def test_ctrl_c_again_while_the_bundle_is_written_leaves_it_whole(tmp_path, monkeypatch, capsys):
    def broken_off(bench, steps):
        raise KeyboardInterrupt
        yield

    pages = bundles.write_pages
    monkeypatch.setattr("radalt.evaluation.radios.first_light.perform", broken_off)
    monkeypatch.setattr(
        bundles, "write_pages", lambda *args: (signal.raise_signal(signal.SIGINT), pages(*args))
    )
    assert command.main(["--sim", "--out", str(tmp_path / "first")]) == 130
    assert "not reached: the hour was broken off" in bundles.read_bundle(tmp_path / "first.zip")


def test_what_a_step_cannot_use_is_a_failed_check_and_the_next_step_goes_on(tmp_path):
    scene = parse_scene(
        {**SCENE, "interference": {"recording": {"file": str(tmp_path / "none"), "sir_db": -10.0}}}
    )
    bench = Bench(scene, tmp_path / "first", simulated=True, frames=4, starts=2, minutes=0.001)
    failed, found = verdicts(bench, "receiver", "radar", "jammer", "starts")
    assert set(failed) == {"jammer: run"}
    assert "cannot be read" in failed["jammer: run"].cause
    assert found["starts: latency 150.30 at 30 MHz, 2 starts"].verdict == "pass"
