"""Result folders, reports, figures and pooling, from rows that were made by hand."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
from pages import assert_whole
from waiting import ran

from radalt.core.interference import Interferer, QpskEmitter
from radalt.core.mitigation import CUSTOM
from radalt.core.mitigation import METHODS as MITIGATIONS
from radalt.core.scene import Scene, SweepSpec, parse_scene, scene_to_mapping
from radalt.evaluation.engine.study import Run
from radalt.evaluation.overlap.figures import draw_pd
from radalt.evaluation.overlap.finding import said_of_pd
from radalt.evaluation.overlap.markdown import against, verdict
from radalt.evaluation.overlap.points import OverlapPoint, point_seed, sweep_points
from radalt.evaluation.overlap.pooling import collect
from radalt.evaluation.overlap.reading import PoolError
from radalt.evaluation.overlap.report import break_points, build_report, write_report
from radalt.evaluation.overlap.rows import COLUMNS, make_row
from radalt.evaluation.results.folder import SCHEMA, FolderError, RunFolder, read_report
from radalt.evaluation.results.proportion import wilson_interval
from radalt.evaluation.results.rows import bits
from radalt.evaluation.results.score import Score
from radalt.evaluation.results.style import series_style
from radalt.evaluation.results.table import table

METHODS = {"none": {}, "tcae": {"model": "m.onnx", "sha256": "ab" * 32, "placeholder": False}}


def scene_of(**changes):
    scene = Scene(
        name="case",
        interference=(Interferer(QpskEmitter()),),
        methods=tuple(METHODS),
        sweep=SweepSpec(overlap=(0.0, 0.5, 1.0), sir_db=(-10.0, -28.0)),
    )
    return replace(scene, **changes)


def correct_of(method, point, trials):
    """A made-up law: the stronger and longer the interference, the fewer."""
    loss = point.overlap * max(0.0, -point.sir_db - 12.0) / 20.0
    return round(trials * (1 - loss) if method == "none" else trials * (1 - loss / 4))


def rows_of(scene, batches=1):
    """A row per point and method; ``batches`` times the trials of each point with interference."""
    out = []
    for point in sweep_points(scene):
        trials = scene.altitude.programme.trial_frames * (batches if point.overlap else 1)
        for method in scene.methods:
            correct = correct_of(method, point, trials)
            squared = 0.04 * trials + 1e4 * (trials - correct)
            s = Score(trials, trials, correct, trials, 0, 0, squared, 0.1, 0.04 * trials)
            seed = point_seed(scene.seed, point)
            found = s.row() | {"right": bits(np.arange(trials) < correct)}
            timing = {"ms_per_frame": np.full(5, 0.2), "real_time_factor": 1.5}
            where = (method, scene.interference_name, point, seed, found)
            out.append(make_row(*where, diverged_frames=0, segmenter={}, **timing))
    return out


def test_the_report_begins_with_the_best_method_and_what_it_is_paired_with():
    """Ten frames apart of a hundred, and one, which is within the interval."""
    right = {"none": 90, "whitening": 99, "tcae": 100}
    rows = []
    for method, count in right.items():
        s = Score(100, 100, count, 100, 0, 0, 4.0, 0.1, 4.0)
        found = s.row() | {"right": bits(np.arange(100) < count)}
        where = (method, "qpsk", OverlapPoint.at(1.0, -28, 10), 1, found)
        more = {"ms_per_frame": np.ones(3), "real_time_factor": 1.0}
        rows.append(make_row(*where, diverged_frames=0, segmenter={}, **more))
    text = verdict(rows, "simulated", {"bandwidth_hz": 7.5e6})
    assert text.startswith(
        "**`tcae` and `whitening` are right most often: Pd 1.000 and 0.990; none 0.900** over "
    )
    assert "above 0, `tcae` 0.100 (0.041 to 0.159) above `none` on the same 100 frames. Most" in text
    assert "Most wrong and valid: `none`, 10 of 100" in text
    tied = [row | {"method": name} for row in rows if row["method"] == "none" for name in ("none", "as none")]
    assert "valid: every method, 10 of 100" in verdict(tied, "simulated", {"bandwidth_hz": 7.5e6})
    assert "valid: `none` and `as none`, 10" in verdict(
        [*rows, tied[1]], "simulated", {"bandwidth_hz": 7.5e6}
    )
    twin = [row | {"method": "twin"} for row in rows if row["method"] == "tcae"]
    assert "| tcae | twin | 100 | no frame differs |" in against([*rows, *twin], "tcae")
    assert "|---|---|---:|" in table("case | cause | count", [["a", "", 1], ["b", "", 2]])


def finished(path, scene, methods=METHODS, *, whole=False, batches=1):
    """A result folder as ota_eval leaves it; figures and report.md only if it is to be whole."""
    folder = RunFolder(path, head_of(scene, methods))
    rows = rows_of(scene, batches)
    run = Run(jobs=2, points=6, points_resumed=0, wall_s=1.0, peak_memory_bytes=1 << 20)
    if whole:
        write_report(folder, scene, {"rows": rows}, run)
    else:
        folder.write_report(build_report(folder.head, scene, {"rows": rows}, run))
    folder.close()
    return path


def head_of(scene, methods=METHODS):
    head = {"study": "OverlapStudy", "source": "simulated", "scene": scene_to_mapping(scene)}
    return head | {"methods": methods, "versions": {"radalt": "0"}}


def test_a_point_without_a_frame_has_no_pd_in_any_report(tmp_path, undrawn):
    """All was measured at -10 dB; at -28 dB the timing was not acquired."""
    scene = scene_of()
    lost = Score(frames_lost=scene.altitude.programme.trial_frames)
    rows = []
    points = [point for point in sweep_points(scene) for _ in scene.methods]
    for row, point in zip(rows_of(scene), points, strict=True):
        if row["sir_db"] == -28 and row["overlap"]:
            labels = (row["method"], row["interference"], point, row["seed"])
            timing = {"ms_per_frame": np.zeros(0), "real_time_factor": 1.5}
            row = make_row(*labels, lost.row(), diverged_frames=0, segmenter={}, **timing)
            assert row["pd"] is None and row["trials"] == 0
        rows.append(row)
    folder = RunFolder(tmp_path / "a", head_of(scene))
    run = Run(jobs=1, points=6, points_resumed=0, wall_s=1.0, peak_memory_bytes=1 << 20)
    write_report(folder, scene, {"rows": rows}, run)
    folder.close()
    text = (tmp_path / "a" / "report.md").read_text(encoding="utf-8")
    assert "Points without a frame never acquired the timing; they have no Pd (–)." in text
    page, _ = collect([tmp_path / "a"], tmp_path / "all")
    assert "| 1 | 0 | – | – |" in page.read_text(encoding="utf-8")


def test_rows_of_another_seed_do_not_hold(tmp_path):
    """Somebody copied the journal: same points, same columns, whole lines."""
    for name, seed in (("a", 1), ("b", 2)):
        folder = RunFolder(tmp_path / name, head_of(scene_of(seed=seed)))
        folder.add("a", rows_of(scene_of(seed=seed))[:2])
        folder.close()
    journal = tmp_path / "a" / "points.jsonl"
    journal.write_bytes((tmp_path / "b" / "points.jsonl").read_bytes())
    again = RunFolder(tmp_path / "a", head_of(scene_of()), resume=True)
    assert again.done == {} and again.rejected == [f"{journal}:1"]


@pytest.mark.parametrize("name", ["report.md", "scene.yaml", "rows.csv", "thesis.tex"])
@pytest.mark.parametrize("resume", [False, True])
def test_a_folder_with_somebodys_own_files_is_refused_and_left_alone(tmp_path, name, resume):
    (tmp_path / name).write_text("mine", encoding="utf-8")
    with pytest.raises(FolderError, match=f"no run of ours \\({name}\\); name a new or an empty folder"):
        RunFolder(tmp_path, head_of(scene_of()), resume=resume)
    assert (tmp_path / name).read_text(encoding="utf-8") == "mine"
    assert not (tmp_path / "run.json").exists()


def test_two_writers_on_one_folder_are_one_too_many(tmp_path):
    first = RunFolder(tmp_path, head_of(scene_of()))
    with pytest.raises(FolderError, match="another process writes into"):
        RunFolder(tmp_path, head_of(scene_of()), resume=True)
    first.close()
    RunFolder(tmp_path, head_of(scene_of()), resume=True)


@pytest.mark.parametrize(
    "change, key",
    [
        ({"seed": 2}, "scene.seed is 1 there and 2 here"),
        ({"sweep": SweepSpec(overlap=(0.0, 0.5, 1.0), sir_db=(-10.0,))}, "scene.sweep.sir_db"),
        ({"interference": (Interferer(QpskEmitter(pulse="rrc")),)}, "scene.interference"),
        ({"methods": METHODS | {"tcae": METHODS["tcae"] | {"sha256": "cd" * 32}}}, "methods.tcae.sha256"),
        ({"versions": {"radalt": "0", "numpy": "2.2.4"}}, "versions.numpy is None there and '2.2.4' here"),
    ],
)
def test_resume_refuses_another_scene_model_or_version_and_names_the_difference(tmp_path, change, key):
    finished(tmp_path / "a", scene_of())
    of_head = change.keys() & {"methods", "versions"}
    head = head_of(scene_of()) | change if of_head else head_of(scene_of(**change))
    with pytest.raises(FolderError, match=key):
        RunFolder(tmp_path / "a", head, resume=True)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return finished(tmp_path_factory.mktemp("page") / "run", scene_of(), whole=True)


def test_the_report_says_all_that_it_has_to(whole):
    report = read_report(whole)
    assert report["schema"] == SCHEMA and report["seed"] == 1
    assert parse_scene(report["scene"]) == scene_of()
    needed = (
        "method interference overlap sir_db snr_db trials detections correct pd pd_low pd_high rmse_detected_m "
        "rmse_forced_m bias_m ms_per_frame_median ms_per_frame_p99"
    ).split()
    assert len(report["rows"]) == 12
    for row in report["rows"]:
        assert set(needed) <= set(row) and set(row) == set(COLUMNS.names)
        interval = wilson_interval(row["correct"], row["trials"])
        assert (row["pd_low"], row["pd_high"]) == pytest.approx(interval)
    assert {r["method"] for r in report["ceiling"]} == set(METHODS) and len(report["ceiling"]) == 2
    assert 0.01 < report["bounds"][0]["altitude_crb_m"] < 0.1  # 10 dB SNR: about 3 cm
    for name in report["figures"]:
        assert (whole / name).read_bytes().startswith(b"\x89PNG")
    text = (whole / "report.md").read_text(encoding="utf-8")
    for part in ("SIR \N{MINUS SIGN}28 dB", "95 % Wilson", "Cram", "left out", "m.onnx", "real-time factor"):
        assert part in text
    assert "placeholder" not in text


def test_a_placeholder_model_is_said_and_names_from_a_scene_stay_text(tmp_path, undrawn):
    methods = METHODS | {"tcae": METHODS["tcae"] | {"placeholder": True}}
    out = finished(tmp_path / "a", scene_of(name="<b>&case"), methods, whole=True)
    text = (out / "report.md").read_text(encoding="utf-8")
    assert "The model of tcae (m.onnx) is a placeholder" in text and "never came out" not in text
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "<b>&case" not in page and "&lt;b&gt;&amp;case" in page


def test_break_points_are_interpolated_and_gains_are_against_none():
    scene = scene_of(sweep=SweepSpec(overlap=(0.0, 1.0), sir_db=(-10.0, -13.0, -16.0, -20.0, -28.0)))
    found = {e["method"]: e for e in break_points(rows_of(scene))}
    # made-up law at full overlap: none loses (|SIR| - 12)/20, tcae a quarter of that, so 0.9 at -14 and -20 dB
    assert found["none"]["sir_db"] == pytest.approx(-14.0, abs=0.05) and found["none"]["mark"] == ""
    assert found["none"]["high_db"] > found["none"]["sir_db"] > found["none"]["low_db"]
    assert found["tcae"]["sir_db"] == pytest.approx(-20.0, abs=0.2)
    assert found["tcae"]["protection_gain_db"] == pytest.approx(6.0, abs=0.2)
    only_bad = [r for r in rows_of(scene) if r["sir_db"] < -14 and r["method"] == "none"]
    assert break_points(only_bad)[0]["text"] == "\N{GREATER-THAN OR EQUAL TO} -16.0"
    assert break_points(rows_of(scene_of())) == []  # two SIRs say too little


def test_every_method_is_named_in_the_figure_and_no_name_covers_another(tmp_path):
    rows = [row for row in rows_of(scene_of()) if row["sir_db"] == -28 and row["method"] == "none"]
    many = [row | {"method": m, "pd": row["pd"] - k / 30} for k, m in enumerate(MITIGATIONS) for row in rows]
    figure = draw_pd(many, tmp_path / "x.png", settings="one")
    texts = [text for text in figure.axes[0].texts if text.get_text()]
    assert sorted(text.get_text().replace("\n", "") for text in texts) == sorted(MITIGATIONS)
    boxes = [text.get_window_extent() for text in texts]
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2)) and not figure.legends
    assert all(0 <= box.x0 and box.x1 <= figure.bbox.width for box in boxes)


def test_a_title_says_who_leads_or_that_nobody_does():
    rows = rows_of(scene_of())
    assert said_of_pd(rows) == "tcae is right most often: Pd 0.925; none 0.700"
    assert said_of_pd([r for r in rows if not r["overlap"]]) == "none and tcae do not differ: Pd 1.000"
    swept = rows_of(scene_of(sweep=SweepSpec(overlap=(0.0, 1.0), sir_db=(-10.0, -13.0, -16.0, -20.0, -28.0))))
    title = said_of_pd(swept, "sir_db").replace("\N{MINUS SIGN}", "-")
    assert title == "tcae holds Pd 0.9 down to -20 dB; none to -14 dB"
    weak = [r | {"pd": 0.6, "pd_high": 0.7} for r in swept]
    assert said_of_pd(weak, "sir_db").startswith("No method holds Pd 0.9. No method differs: Pd 0.5 down to")


def test_counts_of_independent_runs_are_added_and_the_interval_taken_anew(tmp_path):
    a, b = finished(tmp_path / "a", scene_of()), finished(tmp_path / "b", scene_of(seed=2))
    _, notes = collect([a, b], tmp_path / "all")
    pooled = json.loads((tmp_path / "all" / "report.json").read_text(encoding="utf-8"))["rows"]
    assert notes == [] and len(pooled) == 12
    for row, single in zip(pooled, read_report(a)["rows"], strict=True):
        assert (row["runs"], row["trials"], row["correct"]) == (2, 300, 2 * single["correct"])
        assert (row["pd_low"], row["pd_high"]) == pytest.approx(wilson_interval(row["correct"], 300))
        assert row["rmse_detected_m"] == pytest.approx(single["rmse_detected_m"])
    assert (tmp_path / "all" / "pd_vs_overlap.png").stat().st_size > 10_000


def test_methods_of_two_folders_are_compared_on_the_frames_of_both(tmp_path, undrawn):
    """Equal seeds are equal frames; by the made-up law 30 of 150 are right without mitigation, 120 behind tcae."""
    a = finished(tmp_path / "a", scene_of(methods=("none",)), {"none": {}})
    one = scene_of(methods=("tcae",), sweep=SweepSpec(overlap=(0.0, 1.0), sir_db=(-28.0,)))
    b = finished(tmp_path / "b", one, {"tcae": METHODS["tcae"]})
    page, _ = collect([a, b], tmp_path / "all", method="none")
    text = page.read_text(encoding="utf-8")
    assert "`tcae` is right most often: Pd 0.800; none 0.200** over the points that every method has" in text
    assert len(read_report(tmp_path / "all")["rows"]) == 6 + 2
    assert "| none | tcae | 150 | -0.600 (-0.678 to -0.522) |" in text
    assert "| tcae | not measured | not measured | not measured | not measured | 0.800" in text
    with pytest.raises(PoolError, match="--against 'lms': no such method in the runs; there are none, tcae"):
        collect([a, b], tmp_path / "all", method="lms")


def test_a_longer_run_of_one_seed_is_not_independent(tmp_path):
    """Its first trials are those of the shorter one."""
    a, b = finished(tmp_path / "a", scene_of()), finished(tmp_path / "b", scene_of(), batches=3)
    with pytest.raises(PoolError, match="150 trials in the one and 450 in the other.*another --seed"):
        collect([a, b], tmp_path / "all")


def test_a_run_that_occurs_twice_counts_once(tmp_path, undrawn):
    a, b = finished(tmp_path / "a", scene_of()), finished(tmp_path / "b", scene_of())
    _, notes = collect([a, b, a], tmp_path / "all")
    pooled = json.loads((tmp_path / "all" / "report.json").read_text(encoding="utf-8"))["rows"]
    assert {r["trials"] for r in pooled} == {150}
    assert len(notes) == 1 and "repeats 12 rows" in notes[0]


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda s: {"waveform": replace(s.waveform, carrier_hz=4.25e9)}, "waveform.carrier_hz"),
        (lambda s: {"altimeter": replace(s.altimeter, pfa_per_frame=1e-3)}, "is 0.0155 in the one, 0.001"),
        (lambda s: {"altitude": replace(s.altitude, programme_m=(50.0,))}, "altitude.programme_m"),
        (lambda s: {"method_options": {"tcae": {"threads": 2}}}, "method_options.tcae"),
        (lambda s: {}, "methods.tcae.sha256"),
    ],
)
def test_what_is_not_comparable_is_refused_with_folders_key_and_values(tmp_path, change, key):
    scene = scene_of(seed=2)
    methods = METHODS | {"tcae": METHODS["tcae"] | {"sha256": "cd" * 32}} if "sha256" in key else METHODS
    a = finished(tmp_path / "a", scene_of())
    b = finished(tmp_path / "b", replace(scene, **change(scene)), methods)
    with pytest.raises(PoolError, match=key) as caught:
        collect([a, b], tmp_path / "all")
    assert all(str(folder) in str(caught.value) for folder in (a, b)) and "\n" not in str(caught.value)
    assert not (tmp_path / "all").exists()


def edit(path, **changes):
    report = read_report(path) | changes
    (path / "report.json").write_text(json.dumps(report), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"title": "\ud800"}, "title is"),
        ({"title": "x" * 2_000_000}, "title is"),
        ({"title": "<script>alert(1)</script>"}, "title is"),
        ({"created": "\x1b[2J"}, "created is"),
        ({"versions": {"radalt": "<b>"}}, "versions holds 'radalt': '<b>'"),
        ({"rows": []}, "no row with a trial"),
    ],
    ids=["surrogate", "2 MB", "markup", "escape", "version", "no row"],
)
def test_a_strangers_text_that_no_page_can_show_is_refused(tmp_path, changes, message):
    with pytest.raises(PoolError, match=message) as caught:
        collect([edit(finished(tmp_path / "a", scene_of()), **changes)], tmp_path / "all")
    assert len(str(caught.value)) < 600 and str(caught.value).isprintable()


def test_other_schemas_unfinished_runs_and_other_files_are_refused(tmp_path, undrawn):
    with pytest.raises(PoolError, match="schema is 1, this program reads 2"):
        collect([edit(finished(tmp_path / "a", scene_of()), schema=1)], tmp_path / "all")
    RunFolder(tmp_path / "b", head_of(scene_of())).close()
    with pytest.raises(FolderError, match=r"not finished \(repeat its command with --resume\), or a replay"):
        collect([tmp_path / "b"], tmp_path / "all")
    with pytest.raises(FolderError, match="cannot be read"):
        collect([tmp_path / "nowhere"], tmp_path / "all")
    collect([finished(tmp_path / "c", scene_of())], tmp_path / "all")
    with pytest.raises(PoolError, match="itself a collected report"):
        collect([tmp_path / "all"], tmp_path / "again")


def test_simulated_and_real_runs_are_series_of_their_own(tmp_path, undrawn):
    a = finished(tmp_path / "a", scene_of())
    # the simulated channel says nothing about a run on the air
    noisy = replace(scene_of().channel, adc_bits=12)
    b = edit(finished(tmp_path / "b", scene_of(channel=noisy)), source="air")
    collect([a, b], tmp_path / "all")
    pooled = json.loads((tmp_path / "all" / "report.json").read_text(encoding="utf-8"))["rows"]
    assert len(pooled) == 24 and {r["runs"] for r in pooled} == {1}
    assert {r["series"] for r in pooled} == {"none", "tcae", "none, on the air", "tcae, on the air"}


def test_figures_are_the_same_bytes_for_the_same_rows_in_three_formats(whole, tmp_path):
    for folder in ("first", "again"):
        (tmp_path / folder).mkdir()
        draw_pd(read_report(whole)["rows"], tmp_path / folder / "pd.png", settings="one")
    for ending, start in (("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")):
        first, again = (tmp_path.joinpath(f, f"pd.{ending}").read_bytes() for f in ("first", "again"))
        assert first == again and first.startswith(start)


def test_figures_can_be_read_in_grey(whole):
    """Every series differs from every other in more than colour, whatever else is drawn."""
    methods = [*MITIGATIONS, CUSTOM]
    assert series_style("tcae", ["tcae"]) == series_style("tcae", methods)
    styles = [series_style(m, methods) for m in methods]
    told = [(s["marker"], s["linestyle"], s["markerfacecolor"] == "white") for s in styles]
    assert len(set(told)) == len(told)


@pytest.mark.parametrize("pair", [*itertools.combinations("none whitening blanking tcae hybrid".split(), 2)])
def test_colours_of_the_first_figures_differ_to_a_deuteranope(pair):
    """After G. M. Machado et al., IEEE Trans. Vis. Comput. Graph. 15, 2009; cube roots as in CIE L*a*b*."""
    seen = np.array([[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]])
    hexes = (series_style(name, [])["color"][1:] for name in pair)
    linear = (seen @ (np.frombuffer(bytes.fromhex(h), np.uint8) / 255) ** 2.2 for h in hexes)
    first, second = (np.cbrt(np.clip(values, 0, 1)) for values in linear)
    assert np.linalg.norm(first - second) > 0.2


def test_the_page_is_whole_sorts_its_tables_and_switches_a_method(whole, tmp_path, browser):
    assert_whole(whole / "report.md", browser)
    text = (whole / "report.html").read_text()
    for row in read_report(whole)["rows"]:
        assert f'<td data-value="{row["pd"]:.3f}">{row["pd"]:.3f} (' in text
    probe = """<script>
    [...document.querySelectorAll(".switches label")].find((l) => l.innerText.trim() === "tcae").click();
    const parts = [...document.querySelectorAll("svg [id='series tcae']")];
    document.body.dataset.hidden = parts.every((part) => part.style.display === "none");
    </script></body>"""
    page = tmp_path / "page.html"
    page.write_text(text.replace("</body>", probe))
    assert browser is None or 'data-hidden="true"' in ran(*browser, "--dump-dom", page.as_uri()).stdout
