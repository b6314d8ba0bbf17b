"""The integrity campaign: what it flies is true, what is wrong is found, and what was found is found again."""

import csv
import itertools
import os
from dataclasses import replace

import numpy as np
import pytest
from pages import assert_whole
from scipy import stats
from waiting import ROOT

from radalt.core.altimeter.altimeter import shared_altimeter
from radalt.core.tracker.tracker import OUTPUT_DTYPE, AltitudeTracker, Status
from radalt.evaluation.results.integrity import alert_limit_m, is_hazardous
from radalt.studies.integrity import command as program
from radalt.studies.integrity import long_flights, report
from radalt.studies.integrity import study as integrity
from radalt.studies.integrity.beats import Beats
from radalt.studies.integrity.cases import BLOCK, KINDS, WAVEFORM, Case, case_of, cases
from radalt.studies.integrity.columns import ROWS
from radalt.studies.integrity.flights import fly, rng_of
from radalt.studies.integrity.frames import _bent, white_noise
from radalt.studies.integrity.long_flights import flight_of, frames_of
from radalt.studies.integrity.received import received
from radalt.studies.integrity.study import TRACKER, IntegrityPoint, IntegrityStudy, judge_long

FLOWN = ROOT / "docs/data/integrity_flights.csv"
SMALL = IntegrityStudy(methods=("none", "whitening"), frames=480)
ALONE = IntegrityStudy(methods=("none",), frames=480)


def rows_of(name: str, study: IntegrityStudy = SMALL, part: int = 0) -> list[dict]:
    point = IntegrityPoint(name, study.frames, case=name, part=part)
    return [study.tables["rows"].row(row) for row in study.measure(point)]


def test_every_kind_has_cases_and_every_case_its_own_name():
    assert {case.kind for case in cases()} == set(KINDS)
    assert len({case.name for case in cases()}) == len(cases()) > 450
    with pytest.raises(ValueError, match="no case is called"):
        case_of("nothing")


def test_alert_limit_is_do_155_or_half_a_range_cell():
    np.testing.assert_allclose(alert_limit_m(np.array([np.nan, 5.0, 150.0, 1000.0])), [10, 10, 10, 50])


def test_without_a_return_the_alert_limit_is_that_of_the_altitude_given():
    """1,210 m within 14 m is what DO-155 lets an aircraft use, and nothing is there; within 70 m it is not."""
    outputs = np.zeros(2, OUTPUT_DTYPE)
    outputs["status"], outputs["altitude_m"] = Status.NORMAL, 1210.0
    outputs["protection_level_m"] = 14.0, 70.0
    nothing = np.full(2, np.nan)
    limit = integrity._limit_m(outputs, nothing)
    assert is_hazardous(outputs, nothing, limit).tolist() == [True, False]


def test_noise_alone_gives_no_altitude_and_false_alarms_per_frame_are_wrong():
    for row in rows_of("noise/0"):
        assert (row["outputs"], row["computed"], row["hazardous"]) == (12, 0, 0)
        assert row["correct"] == 0 and report.summarise([row])["pd"] is None


def test_a_clean_flight_is_followed_and_its_truth_belongs_to_the_end_of_each_output():
    """A quarter of a metre at 10 m/s is 25 ms: an output of the wrong instant would show."""
    case = Case("jammed", "clean", snr_db=10.0)
    fast = max(range(12), key=lambda batch: abs(fly(case, 1, batch, 480).speed_m_per_s[0]))
    flight, judged = ALONE.flown(case, fast)
    outputs = judged["none"].outputs
    normal = outputs["status"] == Status.NORMAL
    assert normal[2:].all() and not normal[:2].any()
    assert np.abs(outputs["altitude_m"] - flight.end_m[outputs["frame_index"]])[normal].max() < 0.25
    assert np.abs(flight.speed_m_per_s).max() <= 10.0 and flight.end_m.min() >= 5.0


def test_a_step_in_a_block_behind_a_track_that_coasted_is_noticed():
    """The ground is 13 m nearer from the middle of block 22 on: its peak lies between, and the track beyond."""
    study = IntegrityStudy(methods=("none",), frames=2080, seed=9410009)
    case = replace(case_of("landing/nr5/-30dB"), scene="qpsk_shaped")  # the flight is the name's
    flight, judged = study.flown(case, 0)
    outputs = judged["none"].outputs
    truth = flight.end_m[outputs["frame_index"]]
    assert truth[21] - truth[22] > 13.0 and outputs["status"][22] == Status.NO_COMPUTED_DATA
    assert not is_hazardous(outputs, truth, integrity._limit_m(outputs, truth)).any()


