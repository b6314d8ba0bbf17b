"""Pages that are made from the code are what the code says, and their programs run."""

import csv
import importlib
import json
import os
import pkgutil
import re
import runpy
from collections import Counter
from pathlib import Path

import _docs_pages
import cards
import make_scene_reference
import numpy as np
import pytest
import yaml
from waiting import ran_python

from radalt.bench.board import stored_rows
from radalt.bench.lists import load_list
from radalt.bench.rows import read_rows
from radalt.bench.views import summaries
from radalt.core.altimeter.altimeter import Altimeter, Reason
from radalt.core.returns.point import point_return
from radalt.core.waveform import Waveform
from radalt.evaluation.results.break_point import break_point
from radalt.evaluation.results.proportion import clopper_pearson, wilson_interval
from radalt.evaluation.results.rows import Columns
from radalt.evaluation.results.score import CORRECT_LIMIT_M

ROOT = Path(__file__).resolve().parent.parent
LINK = re.compile(r"\]\((?:([\w-]+)\.md)?(?:#([\w-]+))?\)")  # to a page, its heading, or a heading here


def test_the_scene_reference_is_what_the_code_gives():
    stored = make_scene_reference.PAGE.read_text(encoding="utf-8")
    assert stored == make_scene_reference.page(), "run: .venv/bin/python tools/make_scene_reference.py"


def test_the_first_flowgraph_measures_more_with_whitening_than_without(root):
    """QPSK at -28 dB over half the sweep: no mitigation loses frames, whitening next to none."""
    env = os.environ | {"PYTHONPATH": str(root / "python"), "GR_CONF_LOG_LOG_LEVEL": "warn"}
    done = ran_python(root / "examples/first_flowgraph.py", env=env)
    assert done.returncode == 0, done.stderr
    pattern = r"^(\w+) +(\d+) frames, declared (\d+), within 5 m (\d+)$"
    rows = {name: [int(n) for n in numbers] for name, *numbers in re.findall(pattern, done.stdout, re.M)}
    assert set(rows) == {"none", "whitening"}
    assert rows["none"][0] == rows["whitening"][0] == 120
    assert rows["none"][2] < 100 < rows["whitening"][2]


def test_own_samples_are_measured_from_the_altitude_of_the_first_sweeps(root, tmp_path):
    """A file that begins in flight at 500 m and climbs 120 m: altitudes of 500 m and 620 m, and reasons by name."""
    rng = np.random.default_rng(3)
    altitudes_m = np.repeat([500.0, 620.0], [60, 60])
    samples = point_return(Waveform(), altitudes_m).ravel()
    samples += 0.3 * rng.normal(size=(samples.size, 2)).view(complex).ravel()
    samples.astype(np.complex64).tofile(tmp_path / "samples.cf32")
    env = os.environ | {"PYTHONPATH": str(root / "python"), "GR_CONF_LOG_LOG_LEVEL": "warn"}
    done = ran_python(root / "examples/own_samples.py", tmp_path / "samples.cf32", "500", env=env)
    assert done.returncode == 0, done.stderr
    count, first, last = re.search(r"(\d+) altitudes from ([\d.]+) m to ([\d.]+) m", done.stdout).groups()
    assert int(count) > 100 and abs(float(first) - 500) < 5 and abs(float(last) - 620) < 5
    assert f"{count} frames ok" in done.stdout
    done = ran_python(root / "examples/own_samples.py", tmp_path, env=env)
    assert done.returncode == 2 and done.stderr.startswith("usage: own_samples.py FILE ")  # of a folder
    done = ran_python(root / "examples/own_samples.py", tmp_path / "none.cf32", env=env)
    assert done.returncode == 2 and done.stderr.splitlines()[-1].endswith("none.cf32: can't open file")


def test_every_reason_is_on_the_page_and_in_the_companion(root):
    page = (root / "docs/your-own.md").read_text(encoding="utf-8")
    block = (root / "grc/radalt_altimeter_sink.block.yml").read_text(encoding="utf-8")
    for number, name in enumerate(Reason.NAMES):
        assert f"| {number} | `{name}` |" in page and f"{number} {name}" in block


