"""Window of the live view: size, markers and status line; the flowgraph's snippet calls `dress`."""

import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from ...core.scene import Scene
from ..results.score import score_frames

SIZE = (1600, 950)  # size of the window, pixels, unless the screen is smaller or a size was stored
_EVERY_MS = 500  # time between updates of the status line, ms
_LEAST_PLOT = (220, 140)  # smallest plot, pixels
_SPEED_S = 3.0  # averaging time of the real-time factor, s
_FEW = 0.1  # least share of frames that counts as measured: false alarms alone give a hundredth
_TITLES = {"altimeter_none": "No mitigation", "altimeter_tcae": "TCAE", "altimeter_selected": "Chosen"}
# line and marker by Qwt's numbers: a line for the true altitude; ellipse, cross and x without a line for altimeters
_MARKS = ((1, 0), (2, 8), (3, 9))


class StatusLine:
    """Current measurements of the live view, as rich text of three lines; the flowgraph's blocks are found by name."""

    def __init__(self, top: Any, scene: Scene, clock: Callable[[], float] = time.monotonic) -> None:
        self._top, self._clock = top, clock
        self._second = max(1, round(1.0 / scene.waveform.sweep_s))  # frames per second
        self._rate = scene.waveform.rate_hz
        self._jammer = ", ".join(i.emitter.label.replace("_", " ") for i in scene.interference)
        self._seen: deque[tuple[float, int]] = deque()  # time, sample counter

    def text(self) -> str:
        """The current status."""
        segmenter = self._top.frame_segmenter.status()
        lines = (
            [self._altitude(segmenter), self._timing(segmenter)],
            self._scores(segmenter),
            [f"sent: {self._sent()}", self._losses(segmenter), self._speed()],
        )
        return "<big>" + "<br>".join(" &nbsp;|&nbsp; ".join(parts) for parts in lines) + "</big>"

    def _altitude(self, segmenter: dict[str, Any]) -> str:
        """The tracker's altitude behind the chosen method, with its protection level and status."""
        again = getattr(self._top, "reacquire", None)
        if again is not None and again.running:
            return _loud("REACQUIRING TIMING: 0 m is sent", good=False)
        line = self._top.altimeter_selected.line if segmenter["locked"] else "FAILURE (no timing)"
        return _loud(line.replace("+/-", "±"), good=line.startswith("NORMAL"))

    @staticmethod
    def _timing(segmenter: dict[str, Any]) -> str:
        if segmenter["state"] == "lost":
            return _loud("timing LOST, no frames: press Reacquire timing", good=False)
        if not segmenter["locked"]:
            return _loud("no timing, no frames: acquiring the sweep at altitude zero", good=False)
        return f"timing locked, {'checked' if segmenter['timing_verified'] else 'but the sweep is hidden'}"

    def _scores(self, segmenter: dict[str, Any]) -> list[str]:
        """Scores of each altimeter's last second, and the altimeters without detections."""
        out, blind = [], []
        for name, title in _TITLES.items():
            results, truth_m = getattr(self._top, name).latest(self._second)
            if name == "altimeter_selected":
                title = f"Chosen, {'no mitigation' if self._top.method == 'none' else self._top.method}:"
            if not (segmenter["locked"] and len(results)):
                out.append(f"{title} -")
                continue
            score = score_frames(results, truth_m)
            out.append(f"{title} <b>{score.pd:.2f}</b> ({score.wrong / max(1, score.trials):.2f})")
            if np.count_nonzero(results["valid"]) < _FEW * len(results):
                blind.append(title.partition(",")[0])
        parts = ["Pd (wrong and valid) in the last second: " + ", ".join(out)]
        return [*parts, _loud("no altitudes: " + ", ".join(blind), good=False)] if blind else parts

    def _sent(self) -> str:
        top = self._top
        gate = getattr(top, "radar_gate", None)
        why = None if gate is None else gate.gate.why_closed
        if why is not None:
            return _loud(f"nothing: {why}", good=False)
        if not top.tx_enable:
            return _loud("nothing (Transmit: Off)", good=False)
        radar = f"radar at {top.altitude_m:g} m"
        if top.tx_enable < 2 or not self._jammer or not top.overlap:
            return f"{radar}, no jammer"
        return f"{radar}, {self._jammer} at SIR {top.sir_db:g} dB, overlap {top.overlap:g}"

    @staticmethod
    def _losses(segmenter: dict[str, Any]) -> str:
        lost, dropped = segmenter["lost_samples"], segmenter["dropped_slow"]
        text = f"lost: {lost} samples, {dropped} frames (slow)"
        return _loud(text, good=False) if lost or dropped else text

    def _speed(self) -> str:
        now, counter = self._clock(), self._top.frame_segmenter.segmenter.sample_counter
        self._seen.append((now, counter))
        while len(self._seen) > 2 and now - self._seen[0][0] > _SPEED_S:
            self._seen.popleft()
        elapsed = now - self._seen[0][0]
        if elapsed <= 0:
            return "speed -"
        return f"{(counter - self._seen[0][1]) / self._rate / elapsed:.2f} of real time"


