"""IQ recorder: received samples into a SigMF recording, so that a slow disk never delays a radio."""

import queue
import threading
from pathlib import Path

import numpy as np
from gnuradio import gr

from .. import __version__
from ..core.radio.recording import Stretch, write_metadata
from ..core.scene import Scene
from ._frames import RX_TIME_KEY, TagError, say_once, time_counter
from ._guard import guarded

_CHUNKS = 256  # length of the queue, chunks; a chunk is what one call of a block receives


class _Writer:
    """Writes complex64 chunks in a separate thread.

    ``wait``: whether `offer` blocks while the queue is full (simulation) or refuses the chunk (radio).
    """

    def __init__(self, path: Path, *, wait: bool = False) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("wb")
        self._queue: queue.Queue[np.ndarray | None] = queue.Queue(_CHUNKS)
        self._wait = wait
        self.error: OSError | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def offer(self, samples: np.ndarray) -> bool:
        """Copy a chunk into the queue; False where it was refused."""
        if self.error is not None:
            raise self.error
        try:
            self._queue.put(samples.copy(), block=self._wait)
        except queue.Full:
            return False
        return True

    def close(self) -> None:
        """Write the queue and close the file; raises the writer's error."""
        self._queue.put(None)
        self._thread.join()
        self._file.close()
        if self.error is not None:
            raise self.error

    def _run(self) -> None:
        while (samples := self._queue.get()) is not None:
            if self.error is None:
                try:
                    self._file.write(samples.view(np.uint8).data)
                except OSError as error:  # a full disk: `close` raises it; the queue is still emptied
                    self.error = error


class iq_recorder(gr.sync_block):
    """Writes the received samples, with scene, altitude and jammer state as annotations (SigMF).

    Category: [RadAlt]/Receiver. Ports: ``in: complex``.

    Parameters
    ----------
    scene : Scene
        Scene of the run; stored in the recording.
    file : str
        Path without ending: ``FILE.sigmf-data`` and ``FILE.sigmf-meta`` are written.
    drop_when_slow : bool
        Drop samples, counted as ``lost_samples`` and marked in the recording, when the disk cannot keep up (radio);
        off, the stream waits (simulation).
    Example
    -------
    ``rec = radalt.iq_recorder(scene, "flight")``
    """

    def __init__(self, scene: Scene, file: str = "capture", drop_when_slow: bool = False) -> None:
        gr.sync_block.__init__(self, "radalt_iq_recorder", [np.complex64], None)
        self._scene = scene
        self._rate = scene.waveform.rate_hz
        base = Path(file)
        self._data = base.with_name(base.name.removesuffix(".sigmf-meta") + ".sigmf-data")
        self._writer: _Writer | None = _Writer(self._data, wait=not drop_when_slow)
        self._stretches: list[Stretch] = []
        self._start_counter = 0
        self._counter = 0  # sample counter of the next sample
        self._written = 0
        self._broken = True
        self.lost_samples = 0
        self.latency_samples = 0.0
        self.radio: dict[str, float] = {}  # argument ``radio`` of `write_metadata`
        self.finish_at_stop = True

    def set_start_time(self, seconds: float) -> None:
        """Device time of the transmitter's first sample, as in `frame_segmenter.set_start_time`."""
        self._start_counter = round(seconds * self._rate)

    @property
    def sample_counter(self) -> int:
        """Counter of the next sample since the transmitter's first."""
        return self._counter

    @guarded
    def work(self, input_items, output_items) -> int:  # noqa: ANN001
        """Queue samples for the writer; every time tag and every loss begins a new stretch."""
        samples = input_items[0]
        first, at = self.nitems_read(0), 0
        tags = self.get_tags_in_window(0, 0, samples.size, RX_TIME_KEY)
        for tag in sorted(tags, key=lambda t: t.offset):
            try:
                counter = time_counter(tag.value, self._rate) - self._start_counter
            except TagError as error:
                say_once(self, error)
                continue
            self._write(samples[at : tag.offset - first])
            at = tag.offset - first
            self._broken |= counter != self._counter
            self._counter = counter
        self._write(samples[at:])
        return samples.size

    def _write(self, samples: np.ndarray) -> None:
        if samples.size == 0 or self._writer is None:
            return
        if not self._writer.offer(samples):
            self.lost_samples += samples.size
            self._broken = True
        else:
            if self._broken:
                self._stretches.append(Stretch(self._written, self._counter, 0))
                self._broken = False
            last = self._stretches[-1]
            self._stretches[-1] = Stretch(last.file_start, last.global_index, last.count + samples.size)
            self._written += samples.size
        self._counter += samples.size

    def finish(self) -> Path | None:
        """Close the recording; returns the ``.sigmf-meta``, or None where nothing was received."""
        if self._writer is None:
            return None
        writer, self._writer = self._writer, None
        writer.close()
        if not self._stretches:
            self._data.unlink()
            return None
        return write_metadata(
            self._data,
            self._scene,
            self._stretches,
            latency_samples=self.latency_samples,
            recorder=f"gr-radalt {__version__}",
            radio=self.radio,
        )

    def stop(self) -> bool:
        """Write the metadata at the flowgraph's end, unless a runner does so later."""
        if self.finish_at_stop:
            try:
                self.finish()
            except OSError as error:
                self.error = error
        return True