def test_every_shipped_scene_is_named_on_the_page_of_scenes(root):
    named = set(re.findall(r"`(\w+)`", (root / "docs/interference.md").read_text(encoding="utf-8")))
    assert {file.stem for file in (root / "flowgraphs/scenes").glob("*.yaml")} <= named


@pytest.fixture(scope="module")
def site(root):
    return yaml.safe_load((root / "mkdocs.yml").read_text(encoding="utf-8"))


def test_every_page_is_in_the_site_once(root, site):
    named = re.findall(r"- (?:\w+: )?([\w./-]+\.md)$", (root / "mkdocs.yml").read_text(), re.MULTILINE)
    named += [f"{file}.md" for files in site["extra"]["pages"].values() for file in files[1:]]
    assert sorted(named) == sorted(
        str(page.relative_to(root / "docs").with_suffix(".md"))
        for kind in ("*.md", "*.ipynb")
        for page in (root / "docs").rglob(kind)
    )


def test_links_to_a_section_lead_to_its_only_heading(root, site):
    """In the pages put together, and in those that link to them; code is left as it is."""
    pages = site["extra"]["pages"]
    sections = {file for files in pages.values() for file in files[1:]}
    texts = {path.stem: path.read_text(encoding="utf-8") for path in (root / "docs").glob("*.md")}
    made = {name: text for name, text in texts.items() if name not in sections}
    made |= {
        files[0]: _docs_pages.page_text(title, {f: texts[f] for f in files}) for title, files in pages.items()
    }
    made = {name: _docs_pages.with_links(text, pages) for name, text in made.items()}
    anchors = {}
    for name, text in made.items():
        headings = re.findall(r"^#+ (.*)$", re.sub(r"^```.*?^```", "", text, flags=re.M | re.S), re.MULTILINE)
        found = [re.search(r"{#([\w-]+)}|$", head)[1] or _docs_pages.anchor(head) for head in headings]
        assert len(set(found)) == len(found), name
        anchors[name] = found
    links = [(at or name, to) for name, text in made.items() for at, to in LINK.findall(text)]
    assert not sections & {at for at, _ in links}
    assert not [(at, to) for at, to in links if to and to not in anchors[at]]
    assert ("tracker", "integrity-words") in links and ("results", "studies") in links
    assert "\n# a comment\n" in _docs_pages.section("part", "# Part\n\n```\n# a comment\n```\n")


def test_a_models_card_says_what_the_published_rows_say(root):
    models = root / "models"
    for stem in cards.STEMS:
        text = (models / f"{stem}.md").read_text(encoding="utf-8")
        made = cards.card(stem, models, cards.results_of(stem), cards.time_of(text))
        assert made == text, "run: PYTHONPATH=python .venv/bin/python training/cards.py"


def test_the_papers_table_is_that_of_its_rows(root):
    """All three of the paper's networks find a clean altitude in nine frames of ten."""
    line = re.search(r"^\| Pd, no interference \|(.*)\|$", (root / "docs/tcae.md").read_text("utf-8"), re.M)
    clean = {r["method"]: r["pd"] for r in cards.paper_rows() if r["interferer"] == "clean clean"}
    names = ("none", "lms_reference_input", "fc", "cnn", "paper", "tcae")  # columns of the table
    assert [cell.strip() for cell in line[1].split("|")] == [f"{clean[name]:.2f}" for name in names]
    assert all(clean[name] >= 0.9 for name in ("fc", "cnn", "paper"))


def _false_in_noise(rows):
    """False altitudes of no mitigation on both lists, their share, its interval and the bound by design, in percent."""
    both = (*rows, *read_rows(stored_rows("null")))
    mine = [r for r in both if (r["case"], r["entry"]) == ("noise", "none")]
    false, trials = (sum(int(r[key]) for r in mine) for key in ("detections", "trials"))
    shares = [f"{100 * share:.1f}" for share in (false / trials, *clopper_pearson(false, trials))]
    return [str(false), f"{trials:,}", *shares, f"{100 * Altimeter(Waveform()).false_alarms_per_frame:.2f}"]


