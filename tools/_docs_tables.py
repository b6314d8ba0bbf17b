"""MkDocs hook: a page with a sortable table for every docs/data/*.csv, to which links to the CSV lead, and back.

The pages exist only in the built site. `mkdocs.yml` names this file under `hooks`.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import jinja2

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "docs" / "data"
# folder of the frame of every report: style, and the script that sorts
FRAME = ROOT / "python" / "radalt" / "evaluation" / "results"

PAGE = """{% extends "page.html.j2" %}{% block title %}{{ name }}{% endblock %}{% block body %}
<h1>{{ name }}</h1>
<p><a href="../index.html">Home</a>{% for at, title in used %}, <a href="../{{ at }}">{{ title }}</a>{% endfor %}.
{{ rows | length }} rows, <a href="{{ name }}.csv">as CSV</a>. A click on a heading
sorts; the pointer on it says what the column holds (<a href="../columns.html">all columns</a>).</p>
<div class="wide"><table>
<thead><tr>{% for head in heads %}<th><button title="{{ meaning[head] }}">{{ head }}</button></th>
{% endfor %}</tr></thead>
<tbody>{% for row in rows %}<tr>{% for value in row %}<td>{{ value }}</td>{% endfor %}</tr>
{% endfor %}</tbody></table></div>{% endblock %}"""


def table_page(path: Path, sections: dict[str, str]) -> str:
    """Page of a CSV file as HTML, with links to the pages that link to it or show its figure; addresses of sections."""
    texts = {page.stem: page.read_text(encoding="utf-8") for page in sorted(DATA.parent.glob("*.md"))}
    used = [name for name, text in texts.items() if re.search(rf"(?:data|figures)/{path.stem}\.", text)]
    used = [(sections.get(name, f"{name}.html"), texts[name].partition("\n")[0][2:]) for name in used]
    with path.open(newline="", encoding="utf-8") as file:
        heads, *rows = csv.reader(file)
    lines = re.findall(r"^\| (.*) \| (.*) \|$", texts["columns"], re.MULTILINE)
    meaning = {name: text for names, text in lines for name in re.findall(r"`([\w.]+)`", names)}
    page = jinja2.Environment(loader=jinja2.FileSystemLoader(FRAME), autoescape=True).from_string(PAGE)
    return page.render(name=path.stem, heads=heads, rows=rows, meaning=meaning, used=used)


def on_page_content(html: str, **_: object) -> str:
    """Let links to CSV files lead to their pages."""
    return re.sub(r'href="((?:[^":]*/)?data/[\w-]+)\.csv"', r'href="\1.html"', html)


def on_post_build(config: dict, **_: object) -> None:
    """Write the pages next to the files."""
    pages = config["extra"]["pages"].values()
    at = {file: f"{files[0]}.html#{file}" for files in pages for file in files[1:]}
    for path in sorted(DATA.glob("*.csv")):
        Path(config["site_dir"], f"data/{path.stem}.html").write_text(table_page(path, at), encoding="utf-8")
