#!/usr/bin/env python3
"""Words and readability of each page's prose, without code, tables and pictures; generated pages are not added up.

    .venv/bin/python tools/count_words.py            # docs/*.md and README.md
    .venv/bin/python tools/count_words.py CHANGELOG.md

Columns: words, mean words per sentence, Flesch reading ease (higher is easier; Flesch 1948, J. Applied Psychology 32).
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MADE = ("scene-reference.md",)  # by tools/make_scene_reference.py


def prose(text: str) -> str:
    """The sentences of a page of Markdown."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    lines = [s for s in text.splitlines() if not re.match(r"\s*\||    |\s*!\[|#|<|---", s)]
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", "\n".join(lines))
    return re.sub(r"`[^`]*`", "code", text)


def syllables(word: str) -> int:
    """Groups of vowels, without a silent e at the end; at least one."""
    return max(1, len(re.findall(r"[aeiouy]+", re.sub(r"e\b", "", word.lower()))))


def measure(text: str) -> tuple[int, float, float]:
    """(words, words per sentence, reading ease) of a page."""
    text = prose(text)
    words = re.findall(r"[A-Za-z][\w'-]*", text)
    sentences = max(1, len(re.findall(r"[.!?:](?=\s|$)|^\s*[-*\d]+[.)]?\s", text, re.MULTILINE)))
    if not words:
        return 0, 0.0, 0.0
    length = len(words) / sentences
    return len(words), length, 206.8 - 1.015 * length - 84.6 * sum(map(syllables, words)) / len(words)


def main(argv: Sequence[str] | None = None) -> int:
    """Print a line per page, and the sum."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("pages", nargs="*", type=Path, help="default: docs/*.md and README.md")
    pages = parser.parse_args(argv).pages or [*sorted((ROOT / "docs").glob("*.md")), ROOT / "README.md"]
    total = 0
    for page in pages:
        words, length, ease = measure(page.read_text(encoding="utf-8"))
        note = " (made by command)" if page.name in MADE else ""
        total += 0 if note else words
        print(f"{words:6} {length:5.1f} {ease:5.0f}  {page.name}{note}")
    print(f"{total:6} together")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
