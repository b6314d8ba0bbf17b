"""Frames between blocks: vectors of N samples, each with one tag that carries index, counter and residual delay."""

import numpy as np
import pmt

from ..core.altimeter.frame_quality import QUALITY_DTYPE
from ..core.programme import SentAltitudes
from ..core.timing.segmenter import Frame

FRAME_KEY = pmt.intern("radalt_frame")
RX_TIME_KEY = pmt.intern("rx_time")
SENT_KEY = pmt.intern("radalt_altitude")


_QUALITIES = QUALITY_DTYPE.names


def frame_tag(frame: Frame, sent_m: float, quality: np.void):  # noqa: ANN201 - a pmt
    """Tag value of a frame, float64: index, sample counter, residual delay in s, altitude sent or NaN, quality."""
    place = [float(frame.index), float(frame.start_sample), frame.offset_s, sent_m]
    return pmt.init_f64vector(4 + len(_QUALITIES), [*place, *map(float, quality.item())])


def sent_tag(first_index: int, altitude_m: float | None):  # noqa: ANN201 - a pmt
    """Tag value of an altitude set by hand: first sweep at this altitude, metres (NaN: back to the programme)."""
    return pmt.init_f64vector(2, [float(first_index), np.nan if altitude_m is None else altitude_m])


def read_sent_tag(value, sent: SentAltitudes) -> None:  # noqa: ANN001 - a pmt
    """Store an altitude set by hand; raises `TagError`."""
    index, altitude_m = _numbers(SENT_KEY, value, 2)
    if not 0 <= index < 2**62 or altitude_m < 0 or np.isinf(altitude_m):
        raise TagError(f"tag radalt_altitude says {altitude_m:g} m from sweep {index:g} on; it is ignored")
    sent.set(int(index), None if np.isnan(altitude_m) else altitude_m)


def read_frame_tags(block, count: int) -> np.ndarray:  # noqa: ANN001
    """(count, 4 + q) tag values of the next ``count`` items of input 0, as `frame_tag`; NaN in rows without a tag.

    A malformed tag writes one line to the block's log; its frame counts as one without a tag.
    """
    tags, width = block.get_tags_in_window(0, 0, count, FRAME_KEY), 4 + len(_QUALITIES)
    try:
        values = [_numbers(FRAME_KEY, tag.value, width) for tag in tags]
    except TagError as error:
        say_once(block, error)
        tags = [tag for tag in tags if _is_vector(tag.value, width)]
        values = [pmt.f64vector_elements(tag.value) for tag in tags]
    if len(values) == count:  # one each, in order
        return np.array(values)
    out = np.full((count, width), np.nan)
    first = block.nitems_read(0)
    for tag, value in zip(tags, values, strict=True):
        out[tag.offset - first] = value
    return out


def read_quality(block, count: int) -> np.ndarray | None:  # noqa: ANN001
    """(count,) quality of the next frames of input 0 by their tags; None where one has no tag."""
    tags = read_frame_tags(block, count)
    return None if np.isnan(tags[:, 0]).any() else quality_of(tags)


def quality_of(tags: np.ndarray) -> np.ndarray:
    """(count,) quality of frames by their tags (`read_frame_tags`); NaN where one has none."""
    quality = np.empty(len(tags), dtype=QUALITY_DTYPE)
    for column, name in enumerate(_QUALITIES, 4):
        quality[name] = tags[:, column]
    return quality


def time_tag(counter: int, rate_hz: float):  # noqa: ANN201 - a pmt
    """``rx_time`` of a sample counter as UHD sets it: (whole seconds, fraction)."""
    whole, rest = divmod(counter, round(rate_hz))
    return pmt.make_tuple(pmt.from_uint64(int(whole)), pmt.from_double(rest / rate_hz))


def time_counter(value, rate_hz: float) -> int:  # noqa: ANN001 - a pmt
    """Sample counter of an ``rx_time`` tag; raises `TagError`."""
    try:
        seconds, fraction = pmt.to_uint64(pmt.tuple_ref(value, 0)), pmt.to_double(pmt.tuple_ref(value, 1))
    except Exception:  # pmt's errors have no common class
        raise TagError("tag rx_time is no (whole seconds, fraction); it is ignored") from None
    if not (0 <= seconds < 2**40 and 0 <= fraction < 1):
        raise TagError(f"tag rx_time says {seconds} s and {fraction:g}; it is ignored")
    return round(seconds * rate_hz) + round(fraction * rate_hz)


class TagError(ValueError):
    """A stream tag whose value does not fit its key; the message is one line."""


def _is_vector(value, count: int) -> bool:  # noqa: ANN001 - a pmt
    return pmt.is_f64vector(value) and pmt.length(value) == count


def _numbers(key, value, count: int):  # noqa: ANN001, ANN202 - pmts in, floats out
    if not _is_vector(value, count):
        raise TagError(f"tag {pmt.symbol_to_string(key)} is no vector of {count} float64; it is ignored")
    return pmt.f64vector_elements(value)


def say_once(block, error: TagError) -> None:  # noqa: ANN001
    """Log a malformed tag, and count the rest in ``bad_tags``."""
    block.bad_tags = getattr(block, "bad_tags", 0) + 1
    if block.bad_tags == 1:
        block.logger.warn(str(error))


_GATHER = 64  # frames per call where a ring of twice as many fits `_RING_BYTES`: calls cost 5 % less CPU per doubling
_GATHER_WIDE = 16  # frames per call where it does not
_RING_BYTES = 1 << 23  # largest output ring, bytes: 128 vectors of 7,500 complex samples take 7.7 MB
# fewest vectors of a ring: twice a call's frames, so that one half fills while the other empties
_FEWEST = 32


def gather_frames(block, samples: int, frames: int | None = None) -> None:  # noqa: ANN001
    """Make a block process up to ``frames`` frames per call, since a call costs as much as the work on a frame.

    Later blocks receive the same batches. Over all blocks together, eight frames per call took 10 % less CPU than
    four, and every doubling up to 64 another 5 %.
    """
    if frames is None:
        frames = max(_GATHER_WIDE, min(_GATHER, _RING_BYTES // (16 * samples)))
    block.set_output_multiple(frames * samples)
    _set_ring(block, 2 * frames * samples)


def frame_ring(block, samples: int) -> int:  # noqa: ANN001
    """Request an output ring of whole pages for vectors of ``samples`` samples; returns its number of vectors.

    GNU Radio warns where a ring is no whole number of pages. By default it allocates the smallest one, 8 vectors of
    56,000 samples, of which often none is free.
    """
    size = 8 * samples
    whole = 4096 // int(np.gcd(size, 4096))
    vectors = whole * -(-max(_FEWEST, min(128, _RING_BYTES // size)) // whole)
    _set_ring(block, vectors)
    return vectors


def _set_ring(block, items: int) -> None:  # noqa: ANN001
    """Size of a block's output ring, without GNU Radio's line about it: a flowgraph has ten of these."""
    level = block.log_level()
    block.set_log_level("warning")
    block.set_min_output_buffer(items)
    block.set_log_level(level)