def test_a_stronger_second_return_beyond_the_ground_is_scored_as_hazardous():
    (row,) = rows_of("spoofed_first/beyond/+20dB", ALONE)
    assert row["computed"] == row["hazardous"] == row["misleading"] == row["wrong_20m"] == 10
    assert len(row["events"].split()) == 10
    (row,) = rows_of("spoofed/beyond/+3dB", ALONE)  # in mid-track: neither is called NORMAL
    assert row["hazardous"] == 0 and row["interruptions"] == 1 and row["alert_s"] == 0.0


@pytest.mark.parametrize("name", ["slip/clear", "missing/0.1", "nan/0.1", "switched_on/paper_qpsk/-28dB"])
def test_faults_make_failures_or_silence_and_no_wrong_altitude(name):
    for row in rows_of(name):
        assert row["outputs"] == 12 and row["hazardous"] == 0
        assert row["failures"] > 0 or name.startswith("switched")


@pytest.mark.parametrize(
    "name",
    ["jammed/nr5/0.3/-20dB/snr10", "drawn/7", "slip/paper_qpsk", "land_jammed/urban/bank 30/tones/-40dB"],
)
def test_the_same_point_twice_gives_the_same_rows_and_another_part_another_flight(name):
    study = IntegrityStudy(methods=("none",), frames=80)
    first, again = (rows_of(name, study)[0] | {"ms_per_frame": 0.0} for _ in range(2))
    assert first == again
    one, other = (fly(case_of(name), 1, part, 80).end_m[0] for part in (0, 1))
    assert one != other


def test_interference_meets_its_sir_in_every_frame_and_goes_on_between_frames():
    case = case_of("interference/tones/1/-30dB/snr10")
    (_, frames, _) = next(received(case, fly(case, 1, 0, 400), 1, 0))
    np.testing.assert_allclose(10 * np.log10(np.mean(np.abs(frames) ** 2, axis=1)), 30.0, atol=0.05)
    spectrum = np.abs(np.fft.fft(frames.ravel())) ** 2
    # five lines through 40 frames, not forty times five
    assert np.sort(spectrum)[-10:].sum() > 0.9 * spectrum.sum()


@pytest.fixture
def few(monkeypatch):
    """A case each of two kinds."""
    one = {"noise": "noise/0", "spoofed_first": "spoofed_first/beyond/+20dB"}
    monkeypatch.setattr(integrity, "cases", lambda kinds: [case_of(one[kind]) for kind in kinds])


def test_a_campaign_writes_its_page_and_its_events_fly_again(tmp_path, capsys, few, measured_here, undrawn):
    out = tmp_path / "out"
    small = ["--methods=none", "--groups=noise,spoofed_first", "--frames=400"]
    status = program.main([*small, "--jobs=1", f"--out={out}", f"--publish={tmp_path / 'docs'}"])
    assert status == 0  # what is hazardous here is a stated limit
    assert_whole(out / "report.md", None)
    page = (tmp_path / "docs/integrity.md").read_text()
    assert "**0 of 10 tracked outputs are hazardous inside the claim**" in page
    assert "(data/integrity.csv)" in page
    assert (tmp_path / "docs/figures/integrity_stanford.png").is_file()
    for row in csv.DictReader((out / "cases.csv").open()):  # two of ten outputs cannot be available
        assert float(row["after_start"]) == pytest.approx(float(row["availability"]) * 10 / 8)
    events = list(csv.DictReader((out / "events.csv").open()))
    assert events and {e["cause"] for e in events} <= {"before the ground was seen"}
    capsys.readouterr()
    assert program.main([*small, "--replay", events[0]["replay"]]) == 0
    again = [line for line in capsys.readouterr().out.splitlines() if "HAZARDOUS" in line]
    mine = [e for e in events if e["replay"] == events[0]["replay"]]
    assert [int(line.split()[1]) for line in again] == [int(e["frame_index"]) for e in mine]
    with pytest.raises(SystemExit):
        program.main([*small, "--replay", "land/woods/level@1000.5:1"])
    assert "has 1000.5 m/s over ground; only land/... has one, 0.1 to 999" in capsys.readouterr().err


