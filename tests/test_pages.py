"""report.html of every study: one file that asks for nothing, figures drawn in it, tables that sort."""

import re
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import yaml

from radalt.evaluation.engine.run import head_of
from radalt.evaluation.engine.study import Run
from radalt.evaluation.results.chain import Chain
from radalt.evaluation.results.folder import RunFolder
from radalt.evaluation.results.markdown import to_html
from radalt.studies.cancellation.study import CancellationStudy
from radalt.studies.detection.study import DetectionStudy
from radalt.studies.integrity.study import IntegrityStudy
from radalt.studies.landing import config as landing
from radalt.studies.landing.study import LandingStudy
from radalt.studies.leaving_out.study import LeavingOutStudy
from radalt.studies.realtime.outside import Outside
from radalt.studies.realtime.report import Benchmark
from radalt.studies.realtime.report import write_report as write_benchmark
from radalt.studies.realtime.study import Measurement
from radalt.studies.runtime.study import RuntimeStudy
from radalt.studies.stability.study import StabilityStudy, compared_chains

pytestmark = pytest.mark.timeout(150)

RUN = Run(1, 3, 0, 2.0, 1, ".venv/bin/python flowgraphs/a_study.py --seed=3")
CHAINS = (Chain("none", "none"), Chain("whitening", "whitening"))


def _landing(root):
    config = landing.parse_config({}, folder=str(root / "flowgraphs" / "landing"))
    curve = replace(config.curve, overlap=(1.0,), sinr_db=(-40.0, 0.0), trials=4, sensitivity_trials=0)
    return LandingStudy(
        replace(config, methods=("none",), approach=replace(config.approach, frames=4, chunk=4), curve=curve)
    )


# a small study, and the points of it that are measured
STUDIES = {
    "stability": lambda root: (StabilityStudy(compared_chains(["none"]), ("numbers",)), slice(3)),
    "integrity": lambda root: (IntegrityStudy(("none",), frames=80), slice(0, 400, 150)),
    "cancellation": lambda root: (
        CancellationStudy(("none",), ("evm_3",), frames=1, sirs_db=(-20.0, -40.0)),
        slice(None),
    ),
    "landing": lambda root: (_landing(root), slice(None)),
    "error_vs_runtime": lambda root: (
        RuntimeStudy(CHAINS, (-15.0, -45.0), frames=2, rounds=2, interferers=("5 tones, all",)),
        slice(None),
    ),
}


def _leaving_out(path):
    rows = [
        {"scene": "no interference, whitening", "built": built, "cpu_s": cpu_s, "memory_bytes": 1 << 20}
        | {"frames": 10, "digest": "same", "modules": ""}
        for built, cpu_s in (("pruned", 1.0), ("all", 3.0))
    ]
    study = LeavingOutStudy(frames=2, repeats=1)
    return study.report(RunFolder(path, head_of(study)), {"rows": rows}, RUN)


def _detection(path):
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
    return study.report(RunFolder(path, head_of(study)), {"rows": rows, "null": rows}, RUN)


def _realtime(path):
    latency_ms, outside = {"none": np.linspace(1.0, 9.0, 100)}, Outside(0.0, (3.0, 25.0), (0.0, 25.0))
    cpu_s, calls, frames = {"segmenter": 0.5}, {"segmenter": 9}, {"none": 2000}
    measured = Measurement(2.0, 1.0, cpu_s, 0.8, calls, frames, latency_ms, 0, 0, 0, 1, 0, outside, 0.0, 0.0)
    head = {"study": "realtime", "command": RUN.command, "scene": {"name": "paper"}, "methods": ["none"]}
    folder = RunFolder(path, head | {"versions": {"radalt": "0"}})
    return write_benchmark(
        folder, {"held to real time": Benchmark(measured, 4e-5, {"segmenter": 0.1})}, 1e-3, RUN
    )


def _measured(name, root, path):
    study, chosen = STUDIES[name](root)
    points, rows = study.points()[chosen], {table: [] for table in study.tables}
    for point in points:
        for row in study.measure(point):
            table = study.table_of(point, row)
            rows[table].append(study.tables[table].row(row))
    return study.report(RunFolder(path, head_of(study)), rows, RUN)


PROBE = """<script>
const table = document.querySelector("table:has(th button)");
const seen = (k) => [...table.tBodies[0].rows].map((r) => r.cells[k].dataset.value).join("|");
table.querySelectorAll("th button")[1].click(); document.body.dataset.up = seen(1);
table.querySelectorAll("th button")[1].click(); document.body.dataset.down = seen(1);
const wide = (s) => s.getBoundingClientRect().width > 300;
document.body.dataset.drawn = [...document.querySelectorAll("figure svg")].filter(wide).length;
</script></body>"""


MADE = {"detection": _detection, "leaving_out": _leaving_out, "realtime": _realtime}  # from rows by hand


@pytest.mark.parametrize("name", [*STUDIES, *MADE])
def test_a_page_is_whole_and_a_browser_sorts_it(name, root, tmp_path, browser):
    out = tmp_path / "run"
    page = MADE[name](out) if name in MADE else _measured(name, root, out)
    markdown = page.read_text(encoding="utf-8")
    text = page.with_suffix(".html").read_text(encoding="utf-8")
    assert not re.findall(r"""(?:src|href)=["'](?!#|data:)""", text)
    assert not re.findall(r"@import|url\((?!#)", text)
    assert "default-src 'none'" in text
    assert text.count("<figure><svg") == len(re.findall(r"^!\[", markdown, re.MULTILINE))
    assert "<figure><img" not in text
    assert text.count("<th scope") == text.count('<button type="button">') > 0
    rows = [line for line in markdown.splitlines() if line.startswith("|")]
    assert text.count("<tr>") == len(rows) - len([r for r in rows if r.startswith("|---")])
    settings = yaml.safe_load(re.search(r"<pre>(.*?)</pre>", text, re.DOTALL)[1].replace("&#39;", "'"))
    assert settings["study"] and "versions" not in settings
    assert RUN.command in text and "<li>radalt 0" in text
    if browser is None:
        return
    copy = page.with_name("probe.html")
    copy.write_text(text.replace("</body>", PROBE), encoding="utf-8")
    done = subprocess.run(
        [*browser, "--dump-dom", copy.as_uri()], capture_output=True, text=True, timeout=120, check=True
    )
    found = dict(re.findall(r'data-(up|down|drawn)="([^"]*)"', done.stdout))
    up, down = (found[key].split("|") for key in ("up", "down"))
    key = (lambda v: (v == "", float(v or 0))) if re.fullmatch(r"[-+.e\d|]*", found["up"]) else None
    assert up == sorted(up, key=key) and sorted(down) == sorted(up)
    assert found["drawn"] == str(text.count("<figure><svg"))


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
