"""OFDM, QPSK or both that are no short bursts are cancelled; all other frames go to the network, or are whitened."""

from __future__ import annotations

import numpy as np

from ..waveform import Waveform
from .base import Mitigation, MitigationError, PlotStyle
from .interference_detector import InterferenceDetector
from .joint import JointCancel
from .ofdm.tones import without_tones
from .ofdm_cancel import OfdmCancel
from .qpsk_cancel import QpskCancel
from .tcae import Tcae
from .whitening import Whitening

__all__ = ["Hybrid"]

# of a frame: of a shorter burst the other method leaves enough of the sweep
_OFDM_BURST, _QPSK_BURST = 0.45, 0.25
# mean error in a part of the frame: one emitter leaves 0.06, users of unequal powers up to 0.12, bursts of several
# emitters mostly 0.14 and more
_MISREAD = 0.12
# what is no return over what is, once OFDM is gone: 9 at an SNR of -10 dB, 11 to 15 where other bursts stay
_LEFT_DB = 10.0
_SPREAD = 0.06  # of the modulus while it sends: less two signals do not leave
_UNCLEAR_DB = -3.0  # what is no return over what is, in an output: more, and its method is at its limit
_LOST_DB = -1.0  # the same of the network: below it is better than whitening, or as good
# the same where all beside the return is white noise: the network can only make that smaller
_LOST_IN_WHITE_DB = -3.0
_DOUBTED_DB = -7.0  # the same, from which two signals in one band are looked for
# power taken from a burst of QPSK over what is left: 19 to 23 with one pulse, 13 where the sample grid cuts pulses
_SHALLOW_DB = 17.0
_SHARE = 2.0  # amplitude of what is left of QPSK, beside that output
_PARTS, _QUIET = 10, 0.25  # of a frame; power of the quietest part, of the mean, below which there is a burst
_SETTLED = 3  # frames followed in a row, after which a lost emitter is looked for at once
_ALIKE = 8  # frames of a live path, of which one tells whether the network or whitening has them
_NEW = 0.25  # its weight beside those before it
_SCATTER_DB = 1.0  # from the limit that it counts, at most
_LONGEST = 511  # frames between two looks of a live path, at most: one may take as long as a hundred frames
_OTHERS = ("tcae", "whitening")


