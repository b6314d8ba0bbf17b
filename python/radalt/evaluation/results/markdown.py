"""HTML from the Markdown of the report templates: headings, paragraphs, lists, tables, figures."""

import re
from collections.abc import Callable, Iterator
from html import escape

from .table import DASH

_KINDS = {
    "heading": re.compile(r"#{1,6} "),
    "table": re.compile(r"\|"),
    "figure": re.compile(r"!\[(?P<caption>.*)\]\((?P<file>[^)]*)\)$"),
    "ul": re.compile(r"- "),
    "ol": re.compile(r"\d+\. "),
}
_SPANS = (  # in this order, on text between code spans
    (re.compile(r"\[([^\]]*)\]\((https?://[^)\s]*)\)"), r'<a href="\2">\1</a>'),
    (re.compile(r"\[([^\]]*)\]\([^)]*\)"), r"\1"),  # files next to the page may be missing
    (re.compile(r"\*\*([^*]+)\*\*"), r"<b>\1</b>"),
    (re.compile(r"(?<!\w)[*_](?=\S)([^*_]+)(?<=\S)[*_](?!\w)"), r"<i>\1</i>"),
)
_NUMBER = re.compile(r"(?:[<>]=|[≤≥<>])?\s*([+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?)(?![\w.])")


def to_html(text: str, figure: Callable[[str], str]) -> str:
    """A page as HTML, without ``<html>`` and ``<head>``; ``figure`` makes ``<svg>`` or ``<img>`` of a figure's file.

    The script of ``page.html.j2`` sorts tables by a value in each cell: the leading number of its text, else its text,
    which the first column always has; nothing for a dash. Links to other files become plain text.
    """
    return "\n".join(_block(kind, lines, figure) for kind, lines in _blocks(text))


def _blocks(text: str) -> Iterator[tuple[str, list[str]]]:
    """(kind, lines) of each block; an indented line continues the list item before it."""
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
        assert found is not None  # by the kind of the block
        caption = _spans(found["caption"])
        return f"<figure>{figure(found['file'])}<figcaption>{caption}</figcaption></figure>"
    if kind in ("ul", "ol"):
        items = (f"<li>{_spans(_KINDS[kind].sub('', line, count=1))}</li>" for line in lines)
        return f"<{kind}>{''.join(items)}</{kind}>"
    return f"<p>{_spans(lines[0])}</p>"


def _table(lines: list[str]) -> str:
    header, _, *rows = ([cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines)
    head = '<th scope="col"><button type="button" title="sort">{}</button></th>'
    names = "".join(head.format(_spans(h)) for h in header)
    body = "\n".join(f"<tr>{_cell(row[0], label=True)}{''.join(map(_cell, row[1:]))}</tr>" for row in rows)
    return (
        f'<div class="wide"><table>\n<thead><tr>{names}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>'
    )


def _cell(text: str, label: bool = False) -> str:
    number = None if label else _NUMBER.match(text)  # "10 MHz, QPSK" is a name
    value = "" if text == DASH else number[1] if number else text
    return f'<td data-value="{escape(value)}">{_spans(text)}</td>'


def _spans(text: str) -> str:
    """Code unchanged; links, bold and italics elsewhere and around code."""
    parts = [*text.split("`"), ""]  # a mark that is not closed makes code of the rest
    plain, codes = escape("\0".join(parts[::2])), iter(parts[1::2])
    for pattern, html in _SPANS:
        plain = pattern.sub(html, plain)
    return re.sub("\0", lambda _: f"<code>{escape(next(codes))}</code>", plain)
