"""The one interface of every mitigation method."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, TypeVar

import numpy as np

from ..altimeter.frame_quality import levels, rail_peak
from ..usual_errors import usual_errors
from ..waveform import Waveform

_RESERVED = ("custom", "mitigation")  # the method of a file, and no method's name


class MitigationError(ValueError):
    """A method that cannot be built or does not fit; the message is one line for the user."""


@dataclass(frozen=True)
class PlotStyle:
    """How a method is drawn, the same in every figure."""

    colour: str
    """``#RRGGBB``, of Okabe and Ito's palette where one is left: distinguishable with any colour vision."""
    marker: str = "o"
    """In matplotlib's letters."""
    line: str | tuple[float, tuple[float, ...]] = "-"
    """(str or (offset, (on, off, ...))): solid ``"-"``, or dashes in points; marker and line tell methods apart in
    grey as well."""


class Mitigation(ABC):
    """Frames aligned with the sweep in, frames of the same shape out; state is explicit.

    Parameters
    ----------
    waveform : Waveform
        The sweep that frames are aligned with.

    Attributes
    ----------
    name : str
        Registry name.
    style : PlotStyle or None
        Style in figures; None takes the next unused one.
    batch : int
        Default number of frames per call of a block. More frames share the cost of a call. It is 1 for networks:
        their last bits depend on the batch, and results must not depend on the load.
    runs_network : bool
        Whether it needs ONNX Runtime.
    frames : int
        Frames processed since construction or `reset`.
    diverged_frames : int
        Frames in which an adaptive method left its stable region; always 0 for the others.
    beyond_frames : int
        Frames that passed unchanged because the ground lies beyond the span (`BeyondSpan`).
    frame_quality : callable
        Gives the quality of frames (n, N) that come without: a `FrameQuality` of the span that `create` was given.
    independent : bool
        Whether frames have nothing to do with each other, as where a scene draws every frame anew: what the method
        knows of earlier ones is then forgotten before each (`forget`).
    outside_cpu_ns : int
        CPU time spent on frames outside the calling thread, in nanoseconds; 0 except for `OwnProcess`.

    Notes
    -----
    `radalt.core.mitigation.create` gives every method the highest altitude that the altimeter searches. A frame whose
    strongest return lies beyond it passes unchanged and never reaches the method.
    """

    name = "mitigation"
    style: ClassVar[PlotStyle | None] = None
    batch: ClassVar[int] = 4
    runs_network: ClassVar[bool] = False
    outside_cpu_ns = 0
    independent = False
    # a method inside another one needs no more: its frames have been examined
    frame_quality: Callable[[np.ndarray], np.ndarray] = staticmethod(levels)

    def __init__(self, waveform: Waveform) -> None:
        self.waveform = waveform
        self.reset()

    def reset(self) -> None:
        """Forget the state from earlier frames."""
        self.frames = 0
        self.diverged_frames = 0
        self.beyond_frames = 0

    @usual_errors()
    def process(self, frames: np.ndarray, quality: np.ndarray | None = None) -> np.ndarray:
        """Clean ``(n, N)`` or ``(N,)`` complex64 frames; the input is left untouched.

        Frames are taken in the order given; splitting a batch does not change the result. A frame that is not finite
        gives a frame of NaN and does not touch the state, so the frame after it is right again. ``quality`` is (n,)
        of `QUALITY_DTYPE` where the frames' is known already.
        """
        frames = np.asarray(frames, dtype=np.complex64, order="C")
        if frames.ndim not in (1, 2) or frames.shape[-1] != self.waveform.samples_per_frame:
            raise MitigationError(
                f"{self.name}: frames have shape {frames.shape}; expected (n, {self.waveform.samples_per_frame})"
            )
        batch = np.atleast_2d(frames)
        out = np.empty_like(batch)
        self.process_into(batch, out, quality)
        return out.reshape(frames.shape)

    def process_into(self, frames: np.ndarray, out: np.ndarray, quality: np.ndarray | None = None) -> None:
        """Like `process`, (n, N) into ``out`` of the same shape."""
        if not len(frames):
            return
        quality = self.frame_quality(frames) if quality is None else quality
        self.frames += len(frames)
        finite = np.isfinite(quality["peak"])
        beyond = quality["beyond"] >= 1.0
        cleaned = finite & ~beyond
        if cleaned.all():
            self._clean_each(frames, out, quality)
            return
        self.beyond_frames += int(np.count_nonzero(beyond))
        out[:] = np.where(finite[:, None], frames, np.complex64(np.nan))
        if cleaned.any():
            part = frames[cleaned]
            self._clean_each(part, part_out := np.empty_like(part), quality[cleaned])
            out[cleaned] = part_out

    def _clean_each(self, frames: np.ndarray, out: np.ndarray, quality: np.ndarray) -> None:
        """`_clean_into`, frame by frame and without memory where the frames are independent."""
        if not (self.independent and self._remembers):
            self._clean_into(frames, out, quality)
            return
        for k in range(len(frames)):
            self.forget()
            self._clean_into(frames[k : k + 1], out[k : k + 1], quality[k : k + 1])

    def forget(self) -> None:  # noqa: B027 - most methods have no memory
        """Forget what earlier frames showed; counters stay. Overridden by methods that track."""

    @property
    def _remembers(self) -> bool:
        return type(self).forget is not Mitigation.forget

    def _clean_into(self, frames: np.ndarray, out: np.ndarray, quality: np.ndarray) -> None:
        """Like `_clean`, into ``out``; for methods that work in place, or use what is known of the frames."""
        out[:] = self._clean(frames)

    @abstractmethod
    def _clean(self, batch: np.ndarray) -> np.ndarray:
        """(n, N) finite complex64 in, the same shape out, as a new array; wider types are rounded to complex64."""

    @property
    def carries_altitude(self) -> bool:
        """Whether the output keeps the return's delay; where it does not, altitudes from it mean nothing."""
        return True

    def __repr__(self) -> str:
        w, status = self.waveform, self.status()
        model = f" of {status['model']}" if "model" in status else ""
        return (
            f"<{self.name}{model}: {w.bandwidth_hz / 1e6:g} MHz in {w.sweep_s * 1e3:g} ms, "
            f"{w.samples_per_frame} samples per frame; {self.frames} frames so far>"
        )

    def status(self) -> dict[str, object]:
        """Counters and state a report should show."""
        return {
            "method": self.name,
            "frames": self.frames,
            "diverged_frames": self.diverged_frames,
            "beyond_frames": self.beyond_frames,
            "carries_altitude": self.carries_altitude,
        }