def _break_point(rows, **where):
    mine = [r for r in rows if all(r[key] == value for key, value in where.items())]
    return break_point(*([float(r[key]) for r in mine] for key in ("sir_db", "pd", "pd_low", "pd_high")))


def _break_points(rows):
    """Of a 10 MHz downlink behind the canceller, at EVM 3 and 8 %."""
    return [str(_break_point(rows, case=case, entry="ofdm_cancel")) for case in ("evm_3", "evm_8")]


def _to_whitening(rows):
    """Most by which the network's break-point is higher and lower than whitening's, QPSK as received, full overlap."""
    gains_db = [
        _break_point(rows, case=case, overlap="1", entry="whitening").sir_db
        - _break_point(rows, case=case, overlap="1", entry="tcae").sir_db
        for case in {r["case"] for r in rows if r["case"].endswith("qpsk")}
    ]
    return [f"{-min(gains_db):.1f}", f"{max(gains_db):.1f}"]


def _cpu_ratios(rows):
    """Least and largest over the scenes: median with all built over median pruned."""
    median = {
        (scene, built): np.median(
            [float(r["cpu_s"]) for r in rows if (r["scene"], r["built"]) == (scene, built)]
        )
        for scene, built in {(r["scene"], r["built"]) for r in rows}
    }
    ratios = [median[scene, "all"] / value for (scene, built), value in median.items() if built == "pruned"]
    return [f"{end(ratios):.0f}" for end in (min, max)]


def _verdicts(rows):
    counts = Counter(r["verdict"] for r in rows)
    return [str(len(rows)), *(str(counts[name]) for name in ("pass", "refused", "flagged", "WRONG", "FAIL"))]


def _break_points_at_200_ft(rows):
    """Three altimeters under 5G at 3.93 GHz, and how far that is below Table 1."""
    keys = "interferer", "method", "altitude_ft"
    mine = [r for r in rows if [r[key] for key in keys] == ["nr100_3930", "none", "200"]]
    return [f"{float(r['break_dbm']):.1f}" for r in mine] + [f"{-float(r['margin_db']):.0f}" for r in mine]


def _shares_within_5_m(rows, overlap="0", method="none"):
    """Of frames of an approach, and its interval."""
    mine = [r for r in rows if (r["overlap"], r["method"]) == (overlap, method)]
    errors = [abs(float(r["altitude_m"] or "nan") - float(r["height_m"])) for r in mine]
    correct = sum(error < CORRECT_LIMIT_M for error in errors)
    return [correct / len(mine), *wilson_interval(correct, len(mine))]


def _under_and_without_qpsk(rows):
    """Right frames of 200 without mitigation, behind tcae, and without interference."""
    where = (("1", "none"), ("1", "tcae"), ("0", "none"))
    return [f"{200 * _shares_within_5_m(rows, *each)[0]:.0f}" for each in where]


def _what_guarding_costs(rows):
    """Availability after the start, without mitigation and behind tcae."""
    at = {
        (r["kind"], r["method"]): f"{float(r['after_start']):.2f}".removeprefix("0")
        for r in rows
        if r["known_limit"] == "0"
    }
    kinds = ("jammed", "land_jammed", "step", "altimeter", "pull_off")
    return [at[kind, method] for kind in kinds for method in ("none", "tcae")]


