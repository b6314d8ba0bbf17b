"""Pages from templates: the prose of a report lies in a ``.md.j2`` or ``.html.j2`` file beside the study's code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from . import table as tables

__all__ = ["render"]


def render(template: Path, **values: Any) -> str:
    """The template's text with values filled in; a name that is missing is an error.

    Templates know the functions of `results.table` (``table``, ``number``, ``metres``, ``interval``, ...).
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(template.parent),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=template.name.endswith(".html.j2"),  # Markdown is made of our own values
    )
    functions = {name: getattr(tables, name) for name in tables.__all__}
    return environment.get_template(template.name).render(**functions, **values)
