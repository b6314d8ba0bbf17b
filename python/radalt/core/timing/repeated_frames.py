"""Frames that a frozen receiver repeats: equal bit for bit, or with the same noise, as frames with noise never are."""

import numpy as np

from ..altimeter.beat_spectra import BeatSpectra, Spectra
from ..spectral_line import noise_level

# time over which frames are compared, s: a driver that returns an old buffer repeats tens of frames
_MEMORY_S = 1.0
# Longest ring of old frames that a driver returns again and again, s: what tests/test_receiver_faults.py asks for.
_RING_S = 60.0
# Cells of noise by which frames are compared: by chance 24 phases agree to `_LIKE` for one pair in 30 million.
_NOISE_CELLS, _LIKE = 24, 0.85
# Largest difference, rad, of the phase by which noise and strongest line differ between two frames; share of the frames
# with the same noise that have it; times in a row with the same lag. Under interference that repeats itself exactly the
# return of an aircraft has another phase in all but one of a hundred.
_SAME_PHASE, _MOST, _TIMES = 0.3, 0.9, 3
# Power over the noise at which the difference of two frames has a line (white noise: once in a billion cells), and
# over the strongest line of a frame: below it is rounding.
_LINE, _ROUNDING = 21.0, 1e-9


class RepeatedFrames:
    """Notices frames that are equal to one of the last second.

    Works on *marks*: some numbers of each frame that differ between any two frames of a receiver with noise. The
    segmenter marks frames by their samples, the tracker by cells of their spectra.

    ``sweep_s``: duration of a frame in seconds.

    Examples
    --------
    >>> repeated, frames = RepeatedFrames(1e-3), np.random.default_rng(1).standard_normal((3, 8))
    >>> repeated.check(frames[[0, 1, 2, 1, 2]]).tolist()
    [False, False, False, True, True]
    """

    def __init__(self, sweep_s: float) -> None:
        self._memory = max(2, round(_MEMORY_S / sweep_s))
        self._seen: dict[bytes, int] = {}
        self._count = 0

    def reset(self) -> None:
        """Forget all frames."""
        self._seen.clear()

    def check(self, marks: np.ndarray) -> np.ndarray:
        """(n,) bool: which of these frames repeat an earlier one; ``marks`` is (n, ...) of any kind of number."""
        return np.array([self.again(mark.tobytes()) for mark in marks], dtype=bool)

    def again(self, word: bytes) -> bool:
        """Whether the next frame, whose marks are the bytes ``word``, repeats an earlier one."""
        count, seen = self._count, self._seen
        repeats = count - seen.get(word, -self._memory - 1) <= self._memory
        seen[word] = count
        self._count += 1
        if len(seen) > 2 * self._memory:
            self._seen = {word: number for word, number in seen.items() if number > count - self._memory}
        return repeats