_Class = TypeVar("_Class", bound=type[Mitigation])
METHODS: dict[str, type[Mitigation]] = {}  # by name, those of the package first


def register(cls: _Class) -> _Class:
    """Class decorator: makes the method known by its ``name``.

    Raises `MitigationError` if the name is no identifier, or another class has it.
    """
    if not cls.name.isidentifier():
        raise MitigationError(f"{cls.__name__}.name is {cls.name!r}; give it letters, digits and underscores")
    other = METHODS.get(cls.name, cls)
    if cls.name in _RESERVED or (other.__module__, other.__qualname__) != (cls.__module__, cls.__qualname__):
        raise MitigationError(f"{cls.__name__}.name {cls.name!r} is taken; choose another")
    METHODS[cls.name] = cls
    return cls


def peak_scale(batch: np.ndarray, peak: np.ndarray | None = None) -> np.ndarray:
    """(n, 1) float32 largest rail value of each (n, N) complex64 frame, 1 where it is zero or denormal.

    ``peak`` is `rail_peak` where that is known.
    """
    peak = rail_peak(batch) if peak is None else peak
    return np.where(peak >= np.finfo(np.float32).tiny, peak, np.float32(1))


def unit_peak(batch: np.ndarray, out: np.ndarray | None = None, peak: np.ndarray | None = None) -> np.ndarray:
    """(n, N) complex64 frames over their `peak_scale`, in ``out`` or a new array; ``peak`` as there.

    Rails times the inverse are the complex division to the bit, in a tenth of its time.
    """
    out = np.empty_like(batch) if out is None else out
    np.multiply(batch.view(np.float32), np.float32(1) / peak_scale(batch, peak), out=out.view(np.float32))
    return out
