"""Markdown as the templates of our reports write it, as HTML: headings, paragraphs, lists, tables, figures."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from html import escape

from .table import DASH

__all__ = ["to_html"]

_KINDS = {
    "heading": re.compile(r"#{1,6} "),
    "table": re.compile(r"\|"),
    "figure": re.compile(r"!\[(?P<caption>.*)\]\((?P<file>[^)]*)\)$"),
    "ul": re.compile(r"- "),
    "ol": re.compile(r"\d+\. "),
}
_SPANS = (  # in this order, on text between code spans
    (re.compile(r"\[([^\]]*)\]\((https?://[^)\s]*)\)"), r'<a href="\2">\1</a>'),
    (re.compile(r"\[([^\]]*)\]\([^)]*\)"), r"\1"),  # a file beside the page may not be where the page is read
    (re.compile(r"\*\*([^*]+)\*\*"), r"<b>\1</b>"),
    (re.compile(r"(?<!\w)[*_](?=\S)([^*_]+)(?<=\S)[*_](?!\w)"), r"<i>\1</i>"),
)
_NUMBER = re.compile(r"(?:[<>]=|[≤≥<>])?\s*([+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?)(?![\w.])")


def to_html(text: str, figure: Callable[[str], str]) -> str:
    """A page as HTML, without its frame.

    Tables can be sorted by the script of ``page.html.j2``: each cell carries the number its text begins with, or its
    text, as the first column always does; nothing where there is a dash. Links to other files become plain text.

    Parameters
    ----------
    text : str
        Markdown: the blocks named above, each begun at the start of a line; code, bold, italics and links in them.
    figure : callable
        From the file of a figure to its ``<svg>`` or ``<img>``.
    """
    return "\n".join(_block(kind, lines, figure) for kind, lines in _blocks(text))


def _blocks(text: str) -> Iterator[tuple[str, list[str]]]:
    """(kind, lines) of each block; an indented line goes on with the item of a list before it."""
    kind, lines = "", list[str]()
    for line in text.splitlines():
        new = next((name for name, start in _KINDS.items() if start.match(line)), "p" if line.strip() else "")
        if new == "p" and kind in ("p", "ul", "ol"):
            lines[-1] += f" {line.strip()}"
            continue
        if new != kind or new in ("heading", "figure"):
            if kind:
                yield kind, lines
            kind, lines = new, []
        lines.append(line)
    if kind:
        yield kind, lines


def _block(kind: str, lines: list[str], figure: Callable[[str], str]) -> str:
    if kind == "heading":
        level = len(lines[0]) - len(lines[0].lstrip("#"))
        return f"<h{level}>{_spans(lines[0][level:].strip())}</h{level}>"
    if kind == "table":
        return _table(lines)
    if kind == "figure":
        found = _KINDS["figure"].match(lines[0])
        assert found is not None  # what made it a figure
        caption = _spans(found["caption"])
        return f"<figure>{figure(found['file'])}<figcaption>{caption}</figcaption></figure>"
    if kind in ("ul", "ol"):
        items = (f"<li>{_spans(_KINDS[kind].sub('', line, count=1))}</li>" for line in lines)
        return f"<{kind}>{''.join(items)}</{kind}>"
    return f"<p>{_spans(lines[0])}</p>"


def _table(lines: list[str]) -> str:
    header, _, *rows = ([cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines)
    names = "".join(f'<th scope="col"><button type="button">{_spans(h)}</button></th>' for h in header)
    body = "\n".join(f"<tr>{_cell(row[0], label=True)}{''.join(map(_cell, row[1:]))}</tr>" for row in rows)
    return f'<div class="wide"><table>\n<thead><tr>{names}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>'


def _cell(text: str, label: bool = False) -> str:
    number = None if label else _NUMBER.match(text)  # "10 MHz, QPSK" is a name
    value = "" if text == DASH else number[1] if number else text
    return f'<td data-value="{escape(value)}">{_spans(text)}</td>'


def _spans(text: str) -> str:
    """Code as it is, in the rest links, bold and italics."""
    out = []
    for k, part in enumerate(text.split("`")):
        if k % 2:
            out.append(f"<code>{escape(part)}</code>")
            continue
        part = escape(part)
        for pattern, html in _SPANS:
            part = pattern.sub(html, part)
        out.append(part)
    return "".join(out)