@pytest.mark.parametrize(
    ("pages", "pattern", "table", "value"),
    [
        (
            "docs/detection.md",
            r"altitude in (\d+) of ([\d,]+) frames, ([\d.]+) %.*?\(([\d.]+) to ([\d.]+) %, .*? at most ([\d.]+) %",
            "detection",
            _false_in_noise,
        ),
        ("docs/cancellation.md", r"to (-[\d.]+) dB at an .*?to (-[\d.]+) dB at 8 %", "evm", _break_points),
        ("docs/sweeps.md", r"([\d.]+) dB higher.*?([\d.]+) dB lower", "sweeps", _to_whitening),
        ("docs/leaving_out.md", r"takes (\d+) to (\d+) times the CPU", "leaving_out", _cpu_ratios),
        ("docs/stability.md", r"Of (\d+) pairs of case and chain" + r"\D+(\d+)" * 5, "stability", _verdicts),
        (
            "docs/tolerance.md",
            r"breaks our three[^*]*? at ([\d.]+), ([\d.]+) and (-[\d.]+) dBm: (\d+), (\d+) and (\d+) dB below",
            "tolerance",
            _break_points_at_200_ft,
        ),
        (
            "docs/landing.md",
            r"\*\*Extended ground.*?(\d+) %.*?\((\d+) to (\d+) %\)",
            "landing_approach",
            lambda rows: [f"{100 * share:.0f}" for share in _shares_within_5_m(rows)],
        ),
        (
            "README.md docs/index.md",
            r"of 200 frames (\d+) are right without mitigation, (\d+).*?and (\d+) without",
            "range_time",
            _under_and_without_qpsk,
        ),
        (
            "docs/tracker.md",
            "costs availability.*?" + r"\| ([\d.]+) \| ([\d.]+) \|.*?" * 5,
            "integrity_kinds",
            _what_guarding_costs,
        ),
    ],
)
def test_the_first_number_of_a_page_is_that_of_its_table(root, pages, pattern, table, value):
    stored = root / f"bench/rows/{table}.csv"
    file_of = stored if stored.is_file() else root / f"docs/data/{table}.csv"
    with file_of.open(newline="", encoding="utf-8") as file:
        expected = value(list(csv.DictReader(file)))
    for page in pages.split():
        found = re.search(pattern, (root / page).read_text(encoding="utf-8"), re.DOTALL)
        assert found and list(found.groups()) == expected, page


def _packed(page):
    return "".join(page.read_text("utf-8").split())


def _groups(root, table, by, where):
    """Rows that have the values of ``where``, by the columns ``by``, as numbers, summed; `wrong` from the others."""
    groups = {}
    with (root / table).open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if all(row[key] in values for key, values in where.items()):
                found = {k: float(v) for k, v in row.items() if re.fullmatch(r"-?[\d.]+(e-?\d+)?", v)}
                found["wrong"] = found.get("detections", 0) - found.get("correct", 0)
                groups.setdefault(" ".join(row[key] for key in by) or "all", Counter()).update(found)
    return groups


@pytest.mark.parametrize("place", yaml.safe_load((ROOT / "tests/numbers.yaml").read_text("utf-8")))
def test_sentences_give_the_numbers_of_their_rows(root, place):
    if place["table"] == "standard":
        rows = read_rows(stored_rows("standard"))
        found = summaries(rows, list(dict.fromkeys(row["entry"] for row in rows)))
    else:
        found = _groups(root, place["table"], place["by"], place.get("where", {}))
    page = _packed(root / place["page"])
    for text in place["texts"]:
        assert "".join(text.format(r=found).split()) in page, text.format(r=found)


def test_the_table_of_cases_of_the_canceller_is_that_of_its_rows(root):
    page, rows = _packed(root / "docs/cancellation.md"), read_rows(stored_rows("evm"))
    for case in load_list("evm").cases:
        mine = [r for r in rows if (r["case"], r["overlap"]) == (case.name, case.overlap)]
        by = {name: [r for r in mine if r["entry"] == name] for name in {r["entry"] for r in mine}}
        best = by["qpsk_cancel" if case.name == "qpsk" else "ofdm_cancel"]
        ends = [_break_point(by_entry) for by_entry in (by["none"], best)]
        pd = {r["sir_db"]: f"{r['pd']:.2f}" for r in best}
        wrong = sum(r["detections"] - r["correct"] for r in best)
        cells = [*ends, *(pd.get(at, "") for at in (-30, -40, -45, -50)), wrong]
        line = "|".join(map(str, ["", case.title.replace("part", f"{case.overlap:g}"), *cells, ""]))
        assert "".join(line.split()) in page, line


