"""Pages that are made from the code are what the code says, and their programs run."""

import csv
import importlib
import json
import os
import pkgutil
import re
import runpy
from functools import cache
from pathlib import Path

import _docs_pages
import cards
import make_scene_reference
import numpy as np
import pytest
import yaml
from waiting import ROOT, ran_python

from radalt.bench.board import stored_rows
from radalt.bench.lists import load_list
from radalt.bench.rows import read_rows
from radalt.bench.turns import TURN_COLUMNS
from radalt.bench.views import summaries
from radalt.core.altimeter.altimeter import Reason
from radalt.core.returns.point import point_return
from radalt.core.waveform import Waveform
from radalt.evaluation.results.break_point import break_point
from radalt.evaluation.results.proportion import clopper_pearson, clopper_pearson_bound, wilson_interval
from radalt.evaluation.results.rows import Columns
from radalt.evaluation.results.score import CORRECT_LIMIT_M

ENV = os.environ | {"PYTHONPATH": str(ROOT / "python"), "GR_CONF_LOG_LOG_LEVEL": "warn"}
LINK = re.compile(r"\]\((?:([\w-]+)\.md)?(?:#([\w-]+))?\)")  # to a page, its heading, or a heading here


# decibels, FFTs, per cent, milliseconds, shares of two digits or more, and counts of counts
MEASURED = re.compile(
    r"(?<![\w.])\d[\d.,]* (?:dB|FFTs?|%|ms)(?!\w)|(?<![\w.])0?\.\d\d+\b|\b\d[\d,]* of \d[\d,]*"
)
CONDITION = re.compile(
    r"(?:SIRs?|SI?NRs?|INR) (?:of )?-?[\d.]+(?: (?:to|and) -?[\d.]+)? dB|95 %|overlap [\d.]+"
)
DOCS = ROOT / "docs"
NUMBERS = yaml.safe_load((ROOT / "tests/numbers.yaml").read_text("utf-8"))
# every page but those that a command writes whole, or that have no results
PAGES = ["README.md", *(f"docs/{p.name}" for p in sorted((ROOT / "docs").glob("*.md")))]
PAGES = [p for p in PAGES if Path(p).stem not in ("integrity", "stability", "leaving_out", "scene-reference")]


def test_the_scene_reference_is_what_the_code_gives():
    stored = make_scene_reference.PAGE.read_text(encoding="utf-8")
    assert stored == make_scene_reference.page(), "run: .venv/bin/python tools/make_scene_reference.py"


def test_the_first_flowgraph_measures_more_with_whitening_than_without(root):
    """QPSK at -28 dB over half the sweep: no mitigation loses frames, whitening next to none."""
    done = ran_python(root / "examples/first_flowgraph.py", env=ENV, check=True)
    pattern = r"^(\w+) +(\d+) frames, declared (\d+), within 5 m (\d+)$"
    rows = {name: [int(n) for n in numbers] for name, *numbers in re.findall(pattern, done.stdout, re.M)}
    assert {name: row[0] for name, row in rows.items()} == {"none": 120, "whitening": 120}
    assert rows["none"][2] < 100 < rows["whitening"][2]


def test_own_samples_are_measured_from_the_altitude_of_the_first_sweeps(root, tmp_path, monkeypatch, capfd):
    """A file that begins in flight at 500 m and climbs 120 m: altitudes of 500 m and 620 m, and reasons by name."""
    rng = np.random.default_rng(3)
    altitudes_m = np.repeat([500.0, 620.0], [60, 60])
    samples = point_return(Waveform(), altitudes_m).ravel()
    samples += 0.3 * rng.normal(size=(samples.size, 2)).view(complex).ravel()
    samples.astype(np.complex64).tofile(tmp_path / "samples.cf32")
    done = ran_python(root / "examples/own_samples.py", tmp_path / "samples.cf32", 500, env=ENV, check=True)
    count, first, last = re.search(r"(\d+) altitudes from ([\d.]+) m to ([\d.]+) m", done.stdout).groups()
    assert int(count) > 100 and abs(float(first) - 500) < 5 and abs(float(last) - 620) < 5
    assert f"{count} frames ok" in done.stdout
    # a folder has no end
    for name, said in ((".", "usage: own_samples.py FILE .*"), ("none.cf32", ".*none.cf32: can't open file")):
        monkeypatch.setattr("sys.argv", ["own_samples.py", str(tmp_path / name)])
        with pytest.raises(SystemExit, match="2"):
            runpy.run_path(str(root / "examples/own_samples.py"), run_name="__main__")
        assert re.fullmatch(said, capfd.readouterr().err.splitlines()[-1])


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
    pages = (page.relative_to(root / "docs") for kind in ("*.md", "*.ipynb") for page in DOCS.rglob(kind))
    assert sorted(named) == sorted(str(page.with_suffix(".md")) for page in pages)


def test_links_to_a_section_lead_to_its_only_heading(root, site):
    """In the pages put together, and in those that link to them; code is left as it is."""
    pages = site["extra"]["pages"]
    sections = {file for files in pages.values() for file in files[1:]}
    texts = {path.stem: path.read_text(encoding="utf-8") for path in (root / "docs").glob("*.md")}
    made = {name: text for name, text in texts.items() if name not in sections}
    whole = _docs_pages.page_text
    made |= {files[0]: whole(title, {f: texts[f] for f in files}) for title, files in pages.items()}
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


def _packed(text):
    return " ".join(text.split())


def _break_point(rows):
    return break_point(*([float(r[key]) for r in rows] for key in ("sir_db", "pd", "pd_low", "pd_high")))


