"""The tolerance campaign: profiles, criteria, bisection, levels, and a tiny campaign through its command."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from radalt.core.deramp.profile import STANDINGS, load_profile, profile_names
from radalt.core.parsing import InputError
from radalt.core.receiver.tracker_settings import Status
from radalt.studies.tolerance.command import main
from radalt.studies.tolerance.criteria import HIGHEST_DBM, LOWEST_DBM, break_level, judged
from radalt.studies.tolerance.interferers import INTERFERERS, locked_m
from radalt.studies.tolerance.report import draw, figure_name, pooled
from radalt.studies.tolerance.study import ToleranceStudy, Trial

FT = 0.3048


# -- profiles -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", profile_names())
def test_every_number_of_a_profile_has_a_source_and_a_standing(name):
    profile = load_profile(name)
    assert profile.name == name
    for level, source in profile.standing.values():
        assert level in STANDINGS
        assert len(source) > 4
        for body in ("RTCA", "ARINC", "ITU"):  # never quoted as read there
            assert body not in source or level != "read in source"


def test_three_kinds_are_shipped():
    assert (
        " ".join(sorted(profile_names())) == "bench counter fmcw_150mhz fmcw_150mhz_edge fmcw_150mhz_halves"
    )
    whole, halves = load_profile("fmcw_150mhz"), load_profile("fmcw_150mhz_halves")
    assert (whole.period_s, halves.period_s) == (7e-3, 14e-3)
    assert (whole.transmit_w, whole.noise_figure_db, whole.beamwidth_deg) == (0.4, 8.0, 40.0)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("  gain_dbi: 10", "expected \\[value, standing, source\\]"),
        ("  gain_dbi: [10, guessed, me]", "allowed: read in source, secondary, assumed"),
        ("  gain_dbi: [10, secondary, nobody]", "sources has mathworks"),
        ("  gain_dbi: [99, assumed, me]", "gain_dbi is 99; it has to be within -20..40"),
        ("  iip3_dbm: [-14, assumed, me]", "more than 7.8 dB above"),
        ("  max_altitude_ft: [9000, assumed, me]", "raise it or lower max_altitude_ft"),
        ("  gain: [10, assumed, me]", "unknown key 'gain'"),
        ("  gain_dbi: [10, assumed, '']", "has the source ''; expected words"),
        ("  gain_dbi: [10, secondary, [sheet]]", "has the source \\['sheet'\\]; expected words"),
        ("  preselector_hz: [100.0e6, assumed, me]", "it has to pass the sweep"),
        (
            "  carrier_hz: [4.25e9, assumed, me]",
            "covers 4175 to 4325 MHz; it has to stay within 4200 to 4400",
        ),
        ("  p1db_dbm: [-20, assumed, me]\ngain_dbi: 12", "gain_dbi stands outside numbers"),
    ],
)
def test_a_wrong_number_gets_one_line(tmp_path, line, message):
    path = tmp_path / "mine.yaml"
    path.write_text(f"base: fmcw_150mhz\nname: mine\nnumbers:\n{line}\n")
    with pytest.raises(InputError, match=message) as error:
        load_profile(path)
    assert "\n" not in str(error.value)


def test_a_base_is_a_file_beside_or_a_shipped_profile(tmp_path):
    mine, second = tmp_path / "mine.yaml", tmp_path / "second.yaml"
    mine.write_text("base: counter\nname: mine\nnumbers:\n  gain_dbi: [12, assumed, a horn]\n")
    second.write_text("base: mine\nname: second\n")
    found = load_profile(second)
    assert (found.name, found.gain_dbi, found.detector) == ("second", 12.0, "counter")
    second.write_text("base: nobody\nname: second\n")
    with pytest.raises(InputError, match="no altimeter 'nobody'; there are bench"):
        load_profile(second)


def test_a_missing_number_and_an_unknown_profile_are_named(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\nabout: nothing\nsweep: triangle\n")
    with pytest.raises(InputError, match="numbers.bandwidth_hz is missing"):
        load_profile(path)
    with pytest.raises(InputError, match="there are bench, counter"):
        load_profile("benhc")


def test_levels_by_hand():
    """0.4 W, 10 dBi, 3 dB of cable: 1 dBm/MHz at the port is 1 - 30 - 10 + 34.13 + 3 dBW/m2/MHz in the air."""
    profile = load_profile("fmcw_150mhz")
    aperture = 10 * np.log10((299_792_458 / 4.3e9) ** 2 / (4 * np.pi))
    assert profile.flux_dbw_per_m2_mhz(1.0) == pytest.approx(1 - 30 - 10 - aperture + 3)
    assert profile.transmit_dbm == pytest.approx(26.02, abs=0.01)
    assert 10 * np.log10(profile.noise_mw_per_hz) == pytest.approx(-173.98 + 8, abs=0.01)
    # over diffuse ground the loss grows with the square of the height
    assert profile.loop_loss_db(2000.0) - profile.loop_loss_db(200.0) == pytest.approx(20.0)
    # order 3 at 370 MHz from the middle of 200 MHz
    assert profile.preselector_loss_db(3.93e9) == pytest.approx(10 * np.log10(1 + 3.7**6))
    tone, noise = INTERFERERS["tone"], INTERFERERS["white_noise"]
    assert tone.density_dbm_per_mhz(profile, 0.0) == pytest.approx(-10 * np.log10(150))
    assert noise.density_dbm_per_mhz(profile, 0.0) == pytest.approx(
        -10 * np.log10(profile.noise_bandwidth_hz / 1e6)
    )


def test_a_real_mixer_costs_three_decibels():
    profile = load_profile("fmcw_150mhz")
    snr = []
    for mixer in ("iq", "real"):
        trial = Trial(replace(profile, mixer=mixer), "white_noise", "none", 28, 1)
        sums = [
            np.log10(trial.detector.spectra(trial._received(returns, None, slice(0, 256))).sum(axis=(0, 1)))
            for returns in (1e3 * trial.returns(200.0), 0 * trial.returns(200.0))
        ]
        snr.append(10 * (sums[0].max() - np.median(sums[1])))
    assert snr[0] - snr[1] == pytest.approx(3.02, abs=0.3)


# -- criteria and bisection ---------------------------------------------------------------------------------------


def outputs(*, wrong=0, missing=0, count=200, truth=100.0, off=5.0):
    status, altitude = np.full(count, Status.NORMAL), np.full(count, truth)
    altitude[:wrong] += off
    status[count - missing :] = Status.NO_COMPUTED_DATA
    altitude[count - missing :] = 9e9  # means nothing
    return judged(status, altitude, truth, 0.05)


def test_criteria_fall_one_by_one():
    assert not any(outputs().values())
    assert outputs(missing=1) == dict.fromkeys(("mean_error", "within", "wrong", "alert"), False) | {
        "no_data": True
    }
    assert outputs(missing=5)["within"]  # 97.5 %
    assert outputs(wrong=1)["wrong"]
    assert not outputs(wrong=1)["within"]
    assert not outputs(wrong=20)["alert"]  # 1.0 s
    assert outputs(wrong=21)["alert"]
    assert outputs(wrong=21)["mean_error"]  # 0.525 %
    assert not outputs(wrong=200, off=0.4)["mean_error"]
    assert outputs(missing=200)["mean_error"]


@pytest.mark.parametrize("true", [-149.3, -80.2, -1.0, 0.4, HIGHEST_DBM - 0.5])
@pytest.mark.parametrize("expected", [-200.0, -80.0, 0.0, 90.0])
def test_bisection_is_within_half_a_decibel(true, expected):
    asked = []

    def fallen(level):
        asked.append(level)
        return level >= true

    assert abs(break_level(fallen, expected) - true) <= 0.5
    assert all(LOWEST_DBM <= level <= HIGHEST_DBM for level in asked)
    assert len(asked) < 20
    assert break_level(lambda level: False, expected) is None
    assert abs(break_level(lambda level: level >= 40.2, expected, 54) - 40.2) <= 0.5


def test_seeds_are_pooled_with_their_interval():
    row = {"first": "no_data", "break_dbm_per_mhz": 1.0, "break_dbw_per_m2_mhz": 2.0, "margin_db": None}
    found = pooled([row | {"break_dbm": level} for level in (-10.0, -9.0, -11.0)])
    assert found.mean == pytest.approx(-10.0)
    assert found.half == pytest.approx(4.303 / np.sqrt(3), abs=0.01)
    assert np.isnan(found.margin)


def test_a_figure_holds_one_method_and_the_rule_in_the_band():
    study = ToleranceStudy("fmcw_150mhz", ("white_noise", "tone"), ("none", "blanking"), (50.0, 200.0))
    row = {"break_dbm": -6.5, "break_dbm_per_mhz": -29.7, "margin_db": 49.4, "first": "within"}
    groups = {
        (method, name, feet): pooled([row])
        for method in study.methods
        for name in study.interferers
        for feet in study.altitudes_ft
    }
    for method, title, name in (
        ("none", "without mitigation", "tolerance.png"),
        ("blanking", "with blanking", "tolerance_blanking.png"),
    ):
        axis = draw(load_profile("fmcw_150mhz"), study, groups, method).axes[0]
        assert title in axis.get_title()
        assert figure_name(study, method) == name
        rule = axis.lines[-1]
        assert list(rule.get_xdata()) == [50.0, 500.0]
        assert rule.get_ydata()[0] == pytest.approx(-79.1, abs=0.05)


# -- physics of a trial -------------------------------------------------------------------------------------------


def test_a_locked_equal_sweep_wins_at_the_power_of_the_return_wrong_and_normal():
    study = ToleranceStudy("fmcw_150mhz", ("equal_locked",), ("none",), (200.0,), 20, 1)
    row = study.measure(study.points()[0])[0]
    assert row["break_dbm"] == pytest.approx(row["return_dbm"], abs=1.0)
    assert "wrong" in row["first"].split()
    assert row["no_data_dbm"] is None


def test_a_counter_breaks_far_earlier_than_a_spectrum():
    levels = {}
    for name in ("fmcw_150mhz", "counter"):
        study = ToleranceStudy(name, ("nr10",), ("none",), (200.0,), 20, 1)
        levels[name] = study.measure(study.points()[0])[0]["break_dbm"]
    assert levels["fmcw_150mhz"] - levels["counter"] > 20.0


def test_a_blocker_acts_through_the_amplifier_alone():
    profile = load_profile("fmcw_150mhz")
    trial = Trial(profile, "blocker", "none", 20, 1)
    assert trial.bank is None
    returns = trial.returns(200.0)
    far, near = (trial._received(returns, level, slice(0, 8)) for level in (-40.0, 25.0))
    weak = profile.amplifier.beside(
        INTERFERERS["blocker"].at_amplifier_dbm(profile, 25.0), constant_envelope=False
    ).weak
    assert np.vdot(returns[0], near[0]).real / np.vdot(returns[0], far[0]).real == pytest.approx(
        weak, abs=0.02
    )


def test_a_blocker_is_searched_past_what_table_1_asks_for():
    """9.5 dBW/m2/MHz at 3.93 GHz over 98 MHz are +33 dBm at the port, above the highest level in the band."""
    profile, kind = load_profile("fmcw_150mhz"), INTERFERERS["blocker"]
    asked = 9.5 + 30 + 10 - 33.34 - 3 + 10 * np.log10(98)
    assert HIGHEST_DBM < asked < kind.highest_dbm(profile) == 54
    assert INTERFERERS["white_noise"].highest_dbm(profile) == HIGHEST_DBM


def test_a_locked_sweep_lies_within_the_span_and_wins_there():
    low = replace(load_profile("fmcw_150mhz"), max_altitude_ft=1000.0)
    assert locked_m(load_profile("fmcw_150mhz")) == 450.0
    assert locked_m(low) < low.max_range_m
    trial = Trial(low, "equal_locked", "none", 20, 1)
    status, altitude = trial.outputs(trial.returns(200.0), -50.0)
    assert (status == Status.NORMAL).all()
    assert altitude == pytest.approx(locked_m(low) - low.installation_delay_ft * FT, abs=0.5)


@pytest.mark.parametrize(
    ("isolation_db", "at_dbm"), [(150.0, -23.0), (90.0, -28.0), (75.0, -33.0), (60.0, -40.0)]
)
def test_a_blockers_modulation_reaches_the_leakage_before_the_gain_falls(isolation_db, at_dbm):
    """Power at the amplifier at which noise over the return has risen by 1 dB (I/N of -6 dB), by isolation."""
    profile = replace(load_profile("fmcw_150mhz"), isolation_db=isolation_db)
    kind, loss_db = INTERFERERS["blocker"], profile.preselector_loss_db(3.93e9)

    def risen(strong_dbm):
        gain, added = kind.in_receiver(profile, strong_dbm + loss_db)
        return 10 * np.log10((1 + added / profile.noise_mw_per_hz) / gain.weak**2) > 1.0

    assert not risen(at_dbm - 1.0)
    assert risen(at_dbm + 1.0)


def test_the_tracker_takes_the_same_frames():
    study = ToleranceStudy("bench", ("white_noise",), ("none",), (1000.0,), 20, 1)
    row = study.measure(study.points()[0])[0]
    assert 28.0 < row["break_dbm_per_mhz"] - row["return_dbm"] < 34.0
    assert row["wrong_dbm"] is None


# -- the command --------------------------------------------------------------------------------------------------


def test_command_writes_its_page_and_noise_breaks_where_its_density_over_the_return_says(
    tmp_path, measured_here
):
    """One law: some 30 dB/MHz over the return at any altitude (a linear receiver: -17, -29, -44, -57 dBm/MHz)."""
    out = tmp_path / "run"
    options = (
        "--interferers white_noise --method none --altitudes-ft 200,1000 --outputs 20 --seeds 1 --jobs 1"
    )
    assert main([*options.split(), "--out", str(out)]) == 0
    rows = list(csv.DictReader((out / "rows.csv").open()))
    assert [float(r["altitude_ft"]) for r in rows] == [200.0, 1000.0]
    for row in rows:
        assert 28.0 < float(row["break_dbm_per_mhz"]) - float(row["return_dbm"]) < 34.0
        assert row["wrong_dbm"] == ""  # missing, not wrong
    assert float(rows[0]["margin_db"]) == pytest.approx(float(rows[0]["break_dbw_per_m2_mhz"]) + 82.0)
    assert rows[1]["margin_db"] == ""  # Table 1 ends at 500 ft
    page = (out / "report.md").read_text()
    assert "--interferers=white_noise --method=none --altitudes-ft=200.0,1000.0 --outputs=20" in page
    assert "asks for -82 dBW/m²/MHz, which is -79.1 dBm/MHz at the port" in page
    assert "95 %" not in page  # of one seed
    assert "secondary" in page
    assert "Margin to 14 CFR 91.220(b) Table 1" in page
    assert (out / "tolerance.svg").stat().st_size > 1000


def test_an_interferer_that_the_if_cannot_hold_is_refused_before_anything_is_measured(tmp_path, capsys):
    path = tmp_path / "mine.yaml"
    path.write_text("base: fmcw_150mhz\nname: mine\nnumbers:\n  if_rate_hz: [1.6e6, assumed, own]\n")
    assert main(["--profile", str(path), "--dry-run", "--out", str(tmp_path / "run")]) == 2
    assert "--interferers: nr10: the IF's rate 1.6e+06 is no multiple" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--method", "ofdm_cancel"],
            "--method: 'ofdm_cancel' is none of those that work behind an IF filter",
        ),
        (["--altitudes-ft", "200,200.0"], "name each once"),
        (["--altitudes-ft", "1420"], "is where equal_locked appears"),
        (["--interferers", "nr11"], "there are white_noise, tone"),
        (["--altitudes-ft", "6000"], "within 10..5500"),
        (["--altitudes-ft", "abc"], "has to be a number"),
        (["--profile", "none"], "there are bench, counter"),
    ],
)
def test_what_does_not_fit_gets_one_line(options, message, tmp_path, capsys):
    try:
        status = main([*options, "--out", str(tmp_path / "run")])
    except SystemExit as end:
        status = end.code
    error = capsys.readouterr().err
    assert status == 2
    assert message in error
