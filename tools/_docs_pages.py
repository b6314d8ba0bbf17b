"""MkDocs hook: a page of the site from several files of docs/, each of which stays as its command writes it.

`extra.pages` of mkdocs.yml lists, by the page's title, the file that the page is called after and those that follow as
sections. These have no page of their own, and links to them lead to the section.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

_CODE = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)
_HEADING = re.compile(r"^#(#*) (.*)$", re.MULTILINE)
_NOTEBOOK = "notebook.ipynb"
_LINK = re.compile(r"\]\((?:((?:\.\./)?)([\w-]+)\.md)?(?:#([\w-]+))?\)")
_COLUMN_PX = 510  # widest picture, at 96 dpi, whose type (9 pt) is legible in a column of 400 px
_UNITS = r"%|dBm?\b|[mu]?s\b|k?m\b|ft\b|m/s\b|[kMG]?Hz\b|MS/s\b|[MG]i?B\b"
# what a line may not break in, though it has hyphens: options, ranges, small numbers
_WHOLE = re.compile(r"(?<![\w-])--[a-z][\w-]*|-?\b[\d.]+(?:e[-+]?\d+)?\.\.[-+\w.]*\w|\b\d[\d.]*e-\d+")


def anchor(heading: str) -> str:
    """Anchor of a heading, as Markdown's `toc` makes it."""
    plain = re.sub(r"[^\w\s-]", "", heading.encode("ascii", "ignore").decode()).strip().lower()
    return re.sub(r"[-\s]+", "-", plain)


def _prose(text: str, change: Callable[[str], str]) -> str:
    """``text`` with ``change`` applied to all but fenced code."""
    pieces = _CODE.split(text)
    pieces[::2] = map(change, pieces[::2])
    return "".join(pieces)


def section(file: str, text: str) -> str:
    """The file ``file`` as a section: its headings one level down, with anchors of their own, and links to these."""

    def heading(found: re.Match[str]) -> str:
        marks, title = found.groups()
        return f"##{marks} {title} {{#{file}{f'-{anchor(title)}' if marks else ''}}}"

    text = _prose(text, lambda prose: _HEADING.sub(heading, prose))
    return text.replace("](#", f"](#{file}-")


def with_links(text: str, pages: dict[str, list[str]]) -> str:
    """``text`` with links to a file that is a section leading there."""
    page_of = {file: files[0] for files in pages.values() for file in files[1:]}

    def link(found: re.Match[str]) -> str:
        above, file, where = found.groups()
        if file not in page_of:
            return found[0]
        return f"]({above}{page_of[file]}.md#{file}{f'-{where}' if where else ''})"

    return _LINK.sub(link, text).replace(f"]({_NOTEBOOK})", f"]({_NOTEBOOK[:-6]}.md)")


def page_text(title: str, texts: dict[str, str]) -> str:
    """Markdown of a page: the first of ``texts`` (by file) under ``title``, links to the sections, the sections."""
    (_, lead), *rest = texts.items()
    named = [f"[{text.partition(chr(10))[0].removeprefix('# ')}](#{file})" for file, text in rest]
    lead = re.sub(r"\A# .*", f"# {title}", lead)
    made = lead.replace("\n## ", f"\n*Below: {' · '.join(named)}*\n\n## ", 1)
    for file, text in rest:
        for picture in re.findall(r"^!\[.*(\]\(\S+\))$\n", text, re.MULTILINE):
            if picture in made:  # once per page
                text = re.sub(rf"^!.*{re.escape(picture)}\n\n", "", text, flags=re.MULTILINE)
        made += f"\n\n---\n\n{section(file, text)}"
    return made


def notebook(text: str) -> str:
    """Markdown of a notebook with the outputs that are stored in it."""
    made = []
    for cell in json.loads(text)["cells"]:
        source = "".join(cell["source"])
        made.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", []):
            png = output.get("data", {}).get("image/png")
            words = "".join(output.get("text", ""))
            made.append(f"![Output](data:image/png;base64,{png.strip()})" if png else f"```text\n{words}```")
    return "\n\n".join(made)


def on_files(files: Any, config: Any) -> None:
    """Leave out the pages of the files that are sections, and add that of the notebook."""
    from mkdocs.structure.files import File

    text = notebook((Path(config["docs_dir"]) / _NOTEBOOK).read_text(encoding="utf-8"))
    files.append(File.generated(config, f"{_NOTEBOOK[:-6]}.md", content=text))
    for _, *rest in config["extra"]["pages"].values():
        for file in rest:
            files.remove(files.get_file_from_path(f"{file}.md"))


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """Put a page together."""
    pages, docs = config["extra"]["pages"], Path(config["docs_dir"])
    for title, files in pages.items():
        if page.file.src_uri == f"{files[0]}.md":
            texts = {file: (docs / f"{file}.md").read_text(encoding="utf-8") for file in files}
            markdown = page_text(title, texts)
    return with_links(markdown, pages)


def on_page_content(html: str, page: Any, config: Any, **_: Any) -> str:
    """Let a picture lead to its file, for a small screen, and a page's file to the page; know cells of numbers."""
    files = {
        file: f"{files[0]}.html#{file}" for files in config["extra"]["pages"].values() for file in files[1:]
    }
    above = "../" * page.url.count("/")

    def link(found: re.Match[str]) -> str:
        return f'<a href="{above}{files.get(found[1], f"{found[1]}.html")}">{found[0]}</a>'

    html = re.sub(r"\bdocs/([\w-]+)\.md\b", link, html)
    html = re.sub(r"<td([^>]*)>(?=[\d\s./e:–≤≥+%()-]*</td>)", r'<td\1 class="numbers">', html)
    # long names of tests, keys, cases and modules may break there
    html = html.replace(".py::test_", ".py::<wbr>test_")
    html = re.sub(
        r"(<td[^>]*>(?:<code>\w+\.(?=\w{5})|\w{20,}_)|<code>radalt[\w.]*\.)(?=\w+</)", r"\1<wbr>", html
    )
    html = re.sub(rf"(?<=\d) (?={_UNITS})", "\N{NO-BREAK SPACE}", html)
    html = re.sub(
        r"(?<=>)[^<>]+", lambda text: _WHOLE.sub(r'<span class="whole">\g<0></span>', text[0]), html
    )

    def picture(found: re.Match[str]) -> str:
        if found[2].startswith("data:"):
            return found[0]
        head = (Path(config["docs_dir"], page.file.src_uri).parent / found[2]).read_bytes()[:2000]
        drawn = re.search(rb'<svg[^>]*?\swidth="([\d.]+)(pt)?', head)
        per_m = re.search(rb"pHYs(.{4})|$", head, re.DOTALL)[1] or (3780).to_bytes(4, "big")  # 96 dpi
        px = 3780 * int.from_bytes(head[16:20], "big") / int.from_bytes(per_m, "big")
        if drawn:
            px = float(drawn[1]) * (4 / 3 if drawn[2] else 1)
        size = f' class="page" style="--drawn: {px:.0f}px"' if px > _COLUMN_PX else ""
        return f'<a href="{found[2]}">{found[1]}{size}></a>'

    return re.sub(r'(<img [^>]*src="([^"]*)"[^>]*?) ?/?>', picture, html)