class RepeatedNoise:
    """Notices a receiver whose noise comes again: a ring of up to a minute, or a buffer with another gain, phase or DC.

    The noise is that of cells off the span of altitudes, without the side lobes of a return, by phase alone, so that
    no strong line decides. One frame of each block is compared with all frames of the last minute. Interference may
    repeat itself, too: then a return that moves is left in the difference of two frames, where one is in the last
    second. A return that stands to the millimetre under such interference is taken for a frozen receiver.

    ``spectra``: by which the frames are transformed; ``step``: frames per comparison.
    """

    def __init__(self, spectra: BeatSpectra, step: int) -> None:
        self._step = step
        self._memory, self._recalled = (
            max(2 * step, round(time_s / spectra.waveform.sweep_s)) for time_s in (_RING_S, _MEMORY_S)
        )
        self._span = slice(*np.searchsorted(spectra.beat_hz, spectra.search_hz))
        per = max(1, round(1.0 / (spectra.cell_hz * spectra.waveform.half_sweep_s)))
        low, high = np.searchsorted(spectra.beat_hz, spectra.search_hz)
        around = np.r_[
            np.arange(low - 2 * per, per - 1, -per), np.arange(high + per, spectra.beat_hz.size - per, per)
        ]
        most = _NOISE_CELLS // 2  # of each half sweep
        self._at = around[np.linspace(0, around.size - 1, min(most, around.size)).round().astype(int)]
        self._per, self._rising = per, [slope > 0 for slope in spectra.waveform.half_slopes]
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        # pages of memory that no frame has filled yet are none
        self._noise = np.zeros((self._memory, 2 * self._at.size), dtype=np.complex64)
        self._lines = np.zeros((self._memory, 2), dtype=np.complex64)
        self._cells = np.zeros((self._memory, 2), dtype=np.int16)
        self._whole = np.zeros((self._recalled, 2, self._span.stop - self._span.start), dtype=np.complex64)
        self._count = self._times = self._lag = 0

    def check(self, received: Spectra, cleaned: Spectra, usable: np.ndarray) -> np.ndarray:
        """(k,) bool, of the usable ones of these frames, (n,) bool: those of a receiver that repeats.

        By the noise of the received frames, and the return of the cleaned ones.
        """
        again = np.zeros(int(usable.sum()), dtype=bool)
        if received.cells is None or cleaned.cells is None or not again.size:
            return again
        at, per = self._at, self._per
        cells = self._as_received(received.cells[usable])
        noise = cells[..., at] - 0.5 * (cells[..., at - per] + cells[..., at + per])
        noise /= np.maximum(np.abs(noise), np.finfo(np.float32).tiny)
        noise, whole = noise.reshape(len(cells), -1), cells[..., self._span]
        top = cleaned.power[usable].argmax(axis=-1)
        cells = self._as_received(cleaned.cells[usable])
        lines = np.take_along_axis(cells, top[..., None], axis=-1)[..., 0]
        first = 0
        while first < len(again):
            last = min(len(again), first + self._step - self._count % self._step)
            if self._count % self._step == 0:
                self._compare(noise[first], lines[first], top[first], whole[first])
            self._whole[(self._count + np.arange(last - first)) % self._recalled] = whole[first:last]
            self._store(noise[first:last], lines[first:last], top[first:last])
            again[first:last] = self._times >= _TIMES
            first = last
        return again

    def _as_received(self, cells: np.ndarray) -> np.ndarray:
        """Cells (n, 2, J), of a copy, with one phase for both half sweeps: those of a rising one are conjugates."""
        cells[:, self._rising] = cells[:, self._rising].conj()
        return cells

    def _store(self, noise: np.ndarray, lines: np.ndarray, cells: np.ndarray) -> None:
        at = self._count % self._memory
        self._count += len(noise)
        place = (at + np.arange(len(noise))) % self._memory
        self._noise[place], self._lines[place], self._cells[place] = noise, lines, cells

    def _compare(self, noise: np.ndarray, lines: np.ndarray, cells: np.ndarray, whole: np.ndarray) -> None:
        filled = min(self._count, self._memory)
        likeness = self._noise[:filled] @ noise.conj()
        near = np.nonzero(np.abs(likeness) >= _LIKE * noise.size)[0]
        phase = np.angle(self._lines[near] * lines.conj() * likeness[near, None].conj())
        same = (np.abs(phase) < _SAME_PHASE) & (np.abs(self._cells[near] - cells) <= 1)
        same = same.all(axis=1)
        lags = (self._count - near[same]) % self._memory if same.sum() >= _MOST * near.size else near[:0]
        if lags.size and self._moves(whole, int(lags.min())):
            lags = lags[:0]
        if self._times and self._lag in lags:
            self._times += 1
        else:
            self._times, self._lag = (1, int(lags.min())) if lags.size else (0, 0)

    def _moves(self, whole: np.ndarray, lag: int) -> bool:
        """Whether the frame that is so many frames older leaves a line in both half sweeps, if it is still there."""
        if lag > self._recalled:
            return False
        old = self._whole[(self._count - lag) % self._recalled]
        gain = np.sum(whole * old.conj(), axis=-1) / np.maximum(
            np.sum(np.abs(old) ** 2, axis=-1), np.finfo(np.float32).tiny
        )
        power = np.abs(whole - gain[:, None] * old) ** 2
        least = _LINE * noise_level(power) + _ROUNDING * np.max(np.abs(whole) ** 2, axis=-1)
        return bool((power.max(axis=-1) > least).all())
