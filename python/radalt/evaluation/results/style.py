"""Line styles of methods, the same in all figures.

Colours are Okabe and Ito's, distinguishable with any colour vision; marker, filling and line style distinguish the
methods in grey as well.
"""

from collections.abc import Sequence
from typing import Any

from ...core.mitigation import CUSTOM, METHODS, PlotStyle, method_class

# for methods without a registered style
_RESERVE = (
    PlotStyle("#666666", "X", "--"),
    PlotStyle("#8C6D1F", "<", "-."),
    PlotStyle("#5D3A9B", ">", ":"),
    PlotStyle("#A0A0A0", "h", "-"),
)


def series_style(series: str, order: Sequence[str]) -> dict[str, Any]:
    """Line style of one series (a method, or ``method, on the air``) among those of a figure."""
    method = series.split(",")[0]
    style = _style(method)
    if style is None:
        plain = [name for name in dict.fromkeys(o.split(",")[0] for o in order) if _style(name) is None]
        style = _RESERVE[plain.index(method) % len(_RESERVE)]
    return {
        "color": style.colour,
        "marker": style.marker,
        "linestyle": style.line,
        "markerfacecolor": "white" if series == method else style.colour,
        "markeredgecolor": style.colour,
        "label": series,
    }


def _style(method: str) -> PlotStyle | None:
    return method_class(method).style if method in (*METHODS, CUSTOM) else None