def test_every_column_of_a_table_is_in_the_dictionary(root):
    """Of the files of the pages, the stored rows of the bench, and the tables of every study."""
    names = re.findall(r"^\| (.*?) \|", (root / "docs/columns.md").read_text(encoding="utf-8"), re.MULTILINE)
    files = [*(root / "docs/data").glob("*.csv"), *(root / "bench/rows").glob("*.csv")]
    found = {head for path in files for head in path.read_text(encoding="utf-8").split("\n", 1)[0].split(",")}
    for room in ("bench", "evaluation.overlap", "studies"):
        package = importlib.import_module(f"radalt.{room}")
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            for value in vars(importlib.import_module(module.name)).values():
                tables = value.values() if isinstance(value, dict) else [value]
                found |= {name for table in tables if isinstance(table, Columns) for name in table.names}
    assert set(re.findall(r"`([\w.]+)`", " ".join(names))) == {head.strip() for head in found}


def anchors(page) -> set[str]:
    """The anchors of a page's headings, as MkDocs and GitHub make them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def test_every_link_leads_to_a_file_and_a_heading(root):
    """As `make docs` checks those of the site, which needs MkDocs; README and the models' cards besides."""
    for page in [*root.glob("*.md"), *(root / "docs").rglob("*.md"), *(root / "models").glob("*.md")]:
        text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        for link, anchor in re.findall(r"\]\(([^)#:\s]*)(?:#([\w-]*))?\)", text):
            target = page.parent / link if link else page
            assert target.exists(), f"{page.name}: {link}"
            assert not anchor or anchor in anchors(target), f"{page.name}: {link}#{anchor}"


def test_every_test_of_the_safety_case_exists(root):
    """`file::test`, or `::test` of the file named before."""
    found = re.findall(r"`(\w+\.py)?::(\w+)`", (root / "docs/hardware.md").read_text(encoding="utf-8"))
    assert len(found) > 30
    named = None
    for file, test in found:
        named = file or named
        assert f"def {test}(" in (root / "tests" / named).read_text(encoding="utf-8"), f"{named}::{test}"


BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
SNIPPETS = {
    f"{page.stem} {number}": code
    for page in [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("models/*.md")]
    for number, code in enumerate(BLOCK.findall(page.read_text(encoding="utf-8")))
    # the former is an example of its own, the latter one of a package's modules (test_extending)
    if "FirstFlowgraph" not in code and "from .study" not in code
}

NOTEBOOK = json.loads((ROOT / "docs/notebook.ipynb").read_text(encoding="utf-8"))["cells"]
SNIPPETS["notebook"] = "\n".join("".join(c["source"]) for c in NOTEBOOK if c["cell_type"] == "code")


@pytest.mark.parametrize("name", SNIPPETS)
def test_a_snippet_runs_as_a_file_as_printed(name, tmp_path, monkeypatch, capfd):
    for module in re.findall(r"\b(onnx|torch)\b", SNIPPETS[name]):
        pytest.importorskip(module)
    (tmp_path / "snippet.py").write_text(SNIPPETS[name], encoding="utf-8")
    if "__main__" in SNIPPETS[name]:  # its workers import it
        env = os.environ | {"PYTHONPATH": str(ROOT / "python"), "OMP_NUM_THREADS": "1"}
        done = ran_python("snippet.py", cwd=tmp_path, env=env)
        assert (done.returncode, done.stderr) == (0, "")
        return
    monkeypatch.chdir(tmp_path)
    runpy.run_path("snippet.py", run_name="__main__")
    said = capfd.readouterr()
    assert said.err == ""
    if name == "notebook":
        stored = [text for c in NOTEBOOK for out in c.get("outputs", ()) for text in out.get("text", ())]
        assert said.out == "".join(stored), "run: jupyter nbconvert --execute --inplace docs/notebook.ipynb"


@pytest.mark.parametrize(
    "page, program", [("flowgraphs", "examples/first_flowgraph.py"), ("your-own", "flowgraphs/own_method.py")]
)
def test_a_program_that_a_page_shows_is_the_one_that_runs(root, page, program):
    """Written out, since the page is read on the disk and on the web, too, where nothing puts a file into it."""
    text = (root / f"docs/{page}.md").read_text(encoding="utf-8")
    shown = BLOCK.search(text)[1]
    source = (root / program).read_text(encoding="utf-8")
    assert shown == source[source.index("import numpy") :]
