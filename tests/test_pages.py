"""Pages from Markdown."""

import re

from radalt.evaluation.results.markdown import to_html


def test_markdown_keeps_code_and_escapes_the_rest():
    text = "# A <b>\n\nBy `a_b*c*` and *one* **two `c`**\non [x](y.md), [z](https://z.org).\n\n- 1 < 2\n  more\n- b\n"
    assert to_html(text, str) == (
        "<h1>A &lt;b&gt;</h1>\n"
        '<p>By <code>a_b*c*</code> and <i>one</i> <b>two <code>c</code></b> on x, <a href="https://z.org">z</a>.</p>\n'
        "<ul><li>1 &lt; 2 more</li><li>b</li></ul>"
    )


def test_a_cell_sorts_by_the_number_it_begins_with_and_a_figure_lies_in_the_page():
    cells = {"0.940 (0.90–0.97)": "0.940", "≤ -62.5": "-62.5", "–": "", "-1.2e-3": "-1.2e-3", "9MHz": "9MHz"}
    for cell, value in cells.items():
        page = to_html(f"| a | b |\n|---|---:|\n| 10 MHz | {cell} |", str)
        assert re.findall(r'data-value="([^"]*)"', page) == ["10 MHz", value]
    page = to_html("![A *sweep*](a/b.png)", lambda file: f"<svg>{file}</svg>")
    assert page == "<figure><svg>a/b.png</svg><figcaption>A <i>sweep</i></figcaption></figure>"