def test_a_campaign_goes_on_to_more_hours(tmp_path, capsys, few, measured_here, undrawn):
    noise = ["--methods=none", "--groups=noise", "--frames=400", "--jobs=1", f"--out={tmp_path / 'out'}"]
    assert program.main(noise) == 0
    assert program.main([*noise, "--resume", "--hours=0.0003", f"--pool={FLOWN}"]) == 0
    assert "going on: 1 of 3" in capsys.readouterr().out
    # its rates per hour are of these flights, too
    assert len(ROWS.read(tmp_path / "out/flights.csv", "")) == len(ROWS.read(FLOWN, "")) + 3


def test_a_campaign_of_limits_alone_ends_with_its_page(tmp_path, measured_here, undrawn):
    limits = ["--methods=none", "--groups=repeating", "--frames=40", "--jobs=1"]
    assert program.main([*limits, f"--out={tmp_path / 'out'}"]) == 0


ALTIMETER = shared_altimeter(WAVEFORM, SMALL.settings)
BEATS = Beats(ALTIMETER)
BLOCKS = int(os.environ.get("RADALT_BEATS_BLOCKS", "12"))
STRATA_FLOWN = (
    "land/woods/level,land/urban/beam 60,land/desert/bank 30,point/snr-10,point/snr10/30m/-12dB".split(",")
)


@pytest.mark.parametrize("name", STRATA_FLOWN)
def test_flights_at_the_decimated_rate_have_the_statuses_and_levels_of_whole_frames(name):
    """The same scatterers and noise at both rates; so it is over 1,000 blocks of each (`RADALT_BEATS_BLOCKS=1000`)."""
    case, rng = case_of(name), np.random.default_rng(75)
    flight, outputs = flight_of(case, BLOCKS * BLOCK, rng), ([], [])
    trackers = [AltitudeTracker(ALTIMETER, TRACKER) for _ in outputs]
    level = np.float32(10.0 ** (-case.snr_db / 20.0) / np.sqrt(2.0))
    for block in range(BLOCKS):
        scatterers, noise = flight.scatterers(block), level * white_noise(BLOCK, rng)
        beats = ALTIMETER.decimator.mix(noise.reshape(BLOCK, 2, -1), ALTIMETER.mixer)
        low = BEATS.returns(scatterers) + beats
        both = ALTIMETER.spectra(frames_of(scatterers) + noise), ALTIMETER.of_beats(low)
        for tracker, out, spectra in zip(trackers, outputs, both, strict=True):
            out.append(tracker.process(spectra, frame_index=block * BLOCK + np.arange(BLOCK)))
    whole, beats = map(np.concatenate, outputs)
    assert np.mean(whole["status"] != beats["status"]) <= 0.002
    normal = (whole["status"] == Status.NORMAL) & (beats["status"] == Status.NORMAL)
    assert normal.sum() >= 0.7 * BLOCKS
    apart = np.abs(whole["protection_level_m"] - beats["protection_level_m"])[normal]
    assert np.median(apart) < 0.02 and np.quantile(apart, 0.99) < 0.3


def test_noise_at_the_decimated_rate_has_the_covariance_of_decimated_noise():
    rng = np.random.default_rng(76)
    whole = ALTIMETER.decimator.mix(white_noise(400, rng).reshape(400, 2, -1), ALTIMETER.mixer)
    found = [np.einsum("nhi,nhj->ij", x.conj(), x) / (2 * len(x)) for x in (whole, BEATS.noise(2000, rng))]
    top = np.abs(found[0]).max()
    assert np.abs(found[0] - found[1]).max() < 0.2 * top
    assert np.trace(found[1]).real == pytest.approx(np.trace(found[0]).real, rel=0.01)


@pytest.mark.parametrize(
    "land, seed, frames, given",
    [("mountains", 54, 1200, 0), ("mountains", 18, 1600, 38), ("woods", 11, 1600, 38)],
)
def test_banked_by_40_degrees_no_output_misleads_where_the_nearest_ground_is_weak(land, seed, frames, given):
    """In the first the beam points at 1,500 m, in the others the top lies 30 to 60 m beyond the nearest ground."""
    case = case_of(f"land/{land}/bank 40")
    flight, judged = judge_long(case, rng_of(case, seed, 0, 0), frames, SMALL.settings)
    out = judged.outputs
    error_m = np.abs(out["altitude_m"] - flight.end_m[out["frame_index"]])
    assert not np.any(error_m > 0.88 * out["protection_level_m"])
    assert np.isfinite(error_m).sum() == given


