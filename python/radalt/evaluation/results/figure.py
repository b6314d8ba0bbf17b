"""Figures as files: PNG for pages, PDF for print, SVG with tooltips for `report.html`."""

import contextlib
import io
import os
import re
import sys
import textwrap
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from .folder import writing

COLUMN_IN = 4.2  # width in inches of a figure whose type has its own size in a column of print, and at 400 px (96 dpi)


@contextlib.contextmanager
def own_style() -> Iterator[None]:
    """Within, figures have matplotlib's default style, whatever ``MPLBACKEND`` and the user's matplotlibrc state."""
    # an unknown backend, as of another Jupyter, ends the import
    backend = "" if "matplotlib" in sys.modules else os.environ.pop("MPLBACKEND", "")
    import matplotlib

    if backend:
        os.environ["MPLBACKEND"] = backend
        with contextlib.suppress(ValueError):
            matplotlib.rcParams["backend"] = backend
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        yield


def new_figure(width: float, height: float, *, dpi: int = 160, shown: bool = False) -> Any:
    """An empty Agg figure, ``width`` and ``height`` in inches, without pyplot and so without a window system.

    With ``shown`` it is created by pyplot, for ``matplotlib.pyplot.show()`` and notebooks.
    """
    if shown:
        from matplotlib import pyplot

        return pyplot.figure(figsize=(width, height), layout="constrained")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained", dpi=dpi)
    FigureCanvasAgg(figure)
    return figure


def in_lines(text: str, width: int) -> str:
    """``text`` in lines of at most ``width`` characters; in two behind a colon or semicolon, where these hold it."""
    marks = (found.end() for found in re.finditer("[:;] ", text))
    at = next((end for end in marks if max(end - 1, len(text) - end) <= width < len(text)), 0)
    return f"{text[: at - 1]}\n{text[at:]}" if at else textwrap.fill(text, width)


def say(axis: Any, x: Sequence[float], y: Sequence[float], texts: Sequence[str]) -> None:
    """Store the tooltips of an axis' points for `save_figure`."""
    said = getattr(axis.figure, "radalt_said", [])
    axis.figure.radalt_said = said + list(zip([axis] * len(texts), x, y, texts, strict=True))


def save_figure(figure: Any, path: Path) -> None:
    """Write PNG (``path``), PDF and SVG without dates, so that equal rows give equal bytes.

    The canvases write directly: `savefig` draws every file twice, first for a layout that is computed once here.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.text import Text

    path.parent.mkdir(parents=True, exist_ok=True)
    axes = [axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]
    # powers of ten are math text
    scaled = (axis for axis in axes if axis.get_scale() == "log")
    powers = {label for axis in scaled for label in axis.get_ticklabels(which="both")}
    for text in set(figure.findobj(Text)) - powers:
        text.set_parse_math(False)  # names of files and methods may contain a dollar sign
    # TrueType fonts (42): publishers refuse Type 3
    with (
        writing(path),
        matplotlib.rc_context({"svg.hashsalt": path.stem, "pdf.compression": 6, "pdf.fonttype": 42}),
    ):
        figure.get_layout_engine().execute(figure)
        figure.set_layout_engine("none")
        for axis in axes:
            # otherwise computed per format and label: a quarter of the drawing time
            ticks = axis._update_ticks()
            axis._update_ticks = lambda ticks=ticks: ticks
        # level 4 of zlib: half the time of the default, 2 % larger
        png = {"metadata": {"Software": "gr-radalt"}, "pil_kwargs": {"compress_level": 4}}
        FigureCanvasAgg(figure).print_png(path, **png)
        metadata = {"Creator": "gr-radalt", "CreationDate": None}
        FigureCanvasPdf(figure).print_pdf(path.with_suffix(".pdf"), metadata=metadata)
        svg = io.StringIO()
        FigureCanvasSVG(figure).print_svg(svg, metadata={"Creator": "gr-radalt", "Date": None})
        said = _said(figure)
    head, end, tail = svg.getvalue().rpartition("</svg>")
    with writing(path.with_suffix(".svg")):
        path.with_suffix(".svg").write_text(head + said + end + tail, encoding="utf-8")


def _said(figure: Any) -> str:
    """Invisible SVG circles with tooltips, one per point of `say`."""
    points, height = 72.0 / figure.dpi, 72.0 * figure.get_figheight()
    circles = []
    for axis, x, y, text in getattr(figure, "radalt_said", []):
        if np.isfinite(x) and np.isfinite(y):
            across, up = points * axis.transData.transform((x, y))
            if not np.isfinite((across, up)).all():  # zero on a logarithmic axis
                continue
            circles.append(
                f'<circle cx="{across:.2f}" cy="{height - up:.2f}" r="4.5" opacity="0">'
                f"<title>{escape(text)}</title></circle>\n"
            )
    return "".join(circles)
