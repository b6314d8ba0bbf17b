"""A bounded queue between a block and a file, so that a slow disk never delays a radio."""

import queue
import threading
from pathlib import Path

import numpy as np

_CHUNKS = 256  # length of the queue, chunks; a chunk is what one call of a block receives


class BoundedWriter:
    """Writes complex64 chunks in a separate thread.

    ``wait``: whether `offer` blocks while the queue is full (simulation) or refuses the chunk (radio).
    """

    def __init__(self, path: Path, *, wait: bool = False) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("wb")
        self._queue: queue.Queue[np.ndarray | None] = queue.Queue(_CHUNKS)
        self._wait = wait
        self.error: OSError | None = None
        self.highest = 0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def offer(self, samples: np.ndarray) -> bool:
        """Copy a chunk into the queue; False where it was refused."""
        if self.error is not None:
            raise self.error
        self.highest = max(self.highest, self._queue.qsize())
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