def test_woods_whose_top_lies_beyond_the_span_are_no_point_within_it(monkeypatch):
    """Banked by 40 degrees at 1,230 m; 21 peaks of their speckle were altitudes 160 m off."""
    monkeypatch.setattr(long_flights, "_altitudes", lambda rng, blocks: np.full(blocks + 1, 1230.0))
    case = case_of("land/woods/bank 40")
    row = integrity._row(*judge_long(case, rng_of(case, 14, 0, 0), 4000, SMALL.settings))
    assert (row["outputs"], row["misleading"], row["hazardous"]) == (100, 0, 0)


def test_levels_hold_over_land_down_to_an_snr_of_minus_10_db():
    """Below it docs/tracker.md has what RADALT_LAND_SNR_DB prints: weak ground passes for a point."""
    chosen = os.environ.get("RADALT_LAND_SNR_DB")
    names = itertools.product(("woods", "desert", "mountains", "grass"), ("level", "bank 30"), (1, 2))
    rows = []
    for land, attitude, seed in names if chosen else list(names)[::4]:
        case = replace(case_of(f"land/{land}/{attitude}"), snr_db=float(chosen or -10.0))
        rows.append(integrity._row(*judge_long(case, rng_of(case, seed, 0, 0), 1000, SMALL.settings)))
    total = {name: sum(r[name] for r in rows) for name in ("outputs", "computed", "misleading", "hazardous")}
    print(total, "off by up to", max(r["largest_m"] or 0.0 for r in rows))
    assert chosen or total["misleading"] == 0


@pytest.mark.parametrize(
    ("method", "case", "seed", "frames", "least"),
    [
        ("whitening", "drawn/39", 62115907, 1600, 34),
        ("tcae", "drawn/10", 884120197, 1000, 20),
        ("whitening", "interference/nr5/0.3/-60dB/snr10", 779261825, 1000, 0),
    ],
)
def test_a_widened_point_is_no_ground_and_a_base_station_no_return(method, case, seed, frames, least):
    """Its lobes lie on both sides: as ground 8 of 40 altitudes are 27 m too low, and 1 of 25 is left. NR recurs: 9."""
    (row,) = rows_of(case, IntegrityStudy(methods=(method,), frames=frames, seed=seed))
    assert row["computed"] >= least and row["misleading"] == 0


def test_the_pages_have_the_rates_of_the_stored_flights(root):
    rows = ROWS.read(FLOWN, "")
    assert report._hours_table(rows) in (root / "docs/integrity.md").read_text("utf-8")
    land = report.pooled((r for r in rows if r["kind"] == "land"), "case", "method")
    tracker = (root / "docs/tracker.md").read_text("utf-8")
    assert report._attitude_table(land) in tracker
    for method in ("whitening", "hybrid", "tcae"):
        mine = [r for r in rows if r["method"] == method and not case_of(r["case"]).known_limit]
        count = " of ".join(f"{sum(r[name] for r in mine):,}" for name in ("hazardous", "outputs"))
        found = report._hours_of(mine)
        bound, given = np.ceil(found["bound"]), report._above(found["given_bound"])
        assert f"| else, `{method}` | {count} | ≤ {bound:.0f} | ≤ {given} |" in tracker
    assert f"below {bound:.0f} per hour behind `tcae`" in (root / "README.md").read_text()


def test_rates_are_per_flight_hour_and_an_event_is_a_run_of_outputs():
    assert integrity._events_of(np.array([1, 1, 0, 1, 0, 0, 1], dtype=bool)) == 3
    case = case_of("point/snr10")
    row = integrity._row(*judge_long(case, rng_of(case, 1, 0, 0), 1200, SMALL.settings)) | {"method": "none"}
    row |= {"case": "land/woods/level", "kind": "land", "misleading_events": 2, "hazardous_events": 1}
    rows = [row, row | {"hazardous_events": 0, "misleading_events": 0}]
    found = report._hours_of(rows)
    assert (found["misleading"], found["hazardous"], found["hazardous_flights"]) == (2, 1, 1)
    assert found["hours"] == pytest.approx(60 * 0.04 / 3600)
    assert found["bound"] == pytest.approx(4.744 / found["hours"], rel=1e-3)  # Poisson, 95 %, one event
    lines = report._hours_table(rows).splitlines()[2:]
    assert [line.split(" | ")[0] for line in lines][0] == "| land, level" and len(lines) == 4
    # 0.80 of 0.81 of the time level, one event in each stratum
    weighted = report._weighted({"land, level": rows, "a point": rows})
    assert weighted["bound"] == pytest.approx(6.296 / found["hours"] * 80 / 81, rel=1e-3)