MADE = {
    "rows": lambda g: len(g.rows),
    "pd": lambda g: g["correct"] / g["trials"],
    "pd_low": lambda g: wilson_interval(int(g["correct"]), int(g["trials"]))[0],
    "pd_high": lambda g: wilson_interval(int(g["correct"]), int(g["trials"]))[1],
    "wrong": lambda g: int(g["detections"] - g["correct"]),
    "wrong_low": lambda g: clopper_pearson(g["wrong"], int(g["trials"]))[0],
    "wrong_high": lambda g: clopper_pearson(g["wrong"], int(g["trials"]))[1],
    "wrong_bound": lambda g: clopper_pearson_bound(g["wrong"], int(g["trials"])),
    "break_db": lambda g: _break_point(g.rows).sir_db,
    "low_db": lambda g: _break_point(g.rows).low_db,
    "high_db": lambda g: _break_point(g.rows).high_db,
}


class Group:
    """Rows of a table: what is `MADE` of them, or the sum, `mean_` or `median_` of a column."""

    def __init__(self, rows):
        self.rows = rows

    def __getitem__(self, name):
        if name in MADE:
            return MADE[name](self)
        of, _, rest = name.partition("_")
        of, name = (getattr(np, of), rest) if of in ("mean", "median") else (sum, name)
        return of([float(row[name]) for row in self.rows if row[name]])


@cache
def _rows(table):
    with (ROOT / table).open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        if "height_m" in row:  # a frame of an approach
            right = abs(float(row["altitude_m"] or "nan") - float(row["height_m"])) < CORRECT_LIMIT_M
            row |= {"trials": "1", "detections": row["valid"], "correct": str(int(right))}
    return rows


def _groups(tables, by, where):
    """Rows that have the values of ``where``, by the columns ``by``."""
    groups = {}
    for row in (row for table in tables.split() for row in _rows(table)):
        if all(row[key] in values for key, values in where.items()):
            groups.setdefault(" ".join(row[key] for key in by if row[key]) or "all", []).append(row)
    return {name: Group(rows) for name, rows in groups.items()}


@cache
def _held(number):
    """Texts of an entry of `numbers.yaml`, with the numbers of their rows, if they have any."""
    place = NUMBERS[number]
    if "why" in place:
        return [_packed(text) for text in place["texts"]]
    if "/" not in place["table"]:  # a list of the bench: what its table of held decibels has
        rows, turns = read_rows(stored_rows(place["table"])), ROOT / f"bench/rows/turns/{place['table']}.csv"
        cost = read_rows(turns, TURN_COLUMNS) if turns.is_file() else ()
        found = summaries(rows, list(dict.fromkeys(row["entry"] for row in rows)), cost)
    else:
        found = _groups(place["table"], place["by"], place.get("where", {}))
    texts = [re.sub(r"r\[([^]{]+)\]\[(\w+)\]", r'r["\1"]["\2"]', _packed(text)) for text in place["texts"]]
    names = {"r": found, "short": lambda share, digits=2: f"{share:.{digits}f}".removeprefix("0")}
    return [re.sub(r"(?<=\d)%", " %", eval(f"f'''{text}'''", names)) for text in texts]


@pytest.mark.parametrize("page", sorted({place["page"] for place in NUMBERS} | set(PAGES)))
def test_numbers_of_a_page_are_those_of_rows_or_no_results(root, page):
    """Every text of `numbers.yaml` is on the page; on pages that no command writes nothing else has such numbers."""
    text = (root / page).read_text("utf-8")
    packed, prose = _packed(text), _packed(re.sub(r"(?ms)^```.*?^```|^([#!|]|    ).*?$", "", text))
    held = [text for number, place in enumerate(NUMBERS) if place["page"] == page for text in _held(number)]
    assert [text for text in held if text not in packed] == []
    for text in held:
        prose = prose.replace(text, " ... ")
    found = MEASURED.finditer(CONDITION.sub("", prose))
    loose = [m.string[max(0, m.start() - 60) : m.end() + 20] for m in found]
    assert page not in PAGES or loose == []


def test_the_table_of_cases_of_the_canceller_is_that_of_its_rows(root):
    page, rows = (root / "docs/cancellation.md").read_text("utf-8"), read_rows(stored_rows("evm"))
    for case in load_list("evm").cases:
        mine = [r for r in rows if (r["case"], r["overlap"]) == (case.name, case.overlap)]
        by = {name: [r for r in mine if r["entry"] == name] for name in {r["entry"] for r in mine}}
        best = by["qpsk_cancel" if case.name == "qpsk" else "ofdm_cancel"]
        ends = [_break_point(by_entry) for by_entry in (by["none"], best)]
        pd = {r["sir_db"]: f"{r['pd']:.2f}" for r in best}
        wrong = sum(r["detections"] - r["correct"] for r in best)
        cells = [*ends, *(pd.get(at, "") for at in (-30, -40, -45, -50)), wrong]
        cells += [f"{np.median([r['ffts'] for r in best]):.0f}"]
        line = " | ".join(map(str, [case.title.replace("part", f"{case.overlap:g}"), *cells]))
        assert f"| {line} |" in page, line


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
    found = re.findall(r"`(\w+\.py)?::(\w+)`", (root / "docs/safety.md").read_text(encoding="utf-8"))
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
        done = ran_python("snippet.py", cwd=tmp_path, env=ENV)
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
    source = (root / program).read_text(encoding="utf-8")
    shown = BLOCK.search((root / f"docs/{page}.md").read_text(encoding="utf-8"))[1]
    assert shown == source[source.index("import numpy") :]