class Hybrid(Mitigation):
    """`OfdmCancel` or `QpskCancel` where one can demodulate what fills the frame, the network or whitening elsewhere.

    Card: *choice by signal.* Each frame goes to the method that knows its interference, to `OfdmCancel` and
    `QpskCancel` without its tones, which are fitted and subtracted. A chain gains nothing, since the first leaves a
    signal that the second is not made for. The choice depends on what was demodulated, and on how much the network
    leaves, not on which altitude looks better. The method that had the last frame is asked first, and in a frame that
    shows no interference nothing is looked for. Where interference lasts for the whole frame and the network's output
    holds nearly as much beside the return as the return's power (half as much, if that is white noise), the network is
    at its end, and the frame is whitened.
    The network's output is added to what is left of a part of the frame with QPSK that no pulse explains well. Beside
    other bursts the network alone is better: it knows the quiet part. Before that, `JointCancel` is asked for QPSK and
    OFDM in one band.
    A frame that holds both costs some 5,000 transforms, which no live path has. There, looks that lead to no three
    frames that can be followed are 1, 3, 7 ... 511 frames apart. The other frames go to the network, several in one
    call. One in eight tells whether those after it are whitened instead.

    Parameters
    ----------
    other : str
        For all other frames: ``"tcae"`` (the shipped network) or ``"whitening"``, which needs no ONNX Runtime.
    joint : bool
        Whether QPSK and OFDM in one band are read jointly.
    live : bool
        Whether frames come from one antenna, one after the other, and have to be kept up with. Nothing is read jointly
        then, what cannot be followed is looked for less and less often, and the last bits depend on the batch.
    span_m : float or None
        See `OfdmCancel`.

    Attributes
    ----------
    cancelled : int
        Frames whose OFDM or QPSK was cancelled.

    Raises
    ------
    MitigationError
        As the two methods, or if ``other`` is neither.
    """

    name = "hybrid"
    style = PlotStyle("#EE3377", "X", (0, (8, 1)))
    batch = 1  # the network's last bits depend on the batch
    runs_network = True

    def __init__(
        self,
        waveform: Waveform,
        *,
        other: str = "tcae",
        joint: bool = True,
        live: bool = False,
        span_m: float | None = None,
    ) -> None:
        if other not in _OTHERS:
            raise MitigationError(f"hybrid.other is {other!r}; one of {', '.join(_OTHERS)}")
        self._ofdm = OfdmCancel(waveform, span_m=span_m)
        self._qpsk = QpskCancel(waveform)
        self._joint = JointCancel(waveform, span_m=span_m) if joint and not live else None
        self._live = live
        whitening = Whitening(waveform)
        # which frames the network is at its end in is asked here, and they are whitened
        self._other = Tcae(waveform, skip_lost=False) if other == "tcae" else whitening
        self._beside = whitening if other == "tcae" else None
        self._detector = InterferenceDetector(waveform)
        super().__init__(waveform)

    def reset(self) -> None:
        """See `Mitigation.reset`."""
        super().reset()
        self.cancelled = 0
        self._last: OfdmCancel | QpskCancel | None = None  # that had the frame before, if that had no tones
        self._followed = 0  # frames in a row
        self._pause = self._wait = 0  # frames after the next look, and until it, on a live path
        self._past_db = 0.0  # by which the network is past its end, by the frames of a live path that told
        self._others = 0  # frames of a live path that neither method had
        self._ofdm.reset()
        self._qpsk.reset()
        self._other.reset()
        if self._beside is not None:
            self._beside.reset()

    @property
    def sha256(self) -> str | None:
        """SHA-256 of the network's file; None without one."""
        return getattr(self._other, "sha256", None)

    def status(self) -> dict[str, object]:
        """See `Mitigation.status`; with the frames that were cancelled."""
        return super().status() | {"cancelled": self.cancelled}

    def _clean(self, batch: np.ndarray) -> np.ndarray:
        out = np.empty_like(batch)
        unread = np.zeros(len(batch), dtype=bool)
        for k, frame in enumerate(batch):
            read = self._one(frame)
            if read is None:
                unread[k] = True
            else:
                out[k] = read
        if unread.any():
            out[unread] = self._together(batch[unread])
        return out

    def _one(self, frame: np.ndarray) -> np.ndarray | None:
        """(N,) frame cleaned by the method that knows what fills it, the one that had the frame before first.

        None on a live path if neither knows it.
        """
        last, self._last, self._wait = self._last, None, max(0, self._wait - 1)
        out = None
        if last is not None:
            out = last.follow(frame)
            if out is not None and self._fills(last, out):
                self._last = last
                self._followed += 1
                self.cancelled += 1
                return out
        if not self._looks():
            return None
        if not self._detector.present(frame[None])[0]:
            return None if self._live else self._other.process(frame)  # nothing is there to look for
        heard = _toneless(frame)
        for method in (self._ofdm, self._qpsk):
            if method is last and out is not None:
                continue  # it has had this frame
            out = method.cancel(heard, toneless=True)
            if out is not None and self._fills(method, out):
                self._last = method if heard is frame else None
                self.cancelled += 1
                return self._helped(heard, out) if method is self._qpsk else out
        return None if self._live else self._elsewhere(frame, heard)

    def _looks(self) -> bool:
        """Whether this frame is searched; on a live path less and less often, where that leads to nothing."""
        if self._followed >= _SETTLED:
            self._pause = self._wait = 0
        self._followed = 0
        if self._wait:
            return False
        if self._live:
            self._pause = min(2 * self._pause + 1, _LONGEST)
            self._wait = self._pause + 1
        return True

    def _fills(self, method: OfdmCancel | QpskCancel, out: np.ndarray) -> bool:
        """Whether what a method cancelled fills so much of the frame that no other method is better; it left ``out``.

        Other emitters' bursts stand beside OFDM that fills a part of the frame if much is misread; or if little of what
        is left is a return, which is asked of a whole frame, too, where much is misread.
        """
        if method is self._qpsk:
            return method.busy >= _QPSK_BURST
        misread = method.misread > _MISREAD
        if method.busy == 1 and not misread:
            return True
        if method.busy < _OFDM_BURST or (misread and method.busy < 1):
            return False
        return bool(self._detector.residual_db(out[None])[0] < _LEFT_DB)

    def _helped(self, frame: np.ndarray, out: np.ndarray) -> np.ndarray:
        """(N,) what is left of a ``frame`` without its QPSK, ``out``; with the network's output where that fills a part
        of the frame and no pulse explains it well, or much stays beside the return."""
        if self._beside is None or self._qpsk.busy == 1:
            return out
        if self._qpsk.depth_db > _SHALLOW_DB and self._detector.residual_db(out[None])[0] < _UNCLEAR_DB:
            return out
        return _sum(self._other.process(frame), out)

    def _elsewhere(self, frame: np.ndarray, heard: np.ndarray) -> np.ndarray:
        """(N,) frame that neither method can read behind the other one; ``heard`` is it without its tones."""
        out = self._other.process(heard if self._beside is None else frame)
        left_db = self._detector.residual_db(out[None])[0]
        if not (_lasts(frame) and left_db > _DOUBTED_DB):
            return out
        # without a clock there is no QPSK, and two signals have no even modulus
        asked = self._joint is not None and self._qpsk.clocked and _spread(heard) > _SPREAD
        both = self._joint.cancel(heard) if asked else None
        if both is not None:
            self.cancelled += 1
            return both
        lost = self._beside is not None and self._past_end_db(heard, left_db) > 0
        return self._beside.process(heard) if lost else out

    def _past_end_db(self, frame: np.ndarray, left_db: float) -> float:
        """By which the network is past its end in an (N,) frame, if what it leaves beside the return is ``left_db``."""
        white = _LOST_IN_WHITE_DB < left_db <= _LOST_DB and self._detector.white(frame[None])[0]
        return left_db - (_LOST_IN_WHITE_DB if white else _LOST_DB)

    def _together(self, frames: np.ndarray) -> np.ndarray:
        """(n, N) frames of a live path behind the other method, in one call, or whitened; their tones with them.

        One in `_ALIKE` tells which it is of those that follow it.
        """
        if self._beside is None:
            return self._other.process(frames)
        out, lost = np.empty_like(frames), np.zeros(len(frames), dtype=bool)
        tells = (self._others + np.arange(len(frames))) % _ALIKE == 0
        self._others += len(frames)
        if tells.any():
            out[tells] = self._other.process(frames[tells])
        for k, frame in enumerate(frames):
            if tells[k] and _lasts(frame):
                past_db = self._past_end_db(frame, self._detector.residual_db(out[k : k + 1])[0])
                self._past_db += _NEW * (max(-_SCATTER_DB, min(past_db, _SCATTER_DB)) - self._past_db)
            lost[k] = self._past_db > 0 and _lasts(frame)
        rest = ~(lost | tells)
        if rest.any():
            out[rest] = self._other.process(frames[rest])
        if lost.any():
            out[lost] = self._beside.process(frames[lost])
        return out


def _sum(out: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """(N,) network's output ``out`` and `_SHARE` times as much of ``beside``, which another method left, in amplitude.

    Both hold the return, and their errors differ.
    """
    level, other = np.linalg.norm(out), np.linalg.norm(beside)
    return out + np.float32(_SHARE * level / other) * beside if 0 < other < np.inf else out


def _toneless(frame: np.ndarray) -> np.ndarray:
    """An (N,) frame without its tones, or as it is."""
    rest = without_tones(frame)
    return frame if rest is None else rest


def _lasts(frame: np.ndarray) -> bool:
    """Whether an (N,) frame has no part that is much quieter than the others."""
    part = frame.size // _PARTS
    power = [np.vdot(x, x).real for x in frame[: part * _PARTS].reshape(_PARTS, part)]
    return min(power) > _QUIET * np.mean(power)


def _spread(frame: np.ndarray) -> float:
    """Standard deviation of an (N,) frame's modulus over its mean, where it is loud."""
    size = np.abs(frame[::3].astype(np.complex128))  # squares of complex64 may overflow
    high = int(0.9 * size.size)
    loud = size[size > 0.5 * np.partition(size, high)[high]]
    return float(loud.std() / loud.mean()) if loud.size else np.inf
