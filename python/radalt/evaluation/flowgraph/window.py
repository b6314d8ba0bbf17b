"""What the live flowgraphs import: `by_hand`, and first of all one line where Qt would abort for want of a display."""

import os
import sys

from ...core.scene.live import by_hand

__all__ = ["by_hand"]

# a generated flowgraph as the program: neither grcc nor the companion, which import this, too
if "qtgui" in vars(sys.modules["__main__"]) and sys.platform.startswith("linux"):
    if not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")):
        remedy = "set DISPLAY, use xvfb-run, or measure without one: radalt eval --sim"
        print(f"no display for the window; {remedy}", file=sys.stderr)
        sys.exit(2)
