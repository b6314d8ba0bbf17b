"""Your own method: a Python file with a function `mitigate`, or with a `Mitigation` of its own."""

import hashlib
import inspect
import os
import traceback
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np

from ..parsing import InputError, read_text
from ..waveform import Waveform
from .base import Mitigation, MitigationError, PlotStyle
from .trial_run import MOST_BYTES, try_out

_CONTRACT = "it needs a function mitigate(frames, waveform) or one subclass of Mitigation"


class Custom(Mitigation):
    """The method of a Python file, checked on one frame when it is loaded.

    The file holds either a function ``mitigate(frames, waveform)`` or one subclass of `Mitigation`. The function gets
    ``(n, N)`` complex64 frames aligned with the sweep and the `Waveform`, and returns cleaned frames of the same
    shape. The subclass may keep state from frame to frame. The file is executed: use it as you would any program.

    ``file``: Python file. Raises `MitigationError` if the file cannot be read or run, holds no method, or the method
    returns anything but frames; names the file, what is wrong and where. The same for whatever the method raises
    later.

    Examples
    --------
    A file ``limiter.py`` that takes the peaks off every spectrum::

        import numpy as np

        def mitigate(frames, waveform):
            spectrum = np.fft.fft(frames)
            level = np.abs(spectrum)
            limit = 3 * np.median(level, axis=-1, keepdims=True)
            return np.fft.ifft(spectrum * np.minimum(1, limit / level))
    """

    name = "custom"
    style = PlotStyle("#B2182B", "D")

    def __init__(self, waveform: Waveform, *, file: str | Path | None = None) -> None:
        if not file:
            raise MitigationError(f"method custom has no file; name one with --method-file: {_CONTRACT}")
        self.file = Path(file)
        try_out("method file", waveform, self.file)
        module = self._load()
        self._mitigate = self._method(module, waveform)
        self.sha256 = hashlib.sha256(self.file.read_bytes()).hexdigest()
        super().__init__(waveform)
        if not np.isfinite(self._clean(waveform.reference[None].copy()).view(np.float32)).all():
            raise MitigationError(
                f"method file {self.file}: its cleaned frame of a clean sweep is not finite; look for a division by 0"
            )
        self.reset()

    def _load(self) -> ModuleType:
        try:
            source = read_text(self.file, most_bytes=MOST_BYTES["method file"], what="method file")
        except InputError as error:
            raise MitigationError(str(error)) from None
        module = ModuleType(self.file.stem)
        module.__file__ = str(self.file)
        here = os.getcwd()
        try:
            self._guarded(lambda: exec(compile(source, str(self.file), "exec"), module.__dict__))
        finally:
            os.chdir(here)  # a file that changes it, perhaps to its own folder, would move the results
        return module

    def _method(self, module: ModuleType, waveform: Waveform) -> Callable[[np.ndarray], np.ndarray]:
        """The one thing in the file that cleans frames."""
        function = getattr(module, "mitigate", None)
        if callable(function):
            self._inner = None
            return lambda batch: function(batch, waveform)
        own = [c for c in vars(module).values() if inspect.isclass(c) and c.__module__ == module.__name__]
        own = [c for c in own if issubclass(c, Mitigation)]
        if len(own) != 1:
            found = "neither" if not own else f"{len(own)} subclasses"
            raise MitigationError(f"method file {self.file} holds {found}: {_CONTRACT}")
        self._inner = self._guarded(lambda: own[0](waveform))
        return self._inner.process

    def _guarded(self, call: Callable[[], object]) -> object:
        """Whatever the user's code raises, as one line with its place in the file."""
        try:
            return call()
        except (Exception, SystemExit) as error:  # somebody else's code: anything can come
            if isinstance(error, SyntaxError):
                line = error.lineno
            else:
                lines = [
                    f.lineno
                    for f in traceback.extract_tb(error.__traceback__)
                    if f.filename == str(self.file)
                ]
                line = lines[-1] if lines else None
            where = f", line {line}" if line else ""
            text = " ".join(str(error).split())[:150]
            raise MitigationError(
                f"method file {self.file}{where}: {type(error).__name__}: {text}"
            ) from error

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        given = batch.copy()  # the method may work in place
        out = self._guarded(lambda: np.asarray(self._mitigate(given)))
        if out.shape != batch.shape or out.dtype.kind != "c":
            raise MitigationError(
                f"method file {self.file} gives {out.dtype} of shape {out.shape}; expected complex frames of shape "
                f"{batch.shape}"
            )
        return out.astype(np.complex64)

    def reset(self) -> None:
        """Forget what was learnt from earlier frames, as far as the file's method can."""
        super().reset()
        if self._inner is not None:
            self._inner.reset()

    def forget(self) -> None:
        """See `Mitigation.forget`."""
        if self._inner is not None:
            self._inner.forget()

    @property
    def _remembers(self) -> bool:
        return self._inner is not None and self._inner._remembers

    def status(self) -> dict[str, object]:
        """See `Mitigation.status`: file and hash next to what the file's own method says."""
        inner = self._inner.status() if self._inner is not None else {}
        return (
            super().status() | inner | {"method": self.name, "model": self.file.name, "sha256": self.sha256}
        )
