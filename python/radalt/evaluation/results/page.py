"""Pages from templates: the text of a report is a ``.md.j2`` or ``.html.j2`` file next to the study's code."""

import base64
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from . import table as tables
from .folder import RunFolder
from .markdown import to_html

_FRAME = Path(__file__).parent  # folder of page.html.j2, the frame of every HTML page


def render(template: Path, **values: Any) -> str:
    """Render a template; an undefined name is an error.

    Templates may call the functions of `results.table` (``table``, ``number``, ``metres``, ``interval``, ...).
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader([template.parent, _FRAME]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=template.name.endswith(".html.j2"),  # Markdown contains only values of this package
    )
    functions = {name: getattr(tables, name) for name in tables.__all__}
    return environment.get_template(template.name).render(**functions, **values)


def write_result(
    folder: RunFolder,
    template: Path,
    run: Mapping[str, Any],
    report: Mapping[str, Any],
    values: Mapping[str, Any],
) -> Path:
    """Write ``report.md``, ``report.html`` and ``report.json``; returns the path of ``report.md``.

    ``template``: ``.md.j2``; ``run``: a `Run` as a dict; ``report``: content of ``report.json`` besides the folder's
    head and the run; ``values``: further values of the template, such as tables.
    """
    report = folder.head | {"run": run} | report
    page = write_page(folder, render(template, **(report | values)), run)
    folder.write_report(report)
    return page


def write_page(folder: RunFolder, text: str, run: Mapping[str, Any]) -> Path:
    """Write ``report.md``, and ``report.html``, which contains its figures; returns the path of ``report.md``.

    ``text`` is Markdown, ``run`` a `Run` as a dict. Figures lie in the folder; an SVG is preferred.
    """
    page = folder.write_text("report.md", text)
    html = render(
        _FRAME / "report.html.j2",
        title=text.splitlines()[0].lstrip("# "),
        content=to_html(text, lambda file: _inline(folder.path / file)),
        settings=_settings(folder.head),
        created=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        run={"command": "", "by": "", **run},
        **{name: folder.head[name] for name in ("versions", "schema")},
    )
    folder.write_text("report.html", html)
    return page


def _inline(figure: Path) -> str:
    drawn = figure.with_suffix(".svg")
    if drawn.is_file():
        svg = drawn.read_text(encoding="utf-8")
        return svg[svg.index("<svg") :]
    return f'<img src="data:image/png;base64,{base64.b64encode(figure.read_bytes()).decode()}" alt="">'


def _settings(head: Mapping[str, Any]) -> str:
    """Scene, points, methods, seed: everything on which a row depends, except versions."""
    import yaml

    shown = {k: v for k, v in head.items() if k not in ("schema", "journal", "versions")}
    return yaml.safe_dump(shown, sort_keys=False, allow_unicode=True)
