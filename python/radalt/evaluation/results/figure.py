"""Figures as files: PNG for pages, PDF for print, SVG for `report.html`, where a point says its values."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["new_figure", "save_figure", "say"]


def new_figure(width: float, height: float, *, dpi: int = 160) -> Any:
    """An empty Agg figure, ``width`` and ``height`` in inches; made without pyplot, so no window system is asked for."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained", dpi=dpi)
    FigureCanvasAgg(figure)
    return figure


def say(axis: Any, x: Sequence[float], y: Sequence[float], texts: Sequence[str]) -> None:
    """Keep for `save_figure` what each point of an axis says in the SVG when the mouse is over it."""
    said = getattr(axis.figure, "radalt_said", [])
    axis.figure.radalt_said = said + list(zip([axis] * len(texts), x, y, texts, strict=True))


def save_figure(figure: Any, path: Path) -> None:
    """Write PNG (``path``), PDF and SVG beside each other: without dates, the same bytes for the same rows.

    By the canvases themselves: `savefig` draws every file twice, the first time for a layout that is made once here.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    path.parent.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context({"svg.hashsalt": path.stem, "pdf.compression": 6}):
        figure.get_layout_engine().execute(figure)
        figure.set_layout_engine("none")
        FigureCanvasAgg(figure).print_png(path, metadata={"Software": "gr-radalt"})
        metadata = {"Creator": "gr-radalt", "CreationDate": None}
        FigureCanvasPdf(figure).print_pdf(path.with_suffix(".pdf"), metadata=metadata)
        texts = []
        for axis, x, y, text in getattr(figure, "radalt_said", []):
            if np.isfinite(x) and np.isfinite(y):
                # seen by the mouse alone
                axis.plot([x], [y], "o", ms=9, alpha=0.0, gid=f"say{len(texts)}", scalex=False, scaley=False)
                texts.append(text)
        svg = io.StringIO()
        FigureCanvasSVG(figure).print_svg(svg, metadata={"Creator": "gr-radalt", "Date": None})
    drawn = re.sub(
        r'<g id="say(\d+)">',
        lambda found: f"{found[0]}<title>{escape(texts[int(found[1])])}</title>",
        svg.getvalue(),
    )
    path.with_suffix(".svg").write_text(drawn, encoding="utf-8")