def _loud(text: str, *, good: bool) -> str:
    """Bold text, dark green or dark red."""
    return f'<b style="color:{"#005a2b" if good else "#a00000"}">{text}</b>'


def dress(top: Any, scene: Scene) -> None:
    """Set the size of the window and the markers of the altitude chart, and update the status line twice per second.

    ``top`` is the live flowgraph, constructed and not yet started.
    """
    from PyQt5 import Qt

    if top.settings.value("geometry") is None:
        room = Qt.QApplication.primaryScreen().availableGeometry()
        top.resize(min(SIZE[0], round(0.95 * room.width())), min(SIZE[1], round(0.92 * room.height())))
    for line, marker in _MARKS:
        top.altitude_chart.set_line_style(line, 0)
        top.altitude_chart.set_line_marker(line, marker)
    for widget in top.findChildren(Qt.QWidget):
        # controls of the vector sinks, without use here
        if widget.property("plainText") in ("Min Hold", "Max Hold"):
            widget.hide()
    _colour_bars(top, Qt)
    _make_room(top, Qt)
    status = StatusLine(top, scene)
    top.status_timer = Qt.QTimer()
    top.status_timer.timeout.connect(lambda: top.set_status(status.text()))
    top.status_timer.start(_EVERY_MS)


def _colour_bars(top: Any, qt: Any) -> None:
    """A bar of shades with its decibels under both waterfalls, whose level is that of the sum over an FFT's points."""
    for name in ("waterfall_before", "waterfall_after"):
        sink = getattr(top, name)
        ends = [db(0) - 20 * np.log10(sink.fft_size()) for db in (sink.min_intensity, sink.max_intensity)]
        cells = '<td style="color: white">{:.0f} dB</td><td align="right">{:.0f} dB over power 1</td>'
        bar = qt.QLabel(f'<table width="100%"><tr>{cells.format(*ends)}</tr></table>')
        bar.setStyleSheet("background: qlineargradient(x1: 0, x2: 1, stop: 0 black, stop: 1 white)")
        getattr(top, f"_{name}_win").layout().addWidget(bar, 1, 0)


def _make_room(top: Any, qt: Any) -> None:
    """Put the status into a label that wraps, since a tool bar hides long text, and let plots shrink."""
    grid = top.top_grid_layout
    bar = top._status_tool_bar
    row, column, rows, columns = grid.getItemPosition(grid.indexOf(bar))
    bar.hide()
    top._status_label = label = qt.QLabel(top.status)
    label.setWordWrap(True)
    label.setSizePolicy(qt.QSizePolicy.Ignored, qt.QSizePolicy.Preferred)
    grid.addWidget(label, row, column, rows, columns)
    for name in ("spectrum", "waterfall_before", "waterfall_after", "profile_chart", "altitude_chart"):
        window = getattr(top, f"_{name}_win")
        # plots take the remaining height; otherwise a wrapping label makes the window as high as their size hints
        window.setSizePolicy(qt.QSizePolicy.Ignored, qt.QSizePolicy.Ignored)
        for widget in (window, *window.findChildren(qt.QWidget)):
            if widget is window or widget.metaObject().className().endswith("Plot"):
                widget.setMinimumSize(*_LEAST_PLOT)
