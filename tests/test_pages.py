"""Pages from Markdown, and that of the study of detection, from rows that were made by hand."""

import re

from pages import assert_whole

from radalt.evaluation.engine.run import head_of
from radalt.evaluation.engine.study import Run
from radalt.evaluation.results.folder import RunFolder
from radalt.evaluation.results.markdown import to_html
from radalt.studies.detection.study import DetectionStudy

RUN = Run(1, 3, 0, 2.0, 1, ".venv/bin/python flowgraphs/a_study.py --seed=3")


def test_a_page_of_false_alarms_beside_the_textbooks_is_whole(tmp_path, browser):
    """From rows by hand; the other studies' pages are held to the same where these are run."""
    where = {
        "method": "none",
        "scene": "nr5",
        "sir_db": -28.0,
        "inr_db": 20.0,
        "snr_db": 10.0,
        "overlap": 1.0,
    }
    found = {name: 0.5 for name in ("declared", "forced", "rmse_m", "wrong", "rate", "low", "high", "bound")}
    found |= {"declared_alone": 3, "forced_alone": 2}
    row = where | {"frames": 20, "false": 10} | found | {f"textbook_{k}": v for k, v in found.items()}
    rows = [row | {"allowed_m_per_s": speed} for speed in (150.0, 0.0, 20.0)]
    study = DetectionStudy(("none",), 20, 20, 20)
    page = study.report(RunFolder(tmp_path / "run", head_of(study)), {"rows": rows, "null": rows}, RUN)
    assert_whole(page, browser)
    assert RUN.command in page.with_suffix(".html").read_text(encoding="utf-8")


def test_markdown_keeps_code_and_escapes_the_rest():
    text = "# A <b>\n\nBy `a_b*c*` and *one* **two**\non [x](y.md), [z](https://z.org).\n\n- 1 < 2\n  more\n- b\n"
    assert to_html(text, str) == (
        "<h1>A &lt;b&gt;</h1>\n"
        '<p>By <code>a_b*c*</code> and <i>one</i> <b>two</b> on x, <a href="https://z.org">z</a>.</p>\n'
        "<ul><li>1 &lt; 2 more</li><li>b</li></ul>"
    )


def test_a_cell_sorts_by_the_number_it_begins_with_and_a_figure_lies_in_the_page():
    cells = {
        "0.940 (0.90–0.97)": "0.940",
        "≤ -62.5": "-62.5",
        "–": "",
        "-1.2e-3": "-1.2e-3",
        "10MHz": "10MHz",
    }
    for cell, value in cells.items():
        page = to_html(f"| a | b |\n|---|---:|\n| 10 MHz | {cell} |", str)
        assert re.findall(r'data-value="([^"]*)"', page) == ["10 MHz", value]
    page = to_html("![A *sweep*](a/b.png)", lambda file: f"<svg>{file}</svg>")
    assert page == "<figure><svg>a/b.png</svg><figcaption>A <i>sweep</i></figcaption></figure>"
