"""What tests of reports share: `report.html` asks for nothing, holds its figures, and a browser sorts its tables."""

import re
from pathlib import Path

import yaml
from waiting import ran

PROBE = """<script>
const table = document.querySelector("table:has(th button)");
const seen = (k) => [...table.tBodies[0].rows].map((r) => r.cells[k].dataset.value).join("|");
table.querySelectorAll("th button")[1].click(); document.body.dataset.up = seen(1);
table.querySelectorAll("th button")[1].click(); document.body.dataset.down = seen(1);
for (const folded of document.querySelectorAll("details")) folded.open = true;
const wide = (s) => s.getBoundingClientRect().width > 300;
document.body.dataset.drawn = [...document.querySelectorAll("figure svg")].filter(wide).length;
</script></body>"""


def assert_whole(page: Path, browser: list[str] | None) -> None:
    """Of a study's ``report.md`` and the ``report.html`` next to it."""
    markdown = page.read_text(encoding="utf-8")
    text = page.with_suffix(".html").read_text(encoding="utf-8")
    assert not re.findall(r"""(?:src|href)=["'](?!#|data:)""", text)
    assert not re.findall(r"@import|url\((?!#)", text)
    assert "default-src 'none'" in text
    assert text.count("<figure><svg") == len(re.findall(r"^!\[", markdown, re.MULTILINE))
    assert "<figure><img" not in text
    assert text.count("<th scope") == text.count('<button type="button" title="sort">') > 0
    rows = [line for line in markdown.splitlines() if line.startswith("|")]
    assert text.count("<tr>") == len(rows) - len([r for r in rows if r.startswith("|---")])
    settings = yaml.safe_load(re.search(r"<pre>(.*?)</pre>", text, re.DOTALL)[1].replace("&#39;", "'"))
    assert settings["study"] and "versions" not in settings
    assert re.search(r"<li>radalt \d", text)
    if browser is None:
        return
    copy = page.with_name("probe.html")
    copy.write_text(text.replace("</body>", PROBE), encoding="utf-8")
    done = ran(*browser, "--dump-dom", copy.as_uri())
    copy.unlink()
    found = dict(re.findall(r'data-(up|down|drawn)="([^"]*)"', done.stdout))
    up, down = (found[key].split("|") for key in ("up", "down"))
    key = (lambda v: (v == "", float(v or 0))) if re.fullmatch(r"[-+.e\d|]*", found["up"]) else None
    assert up == sorted(up, key=key) and sorted(down) == sorted(up)
    assert found["drawn"] == str(text.count("<figure><svg"))