def test_what_puts_a_case_outside_the_claim_is_stated_on_the_pages_of_the_limits(root):
    tracker, leakage = ((root / f"docs/{name}.md").read_text() for name in ("tracker", "leakage"))
    limits = tracker.split("## What it cannot tell")[1].split("##")[0]
    assert limits.count("\n| ") <= 1 + 10  # a heading
    for case in cases():
        assert case.known in limits + leakage.split("### Limits")[1], case.name
        assert case.known_limit == (case.known != "")


def test_a_flight_counts_once_however_many_of_its_outputs_are_hazardous():
    (row,) = IntegrityStudy(("none",), frames=400).measure(IntegrityPoint("", 400, case="noise/0"))
    flights = [row | {"batch": k // 2, "hazardous": h} for k, h in enumerate((3, 1, 0, 0, 0, 0))]
    claim = report._claim(flights)
    counted = "hazardous", "outputs", "hazardous_flights", "flights"
    assert [claim[name] for name in counted] == [4, 60, 1, 3]
    assert claim["flight_bound"] == pytest.approx(stats.beta.ppf(0.95, 2, 2))
    assert claim["bound"] == pytest.approx(stats.beta.ppf(0.95, 5, 56))
    # another method on the same flights makes no bound smaller; of 60 outputs 30 have an altitude
    both = report._claim([f | {"method": m, "computed": 5} for f in flights for m in ("none", "tcae")])
    given = stats.beta.ppf(0.95, 5, 26)
    assert both["bound"] == claim["bound"] and both["given_bound"] == pytest.approx(given)


def test_a_step_is_in_the_last_quarter_of_a_block_where_the_case_is_outside_the_claim_and_nowhere_else():
    for case in cases(("step", "landing")):
        for part in range(6):
            altitude_m = fly(case, 1, part, 2000).end_m
            steps = 1 + np.flatnonzero(np.abs(np.diff(altitude_m)) > 0.5)
            assert np.all((steps % 40 >= 30) == case.known_limit), (case.name, part)


def test_a_sweep_that_is_not_linear_leaves_the_line_by_its_share_of_the_bandwidth():
    source = _bent(0.01, lambda k: np.ones((k.size, 7500)), np.full(1, 300.0), np.random.default_rng(3))
    phase = np.unwrap(np.angle(source(np.zeros(1, dtype=int))[0])) / (2 * np.pi)
    deviation_hz = np.diff(phase) * WAVEFORM.rate_hz
    assert np.abs(deviation_hz).max() == pytest.approx(0.01 * WAVEFORM.bandwidth_hz, rel=0.01)
    up, down = deviation_hz[100:3700], deviation_hz[3800:7400]
    assert abs(up.mean()) < 0.1 * 75e3 and abs(down.mean()) < 0.1 * 75e3


@pytest.mark.parametrize("name", ["leakage/+40dB", "gear/+20dB"])
def test_what_is_calibrated_costs_no_altitude_whatever_the_cables(name):
    (row, *_) = rows_of(name, IntegrityStudy(("none",), frames=400))
    assert (row["computed"], row["outputs"], row["wrong_5m"], row["failures"]) == (8, 10, 0, 0)


def test_gnu_radios_transmitters_and_fading_hold_their_level_and_are_never_the_same():
    for name in ("gnuradio/ofdm/-20dB", "fading/qpsk_shaped/300Hz/-20dB"):
        case = case_of(name)
        parts = [f for _, f, _ in received(case, fly(case, 1, 0, 120), 1, 0)]
        level_db = 10 * np.log10(np.mean(np.abs(np.concatenate(parts)) ** 2))
        assert level_db == pytest.approx(20.0, abs=0.3 if name.startswith("gnu") else 6.0)
        assert abs(np.vdot(parts[0], parts[1])) < 0.1 * np.linalg.norm(parts[0]) * np.linalg.norm(parts[1])
